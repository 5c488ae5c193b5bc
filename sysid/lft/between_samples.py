"""Band-limited interpolation between samples, for maps that act in continuous time."""

from functools import cache

import numpy as np

from sysid.errors import UsageError
from sysid.linear.forms import Floats

# Samples on either side that take part, and the shape of Kaiser's window: what passes up to 0.84 of the
# Nyquist frequency is exact to 1e-4.
HALF_LENGTH = 16
KAISER = 8.0
LARGEST_OVERSAMPLING = 8


@cache
def interpolation_taps(oversampling: int) -> Floats:
    """Return the weights of neighbouring samples at the points between two of them.

    A signal without content near the Nyquist frequency has at time k + r/R the value
    sum_j s_j x(k + j), j = 1 - L .. L, with s a windowed sinc.

    Parameters
    ----------
    oversampling : int
        R: points in a sampling period.

    Returns
    -------
    ndarray, shape (R - 1, 2 L)
        Row r - 1 belongs to the point r; each sums to one, so that a constant stays what it is.  Read-only.

    Examples
    --------
    >>> interpolation_taps(1).shape, interpolation_taps(2).shape
    ((0, 32), (1, 32))
    """
    if not 1 <= oversampling <= LARGEST_OVERSAMPLING:
        raise UsageError(
            f"oversampling is {oversampling}: give a whole number from 1 (the map acts at samples) "
            f"to {LARGEST_OVERSAMPLING}"
        )
    j = np.arange(1 - HALF_LENGTH, HALF_LENGTH + 1)
    distance = j - np.arange(1, oversampling)[:, np.newaxis] / oversampling
    window = np.i0(KAISER * np.sqrt(np.maximum(1.0 - (distance / HALF_LENGTH) ** 2, 0.0)))
    taps = np.sinc(distance) * window
    taps /= taps.sum(axis=1, keepdims=True)
    taps.setflags(write=False)
    return np.asarray(taps)
