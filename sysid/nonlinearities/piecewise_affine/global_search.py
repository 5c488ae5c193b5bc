"""The best piecewise affine map, exactly where that can be had: scalar z, or two modes in the plane."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import IdentifiabilityError
from sysid.nonlinearities.piecewise_affine.branch_and_bound import best_line_of_all
from sysid.nonlinearities.piecewise_affine.descent import classifier, descend, directions, roam
from sysid.nonlinearities.piecewise_affine.dichotomies import best_line
from sysid.nonlinearities.piecewise_affine.fit import PiecewiseAffineFit, finished, line_separators
from sysid.nonlinearities.piecewise_affine.k_plane import clusterings
from sysid.nonlinearities.piecewise_affine.points import Points
from sysid.nonlinearities.piecewise_affine.segmented import best_breakpoints

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]

WHO = "global search"
CENTRING = 60
FINISHED = 4
"""So many of the best descents go on along fresh random directions."""


def global_search(
    z: ArrayLike,
    w: ArrayLike,
    modes: int,
    *,
    rng: np.random.Generator | None = None,
    exact_up_to: int = 1_000_000,
    pivots: int = 64,
    restarts: int = 20,
    min_points: int | None = None,
) -> PiecewiseAffineFit:
    """Fit the piecewise affine map of least squares by global search.

    * Scalar z: dynamic programming over the breakpoints, exact for any number of modes and points.
    * Two modes, two inputs: branch and bound over all lines, exact up to ``exact_up_to`` points.  Beyond, the
      best of all lines through a random sample of the points, then of all lines through the
      points nearest to it, until it stays; no line through any of them is better.
    * Otherwise not exact: from many starts, each separator moves by exact line searches until none
      improves the sum of squares.

    Parameters
    ----------
    z : array_like, shape (n_points,) or (n_points, n_z)
    w : array_like, shape (n_points,) or (n_points, n_w)
    modes : int
        Number of submodels, each in a region of its own.
    rng : numpy.random.Generator, optional
        Draws samples and starts; seed 0 unless given.  An exact search returns the same optimum for any.
    exact_up_to : int
        Points in the plane up to which branch and bound is tried.  It takes milliseconds for a thousand
        points of two distinct modes.  Where there is little but noise it is cut short after some seconds.
    pivots : int
        Sample size beyond that.
    restarts : int
        Starts where the search is not exact.
    min_points : int, optional
        Points a mode holds at least; n_z + 2 unless given.

    Returns
    -------
    PiecewiseAffineFit
        ``exact`` and ``status`` say what is guaranteed.

    Raises
    ------
    UsageError, IdentifiabilityError
        If the points cannot be used, or admit no such map.

    Examples
    --------
    >>> import numpy as np
    >>> z = np.linspace(-2, 2, 41)
    >>> fit = global_search(z, np.where(z > 0.55, 1 - z, z), 2)
    >>> fit.map.tau.round(9), fit.exact
    (array([0.55]), True)
    """
    points = Points.of(z, w, who=WHO)
    least = points.enough(modes, min_points, WHO)
    generator = np.random.default_rng(0) if rng is None else rng
    if modes == 1:
        return finished(points, np.zeros((1, points.n_z + 1)), "one mode: least squares", exact=True)
    if points.n_z == 1:
        return _along_a_line(points, modes, least)
    if points.n_z == 2 and modes == 2:
        return _in_the_plane(points, least, generator, exact_up_to, pivots)
    return _by_descent(points, modes, least, generator, restarts)


def _along_a_line(points: Points, modes: int, least: int) -> PiecewiseAffineFit:
    found = best_breakpoints(points.z[:, 0], points.w, modes, least)
    if found is None:
        raise _impossible(points, modes, least)
    status = f"exact: no {modes} segments of {least} points or more fit better"
    return finished(points, line_separators(found[0]), status, exact=True)


def _in_the_plane(
    points: Points, least: int, rng: np.random.Generator, exact_up_to: int, pivots: int
) -> PiecewiseAffineFit:
    best, exact = None, False
    if points.n <= exact_up_to:
        best = best_line_of_all(points.z, points.w, least)
        if best is None:
            raise _impossible(points, 2, least)
        exact = best[2] >= best[0]
    if best is not None and exact:
        h = best[1]
        status = f"exact: no line with {least} points or more on each side parts the points better"
    else:
        cost, h, count = _of_sampled_lines(points, least, rng, pivots)
        status = (
            f"the best of all lines through any of {count} of {points.n} points, those nearest to it among "
            "them; not proved best of all"
        )
        if best is None:
            status += ": for that raise exact_up_to"
        else:
            h = h if cost < best[0] else best[1]
            status += ": there is too little but noise to tell two modes by"
    rows = np.vstack([np.zeros(3), h])
    return finished(points, rows, status, exact=exact, centring=directions(points, rng, CENTRING))


def _of_sampled_lines(
    points: Points, least: int, rng: np.random.Generator, pivots: int
) -> tuple[float, Floats, int]:
    """Return cost and h of the best line found, and through how many points lines were tried."""
    tried = rng.choice(points.n, min(pivots, points.n), replace=False)
    best = best_line(points.z, points.w, tried, least)
    if best is None:
        raise _impossible(points, 2, least)
    best, count = _nearby(points, tried, best, least)
    return best[0], best[1], count


def _nearby(
    points: Points, tried: Labels, best: tuple[float, Floats, int], least: int
) -> tuple[tuple[float, Floats, int], int]:
    """Turn lines about the points nearest to the best one until it stays; return it, and how many."""
    done = set(tried.tolist())
    size = max(16, tried.size // 2)
    while True:
        distance = np.abs(points.z @ best[1][:2] + best[1][2])
        near = np.argpartition(distance, min(size, points.n - 1))[:size]
        fresh = np.array(sorted(set(near.tolist()) - done), dtype=np.intp)
        if not fresh.size:
            return best, len(done)
        done.update(fresh.tolist())
        found = best_line(points.z, points.w, fresh, least)
        if found is None or found[0] >= best[0]:
            return best, len(done)
        best = found


def _by_descent(
    points: Points, modes: int, least: int, rng: np.random.Generator, restarts: int
) -> PiecewiseAffineFit:
    ways = directions(points, rng, 3 * (points.n_z + 1))
    ends = []
    for rows in _starts(points, modes, least, rng, restarts):
        ends.append(descend(points, rows, ways, least))
    ends.sort(key=lambda end: end[1])
    ends[:FINISHED] = [roam(points, rows, cost, rng, least) for rows, cost in ends[:FINISHED]]
    costs = np.array([cost for _, cost in ends])
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]):
        raise _impossible(points, modes, least)
    agreeing = float(np.mean(costs <= costs[best] * 1.001 + 1e-15 * points.n))
    status = (
        f"not exact ({modes} modes of {points.n_z} inputs): best of {len(ends)} descents, {agreeing:.0%} of "
        "them within 0.1 % of it"
    )
    if agreeing * len(ends) < 2:
        status += "; a better map may exist: take more restarts"
    centring = directions(points, rng, CENTRING)
    return finished(points, ends[best][0], status, agreement=agreeing, centring=centring)


def _starts(points: Points, modes: int, least: int, rng: np.random.Generator, restarts: int) -> list[Floats]:
    """Return separators to start from: half of them from k-plane clusterings, half random Voronoi cells."""
    labels, costs = clusterings(points, modes, (restarts + 1) // 2, least, rng)
    starts = [
        classifier(points, one, modes, np.ones(points.n))
        for one, cost in zip(labels, costs, strict=True)
        if np.isfinite(cost)
    ]
    while len(starts) < max(restarts, 1):
        centres = points.z[rng.choice(points.n, modes, replace=False)]
        starts.append(np.column_stack([2.0 * centres, -(centres**2).sum(axis=1)]))
    return starts


def _impossible(points: Points, modes: int, least: int) -> IdentifiabilityError:
    return IdentifiabilityError(
        f"{WHO}: no {modes} regions with {least} of the {points.n} points in each exist, for too many points "
        "coincide; ask for fewer modes or a smaller min_points"
    )
