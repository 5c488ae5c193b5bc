"""The linear part of an output-error fit, eliminated by a QR that never holds the whole record.

The output B/A u + d/A + (initial state)/A is linear in B, d and the initial state once the poles are
given.  Rows are made block by block and folded into a triangular factor, so that memory does not
grow with the record; the initial state of each experiment is eliminated inside that experiment.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sysid.linear.forms import Floats, section_coefficients
from sysid.linear.kernels import all_pole_filter, kautz_columns, sensitivity_columns
from sysid.separable.factor import fold

BLOCK_ROWS = 4096
# Below this the response to the initial state has died out: it no longer adds a column.
DEAD = 1e-12
RANK_TOLERANCE = 1e-11


@dataclass(frozen=True)
class Structure:
    """What a linear output-error model consists of.

    Attributes
    ----------
    order : int
        Degree of A.
    delay : int
        First power of q^-1 in B; 0 is a direct term.  B has ``order`` coefficients, one more with a
        direct term.
    constant : bool
        Whether a constant acts in the difference equation.
    free_start : bool
        Whether each experiment starts from a state of its own; at rest otherwise.
    """

    order: int
    delay: int = 1
    constant: bool = False
    free_start: bool = True

    @property
    def direct(self) -> bool:
        """Whether the input acts on the output at once."""
        return self.delay == 0

    @property
    def n_numerator(self) -> int:
        """Coefficients of B for each input."""
        return self.order + int(self.direct)

    def n_shared(self, n_inputs: int) -> int:
        """Linear parameters that all experiments share."""
        return self.n_numerator * n_inputs + int(self.constant)

    def n_parameters(self, n_inputs: int) -> int:
        """Parameters of the transfer function and constant, initial states apart."""
        return self.order + self.n_shared(n_inputs)


@dataclass(frozen=True)
class Segment:
    """One experiment from its first row to the last row that is used.

    Attributes
    ----------
    u : ndarray, shape (n_rows, n_inputs)
    y : ndarray, shape (n_rows,)
    used : ndarray of bool, shape (n_rows,)
        Rows that count; the others are simulated and left out.
    """

    u: Floats
    y: Floats
    used: np.ndarray[tuple[int], np.dtype[np.bool_]]

    def shortened(self, rows: int) -> "Segment":
        """Return the segment up to its ``rows``-th used row."""
        places = np.flatnonzero(self.used)
        end = int(places[min(rows, places.size) - 1]) + 1
        return Segment(self.u[:end], self.y[:end], self.used[:end])


@dataclass(frozen=True)
class Projection:
    """The best linear parameters for given poles.

    Attributes
    ----------
    cost : float
        Sum of squared residuals.
    shared : ndarray, shape (n_shared,)
        Weights of the Kautz columns of each input, of the direct terms and of the constant.
    starts : list of ndarray, shape (order,)
        Weights of the initial state of each experiment.
    """

    cost: float
    shared: Floats
    starts: tuple[Floats, ...]


def shifted(u: Floats, structure: Structure) -> Floats:
    """Return the input that enters the sections: delayed, at least by one sample.

    Before the record the input is zero at rest; with a free start it is held at its first value.
    """
    shift = max(structure.delay, 1)
    moved = np.empty_like(u)
    moved[:shift] = u[0] if structure.free_start else 0.0
    moved[shift:] = u[:-shift] if shift < u.shape[0] else u[:0]
    return moved


class Columns:
    """The linear columns of one experiment, made block after block."""

    def __init__(self, structure: Structure, reflections: Floats, u: Floats):
        self.structure = structure
        self.a1, self.a2 = section_coefficients(reflections)
        self.u = u
        self.moved = np.ascontiguousarray(shifted(u, structure).T)
        n_sections = self.a1.size
        self.start_state = np.zeros((n_sections, 2))
        self.input_states = np.zeros((u.shape[1], n_sections, 2))
        self.constant_state = np.zeros((n_sections, 2))
        self.start_alive = structure.free_start

    def fill_start(self, first: int, last: int, out: Floats) -> None:
        """Fill the responses to the initial state, shape (order, rows)."""
        impulse = np.zeros(last - first)
        if first == 0:
            impulse[0] = 1.0
        kautz_columns(impulse, self.a1, self.a2, self.structure.order, self.start_state, out)
        self.start_alive = bool(np.abs(self.start_state).max() > DEAD)

    def fill_shared(self, first: int, last: int, out: Floats) -> None:
        """Fill the columns that all experiments share, shape (n_shared, rows)."""
        order = self.structure.order
        place = 0
        for channel in range(self.u.shape[1]):
            kautz_columns(
                self.moved[channel, first:last],
                self.a1,
                self.a2,
                order,
                self.input_states[channel],
                out[place : place + order],
            )
            place += order
        if self.structure.direct:
            out[place : place + self.u.shape[1]] = self.u[first:last].T
            place += self.u.shape[1]
        if self.structure.constant:
            all_pole_filter(np.ones(last - first), self.a1, self.a2, self.constant_state, out[place])


class Reduction:
    """Triangular factors of a set of experiments for given poles."""

    def __init__(self, segments: tuple[Segment, ...], structure: Structure, reflections: Floats):
        self.segments = segments
        self.structure = structure
        self.reflections = reflections
        self.n_shared = structure.n_shared(segments[0].u.shape[1])

    @cached_property
    def projection(self) -> Projection:
        """The best linear parameters and their cost."""
        triangle, local = self._reduce(None)
        p = self.n_shared
        shared = solve(triangle[:p, :p], triangle[:p, -1])
        residual = triangle[:, -1].copy()
        residual[:p] -= triangle[:p, :p] @ shared
        starts = tuple(solve(left, right[:, -1] - right[:, :-1] @ shared) for left, right in local)
        return Projection(float(residual @ residual), shared, starts)

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return self.projection.cost

    def output(self, projection: Projection) -> Floats:
        """Return the modelled output on the used rows of all experiments."""
        parts = []
        for number, segment in enumerate(self.segments):
            columns = Columns(self.structure, self.reflections, segment.u)
            block = np.empty((self.n_shared, segment.y.size))
            columns.fill_shared(0, segment.y.size, block)
            output = projection.shared @ block
            if self.structure.free_start:
                block = np.empty((self.structure.order, segment.y.size))
                columns.fill_start(0, segment.y.size, block)
                output += projection.starts[number] @ block
            parts.append(output[segment.used])
        return np.concatenate(parts)

    def linearise(self) -> tuple[Floats, Floats]:
        """Return J (triangular) and r, linear parameters eliminated, in the reflection coefficients.

        The cost near the poles is |r + J step|^2 plus what no step can remove.  Holding B while A
        moves gives the columns q^-i output / A_j, whatever the linear parameters; their part inside
        the span of the linear columns is projected out (the Jacobian of Kaufman).
        """
        triangle, _ = self._reduce(self.projection)
        p, order = self.n_shared, self.structure.order
        corner = triangle[p : p + order, p : p + order]
        return -corner @ self._chain(), triangle[p : p + order, -1]

    def _chain(self) -> Floats:
        """Return d(a1, a2 of each section)/d(reflection coefficients)."""
        order = self.structure.order
        chain = np.eye(order)
        for place in range(0, order - 1, 2):
            k1, k2 = self.reflections[place : place + 2]
            chain[place, place] = 1.0 + k2
            chain[place, place + 1] = k1
        return chain

    def _reduce(self, projection: Projection | None) -> tuple[Floats, list[tuple[Floats, Floats]]]:
        """Return the shared triangle and, for each experiment, the rows that give its initial state."""
        order = self.structure.order
        n_sensitivity = 0 if projection is None else order
        width = self.n_shared + n_sensitivity + 1
        triangle: Floats | None = None
        local = []
        for number, segment in enumerate(self.segments):
            columns = Columns(self.structure, self.reflections, segment.u)
            sensitivity_state = np.zeros((columns.a1.size, 2))
            start_weights = (
                None if projection is None or not columns.start_alive else projection.starts[number]
            )
            own: Floats | None = None
            for first in range(0, segment.y.size, BLOCK_ROWS):
                last = min(first + BLOCK_ROWS, segment.y.size)
                n_start = order if columns.start_alive else 0
                block = np.empty((n_start + width, last - first))
                if n_start:
                    columns.fill_start(first, last, block[:n_start])
                columns.fill_shared(first, last, block[n_start : n_start + self.n_shared])
                block[-1] = segment.y[first:last]
                if projection is not None:
                    output = projection.shared @ block[n_start : n_start + self.n_shared]
                    if n_start and start_weights is not None:
                        output += start_weights @ block[:n_start]
                    sensitivity_columns(
                        output, columns.a1, columns.a2, order, sensitivity_state, block[-1 - order : -1]
                    )
                used = segment.used[first:last]
                if not used.all():
                    block = block[:, used]
                if n_start:
                    own = fold(own, block)
                else:
                    triangle = fold(triangle, block)
            if self.structure.free_start:
                left, right, rest = _split(own, order, width)
                triangle = fold(triangle, rest)
                local.append((left, right))
        assert triangle is not None
        return triangle, local


def _split(own: Floats | None, order: int, width: int) -> tuple[Floats, Floats, Floats]:
    """Split an experiment's triangle into the rows for its initial state and the rest.

    A state that no used row sees (its response died out before) has a zero on the diagonal; its
    row then belongs to the rest.
    """
    if own is None:
        return np.zeros((order, order)), np.zeros((order, width)), np.zeros((width, 0))
    seen = np.abs(np.diag(own)[:order]) > DEAD
    left = np.where(seen[:, np.newaxis], own[:order, :order], 0.0)
    right = np.where(seen[:, np.newaxis], own[:order, order:], 0.0)
    rest = np.vstack([own[order:, order:], own[:order, order:][~seen]])
    return left, right, np.ascontiguousarray(rest.T)


def solve(triangle: Floats, right: Floats) -> Floats:
    """Solve in the least-squares sense with unit columns, dropping directions that data do not show."""
    if right.size == 0:
        return np.zeros(0)
    scale = np.linalg.norm(triangle, axis=0)
    scale[scale == 0.0] = 1.0
    return np.asarray(np.linalg.lstsq(triangle / scale, right, rcond=RANK_TOLERANCE)[0] / scale)
