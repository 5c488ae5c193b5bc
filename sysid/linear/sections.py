"""State-space models in sections of two states: their response, its derivatives, and the linear part.

A is block-diagonal with blocks of 2 x 2 whose four entries are all free; so two real poles may become a
complex pair and back, and each section is simulated and differentiated by itself.  An odd order has a last
section whose second state is not used.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.linear.forms import LARGEST_START, Complexes, Floats, section_coefficients
from sysid.linear.kernels import section_states
from sysid.linear.subspace import Run

RANK_TOLERANCE = 1e-10


@dataclass(frozen=True)
class Sections:
    """x(k+1) = A x + B u + drift, y = C x + D u + offset, A block-diagonal.

    The drift is that of integrators: where no pole is at 1 an offset does the same.

    Attributes
    ----------
    order : int
    A : ndarray, shape (n_sections, 2, 2)
    B : ndarray, shape (n_sections, 2, n_inputs + constant)
        With the drift as its last column if there is a constant.
    C : ndarray, shape (n_outputs, n_sections, 2)
    D : ndarray, shape (n_outputs, n_inputs)
    offset : ndarray, shape (n_outputs,)
    direct, constant, free_start : bool
        Whether D, offset and drift, and initial states are free; zero otherwise.
    starts : ndarray, shape (n_experiments, n_sections, 2)
        Initial states.
    """

    order: int
    A: Floats
    B: Floats
    C: Floats
    D: Floats
    offset: Floats
    direct: bool
    constant: bool
    free_start: bool
    starts: Floats

    @property
    def poles(self) -> Complexes:
        """Eigenvalues of A, those of largest modulus first."""
        found = np.linalg.eigvals(self.A[: self.order // 2]).ravel()
        if self.order % 2:
            found = np.append(found, self.A[-1, 0, 0])
        return np.asarray(sorted(found, key=lambda z: (-round(abs(z), 12), -z.imag)), dtype=np.complex128)

    @property
    def stable(self) -> bool:
        """Whether all poles lie inside the unit circle."""
        trace, size = self.A[:, 0, 0] + self.A[:, 1, 1], np.linalg.det(self.A)
        return bool(np.all(np.abs(trace) < 1.0 + size) and np.all(np.abs(size) < 1.0))

    def free(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Mark the unknowns of `vector` that may move."""
        used = np.ones(self.A.shape[0] * 2, dtype=bool)
        if self.order % 2:
            used[-1] = False
        alive = used.reshape(-1, 2)
        return np.concatenate(
            [
                (alive[:, :, np.newaxis] & alive[:, np.newaxis, :]).ravel(),
                np.repeat(alive.ravel(), self.B.shape[2]),
                np.tile(used, self.C.shape[0]),
                np.full(self.D.size, self.direct),
                np.full(self.offset.size, self.constant),
                np.tile(used & self.free_start, self.starts.shape[0]),
            ]
        )

    def vector(self) -> Floats:
        """Return all entries: A, B, C, D, offset, initial states."""
        parts = (self.A, self.B, self.C, self.D, self.offset, self.starts)
        return np.concatenate([part.ravel() for part in parts])

    def with_vector(self, values: Floats) -> "Sections":
        """Return the model with other entries."""
        parts = (self.A, self.B, self.C, self.D, self.offset, self.starts)
        cut = np.split(values, np.cumsum([part.size for part in parts])[:-1])
        A, B, C, D, offset, starts = (new.reshape(old.shape) for new, old in zip(cut, parts, strict=True))
        return replace(self, A=A, B=B, C=C, D=D, offset=offset, starts=starts)

    def matrices(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return A, B, C, D of shapes (order, order), (order, n_inputs), (n_outputs, order), (..)."""
        from scipy.linalg import block_diag

        n, n_outputs = self.order, self.C.shape[0]
        A = block_diag(*self.A)[:n, :n]
        B = self.B[:, :, : self.D.shape[1]].reshape(2 * self.A.shape[0], -1)
        return A, B[:n], self.C.reshape(n_outputs, -1)[:, :n], self.D

    @property
    def drift(self) -> Floats:
        """What is added to the state at each step, shape (order,)."""
        return self.B[:, :, -1].ravel()[: self.order] if self.constant else np.zeros(self.order)

    def _driving(self, u: Floats) -> Floats:
        """Return what drives the states: the inputs, and ones for the drift."""
        return np.column_stack([u, np.ones(u.shape[0])]) if self.constant else u

    def response(self, u: Floats, start: Floats) -> Floats:
        """Return the outputs of one experiment, shape (n_rows, n_outputs)."""
        y = self.offset + u @ self.D.T
        driving = self._driving(u)
        empty = np.empty((2, 6 + 2 * driving.shape[1], 0))
        for i in range(self.A.shape[0]):
            x = np.empty((2, u.shape[0]))
            section_states(self.A[i], self.B[i], start[i], driving, x, empty)
            y += x.T @ self.C[:, i, :].T
        return np.asarray(y)

    def slopes(self, run: Run, number: int) -> tuple[Floats, Floats]:
        """Return the outputs of an experiment of the fit and their derivatives by `vector`.

        Returns
        -------
        y : ndarray, shape (n_rows, n_outputs)
        J : ndarray, shape (n_rows, n_outputs, n_entries)
        """
        driving = self._driving(run.u)
        n_rows, m = driving.shape
        sections, p = self.A.shape[0], self.C.shape[0]
        sizes = [self.A.size, self.B.size, self.C.size, self.D.size, self.offset.size]
        at_B, at_C, at_D, at_offset, at_start = np.cumsum(sizes).tolist()
        J = np.zeros((n_rows, p, at_start + self.starts.size))
        y = self.offset + run.u @ self.D.T
        for i in range(sections):
            x, S = np.empty((2, n_rows)), np.empty((2, 6 + 2 * m, n_rows))
            section_states(self.A[i], self.B[i], self.starts[number, i], driving, x, S)
            y += x.T @ self.C[:, i, :].T
            by = np.einsum("oj,jck->koc", self.C[:, i, :], S)
            J[:, :, 4 * i : 4 * i + 4] = by[:, :, :4]
            first = at_B + 2 * m * i
            J[:, :, first : first + 2 * m] = by[:, :, 4 : 4 + 2 * m]
            first = at_start + 2 * sections * number + 2 * i
            J[:, :, first : first + 2] = by[:, :, 4 + 2 * m :]
            for o in range(p):
                first = at_C + 2 * sections * o + 2 * i
                J[:, o, first : first + 2] = x.T
        for o in range(p):
            first = at_D + run.u.shape[1] * o
            J[:, o, first : first + run.u.shape[1]] = run.u
            J[:, o, at_offset + o] = 1.0
        return y, J

    def with_linear_part(self, runs: Sequence[Run], weights: Floats) -> "Sections":
        """Return the model with the best B, D, offset and initial states for its A and C."""
        zero = replace(
            self,
            B=np.zeros_like(self.B),
            D=np.zeros_like(self.D),
            offset=np.zeros_like(self.offset),
            starts=np.zeros((len(runs), self.A.shape[0], 2)),
        )
        chosen = zero.free()
        chosen[: self.A.size] = False
        chosen[self.A.size + self.B.size : self.A.size + self.B.size + self.C.size] = False
        columns, target = [], []
        for number, run in enumerate(runs):
            _, J = zero.slopes(run, number)
            columns.append(
                (J[run.used][:, :, chosen] * weights[:, np.newaxis]).reshape(-1, int(chosen.sum()))
            )
            target.append((run.y[run.used] * weights).ravel())
        matrix = np.concatenate(columns)
        scale = np.linalg.norm(matrix, axis=0)
        scale[scale == 0.0] = 1.0
        found = np.linalg.lstsq(matrix / scale, np.concatenate(target), rcond=RANK_TOLERANCE)[0] / scale
        values = zero.vector()
        values[chosen] = found
        return zero.with_vector(values)


def sections_of_poles(reflections: Floats, n_inputs: int, direct: bool, constant: bool) -> Sections:
    """Return a model of one output with the poles of reflection coefficients, all else zero.

    A constant comes with free initial states.  Each section is in observable form, which holds equal poles
    too; the linear part is left to be fitted.
    """
    a1, a2 = section_coefficients(reflections)
    blocks = [[[-first, 1.0], [-second, 0.0]] for first, second in zip(a1, a2, strict=True)]
    C = np.zeros((1, len(blocks), 2))
    C[0, :, 0] = 1.0
    return Sections(
        order=reflections.size,
        A=np.array(blocks),
        B=np.zeros((len(blocks), 2, n_inputs + constant)),
        C=C,
        D=np.zeros((1, n_inputs)),
        offset=np.zeros(1),
        direct=direct,
        constant=constant,
        free_start=constant,
        starts=np.zeros((1, len(blocks), 2)),
    )


def sections_of(
    A: Floats, C: Floats, n_inputs: int, *, direct: bool, constant: bool, free_start: bool
) -> Sections:
    """Return a model in sections with this A and C, B and D zero.

    Complex pairs make a section each; real poles are paired by size, slow with slow.
    """
    order, p = A.shape[0], C.shape[0]
    poles, vectors = np.linalg.eig(A)
    limited = poles * np.minimum(1.0, LARGEST_START / np.maximum(np.abs(poles), 1e-300))
    pairs = [i for i in range(order) if poles[i].imag > 0.0]
    real = sorted((i for i in range(order) if poles[i].imag == 0.0), key=lambda i: -poles[i].real)
    blocks, readings = [], []
    for i in pairs:
        a, b = limited[i].real, limited[i].imag
        blocks.append([[a, b], [-b, a]])
        readings.append(C @ np.column_stack([vectors[:, i].real, vectors[:, i].imag]))
    for i in range(0, len(real), 2):
        two = real[i : i + 2]
        first, second = [*limited[two].real, 0.0][:2]
        blocks.append([[first, 0.0], [0.0, second]])
        reading = np.zeros((p, 2))
        reading[:, : len(two)] = C @ vectors[:, two].real
        readings.append(reading)
    n_sections = len(blocks)
    return Sections(
        order=order,
        A=np.array(blocks, dtype=np.float64),
        B=np.zeros((n_sections, 2, n_inputs + constant)),
        C=np.stack(readings, axis=1),
        D=np.zeros((p, n_inputs)),
        offset=np.zeros(p),
        direct=direct,
        constant=constant,
        free_start=free_start,
        starts=np.zeros((1, n_sections, 2)),
    )
