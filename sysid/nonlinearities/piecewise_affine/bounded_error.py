"""Bounded-error procedure: as few submodels as explain the points within a bound."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import IdentifiabilityError, UsageError
from sysid.nonlinearities.piecewise_affine.descent import assign, directions
from sysid.nonlinearities.piecewise_affine.fit import (
    PiecewiseAffineFit,
    assembled,
    in_the_middle,
    region_labels,
)
from sysid.nonlinearities.piecewise_affine.points import Points, neighbourhoods, regions_of
from sysid.nonlinearities.piecewise_affine.refinement import INFEASIBLE, refined
from sysid.nonlinearities.piecewise_affine.relaxation import largest_subsystem
from sysid.nonlinearities.piecewise_affine.separation import Separation, separated

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]

WHO = "bounded error"
MOST_MODES = 40
CENTRING = 60
TOLERATED = 0.05
"""Where more than this share of the sorted points is on the wrong side, modes get several regions."""


def bounded_error(
    z: ArrayLike,
    w: ArrayLike,
    delta: float,
    *,
    rng: np.random.Generator,
    starts: int = 6,
    cycles: int = 15,
    neighbours: int = 10,
    merge: float = 0.02,
    discard: float = 0.02,
    rounds: int = 20,
    separation: Separation = "linear-programming",
    polish: bool = False,
    convex: bool = False,
) -> PiecewiseAffineFit:
    """Fit a piecewise affine map with as few submodels as a bound on the error allows.

    The procedure of Bemporad, Garulli, Paoletti and Vicino (2005), Section 5.1.1 of Pepona (2009):

    1. the submodel that explains the most points within ``delta`` is searched for by randomised
       relaxation, its points are put aside, and so on with the rest (minimum partition into feasible
       subsystems);
    2. points that several submodels explain follow their neighbours, similar submodels are joined, tiny
       ones dropped, the others fitted anew, until nothing changes;
    3. hyperplanes are put between the modes, and each submodel is fitted to the points of its region
       that it explains.

    Parameters
    ----------
    z : array_like, shape (n_points,) or (n_points, n_z)
    w : array_like, shape (n_points,) or (n_points, n_w)
    delta : float
        Bound on the error, in the unit of w; on that of each output for a vector-valued w.
    rng : numpy.random.Generator
    starts, cycles : int
        Starts of each relaxation, and how often each visits all points.
    neighbours : int
        A point that several submodels explain follows the majority of so many neighbours.
    merge : float
        Two submodels are joined where one explains their points but for this share.
    discard : float
        A mode with less than this share of all points is dropped.
    rounds : int
        Of the refinement, at most.
    separation : {"linear-programming", "svm"}
        The second one needs scikit-learn.
    polish : bool
        Beyond the procedure: then move the hyperplanes to where the squared errors, each up to the bound's,
        are least.  Undecided points count as well then, which helps where a jump is hardly more than the
        noise; at a kink it does not.
    convex : bool
        Whether each mode has one region, as in eq. (5.7), even where hyperplanes cannot part the modes;
        otherwise such a mode is cut into several.

    Returns
    -------
    PiecewiseAffineFit
        ``outliers`` marks the points that their region's submodel does not explain.  Where the points of
        a mode cannot be held in one convex region, ``map.merged`` is true.

    Raises
    ------
    UsageError, IdentifiabilityError
        If the bound or the points cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(1)
    >>> z = rng.uniform(-2, 2, 200)
    >>> w = np.where(z > 0, z, -0.5 * z) + rng.uniform(-0.05, 0.05, 200)
    >>> bounded_error(z, w, 0.06, rng=rng).map.theta[:, 0].round(1)
    array([-0.5,  1. ])
    """
    points = Points.of(z, w, who=WHO)
    found = subsystems(
        points,
        delta,
        rng,
        starts=starts,
        cycles=cycles,
        neighbours=neighbours,
        merge=merge,
        discard=discard,
        rounds=rounds,
    )
    theta, sure = found.theta, np.flatnonzero(found.labels >= 0)
    z_sure, labels_sure = np.ascontiguousarray(points.z[sure]), found.labels[sure]
    tolerated = 1.0 if convex else TOLERATED
    rows, owners = separated(z_sure, labels_sure, theta.shape[0], separation, rng, tolerated)
    ways = directions(points, rng, CENTRING)
    if polish:
        rows = _polished(points, theta, rows, owners, delta / points.unit, ways)
    rows = in_the_middle(points, rows, ways, None if polish else sure)
    placed = owners[region_labels(points, rows)]
    outliers = trimmed(points, theta, placed, delta / points.unit)
    status = _status(delta, found.partition, owners, points.n - sure.size, float(outliers.mean()))
    wrong = float(np.mean(owners[regions_of(z_sure, rows)] != labels_sure))
    if wrong > TOLERATED:
        status += (
            f"; {wrong:.1%} of the others lie in another mode's region, for hyperplanes cannot part the "
            "modes: try another delta"
        )
    return assembled(points, rows, owners, np.where(outliers, -1, placed), status, outliers=outliers)


@dataclass(frozen=True, eq=False)
class Subsystems:
    """Submodels and the points that belong to each, before hyperplanes are put between them.

    Attributes
    ----------
    theta : ndarray, shape (modes, n_z + 1, n_w)
        Scaled.
    labels : ndarray of int, shape (n_points,)
        Negative where a point belongs to none or is undecided.
    partition : int
        Number of subsystems of the greedy partition, before any were joined or dropped.
    """

    theta: Floats
    labels: Labels
    partition: int

    @property
    def unexplained(self) -> float:
        """Share of the points that no submodel explains."""
        return float(np.mean(self.labels == INFEASIBLE))


def subsystems(
    points: Points,
    delta: float,
    rng: np.random.Generator,
    *,
    starts: int,
    cycles: int,
    neighbours: int,
    merge: float,
    discard: float,
    rounds: int,
) -> Subsystems:
    """Return the first two steps of `bounded_error`."""
    _check(delta, starts, cycles, neighbours, rounds)
    bound = delta / points.unit
    smallest = max(points.n_z + 2, int(np.ceil(discard * points.n)))
    theta = partition(points, bound, rng, starts=starts, cycles=cycles, smallest=smallest)
    count = theta.shape[0]
    theta, labels = refined(
        points, theta, bound, neighbours=neighbours, merge=merge, smallest=smallest, rounds=rounds
    )
    if np.bincount(labels[labels >= 0], minlength=1).max() < points.n_z + 2:
        raise IdentifiabilityError(
            f"{WHO}: no {points.n_z + 2} points agree with one affine submodel within delta = {delta:g}; "
            "give a larger delta"
        )
    return Subsystems(theta, labels, count)


def partition(
    points: Points, bound: float, rng: np.random.Generator, *, starts: int, cycles: int, smallest: int
) -> Floats:
    """Return submodels (subsystems, n_z + 1, n_w), scaled, that explain the points within a bound.

    Greedy: each explains as many of the points that are left as relaxation can find.  It ends where fewer
    than ``smallest`` points agree with one.
    """
    z, w = points.z, points.w
    found: list[Floats] = []
    while z.shape[0] >= smallest and len(found) < MOST_MODES:
        seeds = rng.integers(0, z.shape[0], starts - 1)
        orders = rng.permuted(np.tile(np.arange(z.shape[0]), (cycles, 1)), axis=1)
        near = min(max(3 * (points.n_z + 1), z.shape[0] // 20), z.shape[0])
        theta = np.zeros((points.n_z + 1, points.n_w))
        count = largest_subsystem(z, w, bound, neighbourhoods(z, seeds, near), orders, theta)
        if count < smallest and found:
            break
        found.append(theta)
        rest = misfits(z, w, theta) > bound
        z, w = np.ascontiguousarray(z[rest]), np.ascontiguousarray(w[rest])
    return np.array(found)


def _polished(
    points: Points, theta: Floats, rows: Floats, owners: Labels, bound: float, ways: Floats
) -> Floats:
    """Return separators and refitted submodels in turn, for capped squared errors, until they stay."""
    cap = points.n_w * bound**2
    for _ in range(10):
        costs = np.ascontiguousarray(np.minimum(points.costs(theta), cap)[:, owners])
        moved = assign(points, costs, rows, ways[: 3 * (points.n_z + 1)])
        labels = owners[region_labels(points, moved)]
        off = points.costs(theta)[np.arange(points.n), labels] > cap
        fitted, counts = points.fitted(np.where(off, -1, labels), theta.shape[0])
        if counts.min() < points.n_z + 2 or np.array_equal(moved, rows):
            break
        rows, theta = moved, fitted
    return rows


def trimmed(points: Points, theta: Floats, labels: Labels, bound: float) -> NDArray[np.bool_]:
    """Return the points beyond the bound, submodels fitted to the others of their regions."""
    outliers = np.zeros(points.n, dtype=np.bool_)
    for _ in range(5):
        off = np.empty(points.n)
        for i in range(theta.shape[0]):
            own = labels == i
            off[own] = misfits(points.z[own], points.w[own], theta[i])
        before, outliers = outliers, off > bound
        fitted, counts = points.fitted(np.where(outliers, -1, labels), theta.shape[0])
        theta = np.where((counts > points.n_z)[:, None, None], fitted, theta)
        if np.array_equal(before, outliers):
            break
    return outliers


def misfits(z: Floats, w: Floats, theta: Floats) -> Floats:
    """Return the largest residual, over the outputs, of each point."""
    return np.asarray(np.abs(w - z @ theta[:-1] - theta[-1]).max(axis=1, initial=0.0))


def _status(delta: float, subsystems: int, owners: Labels, undecided: int, share: float) -> str:
    modes = int(owners.max()) + 1
    words = (
        f"{modes} mode{'s' * (modes > 1)} from {subsystems} subsystem{'s' * (subsystems > 1)}; {share:.1%} "
        f"of the points are off by more than {delta:g}; {undecided} took the mode of the region they lie in"
    )
    if owners.size > modes:
        words += f"; {owners.size} regions share the modes, for one hyperplane cannot hold a mode together"
    return words


def _check(delta: float, starts: int, cycles: int, neighbours: int, rounds: int) -> None:
    if not (np.isfinite(delta) and delta > 0.0):
        raise UsageError(f"{WHO}: delta is {delta}; give the bound on the error, a number > 0")
    for name, value in (
        ("starts", starts),
        ("cycles", cycles),
        ("neighbours", neighbours),
        ("rounds", rounds),
    ):
        if value < 1:
            raise UsageError(f"{WHO}: {name} is {value}; give 1 at least")
