"""Input distributions: draws, and exact moments over any interval."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sysid.errors import UsageError

Floats = NDArray[np.float64]

_QUADRATURE_TOLERANCE = 1e-12
_GAUSSIAN_PANELS = (-39.0, -12.0, -6.0, -3.0, 0.0, 3.0, 6.0, 12.0, 39.0)  # in standard deviations


class Distribution(ABC):
    """Distribution of one sample of an independent input sequence."""

    @abstractmethod
    def sample(self, rng: np.random.Generator, n: int) -> Floats:
        """Draw ``n`` independent values, shape (n,)."""

    @abstractmethod
    def partial_moment(self, order: int, lower: float, upper: float) -> float:
        """Return E[u^order; lower < u <= upper] in closed form, order 0, 1 or 2."""

    @abstractmethod
    def reflected(self) -> Distribution:
        """Return the distribution of -u."""

    @abstractmethod
    def expectation(self, function: Callable[[float], float], breaks: Iterable[float] = ()) -> float:
        """Return E[function(u)] by adaptive quadrature between the ``breaks``.

        Parameters
        ----------
        function : callable
            Maps one number to one number; smooth between the breaks.
        breaks : iterable of float
            Where the function has a jump or a kink.

        Raises
        ------
        UsageError
            If the quadrature does not reach an error below 1e-12 (relative to the integral of
            the function where that exceeds one), as with a jump that is not among the breaks.
        """

    @property
    def mean(self) -> float:
        """E[u]."""
        return self.partial_moment(1, -math.inf, math.inf)

    @property
    def variance(self) -> float:
        """E[(u - E[u])^2]."""
        return self.partial_moment(2, -math.inf, math.inf) - self.mean**2

    def probability(self, lower: float, upper: float) -> float:
        """Return P(lower < u <= upper)."""
        return self.partial_moment(0, lower, upper)


class _UniformPieces(Distribution):
    """What every mixture of uniform pieces and point masses shares."""

    @property
    @abstractmethod
    def intervals(self) -> tuple[tuple[float, float, float], ...]:
        """Uniform pieces (low, high, probability)."""

    @property
    @abstractmethod
    def masses(self) -> tuple[tuple[float, float], ...]:
        """Point masses (point, probability)."""

    def partial_moment(self, order: int, lower: float, upper: float) -> float:
        """Return E[u^order; lower < u <= upper] in closed form, order 0, 1 or 2."""
        _check_order(order)
        total = 0.0
        for low, high, weight in self.intervals:
            start, stop = max(low, lower), min(high, upper)
            if start < stop:
                middle, half = 0.5 * (start + stop), 0.5 * (stop - start)
                power = (1.0, middle, middle**2 + half**2 / 3.0)[order]
                total += weight * (stop - start) / (high - low) * power
        return total + sum(weight * point**order for point, weight in self.masses if lower < point <= upper)

    def expectation(self, function: Callable[[float], float], breaks: Iterable[float] = ()) -> float:
        """Return E[function(u)] by adaptive quadrature between the ``breaks``.

        Parameters
        ----------
        function : callable
            Maps one number to one number; smooth between the breaks.
        breaks : iterable of float
            Where the function has a jump or a kink.

        Raises
        ------
        UsageError
            If the quadrature does not reach an error below 1e-12.
        """
        breaks = tuple(breaks)
        total = sum(weight * function(point) for point, weight in self.masses)
        for low, high, weight in self.intervals:
            total += weight / (high - low) * _integral(function, low, high, breaks)
        return total

    @property
    def variance(self) -> float:
        """E[(u - E[u])^2]; summed about the mean so that nothing cancels."""
        mean = self.mean
        spread = sum(w * ((0.5 * (a + b) - mean) ** 2 + (b - a) ** 2 / 12.0) for a, b, w in self.intervals)
        return spread + sum(weight * (point - mean) ** 2 for point, weight in self.masses)


@dataclass(frozen=True)
class Uniform(_UniformPieces):
    """Uniform distribution on ``[low, high]``.

    Examples
    --------
    >>> u = Uniform.symmetric(4.0)
    >>> u.mean, round(u.variance, 6)
    (0.0, 5.333333)
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        _check_interval("Uniform", self.low, self.high)

    @classmethod
    def symmetric(cls, bound: float) -> Uniform:
        """Return the uniform distribution on ``[-bound, bound]``."""
        return cls(-bound, bound)

    @property
    def intervals(self) -> tuple[tuple[float, float, float], ...]:
        """The one piece, with probability one."""
        return ((self.low, self.high, 1.0),)

    @property
    def masses(self) -> tuple[tuple[float, float], ...]:
        """None."""
        return ()

    def sample(self, rng: np.random.Generator, n: int) -> Floats:
        """Draw ``n`` independent values, shape (n,)."""
        return rng.uniform(self.low, self.high, n)

    def reflected(self) -> Uniform:
        """Return the distribution of -u."""
        return Uniform(-self.high, -self.low)


