"""Input signals for experiments; independent draws come from ``sysid.distributions``."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.distributions import Distribution
from sysid.errors import UsageError

Floats = NDArray[np.float64]


def random_steps(rng: np.random.Generator, n: int, levels: Distribution, hold: int = 1) -> Floats:
    """Return random levels, each held for ``hold`` samples.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the draws.
    n : int
        Number of samples; the last level is cut short where ``hold`` does not divide it.
    levels : Distribution
        Distribution of the levels; with ``hold=1`` the signal is independent draws from it.
    hold : int
        Samples per level.

    Returns
    -------
    ndarray, shape (n,)

    Raises
    ------
    UsageError
        If ``n`` or ``hold`` is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.distributions import Uniform
    >>> u = random_steps(np.random.default_rng(0), 5, Uniform(0.0, 1.0), hold=2)
    >>> u.shape, u[0] == u[1], u[1] == u[2]
    ((5,), np.True_, np.False_)
    """
    _check_at_least("random_steps: n", n, 1)
    _check_at_least("random_steps: hold", hold, 1)
    return np.repeat(levels.sample(rng, -(-n // hold)), hold)[:n]


def multisine(
    period: int,
    lines: Sequence[int] | NDArray[np.int64],
    rms: float = 1.0,
    rng: np.random.Generator | None = None,
    periods: int = 1,
) -> Floats:
    """Return a periodic sum of sines with equal amplitudes.

    Parameters
    ----------
    period : int
        Samples per period.
    lines : sequence of int
        Excited harmonics of the period, distinct, each in ``1 .. (period - 1) // 2``.
    rms : float
        Root mean square of the signal, exact over a period.
    rng : numpy.random.Generator, optional
        Source of uniformly random phases; without it the phases are Schroeder's, for a low crest.
    periods : int
        Number of periods.

    Returns
    -------
    ndarray, shape (period * periods,)

    Raises
    ------
    UsageError
        If a line is repeated or outside its range, or a number is not positive.

    Notes
    -----
    Schroeder (1970), Synthesis of low-peak-factor signals, IEEE Trans. Information Theory 16.

    Examples
    --------
    >>> u = multisine(64, [1, 2, 3], rms=2.0)
    >>> round(float((u**2).mean()), 12)
    4.0
    """
    _check_at_least("multisine: period", period, 3)
    _check_at_least("multisine: periods", periods, 1)
    _check_positive("multisine: rms", rms)
    harmonics = np.asarray(lines)
    count = harmonics.size
    highest = (period - 1) // 2
    if harmonics.ndim != 1 or count == 0 or harmonics.dtype.kind not in "iu":
        raise UsageError("multisine: lines is not a sequence of integers; name at least one harmonic.")
    if harmonics.min() < 1 or harmonics.max() > highest or np.unique(harmonics).size != count:
        raise UsageError(
            f"multisine: lines {harmonics.tolist()} are unusable; give distinct harmonics in 1..{highest} "
            f"for a period of {period} samples."
        )
    position = np.arange(count)
    phase = rng.uniform(0.0, 2.0 * np.pi, count) if rng else -np.pi * position * (position + 1) / count
    spectrum = np.zeros(period // 2 + 1, complex)
    spectrum[harmonics] = np.exp(1j * phase) * period * rms / math.sqrt(2.0 * count)
    return np.tile(np.fft.irfft(spectrum, period), periods)


def prbs(order: int, amplitude: float = 1.0, hold: int = 1, periods: int = 1) -> Floats:
    """Return a pseudo-random binary sequence of maximal length.

    Parameters
    ----------
    order : int
        Length of the shift register, 2 to 20; a period is ``2**order - 1`` bits.
    amplitude : float
        The signal is ``+amplitude`` or ``-amplitude``.
    hold : int
        Samples per bit.
    periods : int
        Number of periods.

    Returns
    -------
    ndarray, shape ((2**order - 1) * hold * periods,)

    Raises
    ------
    UsageError
        If the order is outside 2..20 or another number is not positive.

    Examples
    --------
    >>> prbs(3)
    array([ 1.,  1.,  1., -1.,  1., -1., -1.])
    """
    from scipy.signal import max_len_seq

    if not 2 <= order <= 20:
        raise UsageError(f"prbs: order is {order}; give a register length from 2 to 20.")
    _check_at_least("prbs: hold", hold, 1)
    _check_at_least("prbs: periods", periods, 1)
    _check_positive("prbs: amplitude", amplitude)
    bits = np.asarray(max_len_seq(order)[0], np.float64)
    return np.tile(np.repeat(amplitude * (2.0 * bits - 1.0), hold), periods)


def impulse_levels(levels: ArrayLike, order: int, periods: int = 1, *, even: bool = False) -> Floats:
    """Return Giri's periodic train of one impulse a level, eq. (5.1).

    With n = ``order`` a period has n (n_levels + 3) samples; the first level comes at 2n, the others
    at 4n, 5n, ...  The gap of 2n after the first impulse gives the free response of the plant a second
    start, so that the two free stretches of a period together excite every mode.

    Parameters
    ----------
    levels : array_like, shape (n_levels,)
        Heights of the impulses, at least two, none of them zero.
    order : int
        Order n of the linear system to be identified.
    periods : int
        Number of periods.
    even : bool
        Put the impulses at 2n, 3n, 4n, ... instead: the same period with one free stretch, which some
        plants do not excite.

    Returns
    -------
    ndarray, shape (order * (n_levels + 3) * periods,)

    Raises
    ------
    UsageError
        If there are fewer than two levels, one is zero or not finite, or a number is not positive.

    Examples
    --------
    >>> impulse_levels([-6.0, -3.0, 3.0, 6.0], order=1)
    array([ 0.,  0., -6.,  0., -3.,  3.,  6.])
    """
    _check_at_least("impulse_levels: order", order, 1)
    _check_at_least("impulse_levels: periods", periods, 1)
    heights = np.asarray(levels, dtype=np.float64)
    if heights.ndim != 1 or heights.size < 2 or not np.all(np.isfinite(heights)) or np.any(heights == 0.0):
        raise UsageError(
            f"impulse_levels: levels are {heights.tolist()}; give at least two finite numbers, none zero."
        )
    places = (2 + np.arange(heights.size)) * order
    if not even:
        places[1:] += order
    period = np.zeros(order * (heights.size + 3))
    period[places] = heights
    return np.tile(period, periods)


def _check_at_least(what: str, value: int, least: int) -> None:
    if value < least:
        raise UsageError(f"{what} is {value}; give an integer >= {least}.")


def _check_positive(what: str, value: float) -> None:
    if not (value > 0.0 and math.isfinite(value)):
        raise UsageError(f"{what} is {value}; give a positive finite number.")
