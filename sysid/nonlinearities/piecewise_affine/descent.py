"""Descent over separators: exact line searches along many directions, to a point none of them improves."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sysid.nonlinearities.piecewise_affine.kernels import best_step, best_step_of_costs
from sysid.nonlinearities.piecewise_affine.points import Points

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]

ENOUGH = 1e-9
"""A step that lowers the cost by less than this share of it is no progress."""


def directions(points: Points, rng: np.random.Generator, count: int) -> Floats:
    """Return directions in which to move a separator, shape (count, n_z + 1).

    The axes come first: each tilts it about another line, the last one shifts it.  Others are random.
    """
    axes = np.eye(points.n_z + 1)[::-1]
    others = rng.standard_normal((max(count - axes.shape[0], 0), points.n_z + 1))
    return np.concatenate([axes, others])[:count]


def descend(points: Points, rows: Floats, ways: Floats, least: int) -> tuple[Floats, float]:
    """Return separators that no single step along ``ways`` improves, and the sum of squares, scaled.

    Submodels are fitted anew at every step.  The cost is infinite where no step is admitted at all.
    """
    now, cost = rows.copy(), np.inf
    tried = 0
    for i, way in _turns(rows.shape[0], ways):
        step, reached = best_step(points.z, points.w, now, i, way, least)
        if reached < cost * (1.0 - ENOUGH) - 1e-15 * points.n:
            now[i] += step * way
            _keep_small(now)
            cost, tried = reached, 0
        else:
            tried += 1
        if tried >= ways.shape[0] * (rows.shape[0] - 1):
            break
    return now, cost


def roam(
    points: Points, rows: Floats, cost: float, rng: np.random.Generator, least: int, patience: int = 100
) -> tuple[Floats, float]:
    """Go on along fresh random directions until ``patience`` of them in turn do not help."""
    now, tried = rows.copy(), 0
    while tried < patience:
        i, way = 1 + int(rng.integers(rows.shape[0] - 1)), rng.standard_normal(points.n_z + 1)
        step, reached = best_step(points.z, points.w, now, i, way, least)
        tried += 1
        if reached < cost * (1.0 - ENOUGH) - 1e-15 * points.n:
            now[i] += step * way
            _keep_small(now)
            cost, tried = reached, 0
    return now, cost


def assign(points: Points, costs: Floats, rows: Floats, ways: Floats) -> Floats:
    """Return separators near ``rows`` that send each point to a region of little cost, costs given."""
    now = rows.copy()
    tried = 0
    scale = max(float(costs.sum()), 1e-300)
    for i, way in _turns(rows.shape[0], ways):
        step, change = best_step_of_costs(points.z, costs, now, i, way)
        if change < -1e-12 * scale:
            now[i] += step * way
            _keep_small(now)
            tried = 0
        else:
            tried += 1
        if tried >= ways.shape[0] * (rows.shape[0] - 1):
            break
    return now


def _turns(regions: int, ways: Floats) -> Iterator[tuple[int, Floats]]:
    """Go round through separators and directions; of the separators one may stand still."""
    for _ in range(40):
        for way in ways:
            for i in range(1, regions):
                yield i, way


def _keep_small(rows: Floats) -> None:
    """Scale the separators, which changes no region, to keep their numbers near one."""
    rows -= rows[0].copy()
    size = float(np.linalg.norm(rows))
    if size > 0.0:
        rows /= size


def classifier(points: Points, labels: Labels, modes: int, weights: Floats) -> Floats:
    """Return separators by weighted least squares on indicators: a start, never far off."""
    indicators = np.zeros((points.n, modes))
    own = labels >= 0
    indicators[np.flatnonzero(own), labels[own]] = 1.0
    root = np.sqrt(np.where(own, weights, 0.0))[:, None]
    phi = np.column_stack([points.z, np.ones(points.n)])
    rows = np.linalg.lstsq(root * phi, root * indicators, rcond=1e-12)[0].T.copy()
    _keep_small(rows)
    return np.ascontiguousarray(rows)
