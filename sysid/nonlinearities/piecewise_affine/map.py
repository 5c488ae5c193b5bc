r"""Piecewise affine maps: an affine submodel in each polyhedral region.

Pepona (2009), eqs. (5.1) and (5.7): :math:`f(z) = \theta_i^T \phi` for z in region i, with
:math:`\phi = [z^T\ 1]^T`.  The regions are where one of several affine functions of z, the
separators, is the greatest, so that they are convex, do not overlap and leave no hole.
"""

import json
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import ModelError, UsageError
from sysid.nonlinearities.piecewise_affine.kernels import fill_regions, fill_values

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class PiecewiseAffineMap:
    r"""A map w = f(z) that is affine on each of several polyhedra.

    Attributes
    ----------
    theta : ndarray, shape (modes, n_z + 1) or (modes, n_z + 1, n_w)
        Submodels: coefficients of z, then the constant.  Two axes for a scalar w, three for a vector.
    separators : ndarray, shape (regions, n_z + 1)
        z lies in the region whose affine function is the greatest there; the first one at a tie.
    owners : ndarray of int, shape (regions,)
        The submodel of each region.  Several regions share one where no convex region holds all
        points of a mode; otherwise there is a region a mode, in the same order (the default).

    Examples
    --------
    >>> absolute = PiecewiseAffineMap([[-1.0, 0.0], [1.0, 0.0]], [[-1.0, 0.0], [0.0, 0.0]])
    >>> absolute([-2.0, 0.5])
    array([2. , 0.5])
    >>> absolute.mode([-2.0, 0.5])
    array([0, 1])
    >>> absolute.tau + 0.0
    array([0.])
    """

    theta: Floats
    separators: Floats
    owners: Labels = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        theta, separators = _constant(self.theta, "theta"), _constant(self.separators, "separators")
        if theta.ndim not in (2, 3) or separators.ndim != 2 or 0 in theta.shape or theta.shape[1] < 2:
            raise ModelError(
                f"piecewise affine map: theta of shape {theta.shape} and separators of shape "
                f"{separators.shape} were given; take (modes, n_z + 1[, n_w]) and (regions, n_z + 1)"
            )
        if separators.shape[1] != theta.shape[1]:
            raise ModelError(
                f"piecewise affine map: separators have {separators.shape[1]} columns and theta "
                f"{theta.shape[1]}; both take n_z + 1"
            )
        owners = np.arange(separators.shape[0]) if self.owners is None else np.array(self.owners, np.intp)
        if owners.shape != separators.shape[:1] or sorted(set(owners.tolist())) != [*range(theta.shape[0])]:
            raise ModelError(
                f"piecewise affine map: {theta.shape[0]} submodels, {separators.shape[0]} regions and owners "
                f"{owners.tolist()} do not match: name a submodel for each region, and each one once at least"
            )
        owners.setflags(write=False)
        object.__setattr__(self, "theta", theta)
        object.__setattr__(self, "separators", separators)
        object.__setattr__(self, "owners", owners)

    @classmethod
    def of_breakpoints(cls, theta: ArrayLike, tau: ArrayLike) -> "PiecewiseAffineMap":
        """Return the map of a scalar z with a submodel between one breakpoint and the next.

        Parameters
        ----------
        theta : array_like, shape (modes, 2) or (modes, 2, n_w)
            Slope and constant of each piece, from left to right.
        tau : array_like, shape (modes - 1,)
            Breakpoints, ascending; each belongs to the piece on its left.

        Examples
        --------
        >>> PiecewiseAffineMap.of_breakpoints([[0, -1], [0, 1]], [0.5]).tau
        array([0.5])
        """
        breaks = np.atleast_1d(np.asarray(tau, dtype=np.float64))
        if breaks.ndim != 1 or np.any(np.diff(breaks) <= 0.0):
            raise ModelError(f"piecewise affine map: breakpoints {breaks.tolist()} do not ascend")
        pieces = np.arange(breaks.size + 1.0)
        return cls(
            np.asarray(theta, dtype=np.float64),
            np.column_stack([pieces, -np.concatenate([[0.0], np.cumsum(breaks)])]),
        )

    @property
    def modes(self) -> int:
        """Number of affine submodels."""
        return int(self.theta.shape[0])

    @property
    def regions(self) -> int:
        """Number of polyhedra."""
        return int(self.separators.shape[0])

    @property
    def n_z(self) -> int:
        """Number of inputs of the map."""
        return int(self.theta.shape[1]) - 1

    @property
    def merged(self) -> bool:
        """True where several regions share a submodel."""
        return self.regions > self.modes

    @property
    def hyperplane(self) -> Floats:
        r"""The vector h of a map of two regions, shape (n_z + 1,): the first one is where h^T phi <= 0.

        Its first ``n_z`` entries, the normal, have norm one.
        """
        if self.regions != 2:
            raise ModelError(
                f"piecewise affine map: one hyperplane separates two regions, this map has {self.regions}: "
                "take `inequalities`"
            )
        h = self.separators[1] - self.separators[0]
        normal = float(np.linalg.norm(h[:-1]))
        return np.asarray(h / normal if normal > 0.0 else h)

    @property
    def tau(self) -> Floats:
        """Breakpoints of a scalar z, where the submodel changes, ascending."""
        if self.n_z != 1:
            raise ModelError(f"piecewise affine map: breakpoints are for a scalar z, this one has {self.n_z}")
        slopes, constants = self.separators.T
        found: list[float] = []
        place = -np.inf
        now = int(np.lexsort((constants, -slopes))[-1])  # the greatest far to the left
        while True:
            steeper = np.flatnonzero(slopes > slopes[now])
            if not steeper.size:
                return np.array(found)
            crossings = (constants[now] - constants[steeper]) / (slopes[steeper] - slopes[now])
            order = np.lexsort((-slopes[steeper], np.maximum(crossings, place)))
            then, place = int(steeper[order[0]]), float(max(crossings[order[0]], place))
            if self.owners[then] != self.owners[now]:
                found.append(place)
            now = then

    def __call__(self, z: ArrayLike) -> Floats:
        """Return w = f(z), shape (n_points,) or, for a vector-valued map, (n_points, n_w).

        Parameters
        ----------
        z : array_like, shape (n_points, n_z)
            For a scalar z also (n_points,).

        Raises
        ------
        UsageError
            If z has another shape or is not finite.
        """
        points = self._points(z)
        weights = self.theta.reshape(self.modes, self.n_z + 1, -1)
        values = np.empty((points.shape[0], weights.shape[2]))
        fill_values(points, weights, self.mode(points), values)
        return values if self.theta.ndim == 3 else values[:, 0]

    def mode(self, z: ArrayLike) -> Labels:
        """Return the number of the submodel at each point, from zero, shape (n_points,)."""
        return np.asarray(self.owners[self.region(z)])

    def region(self, z: ArrayLike) -> Labels:
        """Return the number of the region of each point, from zero, shape (n_points,)."""
        points = self._points(z)
        found = np.empty(points.shape[0], dtype=np.intp)
        fill_regions(points, self.separators, found)
        return found

    def inequalities(self, region: int) -> tuple[Floats, NDArray[np.bool_]]:
        """Return H and which rows are strict: the region is where H phi <= 0 (< 0), eq. (5.7).

        Parameters
        ----------
        region : int
            From zero; the same as the mode unless `merged`.

        Returns
        -------
        tuple of ndarray
            H, shape (regions - 1, n_z + 1), and a flag for each of its rows.

        Examples
        --------
        >>> step = PiecewiseAffineMap.of_breakpoints([[0, -1], [0, 1]], [0.5])
        >>> step.inequalities(1)
        (array([[-1. ,  0.5]]), array([ True]))
        """
        if not 0 <= region < self.regions:
            raise UsageError(f"piecewise affine map: region {region} of {self.regions} was asked for")
        others = np.delete(np.arange(self.regions), region)
        return self.separators[others] - self.separators[region], others < region

    def to_json(self) -> str:
        """Return the map as text that `from_json` reads without loss."""
        return json.dumps(
            {
                "kind": "piecewise-affine-map",
                "theta": self.theta.tolist(),
                "separators": self.separators.tolist(),
                "owners": self.owners.tolist(),
            }
        )

    @classmethod
    def from_json(cls, text: str) -> "PiecewiseAffineMap":
        """Read what `to_json` wrote.

        Raises
        ------
        ModelError
            If the text is something else.
        """
        try:
            content = json.loads(text)
            if content["kind"] != "piecewise-affine-map":
                raise KeyError("kind")
            parts = (content["theta"], content["separators"], content["owners"])
        except (ValueError, KeyError, TypeError) as error:
            raise ModelError("piecewise affine map: this is no JSON text of such a map") from error
        return cls(*parts)

    def __repr__(self) -> str:
        regions = f" in {self.regions} regions" if self.merged else ""
        lines = [f"PiecewiseAffineMap: {self.modes} submodel{'s'[: self.modes > 1]} of {self.n_z} input"]
        lines[0] += "s" * (self.n_z > 1) + regions
        for i, rows in enumerate(self.theta.reshape(self.modes, self.n_z + 1, -1)):
            words = "; ".join(" ".join(f"{value:9.5g}" for value in column) for column in rows.T)
            lines.append(f"  theta {i + 1}   {words}")
        if self.n_z == 1:
            lines.append("  tau       " + " ".join(f"{value:9.5g}" for value in self.tau))
        elif self.regions == 2:
            lines.append("  h         " + " ".join(f"{value:9.5g}" for value in self.hyperplane))
        return "\n".join(lines)

    def _points(self, z: ArrayLike) -> Floats:
        points = np.ascontiguousarray(z, dtype=np.float64)
        if points.ndim == 1 and self.n_z == 1:
            points = points[:, None]
        if points.ndim != 2 or points.shape[1] != self.n_z:
            raise UsageError(
                f"piecewise affine map: z of shape {np.shape(z)} was given; it takes (n_points, {self.n_z})"
            )
        if not np.isfinite(points).all():
            raise UsageError("piecewise affine map: z is not finite everywhere; leave such points out")
        return points


def _constant(values: ArrayLike, name: str) -> Floats:
    array = np.array(values, dtype=np.float64)
    if not np.isfinite(array).all():
        raise ModelError(f"piecewise affine map: {name} is not finite; give finite numbers")
    array.setflags(write=False)
    return array
