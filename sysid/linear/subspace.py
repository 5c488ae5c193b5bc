"""Subspace identification by one QR factorisation: PO-MOESP and PI-MOESP, several inputs and outputs.

Sources: Verhaegen, Dewilde (1992), Subspace model identification, part 1, Int. J. Control 56(5); Verhaegen
(1994), Identification of the deterministic part of MIMO state space models given in innovations form from
input-output data, Automatica 30(1).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.data.record import Mask
from sysid.linear.forms import LARGEST_START, Complexes, Floats
from sysid.linear.reduction import BLOCK_ROWS
from sysid.separable.factor import fold

PAST_OUTPUTS, PAST_INPUTS = "PO-MOESP", "PI-MOESP"
INSTRUMENTS = (PAST_OUTPUTS, PAST_INPUTS)
FACTORED_ROWS = 30_000


@dataclass(frozen=True)
class Run:
    """One experiment with several inputs and outputs.

    Attributes
    ----------
    u : ndarray, shape (n_rows, n_inputs)
    y : ndarray, shape (n_rows, n_outputs)
    used : ndarray of bool, shape (n_rows,)
        Rows that count.
    """

    u: Floats
    y: Floats
    used: Mask


@dataclass(frozen=True)
class Factor:
    """Triangular factor of a constant and the block-Hankel matrices of the signals.

    Attributes
    ----------
    triangle : ndarray
        R of the QR factorisation; its columns are the constant, future inputs, past inputs, past outputs and
        future outputs.
    depth : int
        Block rows of past and of future.
    n_inputs, n_outputs : int
    """

    triangle: Floats
    depth: int
    n_inputs: int
    n_outputs: int

    def observability(self, instruments: str) -> tuple[Floats, Floats]:
        """Return the left singular vectors that span the extended observability matrix, and their sizes.

        PO-MOESP takes past inputs and outputs as instruments; PI-MOESP past inputs alone, so that it is
        consistent whatever the colour of noise that does not come from the input.
        """
        inputs, outputs = self.depth * self.n_inputs, self.depth * self.n_outputs
        first = 1 + inputs
        last = -outputs if instruments == PAST_OUTPUTS else first + inputs
        part = self.triangle[first:last, -outputs:].T
        left, sizes, _ = np.linalg.svd(part, full_matrices=False)
        return left, sizes

    def dynamics(self, instruments: str, order: int) -> tuple[Floats, Floats]:
        """Return A and C of an order, by the shift of the observability matrix; A made stable."""
        left, sizes = self.observability(instruments)
        gamma = left[:, :order] * np.sqrt(np.maximum(sizes[:order], 1e-14 * sizes[0]))
        p = self.n_outputs
        A = np.linalg.lstsq(gamma[:-p], gamma[p:], rcond=None)[0]
        return stabilised(np.asarray(A)), gamma[:p].copy()


def factorise(runs: Sequence[Run], depth: int) -> Factor | None:
    """Factorise the block-Hankel matrices of a record; None if too few rows follow one another.

    Parameters
    ----------
    runs : sequence of Run
    depth : int
        Block rows of past and of future, more than the order.
    """
    triangle: Floats | None = None
    rows_left, counted = FACTORED_ROWS, 0
    for run in runs:
        usable = np.flatnonzero(run.used)
        usable = usable[usable >= 2 * depth - 1][:rows_left]
        rows_left -= usable.size
        counted += usable.size
        if usable.size == 0:
            continue
        u, y = run.u.T, run.y.T
        past = range(2 * depth - 1, depth - 1, -1)
        future = range(depth - 1, -1, -1)
        for first in range(0, usable.size, BLOCK_ROWS):
            rows = usable[first : first + BLOCK_ROWS]
            blocks = [(u, future), (u, past), (y, past), (y, future)]
            stacked = [signal[:, rows - lag] for signal, lags in blocks for lag in lags]
            # The constant takes off whatever offsets the signals have.
            triangle = fold(triangle, np.ascontiguousarray(np.vstack([np.ones(rows.size), *stacked])))
    n_inputs, n_outputs = runs[0].u.shape[1], runs[0].y.shape[1]
    if triangle is None or counted < 2 * depth * (n_inputs + n_outputs):
        return None
    return Factor(triangle, depth, n_inputs, n_outputs)


def stabilised(A: Floats) -> Floats:
    """Return A with eigenvalues outside the unit circle mirrored into it.

    Examples
    --------
    >>> import numpy as np
    >>> np.round(stabilised(np.array([[2.0, 1.0], [0.0, 0.5]])), 12)
    array([[0.5, 0. ],
           [0. , 0.5]])
    """
    poles, vectors = np.linalg.eig(A)
    size = np.abs(poles)
    if size.max(initial=0.0) <= LARGEST_START:
        return A
    if np.linalg.cond(vectors) > 1e10:  # nearly defective: the mirror would not be real
        return np.asarray(A * (LARGEST_START / size.max()))
    mirrored = np.where(size > 1.0, poles / np.maximum(size, 1.0) ** 2, poles)
    limited = mirrored * np.minimum(1.0, LARGEST_START / np.maximum(np.abs(mirrored), 1e-300))
    return np.asarray((vectors * limited @ np.linalg.inv(vectors)).real)


def subspace_poles(runs: Sequence[Run], orders: range) -> dict[int, list[Complexes]]:
    """Return poles of each order from one factorisation, by PO-MOESP and by PI-MOESP."""
    factor = factorise(runs, max(orders) + 4)
    if factor is None:
        return {}
    return {
        order: [
            np.asarray(np.linalg.eigvals(factor.dynamics(kind, order)[0]), dtype=np.complex128)
            for kind in INSTRUMENTS
        ]
        for order in orders
    }
