"""What a piecewise affine regression returns, and what makes the three stages interchangeable."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import UsageError
from sysid.nonlinearities.piecewise_affine.kernels import centred
from sysid.nonlinearities.piecewise_affine.map import PiecewiseAffineMap
from sysid.nonlinearities.piecewise_affine.points import Points, regions_of

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class PiecewiseAffineFit:
    """A piecewise affine map fitted to points (z, w).

    Attributes
    ----------
    map : PiecewiseAffineMap
        Its modes are in the order of the mean of z's first column.
    labels : ndarray of int, shape (n_points,)
        Mode of each point, from zero: that of the region it lies in.
    values : ndarray, shape of w
        The map at the points.
    cost : float
        Sum of squares of w - values over all points.
    status : str
        How the search ended, what is guaranteed, and what to do where something is wrong.
    outliers : ndarray of bool, shape (n_points,)
        Points that their submodel does not explain within the bound (`bounded_error` only).
    exact : bool
        True where no other map of this structure fits better.
    agreement : float
        Share of the restarts that ended in this solution; 1 for an exact search.
    """

    map: PiecewiseAffineMap
    labels: Labels
    values: Floats
    cost: float
    status: str
    outliers: NDArray[np.bool_]
    exact: bool = False
    agreement: float = 1.0

    @property
    def modes(self) -> int:
        """Number of submodels."""
        return self.map.modes

    @property
    def outlier_share(self) -> float:
        """Share of the points that their submodel does not explain within the bound."""
        return float(self.outliers.mean())

    @property
    def rmse(self) -> float:
        """Root of the mean square of w - values."""
        return float(np.sqrt(self.cost / self.values.size))

    def __repr__(self) -> str:
        return f"PiecewiseAffineFit: RMSE {self.rmse:.5g}\n{self.map!r}\n  {self.status}"


class Stage(Protocol):
    """A way to fit a piecewise affine map, with its settings."""

    def __call__(self, z: ArrayLike, w: ArrayLike, rng: np.random.Generator) -> PiecewiseAffineFit:
        """Fit a map to the points; the same generator state gives the same map."""


def label_error(found: ArrayLike, truth: ArrayLike) -> float:
    """Return the share of points in a wrong mode, under the best naming of the modes.

    Parameters
    ----------
    found, truth : array_like of int, shape (n_points,)
        Labels; a negative one agrees with none.

    Examples
    --------
    >>> label_error([1, 1, 0, 0], [0, 0, 1, 0])
    0.25
    """
    ours, theirs = np.asarray(found, dtype=np.intp), np.asarray(truth, dtype=np.intp)
    if ours.shape != theirs.shape or ours.ndim != 1 or not ours.size:
        raise UsageError(f"labels of shapes {ours.shape} and {theirs.shape} cannot be compared")
    from scipy.optimize import linear_sum_assignment

    size = int(max(ours.max(), theirs.max(), 0)) + 1
    table = np.zeros((size, size))
    both = (ours >= 0) & (theirs >= 0)
    np.add.at(table, (ours[both], theirs[both]), 1.0)
    rows, columns = linear_sum_assignment(-table)
    return float(1.0 - table[rows, columns].sum() / ours.size)


def finished(
    points: Points,
    separators: Floats,
    status: str,
    *,
    exact: bool = False,
    agreement: float = 1.0,
    centring: Floats | None = None,
) -> PiecewiseAffineFit:
    """Return the fit of given separators (scaled), one mode a region: least squares on each region.

    With ``centring``, directions of shape (n, n_z + 1), the separators are first moved to the middle of
    what leaves all points where they are.
    """
    if centring is not None:
        separators = in_the_middle(points, separators, centring)
    labels = region_labels(points, separators)
    return assembled(points, separators, None, labels, status, exact=exact, agreement=agreement)


def assembled(
    points: Points,
    separators: Floats,
    owners: Labels | None,
    fitted: Labels,
    status: str,
    *,
    exact: bool = False,
    agreement: float = 1.0,
    outliers: NDArray[np.bool_] | None = None,
    theta: Floats | None = None,
) -> PiecewiseAffineFit:
    """Return the fit of given separators whose submodels are fitted to the points labelled ``fitted``.

    A negative label leaves a point out; scaled submodels ``theta`` are taken as they are.  Modes are put in
    order of the mean of z's first column.
    """
    owners = np.arange(separators.shape[0]) if owners is None else owners
    modes = int(owners.max()) + 1
    order = np.argsort(first_means(points, owners[region_labels(points, separators)], modes), kind="stable")
    place = np.argsort(order)
    owners, fitted = place[owners], np.where(fitted >= 0, place[np.maximum(fitted, 0)], -1)
    rows = np.argsort(owners, kind="stable")
    theta = points.polished(fitted, modes) if theta is None else theta[order]
    found = points.in_units(theta, separators[rows], owners[rows])
    labels = found.mode(points.original_z)  # a point on a border may change sides by rounding
    costs = points.costs(theta)[np.arange(points.n), labels]
    return PiecewiseAffineFit(
        found,
        labels,
        found(points.original_z),
        float(costs.sum() * points.unit**2),
        status + _thin(points, fitted, modes),
        np.zeros(points.n, dtype=np.bool_) if outliers is None else outliers,
        exact,
        agreement,
    )


def in_the_middle(points: Points, separators: Floats, ways: Floats, kept: Labels | None = None) -> Floats:
    """Return separators in the middle of those that leave all points, or those ``kept``, where they are."""
    if separators.shape[0] < 2:
        return separators
    z = points.z if kept is None else np.ascontiguousarray(points.z[kept])
    middle = _midpoints(z, separators) if points.n_z == 1 else centred(z, separators, ways)
    before, after = regions_of(z, separators), regions_of(z, middle)
    return middle if np.array_equal(after, before) else separators


def region_labels(points: Points, separators: Floats) -> Labels:
    """Return the region of each point."""
    return regions_of(points.z, separators)


def _midpoints(z: Floats, separators: Floats) -> Floats:
    """Return separators of a scalar z that change at midpoints between neighbours, in the same order."""
    order = np.argsort(z[:, 0], kind="stable")
    ascending, labels = z[order, 0], regions_of(z, separators)[order]
    changes = np.flatnonzero(labels[1:] != labels[:-1])
    if changes.size != separators.shape[0] - 1:
        return separators
    rows = line_separators(0.5 * (ascending[changes] + ascending[changes + 1]))
    names = np.append(labels[changes], labels[-1])
    return rows[np.argsort(names)]


def line_separators(tau: Floats) -> Floats:
    """Return the separators of the pieces between ascending breakpoints, from left to right."""
    return np.column_stack([np.arange(tau.size + 1.0), -np.concatenate([[0.0], np.cumsum(tau)])])


def first_means(points: Points, labels: Labels, modes: int) -> Floats:
    """Return the mean of z's first column in each mode; infinite for an empty one."""
    counts = np.bincount(labels[labels >= 0], minlength=modes)
    sums = np.bincount(labels[labels >= 0], points.z[labels >= 0, 0], minlength=modes)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.inf)


def _thin(points: Points, labels: Labels, modes: int) -> str:
    """Return a warning where the points of a mode do not determine its submodel."""
    for i in range(modes):
        z = points.z[labels == i]
        if z.shape[0] < points.n_z + 1 or (
            np.linalg.matrix_rank(z - z.mean(axis=0), tol=1e-9 * np.sqrt(z.shape[0])) < points.n_z
        ):
            return (
                f"; the {z.shape[0]} points of mode {i + 1} do not determine its {points.n_z + 1} parameters "
                "(the smallest ones that fit are returned): ask for fewer modes or give more points"
            )
    return ""
