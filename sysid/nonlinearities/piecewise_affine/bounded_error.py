"""Bounded-error procedure: as few submodels as explain the points within a bound."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.nonlinearities.piecewise_affine.descent import assign, directions
from sysid.nonlinearities.piecewise_affine.fit import (
    PiecewiseAffineFit,
    assembled,
    in_the_middle,
    region_labels,
)
from sysid.nonlinearities.piecewise_affine.points import Points, regions_of
from sysid.nonlinearities.piecewise_affine.separation import Separation, separated
from sysid.nonlinearities.piecewise_affine.subsystems import USUAL, WHO, PartitionSearch, misfits, subsystems

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]

CENTRING = 60
TOLERATED = 0.05
"""Where more than this share of the sorted points is on the wrong side, modes get several regions."""


def bounded_error(
    z: ArrayLike,
    w: ArrayLike,
    delta: float,
    *,
    rng: np.random.Generator,
    search: PartitionSearch = USUAL,
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
    search : PartitionSearch, optional
        Settings of the first two steps.
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
    found = subsystems(points, delta, rng, search)
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


def _status(delta: float, subsystems: int, owners: Labels, undecided: int, share: float) -> str:
    modes = int(owners.max()) + 1
    words = (
        f"{modes} mode{'s' * (modes > 1)} from {subsystems} subsystem{'s' * (subsystems > 1)}; {share:.1%} "
        f"of the points are off by more than {delta:g}; {undecided} took the mode of the region they lie in"
    )
    if owners.size > modes:
        words += f"; {owners.size} regions share the modes, for one hyperplane cannot hold a mode together"
    return words
