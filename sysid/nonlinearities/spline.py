r"""Spline maps: a static nonlinearity of no assumed form, linear in its coefficients.

Pepona (2009), eq. (4.10c), writes a map of degree m with knots :math:`\kappa_1 < \dots < \kappa_s` as
:math:`w = \sum_j \lambda_j |z - \kappa_j|^m + \lambda_{s+1} z + \lambda_0`.  For m = 3 this is the space
of all cubic splines with these knots between the first and the last one, and B-splines span it with
a far better condition.  For other m it is not: an even power has no break at its knot, m = 1
counts two functions twice, and m = 5 leaves some out.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import IdentifiabilityError, ModelError, UsageError
from sysid.nonlinearities.base import Floats, checked_input, checked_sequence
from sysid.nonlinearities.spline_kernels import (
    CONSTANT,
    LINEAR,
    fill_basis,
    fill_by_knots,
    fill_values,
)

Extrapolation = Literal["linear", "constant"]

EXTRAPOLATIONS = {"constant": CONSTANT, "linear": LINEAR}
LARGEST_DEGREE = 7


@dataclass(frozen=True, eq=False)
class Spline:
    """A map w = f(z) of piecewise polynomials that join smoothly.

    Attributes
    ----------
    knots : ndarray, shape (n_knots,)
        Ascending; the first and the last one bound the range in which the map is fitted.
    coefficients : ndarray, shape (n_knots - 1 + degree,)
        Of the B-splines; the first and the last one are the values at both ends.
    degree : int
    extrapolation : {"linear", "constant"}
        How the map goes on outside its knots: never as a polynomial of higher degree.

    Examples
    --------
    >>> import numpy as np
    >>> z = np.linspace(-1.0, 1.0, 50)
    >>> cube = Spline.fitted(z, z**3, equal_knots(z, 4))
    >>> cube([0.5, 1.0, 2.0]).round(9)  # beyond the last knot with the slope it had there
    array([0.125, 1.   , 4.   ])
    >>> cube.slope([0.5]).round(9)
    array([0.75])
    """

    knots: Floats
    coefficients: Floats
    degree: int = 3
    extrapolation: Extrapolation = "linear"

    def __post_init__(self) -> None:
        knots, degree, _ = _checked_form(self.knots, self.degree, self.extrapolation)
        coefficients = np.array(self.coefficients, dtype=np.float64)
        if coefficients.shape != (knots.size - 1 + degree,):
            raise ModelError(
                f"spline: coefficients of shape {coefficients.shape} were given; {knots.size} knots and "
                f"degree {degree} take {knots.size - 1 + degree}"
            )
        coefficients.setflags(write=False)
        object.__setattr__(self, "knots", knots)
        object.__setattr__(self, "coefficients", coefficients)

    @classmethod
    def fitted(
        cls,
        z: ArrayLike,
        w: ArrayLike,
        knots: ArrayLike,
        *,
        degree: int = 3,
        extrapolation: Extrapolation = "linear",
    ) -> "Spline":
        """Fit a spline to points by least squares.

        Parameters
        ----------
        z, w : array_like, shape (n_points,)
        knots : array_like, shape (n_knots,)
        degree : int
        extrapolation : {"linear", "constant"}

        Raises
        ------
        IdentifiabilityError
            If a basis function has no data.
        """
        from sysid.separable.factor import project

        basis = spline_basis(z, knots, degree=degree, extrapolation=extrapolation)
        fit = project(basis, checked_sequence("spline", w))
        if fit.rank < basis.shape[1]:
            raise IdentifiabilityError(
                f"spline: only {fit.rank} of {basis.shape[1]} coefficients are seen by the data: "
                "take fewer knots, or place them at quantiles of z"
            )
        return cls(np.asarray(knots, dtype=np.float64), fit.theta, degree, extrapolation)

    def __call__(self, z: ArrayLike) -> Floats:
        """Return w = f(z), in the shape of ``z``."""
        return self._values(z)[0]

    def slope(self, z: ArrayLike) -> Floats:
        """Return the derivative of f by z, in the shape of ``z``."""
        return self._values(z)[1]

    def basis(self, z: ArrayLike) -> Floats:
        """Return the derivatives of f by the coefficients, shape (n_points, n_coefficients)."""
        return spline_basis(z, self.knots, degree=self.degree, extrapolation=self.extrapolation)

    def by_knots(self, z: ArrayLike) -> Floats:
        """Return the derivatives of f by the knots, coefficients held, shape (n_points, n_knots)."""
        points = checked_sequence("spline", z)
        out = np.empty((points.size, self.knots.size))
        form = EXTRAPOLATIONS[self.extrapolation]
        fill_by_knots(points, self.knots, self.degree, form, self.coefficients, out)
        return out

    def _values(self, z: ArrayLike) -> tuple[Floats, Floats]:
        points = checked_input("spline", z)
        flat = points.reshape(-1)
        values, slopes = np.empty(flat.size), np.empty(flat.size)
        form = EXTRAPOLATIONS[self.extrapolation]
        knots, coefficients = self.knots.copy(), self.coefficients.copy()
        fill_values(flat, knots, self.degree, form, coefficients, values, slopes)
        return values.reshape(points.shape), slopes.reshape(points.shape)


def spline_basis(
    z: ArrayLike, knots: ArrayLike, *, degree: int = 3, extrapolation: Extrapolation = "linear"
) -> Floats:
    """Return the B-splines at points, shape (n_points, n_knots - 1 + degree).

    Parameters
    ----------
    z : array_like, shape (n_points,)
    knots : array_like, shape (n_knots,)
        Ascending.
    degree : int
    extrapolation : {"linear", "constant"}

    Examples
    --------
    >>> spline_basis([0.0, 0.25, 2.0], [0.0, 1.0], degree=1)
    array([[ 1.  ,  0.  ],
           [ 0.75,  0.25],
           [-1.  ,  2.  ]])
    """
    places, degree, form = _checked_form(knots, degree, extrapolation)
    points = checked_sequence("spline", z)
    basis = np.zeros((points.size, places.size - 1 + degree))
    fill_basis(points, places.copy(), degree, form, basis, np.zeros_like(basis))
    return basis


def absolute_power_basis(z: ArrayLike, knots: ArrayLike, *, degree: int = 3) -> Floats:
    r"""Return :math:`|z - \kappa_1|^m, \dots, |z - \kappa_s|^m, z, 1`, eq. (4.16) of Pepona (2009).

    Parameters
    ----------
    z : array_like, shape (n_points,)
    knots : array_like, shape (n_knots,)
        Ascending.
    degree : int
        Odd: an even power of the distance is a polynomial without a break at its knot.

    Returns
    -------
    ndarray, shape (n_points, n_knots + 2)

    Examples
    --------
    >>> absolute_power_basis([0.5], [0.0, 1.0, 2.0])
    array([[0.125, 0.125, 3.375, 0.5  , 1.   ]])
    """
    places, degree, _ = _checked_form(knots, degree, "linear")
    if degree % 2 == 0:
        raise UsageError(f"spline: degree {degree} gives |z - knot|^m no break at its knot: take an odd one")
    points = checked_sequence("spline", z)
    powers = np.abs(points[:, np.newaxis] - places) ** degree
    return np.column_stack([powers, points, np.ones_like(points)])


def equal_knots(z: ArrayLike, n_intervals: int) -> Floats:
    """Return knots equally spaced over the range of ``z``.

    Parameters
    ----------
    z : array_like, shape (n_points,)
    n_intervals : int

    Examples
    --------
    >>> equal_knots([0.0, 3.0, 1.0], 3)
    array([0., 1., 2., 3.])
    """
    points = _spread(z, n_intervals)
    return np.linspace(points.min(), points.max(), n_intervals + 1)


def quantile_knots(z: ArrayLike, n_intervals: int) -> Floats:
    """Return knots between which equally many points lie; quantiles that coincide count once.

    Examples
    --------
    >>> quantile_knots([0.0, 1.0, 2.0, 3.0, 100.0], 2)
    array([  0.,   2., 100.])
    """
    points = _spread(z, n_intervals)
    return np.unique(np.quantile(points, np.linspace(0.0, 1.0, n_intervals + 1)))


def supported_knots(z: ArrayLike, n_intervals: int, fewest: int) -> Floats:
    """Return equally spaced knots without those that would leave an interval too few points.

    Parameters
    ----------
    z : array_like, shape (n_points,)
    n_intervals : int
        Before any is merged with its neighbour.
    fewest : int
        Points that an interval must hold.

    Examples
    --------
    >>> supported_knots([0.0, 1.0, 1.1, 1.9, 2.1, 2.9, 4.0], 4, 2)
    array([0., 2., 4.])
    """
    points = np.sort(_spread(z, n_intervals))
    knots = equal_knots(points, n_intervals)
    kept = [float(knots[0])]
    below = 0
    for knot in knots[1:-1]:
        count = int(np.searchsorted(points, knot))
        if count - below >= fewest and points.size - count >= fewest:
            kept.append(float(knot))
            below = count
    return np.array([*kept, float(knots[-1])])


def _spread(z: ArrayLike, n_intervals: int) -> Floats:
    points = checked_sequence("spline", z)
    if n_intervals < 1:
        raise UsageError(f"spline: {n_intervals} intervals were asked for; give at least 1")
    if points.size < 2 or np.ptp(points) == 0.0:
        raise IdentifiabilityError("spline: all points have one value: a map needs points that differ")
    return points


def _checked_form(knots: ArrayLike, degree: int, extrapolation: str) -> tuple[Floats, int, int]:
    places = np.array(knots, dtype=np.float64)
    if places.ndim != 1 or places.size < 2 or not np.isfinite(places).all() or (np.diff(places) <= 0).any():
        raise ModelError(f"spline: the knots {places.tolist()} do not ascend; give at least two that do")
    if not 1 <= degree <= LARGEST_DEGREE:
        raise ModelError(f"spline: degree is {degree}; give a whole number from 1 to {LARGEST_DEGREE}")
    if extrapolation not in EXTRAPOLATIONS:
        raise UsageError(f"spline: extrapolation is {extrapolation!r}; choose linear or constant")
    places.setflags(write=False)
    return places, int(degree), EXTRAPOLATIONS[extrapolation]
