r"""The separable problem behind an LFT model: regressors and their derivative by d and g.

The knots :math:`\kappa_j = z_{min} + t_j (z_{max} - z_{min})` keep their places :math:`t_j` in the
range of z.  A spline does not change when its argument and its knots are stretched together, so the
basis at z is that of :math:`x = (z - z_{min}) / (z_{max} - z_{min})` on the fixed knots t, and the
length of d drops out: the search runs in the tangent space of the sphere, :math:`v = d_0 + T t`, with
:math:`d = v / \|v\|`.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sysid.errors import IdentifiabilityError
from sysid.lft.signals import Indices, Signals
from sysid.lft.structure import Lag, LftStructure
from sysid.nonlinearities.spline_kernels import LINEAR, fill_basis

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PlacedBasis:
    """The basis of the map at every point of z, for one direction of z.

    Attributes
    ----------
    values, slopes : ndarray, shape (n_points, n_coefficients)
        Basis and its derivative by the place x in the range.
    x : ndarray, shape (n_points,)
        Place in the range, 0 to 1.
    ends : tuple of int
        Points at which z is least and largest.
    low, width : float
        The range of z.
    """

    values: Floats
    slopes: Floats
    x: Floats
    ends: tuple[int, int]
    low: float
    width: float


@dataclass(frozen=True)
class LftDerivative:
    """dPhi/deta as its two products; eta holds the tangent coordinates of d, then g1, g2, ..."""

    basis: PlacedBasis
    moved: Floats  # dx/dt, shape (n_points, n_tangents)
    index: Indices
    g: Floats
    n_fixed: int

    def along(self, theta: Floats) -> Floats:
        """Return (dPhi/deta_j) theta, shape (n_rows, n_eta)."""
        c = theta[self.n_fixed :]
        by_tangent = (self.basis.slopes @ c)[:, np.newaxis] * self.moved
        turned = sum(g * by_tangent[self.index[:, i]] for i, g in enumerate(self.g))
        w = self.basis.values @ c
        return np.column_stack([np.asarray(turned), w[self.index[:, 1:]]])

    def correlated(self, residual: Floats) -> Floats:
        """Return (dPhi/deta_j)^T residual, shape (n_linear, n_eta)."""
        n_points, n_coefficients = self.basis.values.shape
        spread = [np.bincount(column, residual, n_points) for column in self.index.T]
        weight = np.asarray(sum(g * part for g, part in zip(self.g, spread, strict=True)))
        out = np.zeros((self.n_fixed + n_coefficients, self.moved.shape[1] + self.g.size - 1))
        out[self.n_fixed :, : self.moved.shape[1]] = self.basis.slopes.T @ (
            weight[:, np.newaxis] * self.moved
        )
        for i, part in enumerate(spread[1:]):
            out[self.n_fixed :, self.moved.shape[1] + i] = self.basis.values.T @ part
        return out


@dataclass(frozen=True, eq=False)
class LftProblem:
    r"""Rows :math:`y(k) = F_k \theta_F + \sum_i g_i \phi(z(k-i))^T c` around one direction of d.

    Attributes
    ----------
    structure : LftStructure
    y : ndarray, shape (n_rows,)
    fixed : ndarray, shape (n_rows, n_fixed)
        Columns of A (with the minus sign) and B.
    fixed_lags : tuple of Lag
        Their lags.
    times : ndarray of int, shape (n_rows,)
        Sample of each row.
    taps : ndarray, shape (n_points, n_taps)
        The lagged samples that D weighs, at each sample where z is needed.
    index : ndarray of int, shape (n_rows, n_g + 1)
        Point of z(k), z(k-1), ... for each row.
    centre : ndarray, shape (n_taps,)
        The direction d0, of length 1.
    tangents : ndarray, shape (n_taps, n_taps - 1)
        Orthonormal directions in which d moves.
    """

    structure: LftStructure
    y: Floats
    fixed: Floats
    fixed_lags: tuple[Lag, ...]
    times: Indices
    taps: Floats
    index: Indices
    centre: Floats
    tangents: Floats

    @classmethod
    def of(cls, signals: Signals, structure: LftStructure, times: Indices) -> "LftProblem":
        """Make the problem from the rows of some signals; d points along the first tap.

        Raises
        ------
        IdentifiabilityError
            If there are fewer rows than parameters.
        """
        gone = structure.left_out()
        kept = tuple(lag for lag in structure.linear_lags if lag not in gone)
        n_parameters = len(kept) + structure.n_coefficients + structure.n_g + len(structure.z_lags) - 1
        if times.size <= n_parameters:
            raise IdentifiabilityError(
                f"{times.size} rows cannot determine {n_parameters} parameters: give more data, or fewer "
                "knots and lags"
            )
        fixed = signals.lagged(kept, times)
        fixed[:, [signal == "y" for signal, _ in kept]] *= -1.0
        needed = times[:, np.newaxis] - np.arange(structure.n_g + 1)
        points, index = np.unique(needed, return_inverse=True)
        taps = signals.lagged(structure.z_lags, points)
        problem = cls(
            structure=structure,
            y=signals.y[times],
            fixed=fixed,
            fixed_lags=kept,
            times=times,
            taps=taps,
            index=np.ascontiguousarray(index.reshape(needed.shape), dtype=np.int64),
            centre=np.eye(taps.shape[1])[0],
            tangents=np.eye(taps.shape[1])[:, 1:],
        )
        for column in np.flatnonzero(np.ptp(taps, axis=0) == 0.0):
            signal, delay = structure.z_lags[int(column)]
            raise IdentifiabilityError(
                f"{signal}(k-{delay}) is constant on the rows of the fit, so that z and the map are not "
                "excited: take it out of z, or give rows on which it moves"
            )
        return problem

    @property
    def n_tangents(self) -> int:
        """Free directions of d."""
        return int(self.tangents.shape[1])

    @property
    def n_fixed(self) -> int:
        """Columns of A and B."""
        return int(self.fixed.shape[1])

    def around(self, d: Floats) -> "LftProblem":
        """Return the problem with the search centred at a direction."""
        centre = d / np.linalg.norm(d)
        basis = np.linalg.qr(np.column_stack([centre, np.eye(centre.size)]))[0]
        return replace(self, centre=centre, tangents=basis[:, 1 : centre.size])

    def direction(self, eta: Floats) -> Floats:
        """Return d at a point of the search, of length 1."""
        v = self.centre + self.tangents @ eta[: self.n_tangents]
        return v / float(np.linalg.norm(v))

    def numerator(self, eta: Floats) -> Floats:
        """Return g with its leading 1."""
        return np.concatenate([[1.0], eta[self.n_tangents :]])

    def place(self, eta: Floats) -> PlacedBasis:
        """Return the basis of the map at every point of z."""
        key = eta.tobytes()
        if key not in self._last:  # regressors and derivative are asked for at the same place
            self._last.clear()
            self._last[key] = self._placed(eta)
        return self._last[key]

    @cached_property
    def _last(self) -> dict[bytes, PlacedBasis]:
        return {}

    def _placed(self, eta: Floats) -> PlacedBasis:
        z = self.taps @ (self.centre + self.tangents @ eta[: self.n_tangents])
        ends = int(np.argmin(z)), int(np.argmax(z))
        low, width = float(z[ends[0]]), float(z[ends[1]] - z[ends[0]])
        x = np.clip((z - low) / width, 0.0, 1.0) if width > 0.0 else np.full_like(z, np.nan)
        values, slopes = map_basis(x, self.structure)
        return PlacedBasis(values, slopes, x, ends, low, width)

    def regressors(self, eta: Floats) -> Floats:
        """Return Phi(eta), shape (n_rows, n_fixed + n_coefficients)."""
        return np.column_stack([self.fixed, self.filtered(self.place(eta).values, eta)])

    def filtered(self, values: Floats, eta: Floats) -> Floats:
        """Return what G makes of columns that are given at the points of z, shape (n_rows, n_columns)."""
        g = self.numerator(eta)
        return np.asarray(sum(gain * values[self.index[:, i]] for i, gain in enumerate(g)))

    def derivative(self, eta: Floats) -> LftDerivative:
        """Return dPhi/deta; the ends of the range move with d."""
        basis = self.place(eta)
        taps = self.taps @ self.tangents
        first, last = taps[basis.ends[0]], taps[basis.ends[1]]
        moved = (taps - first - basis.x[:, np.newaxis] * (last - first)) / basis.width
        return LftDerivative(basis, moved, self.index, self.numerator(eta), self.n_fixed)


def map_basis(x: Floats, structure: LftStructure) -> tuple[Floats, Floats]:
    """Return basis and slopes of the map at places in its range, shape (n_points, n_coefficients)."""
    places = np.linspace(0.0, 1.0, structure.knots)
    if structure.basis == "thesis":
        distance, degree = x[:, np.newaxis] - places, structure.degree
        powers = np.abs(distance) ** degree
        slopes = degree * np.sign(distance) * np.abs(distance) ** (degree - 1)
        ones = np.ones_like(x)
        return np.column_stack([powers, x, ones]), np.column_stack([slopes, ones, np.zeros_like(x)])
    values = np.zeros((x.size, structure.n_coefficients))
    slopes = np.zeros_like(values)
    if np.isnan(x).any():  # z has no range
        values[:] = np.nan
        return values, slopes
    fill_basis(x, places, structure.degree, LINEAR, values, slopes)
    return values, slopes


def to_bsplines(structure: LftStructure) -> Floats:
    """Return the matrix that turns coefficients of the fit into those of B-splines."""
    if structure.basis == "bspline":
        return np.eye(structure.n_coefficients)
    x = np.linspace(0.0, 1.0, 8 * (structure.knots + structure.degree))
    b, _ = map_basis(x, replace(structure, basis="bspline"))
    return np.asarray(np.linalg.lstsq(b, map_basis(x, structure)[0])[0])
