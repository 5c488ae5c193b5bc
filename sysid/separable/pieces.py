"""Signals that are affine in one parameter between knots, stored as a list of events."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class AffinePieces:
    r"""A signal :math:`x_k(a) = \text{offset}_k + a\,\text{slope}_k` for ``lower <= a <= upper``.

    Offset and slope of single samples change at knots.  Every hard map with one parameter is of
    this form (piecewise constant when all slopes are zero), which is what makes an exact global
    search over ``a`` possible.

    Attributes
    ----------
    lower, upper : float
        Range of the parameter that the events cover.
    offset, slope : ndarray, shape (n_samples,)
        The signal just above ``lower``, before any event.
    knot : ndarray, shape (n_events,)
        Parameter values at which a sample changes, ascending, in ``(lower, upper)``.
    sample : ndarray of int, shape (n_events,)
        The sample that changes.
    new_offset, new_slope : ndarray, shape (n_events,)
        Its offset and slope above the knot.
    """

    lower: float
    upper: float
    offset: Floats
    slope: Floats
    knot: Floats
    sample: Indices
    new_offset: Floats
    new_slope: Floats

    @classmethod
    def joined(cls, parts: Sequence["AffinePieces"]) -> "AffinePieces":
        """Return signals over the same range one after another, as of several experiments."""
        if len(parts) == 1:
            return parts[0]
        firsts = accumulate([0, *(part.offset.size for part in parts[:-1])])
        knot = np.concatenate([part.knot for part in parts])
        order = np.argsort(knot, kind="stable")
        return cls(
            parts[0].lower,
            parts[0].upper,
            np.concatenate([part.offset for part in parts]),
            np.concatenate([part.slope for part in parts]),
            knot[order],
            np.concatenate([part.sample + first for part, first in zip(parts, firsts, strict=True)])[order],
            np.concatenate([part.new_offset for part in parts])[order],
            np.concatenate([part.new_slope for part in parts])[order],
        )

    def at(self, a: float) -> Floats:
        """Return the signal at parameter ``a``, shape (n_samples,); the right limit at a knot."""
        offset, slope = self.offset.copy(), self.slope.copy()
        for event in range(int(np.searchsorted(self.knot, a, side="right"))):
            offset[self.sample[event]] = self.new_offset[event]
            slope[self.sample[event]] = self.new_slope[event]
        return offset + a * slope