@dataclass(frozen=True)
class PiecewiseUniform(_UniformPieces):
    """Mixture of uniform pieces and point masses.

    Parameters
    ----------
    intervals : sequence of (low, high, probability)
        Uniform pieces.
    masses : sequence of (point, probability)
        Point masses.

    Raises
    ------
    UsageError
        If an interval is empty, a probability is negative or they do not sum to one.

    Examples
    --------
    >>> u = PiecewiseUniform.mass_and_uniform(2.0)
    >>> u.mean, u.probability(0.0, 2.0)
    (-0.5, 0.5)
    """

    intervals: tuple[tuple[float, float, float], ...] = ()
    masses: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "intervals", tuple(tuple(map(float, piece)) for piece in self.intervals))
        object.__setattr__(self, "masses", tuple(tuple(map(float, mass)) for mass in self.masses))
        for low, high, _ in self.intervals:
            _check_interval("PiecewiseUniform", low, high)
        for point, _ in self.masses:
            if not math.isfinite(point):
                raise UsageError(f"PiecewiseUniform: a point mass is at {point}; give a finite point.")
        weights = [piece[2] for piece in self.intervals] + [mass[1] for mass in self.masses]
        if not all(weight >= 0.0 for weight in weights) or abs(sum(weights) - 1.0) > 1e-12:
            raise UsageError(
                f"PiecewiseUniform: the probabilities {weights} sum to {sum(weights):.15g}; "
                "give nonnegative ones that sum to 1."
            )

    @classmethod
    def zero_mean(cls, negative_bound: float, positive_bound: float) -> PiecewiseUniform:
        """Return the two-step density of zero mean on ``[-d1, d2]``: Eq. (3.7) of Bai (2002)."""
        d1, d2 = negative_bound, positive_bound
        _check_interval("PiecewiseUniform.zero_mean", -d1, 0.0)
        _check_interval("PiecewiseUniform.zero_mean", 0.0, d2)
        return cls(((-d1, 0.0, d2 / (d1 + d2)), (0.0, d2, d1 / (d1 + d2))))

    @classmethod
    def mass_and_uniform(cls, bound: float) -> PiecewiseUniform:
        """Return half a mass at -bound, half uniform on [0, bound]: Eq. (3.10) of Bai (2002)."""
        return cls(((0.0, bound, 0.5),), ((-bound, 0.5),))

    def sample(self, rng: np.random.Generator, n: int) -> Floats:
        """Draw ``n`` independent values, shape (n,)."""
        lows = np.array([piece[0] for piece in self.intervals] + [mass[0] for mass in self.masses])
        highs = np.array([piece[1] for piece in self.intervals] + [mass[0] for mass in self.masses])
        weights = [piece[2] for piece in self.intervals] + [mass[1] for mass in self.masses]
        component = rng.choice(lows.size, size=n, p=weights)
        draws: Floats = lows[component] + (highs - lows)[component] * rng.random(n)
        return draws

    def reflected(self) -> PiecewiseUniform:
        """Return the distribution of -u."""
        return PiecewiseUniform(
            tuple((-high, -low, weight) for low, high, weight in self.intervals),
            tuple((-point, weight) for point, weight in self.masses),
        )


