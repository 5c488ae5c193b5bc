"""Derivatives of an effect by its parameters, where no formula is known: central differences."""

from collections.abc import Callable

import numpy as np

from sysid._compile import compiled
from sysid.diagnosis.effects.base import Floats

# Relative step of a difference quotient: between rounding and curvature for values of any size.
STEP = 1e-5
# A step in a strength is enlarged until its change is this share of what it is added to.
LEAST_FELT = 1e-6


def quotient(function: Callable[[float], Floats], value: float, strength: bool) -> Floats:
    """Return the derivative by a parameter as a central difference.

    Parameters
    ----------
    function : callable
        The sequence for a value of the parameter.
    value : float
    strength : bool
        Whether the sequence is linear in the parameter.

    Notes
    -----
    Effects are linear in a strength, so that its step may be large; it must only be felt beside what
    it is added to.
    """
    step = max(1e-3 * abs(value), 1.0) if strength else STEP * (abs(value) or 1.0)
    while True:
        slope, felt = _difference(function(value + step), function(value - step), step)
        if not strength or step > 1e30 or felt:
            return slope
        step *= 1e4


@compiled
def _difference(ahead: Floats, behind: Floats, step: float) -> tuple[Floats, bool]:
    """Return the central difference, and whether it is felt beside what it is added to."""
    slope, largest_change, largest = np.empty(ahead.shape[0]), 0.0, 0.0
    for k in range(ahead.shape[0]):
        change = ahead[k] - behind[k]
        slope[k] = change / (2.0 * step)
        largest_change = max(largest_change, abs(change))
        largest = max(largest, abs(behind[k]))
    return slope, largest_change >= LEAST_FELT * largest
