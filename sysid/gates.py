"""Tolerance gates: what a figure must be, why, and the verdict."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from scipy.special import ndtri

from sysid.errors import UsageError

FALSE_ALARM = 1e-4
"""Default chance that a Monte-Carlo gate is red although nothing is wrong."""


@dataclass(frozen=True)
class Gate:
    """A number with the interval it must lie in.

    Attributes
    ----------
    id : str
        Name, unique within a paper.
    value : float
        What was found.
    lower, upper : float
        Interval, bounds included; infinite where one side is open.
    type : str
        ``exact``, ``digits``, ``relative``, ``absolute``, ``monte-carlo-band`` or ``slope``.
    reason : str
        Why the interval is what it is.
    false_alarm : float or None
        For Monte-Carlo bands: the chance of a red gate when nothing is wrong.
    """

    id: str
    value: float
    lower: float
    upper: float
    type: str
    reason: str
    false_alarm: float | None = None

    @property
    def passed(self) -> bool:
        """Whether the value lies in the interval; one that is not finite never does."""
        return math.isfinite(self.value) and self.lower <= self.value <= self.upper

    def to_json(self) -> dict[str, Any]:
        """Return the gate as JSON types; infinite and undefined numbers become null."""
        fields = asdict(self)
        for name in ("value", "lower", "upper"):
            if not math.isfinite(fields[name]):
                fields[name] = None
        return {**fields, "passed": self.passed}


def exact(name: str, value: float, expected: float, reason: str) -> Gate:
    """Require equality: counts, truths of logic, integers.

    Examples
    --------
    >>> exact("roots", 3, 3, "a cubic with three sign changes").passed
    True
    """
    return Gate(name, float(value), float(expected), float(expected), "exact", reason)


def digits(name: str, value: float, printed: float, decimals: int, reason: str) -> Gate:
    """Require that the value rounds to what is printed with so many decimals.

    Examples
    --------
    >>> digits("alpha1", -0.8349, -0.83, 2, "printed with two decimals").passed
    True
    """
    half = 0.5 * 10.0**-decimals
    # The slack covers the rounding of the printed decimal to binary, nothing else.
    slack = 1e-12 * max(abs(printed), half)
    return Gate(name, float(value), printed - half - slack, printed + half + slack, "digits", reason)


def relative(name: str, value: float, expected: float, tolerance: float, reason: str) -> Gate:
    """Require agreement within a share of the expected value."""
    half = abs(expected) * tolerance
    return Gate(name, float(value), expected - half, expected + half, "relative", reason)


def absolute(name: str, value: float, expected: float, tolerance: float, reason: str) -> Gate:
    """Require agreement within a distance that the reason explains."""
    return Gate(name, float(value), expected - tolerance, expected + tolerance, "absolute", reason)


def monte_carlo_band(
    name: str,
    value: float,
    expected: float,
    std_error: float,
    reason: str,
    *,
    allowance: float = 0.0,
    false_alarm: float = FALSE_ALARM,
) -> Gate:
    """Require agreement within what chance explains.

    Parameters
    ----------
    name, value, expected, reason
        See `Gate`.
    std_error : float
        Standard error of ``value`` over the Monte-Carlo runs; the gate is red if it is not finite.
    allowance : float
        A difference that is no error, such as the known small-sample bias; the reason says which.
    false_alarm : float
        Chance of a red gate when nothing is wrong (two-sided, normal).

    Raises
    ------
    UsageError
        If the false alarm does not lie between 0 and 1.

    Examples
    --------
    >>> monte_carlo_band("bias", 0.002, 0.0, 0.001, "1000 runs").passed
    True
    >>> monte_carlo_band("bias", 0.005, 0.0, 0.001, "1000 runs").passed
    False
    """
    if not 0 < false_alarm < 1:
        raise UsageError(
            f"gate {name}: the false alarm {false_alarm:g} is no chance: give one between 0 and 1"
        )
    half = allowance - float(ndtri(false_alarm / 2)) * std_error
    if not math.isfinite(half):  # an infinite band would hold anything
        half = math.nan
    return Gate(name, float(value), expected - half, expected + half, "monte-carlo-band", reason, false_alarm)


def slope(name: str, value: float, expected: float, tolerance: float, reason: str) -> Gate:
    """Require the exponent of a power law."""
    return Gate(name, float(value), expected - tolerance, expected + tolerance, "slope", reason)


def at_most(name: str, value: float, bound: float, kind: str, reason: str) -> Gate:
    """Require that the value does not exceed a bound."""
    return Gate(name, float(value), -math.inf, bound, kind, reason)


def at_least(name: str, value: float, bound: float, kind: str, reason: str) -> Gate:
    """Require that the value does not fall below a bound."""
    return Gate(name, float(value), bound, math.inf, kind, reason)


def summary(gates: Mapping[str, list[Gate]]) -> str:
    """Return one sentence about all gates.

    Examples
    --------
    >>> summary({"bai": [exact("one", 1, 1, ""), exact("two", 3, 2, "")]})
    '1 of 2 gates passed; red: bai two'
    """
    total = sum(len(group) for group in gates.values())
    red = [f"{paper} {gate.id}" for paper, group in gates.items() for gate in group if not gate.passed]
    if not red:
        return f"all {total} gates passed"
    return f"{total - len(red)} of {total} gates passed; red: {', '.join(red)}"
