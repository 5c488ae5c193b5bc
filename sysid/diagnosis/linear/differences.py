"""Derivatives of an effect by its parameters, where no formula is known: central differences."""

from collections.abc import Callable

from sysid._compile import compiled
from sysid.diagnosis.effects.base import Floats

# Relative step of a difference quotient: between rounding and curvature for values of any size.
STEP = 1e-5
# A step in a strength is enlarged until its change is this share of what it is added to, or as far as this.
LEAST_FELT, LARGEST_STEP = 1e-6, 1e30


@compiled
def first_step(value: float, strength: bool) -> float:
    """Return the step by which a parameter is moved first.

    Effects are linear in a strength, so that its step may be large; it must only be felt beside what
    it is added to.
    """
    if strength:
        return max(1e-3 * abs(value), 1.0)
    return STEP * (abs(value) or 1.0)


@compiled
def central_difference(ahead: Floats, behind: Floats, step: float, slope: Floats) -> bool:
    """Fill the slope; tell whether the step is felt beside what it is added to, or cannot be larger."""
    largest_change, largest = 0.0, 0.0
    for k in range(ahead.shape[0]):
        change = ahead[k] - behind[k]
        slope[k] = change / (2.0 * step)
        largest_change = max(largest_change, abs(change))
        largest = max(largest, abs(behind[k]))
    return largest_change >= LEAST_FELT * largest or step > LARGEST_STEP


def fill_quotient(function: Callable[[float], Floats], value: float, strength: bool, slope: Floats) -> None:
    """Fill the derivative by a parameter, shape (n_rows,), as a central difference.

    Parameters
    ----------
    function : callable
        The sequence for a value of the parameter.
    value : float
    strength : bool
        Whether the sequence is linear in the parameter.
    slope : ndarray, shape (n_rows,)
    """
    step = first_step(value, strength)
    while not central_difference(function(value + step), function(value - step), step, slope) and strength:
        step *= 1e4
