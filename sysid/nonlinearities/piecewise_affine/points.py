"""The points of a piecewise affine regression: checked, scaled, and fitted for given labels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import IdentifiabilityError, UsageError
from sysid.nonlinearities.piecewise_affine.kernels import fill_costs, fill_regions, fit_modes
from sysid.nonlinearities.piecewise_affine.map import PiecewiseAffineMap

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Points:
    """Pairs (z, w) in coordinates of zero mean and unit variance.

    Attributes
    ----------
    z : ndarray, shape (n_points, n_z)
    w : ndarray, shape (n_points, n_w)
        Scaled by one number, so that a sum of squares over the outputs keeps its meaning.
    original_z : ndarray, shape (n_points, n_z)
        In its own units.
    centre, spread : ndarray, shape (n_z,)
    level : ndarray, shape (n_w,)
    unit : float
        w = level + unit * scaled w.
    scalar : bool
        True where w was given as one sequence.
    """

    z: Floats
    w: Floats
    original_z: Floats
    centre: Floats
    spread: Floats
    level: Floats
    unit: float
    scalar: bool

    @classmethod
    def of(cls, z: ArrayLike, w: ArrayLike, *, who: str) -> "Points":
        """Check and scale the points.

        Raises
        ------
        UsageError
            If shapes do not match or a value is not finite.
        IdentifiabilityError
            If an input is constant, depends on the others, or there are too few points.
        """
        inputs, outputs = _matrix(z, "z", who), _matrix(w, "w", who)
        n, n_z = inputs.shape
        if outputs.shape[0] != n:
            raise UsageError(f"{who}: z has {n} points and w has {outputs.shape[0]}; give as many of both")
        if n < n_z + 2:
            raise IdentifiabilityError(
                f"{who}: {n} points cannot determine an affine submodel of {n_z + 1} parameters "
                f"and its misfit; give {n_z + 2} at least"
            )
        centre, spread = inputs.mean(axis=0), inputs.std(axis=0)
        constant = np.flatnonzero(spread <= 1e-12 * np.maximum(np.abs(inputs).max(axis=0), 1e-300))
        if constant.size:
            raise IdentifiabilityError(
                f"{who}: column {constant[0] + 1} of z is constant at {centre[constant[0]]:g}, so that its "
                "coefficient and the submodel's constant cannot be told apart; leave this column out"
            )
        scaled = np.ascontiguousarray((inputs - centre) / spread)
        singular = np.linalg.svd(scaled / np.sqrt(n), compute_uv=False)
        if singular[-1] <= 1e-9:
            raise IdentifiabilityError(
                f"{who}: the columns of z depend on each other (smallest singular value {singular[-1]:.1e} "
                "of the scaled columns); leave one of them out"
            )
        level = outputs.mean(axis=0)
        unit = float(np.sqrt(((outputs - level) ** 2).mean())) or 1.0
        return cls(
            scaled,
            np.ascontiguousarray((outputs - level) / unit),
            inputs,
            centre,
            spread,
            level,
            unit,
            np.ndim(w) == 1,
        )

    @property
    def n(self) -> int:
        """Number of points."""
        return int(self.z.shape[0])

    @property
    def n_z(self) -> int:
        """Number of inputs."""
        return int(self.z.shape[1])

    @property
    def n_w(self) -> int:
        """Number of outputs."""
        return int(self.w.shape[1])

    def enough(self, modes: int, least: int | None, who: str) -> int:
        """Return the least number of points of a mode, checked.

        Raises
        ------
        UsageError
            If modes or least are no whole number in range.
        IdentifiabilityError
            If there are too few points for so many modes.
        """
        if modes < 1 or modes != int(modes):
            raise UsageError(f"{who}: {modes} modes were asked for; ask for one at least")
        smallest = self.n_z + 2 if least is None else least
        if smallest < self.n_z + 1:
            raise UsageError(
                f"{who}: min_points is {smallest}; a submodel has {self.n_z + 1} parameters, "
                "so give as many at least"
            )
        if self.n < modes * smallest:
            raise IdentifiabilityError(
                f"{who}: {self.n} points are too few for {modes} modes of {smallest} points each; give "
                f"{modes * smallest} at least, or ask for fewer modes"
            )
        return smallest

    def fitted(self, labels: Labels, modes: int) -> tuple[Floats, Labels]:
        """Return scaled least-squares submodels (modes, n_z + 1, n_w) and their numbers of points."""
        theta = np.zeros((modes, self.n_z + 1, self.n_w))
        counts = np.zeros(modes, dtype=np.intp)
        fit_modes(self.z, self.w, labels, theta, counts)
        return theta, counts

    def costs(self, theta: Floats) -> Floats:
        """Return squared residuals, scaled, shape (n_points, modes)."""
        out = np.empty((self.n, theta.shape[0]))
        fill_costs(self.z, self.w, theta, out)
        return out

    def polished(self, labels: Labels, modes: int) -> Floats:
        """Return submodels by QR about each mode's own centre: to the last digits, where sums lose some."""
        theta = np.zeros((modes, self.n_z + 1, self.n_w))
        for i in range(modes):
            own = labels == i
            if not own.any():
                continue
            z, w = self.z[own], self.w[own]
            centre, level = z.mean(axis=0), w.mean(axis=0)
            theta[i, :-1] = np.linalg.lstsq(z - centre, w - level, rcond=1e-9)[0]
            theta[i, -1] = level - centre @ theta[i, :-1]
        return theta

    def in_units(self, theta: Floats, separators: Floats, owners: Labels | None = None) -> PiecewiseAffineMap:
        """Return the map in the points' own units from scaled submodels and separators."""
        slopes = self.unit * theta[:, :-1] / self.spread[:, None]
        constants = self.level + self.unit * theta[:, -1] - np.einsum("j,ijc->ic", self.centre, slopes)
        full = np.concatenate([slopes, constants[:, None]], axis=1)
        normals = separators[:, :-1] / self.spread
        rows = np.column_stack([normals, separators[:, -1] - normals @ self.centre])
        return PiecewiseAffineMap(full[:, :, 0] if self.scalar else full, rows, owners)  # type: ignore[arg-type]


def regions_of(z: Floats, separators: Floats) -> Labels:
    """Return the region of each point."""
    regions = np.empty(z.shape[0], dtype=np.intp)
    fill_regions(z, separators, regions)
    return regions


def neighbourhoods(z: Floats, seeds: Labels, size: int) -> Labels:
    """Return the ``size`` points nearest to each of some points, shape (n_seeds, size)."""
    found = np.empty((seeds.size, size), dtype=np.intp)
    for row, seed in zip(found, seeds, strict=True):
        row[:] = np.argpartition(((z - z[seed]) ** 2).sum(axis=1), size - 1)[:size]
    return found


def _matrix(values: ArrayLike, name: str, who: str) -> Floats:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim not in (1, 2) or array.size == 0:
        raise UsageError(f"{who}: {name} of shape {array.shape} was given; give (n_points,) or a matrix")
    bad = np.flatnonzero(~np.isfinite(array.reshape(array.shape[0], -1)).all(axis=1))
    if bad.size:
        raise UsageError(f"{who}: {name} is not finite at point {bad[0]}; leave such points out")
    return array.reshape(array.shape[0], -1)
