"""Boundaries of a piecewise affine map inside a linear system: exact improvement along lines.

A region is where its separator, an affine function of z, is the greatest; see `PiecewiseAffineMap`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled
from sysid.lft.piecewise import Integers, Rows
from sysid.nonlinearities.piecewise_affine.kernels import between, centred, thresholds

Floats = NDArray[np.float64]

ENOUGH = 1e-12
"""A step that lowers the cost by less than this share of it is rounding."""


def regions_of(separators: Floats, phi: Floats) -> Integers:
    """Return the region of each row of phi."""
    return np.asarray(np.argmax(phi @ separators.T, axis=1))


def values(theta: Floats, regions: Integers, phi: Floats) -> Floats:
    """Return the value of each row of phi by the submodel of its region."""
    return np.asarray(np.einsum("ij,ij->i", theta[regions], phi))


@compiled
def _sweep(
    residual: Floats, filter_: Floats, at: Integers, order: Integers, change: Floats
) -> tuple[int, float]:
    """Move samples over the boundary one after another; return the best count of moves, and its cost."""
    cost = 0.0
    for i in range(residual.size):
        cost += residual[i] * residual[i]
    best, best_cost = 0, cost
    for count in range(order.size):
        k = order[count]
        for lag in range(min(filter_.size, at.size - k)):
            row = at[k + lag]
            if row >= 0:
                moved = residual[row] - filter_[lag] * change[k]
                cost += moved * moved - residual[row] * residual[row]
                residual[row] = moved
        if cost < best_cost:
            best, best_cost = count + 1, cost
    return best, best_cost


@dataclass(frozen=True)
class Boundaries:
    """The one-step cost as a function of the boundaries alone, everything else held.

    Attributes
    ----------
    rows : Rows
    theta : ndarray, shape (n_regions, n_z + 1)
        Submodel of each region.
    filter : ndarray, shape (n_g + 1,)
        Coefficients of G, the leading one included.
    target : ndarray, shape (n_rows,)
        Output less what the measured regressors explain.
    """

    rows: Rows
    theta: Floats
    filter: Floats
    target: Floats

    def residual(self, regions: Integers) -> Floats:
        """Return the prediction errors of a partition."""
        w = values(self.theta, regions, self.rows.phi)
        moving = sum(c * self.rows.delayed(w, lag) for lag, c in enumerate(self.filter))
        return np.asarray(self.target - moving)

    def line(self, separators: Floats, i: int, direction: Floats) -> tuple[float, float]:
        """Minimise exactly over the step t in ``separators[i] + t direction``.

        Each sample enters or leaves the region at one t and touches n_g + 1 residuals, so all cells of
        the line are examined in the time of a sort.

        Returns
        -------
        step, cost
            The middle of the best cell, and the cost there.
        """
        phi = self.rows.phi
        n = phi.shape[0]
        rival, place, rate = np.empty(n, np.intp), np.empty(n), np.empty(n)
        thresholds(np.ascontiguousarray(self.rows.z), separators, i, direction, rival, place, rate)
        moving = np.isfinite(place)
        inside = np.where(moving, rate < 0.0, place < 0.0)  # at t = -infinity
        value_in = phi @ self.theta[i]
        value_out = values(self.theta, rival, phi)
        change = np.where(inside, value_out - value_in, value_in - value_out)
        order = np.flatnonzero(moving)
        order = order[np.argsort(place[order], kind="stable")]
        residual = self.residual(np.where(inside, i, rival))
        best, cost = _sweep(residual, self.filter, self.rows.at, order, change)
        low = place[order[best - 1]] if best > 0 else -np.inf
        high = place[order[best]] if best < order.size else np.inf
        return float(between(low, high)), cost


def improve(
    boundaries: Boundaries, separators: Floats, rng: np.random.Generator, lines: int = 12, rounds: int = 20
) -> Floats:
    """Lower the cost over the boundaries by exact line minimisation until no line of a round helps.

    Parameters
    ----------
    boundaries : Boundaries
    separators : ndarray, shape (n_regions, n_z + 1)
        Start.
    rng : Generator
        Draws the lines beside those along the axes.
    lines : int
        Random lines a region and round.
    rounds : int
        Limit.

    Returns
    -------
    ndarray, shape (n_regions, n_z + 1)
        As good as the start or better.
    """
    separators = separators - separators[0]  # only differences count, so the first one stands still
    spread, n = _spread(boundaries.rows), separators.shape[1]
    cost = float(np.sum(boundaries.residual(regions_of(separators, boundaries.rows.phi)) ** 2))
    for _ in range(rounds):
        before = cost
        for i in range(1, separators.shape[0]):
            size = float(np.linalg.norm(separators[i] * spread)) or 1.0
            for way in np.vstack([np.eye(n), rng.standard_normal((lines, n))]):
                direction = size * way / spread
                step, found = boundaries.line(separators, i, direction)
                if found < cost * (1.0 - ENOUGH):
                    separators[i] += step * direction
                    cost = found
        if cost >= before * (1.0 - ENOUGH):
            break
    return separators


def middle(separators: Floats, rows: Rows, rng: np.random.Generator, lines: int = 200) -> Floats:
    """Return separators in the middle of all that part the samples alike."""
    ways = rng.standard_normal((lines, separators.shape[1]))
    spread = _spread(rows)
    scaled = np.ascontiguousarray(rows.z / spread[:-1])
    found = centred(scaled, np.ascontiguousarray(separators * spread), ways) / spread
    alike = np.array_equal(regions_of(found, rows.phi), regions_of(separators, rows.phi))
    return np.asarray(found) if alike else separators


def _spread(rows: Rows) -> Floats:
    sizes = rows.z.std(axis=0)
    return np.append(np.where(sizes > 0.0, sizes, 1.0), 1.0)