@dataclass(frozen=True)
class Gaussian(Distribution):
    """Gaussian distribution of given mean and standard deviation.

    Examples
    --------
    >>> round(Gaussian().probability(-1.959964, 1.959964), 6)
    0.95
    """

    location: float = 0.0
    std: float = 1.0

    def __post_init__(self) -> None:
        if not math.isfinite(self.location):
            raise UsageError(f"Gaussian: the mean is {self.location}; give a finite number.")
        if not (self.std > 0.0 and math.isfinite(self.std)):
            raise UsageError(
                f"Gaussian: the standard deviation is {self.std}; give a positive finite number."
            )

    @property
    def mean(self) -> float:
        """E[u]."""
        return self.location

    @property
    def variance(self) -> float:
        """E[(u - E[u])^2]."""
        return self.std**2

    def sample(self, rng: np.random.Generator, n: int) -> Floats:
        """Draw ``n`` independent values, shape (n,)."""
        return rng.normal(self.location, self.std, n)

    def partial_moment(self, order: int, lower: float, upper: float) -> float:
        """Return E[u^order; lower < u <= upper] in closed form, order 0, 1 or 2."""
        _check_order(order)
        if not lower < upper:
            return 0.0
        a, b = (lower - self.location) / self.std, (upper - self.location) / self.std
        standard = (
            _gaussian_probability(a, b),
            _gaussian_density(a) - _gaussian_density(b),
            _gaussian_probability(a, b) + _times_density(a) - _times_density(b),
        )
        if order == 0:
            return standard[0]
        if order == 1:
            return self.location * standard[0] + self.std * standard[1]
        return (
            self.location**2 * standard[0]
            + 2.0 * self.location * self.std * standard[1]
            + self.std**2 * standard[2]
        )

    def reflected(self) -> Gaussian:
        """Return the distribution of -u."""
        return Gaussian(-self.location, self.std)

    def expectation(self, function: Callable[[float], float], breaks: Iterable[float] = ()) -> float:
        """Return E[function(u)] by adaptive quadrature between the ``breaks``.

        Parameters
        ----------
        function : callable
            Maps one number to one number; smooth between the breaks and growing at most
            polynomially.
        breaks : iterable of float
            Where the function has a jump or a kink.

        Raises
        ------
        UsageError
            If the quadrature does not reach an error below 1e-12.
        """
        edges = [self.location + self.std * z for z in _GAUSSIAN_PANELS]
        interior = (*edges[1:-1], *breaks)

        def weighted(u: float) -> float:
            return function(u) * _gaussian_density((u - self.location) / self.std)

        return _integral(weighted, edges[0], edges[-1], interior) / self.std


def _gaussian_density(z: float) -> float:
    return math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)


def _times_density(z: float) -> float:
    return 0.0 if math.isinf(z) else z * _gaussian_density(z)


def _gaussian_probability(a: float, b: float) -> float:
    """P(a < z <= b); both ends taken on the side where the tails are small."""
    root = math.sqrt(2.0)
    if a > 0.0:
        return 0.5 * (math.erfc(a / root) - math.erfc(b / root))
    return 0.5 * (math.erfc(-b / root) - math.erfc(-a / root))


def _integral(
    function: Callable[[float], float], lower: float, upper: float, breaks: Iterable[float]
) -> float:
    """Integrate over each smooth panel of ``[lower, upper]``."""
    from scipy.integrate import quad

    edges = [lower, *sorted({point for point in breaks if lower < point < upper}), upper]
    total = 0.0
    for start, stop in pairwise(edges):
        value, error, *_ = quad(function, start, stop, epsabs=1e-14, epsrel=1e-13, limit=200, full_output=1)
        bound = _QUADRATURE_TOLERANCE * max(1.0, abs(value))
        if not error <= bound:
            raise UsageError(
                f"The expectation on [{start:.6g}, {stop:.6g}] has error {error:.1e}, above {bound:.1e}; "
                "list every jump and kink of the function in `breaks`."
            )
        total += value
    return float(total)


def _check_order(order: int) -> None:
    if order not in (0, 1, 2):
        raise UsageError(f"A partial moment of order {order} was asked for; the orders are 0, 1 and 2.")


def _check_interval(what: str, low: float, high: float) -> None:
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise UsageError(
            f"{what}: the interval [{low}, {high}] is not one; give finite ends with low < high."
        )
