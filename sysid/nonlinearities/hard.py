"""Hard static nonlinearities: preload, dead zone, saturation, relay, their two-sided and even kin.

Every map here is sign(u) times a magnitude (an even map: the magnitude alone) that is affine in
|u| and in its parameter, once for |u| <= a and once beyond.  Values, pieces and moments follow
from these six coefficients.
"""

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sysid.distributions import Distribution
from sysid.nonlinearities.base import (
    Floats,
    Nonlinearity,
    OneParameterMap,
    checked_input,
    checked_range,
    checked_sequence,
)
from sysid.nonlinearities.kernels import (
    BOTH_SIDES,
    NEGATIVE_SIDE,
    POSITIVE_SIDE,
    Law,
    PieceArrays,
    static_pieces,
    static_response,
)
from sysid.separable.pieces import AffinePieces


class Branch(NamedTuple):
    """Magnitude ``constant + input |u| + parameter a`` on one side of the threshold."""

    constant: float
    input: float
    parameter: float


class StaticMap(Nonlinearity):
    """A map without memory: its moments under an input distribution are closed forms."""

    def mean(self, distribution: Distribution, *parameters: float) -> float:
        """Return E[x] in closed form."""
        return self._moment(distribution, 0, self._checked(parameters))

    def moment(self, distribution: Distribution, *parameters: float) -> float:
        """Return q = E[x u] in closed form, as in Section 3 of Bai (2002)."""
        return self._moment(distribution, 1, self._checked(parameters))

    def covariance(self, distribution: Distribution, *parameters: float) -> float:
        """Return E[x u] - E[x] E[u], what a correlation with the centred input gives."""
        mean = self.mean(distribution, *parameters)
        return self.moment(distribution, *parameters) - mean * distribution.mean

    def moment_by_quadrature(self, distribution: Distribution, *parameters: float) -> float:
        """Return q = E[x u] by adaptive quadrature, independently of :meth:`moment`."""
        thresholds = self._checked(parameters)
        breaks = (-thresholds[0], 0.0, thresholds[-1])
        return distribution.expectation(lambda u: u * float(self(u, *parameters)), breaks)

    def _moment(self, distribution: Distribution, power: int, thresholds: tuple[float, ...]) -> float:
        """Return E[x u^power], the negative half by reflection."""
        law = self._law
        negative = _half_moment(law, distribution.reflected(), power, thresholds[0])
        positive = _half_moment(law, distribution, power, thresholds[-1])
        even_product = (power == 0) == bool(law[-1])
        return positive + negative if even_product else positive - negative

    @property
    @abstractmethod
    def _law(self) -> Law:
        """The six coefficients and the parity, for the kernels."""


@dataclass(frozen=True)
class HardMap(StaticMap, OneParameterMap):
    """A hard static map with one threshold.

    Parameters
    ----------
    name, title : str
        Key and name for tables.
    inner, outer : Branch
        Magnitude for ``|u| <= a`` and for ``|u| > a``.
    even : bool
        Whether x(-u) = x(u); otherwise x(-u) = -x(u).

    Examples
    --------
    >>> SATURATION([-2.0, 0.5, 3.0], 1.0)
    array([-1. ,  0.5,  1. ])
    >>> from sysid.distributions import Uniform
    >>> SATURATION.moment(Uniform.symmetric(2.0), 1.0)  # (3.13): a/b (b^2/2 - a^2/6)
    0.9166666666666666
    """

    name: str
    title: str
    inner: Branch
    outer: Branch
    even: bool = False

    @property
    def _law(self) -> Law:
        return (*self.inner, *self.outer, float(self.even))

    def __call__(self, u: ArrayLike, *parameters: float) -> Floats:
        """Return the output x, in the shape of ``u``.

        Raises
        ------
        ModelError
            If the parameter is negative or not finite.
        UsageError
            If the input is not finite.
        """
        return self._response(u, parameters)[0]

    def slope(self, u: ArrayLike, *parameters: float) -> Floats:
        """Return dx/da, in the shape of ``u``; the right derivative at |u| = a."""
        return self._response(u, parameters)[1]

    def _response(self, u: ArrayLike, parameters: tuple[float, ...]) -> tuple[Floats, Floats]:
        (a,) = self._checked(parameters)
        values = checked_input(self.name, u)
        x, slope = static_response(values.reshape(-1), a, a, self._law)
        return x.reshape(values.shape), slope.reshape(values.shape)

    def piece_arrays(self, u: Floats, lower: float, upper: float) -> PieceArrays:
        """Return the arrays of :meth:`pieces` without any check, for estimators' inner loops.

        ``u`` must be a contiguous, writeable float array of shape (n_samples,).
        """
        return static_pieces(u, lower, upper, self._law, BOTH_SIDES)


@dataclass(frozen=True)
class TwoSidedMap(StaticMap):
    """A hard map with parameter a1 for negative and a2 for positive input.

    Parameters
    ----------
    symmetric : HardMap
        The map it becomes with a1 = a2.

    Examples
    --------
    >>> TWO_SIDED_PRELOAD([-1.0, 0.0, 1.0], 0.5, 2.0)
    array([-1.5,  0. ,  3. ])
    """

    symmetric: HardMap
    parameters: tuple[str, ...] = ("a1", "a2")

    @property
    def name(self) -> str:  # type: ignore[override]
        """The symmetric map's name with ``two-sided-`` in front."""
        return f"two-sided-{self.symmetric.name}"

    @property
    def title(self) -> str:  # type: ignore[override]
        """Name for tables and figures."""
        return f"Non-symmetric {self.symmetric.title.lower()}"

    @property
    def _law(self) -> Law:
        return self.symmetric._law

    def __call__(self, u: ArrayLike, *parameters: float) -> Floats:
        """Return the output x, in the shape of ``u``.

        Raises
        ------
        ModelError
            If a parameter is negative or not finite.
        UsageError
            If the input is not finite.
        """
        negative, positive = self._checked(parameters)
        values = checked_input(self.name, u)
        x, _ = static_response(values.reshape(-1), negative, positive, self._law)
        return x.reshape(values.shape)

    def slope(self, u: ArrayLike, *parameters: float) -> Floats:
        """Return (dx/da1, dx/da2), shape (..., 2); the right derivatives at a kink."""
        negative, positive = self._checked(parameters)
        values = checked_input(self.name, u)
        _, slope = static_response(values.reshape(-1), negative, positive, self._law)
        own = slope.reshape(values.shape)
        return np.stack([np.where(values < 0.0, own, 0.0), np.where(values > 0.0, own, 0.0)], axis=-1)

    def sided_piece_arrays(self, u: Floats, lower: float, upper: float) -> tuple[PieceArrays, PieceArrays]:
        """Return the arrays of :meth:`sided_pieces` without any check."""
        law = self._law
        return (
            static_pieces(u, lower, upper, law, NEGATIVE_SIDE),
            static_pieces(u, lower, upper, law, POSITIVE_SIDE),
        )

    def sided_pieces(self, u: ArrayLike, lower: float, upper: float) -> tuple[AffinePieces, AffinePieces]:
        """Return the two summands of x = x_negative(a1) + x_positive(a2), both on ``[lower, upper]``.

        Parameters
        ----------
        u : array_like, shape (n_samples,)
            Input.
        lower, upper : float
            Range of both parameters, ``0 <= lower < upper``.

        Raises
        ------
        UsageError
            If ``u`` is not one finite sequence or the range is empty or negative.
        """
        lower, upper = checked_range(self.name, lower, upper)
        negative, positive = self.sided_piece_arrays(checked_sequence(self.name, u), lower, upper)
        return AffinePieces(lower, upper, *negative), AffinePieces(lower, upper, *positive)


def _half_moment(law: Law, distribution: Distribution, power: int, a: float) -> float:
    """Return E[g(u) u^power; u > 0] of the magnitude g, from the distribution's partial moments."""
    total = 0.0
    for constant, gain, parameter, start, stop in ((*law[0:3], 0.0, a), (*law[3:6], a, math.inf)):
        level = constant + parameter * a
        if level != 0.0:
            total += level * distribution.partial_moment(power, start, stop)
        if gain != 0.0:
            total += gain * distribution.partial_moment(power + 1, start, stop)
    return total


_ZERO, _INPUT = Branch(0.0, 0.0, 0.0), Branch(0.0, 1.0, 0.0)
_BEYOND = Branch(0.0, 1.0, -1.0)

PRELOAD = HardMap("preload", "Preload", Branch(0.0, 1.0, 1.0), Branch(0.0, 1.0, 1.0))
"""x = u + a sgn u."""
DEAD_ZONE = HardMap("dead-zone", "Dead zone", _ZERO, _BEYOND)
"""x = 0 for |u| <= a, else u - a sgn u."""
SATURATION = HardMap("saturation", "Saturation", _INPUT, Branch(0.0, 0.0, 1.0))
"""x = u for |u| <= a, else a sgn u."""
RELAY = HardMap("relay", "Relay", _ZERO, Branch(1.0, 0.0, 0.0))
"""x = 0 for |u| <= a, else sgn u."""
EVEN_DEAD_ZONE = HardMap("even-dead-zone", "Even dead zone", _ZERO, _BEYOND, even=True)
"""x = max(|u| - a, 0): an even map, uncorrelated with every even input (Remark 3.2 of Bai, 2002)."""

TWO_SIDED_PRELOAD = TwoSidedMap(PRELOAD)
"""Eq. (3.9) of Bai (2002)."""
TWO_SIDED_DEAD_ZONE = TwoSidedMap(DEAD_ZONE)
TWO_SIDED_SATURATION = TwoSidedMap(SATURATION)
TWO_SIDED_RELAY = TwoSidedMap(RELAY)
"""Eq. (3.6) of Bai (2002)."""
