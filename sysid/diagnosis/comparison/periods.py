"""Periods of the input: found exactly, and what they tell of noise and nonlinear distortion."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.wording import percent, quantity
from sysid.linear.forms import Floats
from sysid.result_files import finite

SHORTEST = 8
# Two periods are the same if they differ by less than this share of the input's deviation.
EQUAL = 1e-3
EXCITED = 1e-3
HARMONICS = 3
LEVEL = 0.01


@dataclass(frozen=True)
class Periodic:
    """Periods of one experiment, the first left out as transient if there are three.

    Attributes
    ----------
    length : int
        Samples in a period.
    u : ndarray, shape (n_periods, length, n_inputs)
    y : ndarray, shape (n_periods, length)
    """

    length: int
    u: Floats
    y: Floats

    @property
    def count(self) -> int:
        """Number of periods."""
        return int(self.y.shape[0])


@dataclass(frozen=True)
class Distortion:
    """Nonlinear distortion at frequencies that the input does not excite.

    Attributes
    ----------
    available : bool
    reason : str
        Why it cannot be had, or what it says.
    even, odd, noise : float
        Root mean square of the output at even and odd unexcited lines less the noise there, and of
        the noise at as many lines, each as a share of the output's deviation.
    p_even, p_odd : float
        Probability of so much by noise alone.
    """

    available: bool
    reason: str
    even: float = float("nan")
    odd: float = float("nan")
    noise: float = float("nan")
    p_even: float = float("nan")
    p_odd: float = float("nan")

    def to_json(self) -> dict[str, Any]:
        """Return the form of the JSON file."""
        if not self.available:
            return {"available": False, "reason": self.reason}
        found = {name: finite(getattr(self, name)) for name in ("even", "odd", "noise", "p_even", "p_odd")}
        return {"available": True, "reason": self.reason, **found}


def find_period(u: Floats) -> int | None:
    """Return the smallest number of samples after which all inputs repeat, if they do so at least once.

    The squared difference of a signal and itself so many samples later is had at all lags from one
    fast Fourier transform; the smallest that vanishes is then compared sample by sample.

    Parameters
    ----------
    u : ndarray, shape (n_samples, n_inputs)

    Examples
    --------
    >>> import numpy as np
    >>> find_period(np.tile(np.random.default_rng(0).standard_normal(50), 3)[:, np.newaxis])
    50
    """
    n = u.shape[0]
    signals = u - u.mean(axis=0)
    spread = signals.std(axis=0)
    signals = signals[:, spread > 0.0] / spread[spread > 0.0]
    if n < 2 * SHORTEST or signals.shape[1] == 0:
        return None
    size = 1 << (2 * n - 1).bit_length()
    products = np.fft.irfft((np.abs(np.fft.rfft(signals, size, axis=0)) ** 2).sum(axis=1), size)
    lags = np.arange(SHORTEST, n // 2 + 1)
    energy = np.concatenate([[0.0], np.cumsum((signals**2).sum(axis=1))])
    differences = energy[n - lags] + energy[n] - energy[lags] - 2.0 * products[lags]
    alike = lags[differences <= EQUAL**2 * (n - lags) * signals.shape[1] + 1e-9 * n]
    for lag in alike[:8].tolist():
        if np.abs(signals[lag:] - signals[:-lag]).max() <= 4.0 * EQUAL:
            return int(lag)
    return None


def periodic_part(record: Record, part: slice, used: Mask) -> Periodic | None:
    """Return the periods of an experiment, counted back from its last measured row.

    Parameters
    ----------
    record : Record
    part : slice
        Rows of the experiment.
    used : ndarray of bool, shape (n_samples,)
        Rows that may be used.
    """
    rows = np.flatnonzero(np.isfinite(record.y[part, 0]) & used[part])
    if rows.size < 2 * SHORTEST:
        return None
    breaks = np.flatnonzero(np.diff(rows) != 1) + 1
    longest = max(np.split(rows, breaks), key=len)
    u, y = record.u[part][longest], record.y[part, 0][longest]
    length = find_period(u)
    if length is None:
        return None
    count = longest.size // length
    count -= count >= 3  # the first holds the transient
    return Periodic(
        length,
        u[longest.size - count * length :].reshape(count, length, -1),
        y[longest.size - count * length :].reshape(count, length),
    )


def distortion(periodic: Periodic | None, period: float) -> Distortion:
    """Compare the output at lines without excitation with the noise between periods.

    A linear system answers at the excited lines only.  Even nonlinearities answer at even sums of
    them, odd ones at odd sums (Pintelon and Schoukens, 2012,
    System Identification, chapter 4: detection lines).

    Parameters
    ----------
    periodic : Periodic or None
    period : float
        Sampling period [s].
    """
    from scipy.special import fdtrc

    if periodic is None or periodic.count < 2:
        return Distortion(
            False,
            "the input does not repeat, so that distortion and noise cannot be told apart by periods",
        )
    U = np.abs(np.fft.rfft(periodic.u[0], axis=0)).max(axis=1)
    U[0] = 0.0
    excited = np.max(U) * EXCITED < U
    last = int(np.flatnonzero(excited)[-1])
    lines = np.arange(1, min((periodic.length - 1) // 2, HARMONICS * last) + 1)
    quiet = lines[~excited[lines]]
    even, odd = quiet[quiet % 2 == 0], quiet[quiet % 2 == 1]
    if even.size == 0 or odd.size == 0:
        highest = quantity(last / (periodic.length * period), "Hz")
        return Distortion(
            False,
            f"the input excites every line up to {highest}: even and odd distortion fall on the linear "
            "response; an input with some lines left out would show them",
        )
    Y = np.fft.rfft(periodic.y, axis=1)
    mean, count = Y.mean(axis=0), periodic.count
    variance = (np.abs(Y - mean) ** 2).sum(axis=0) / (count - 1) / count
    spread = float(np.std(periodic.y.mean(axis=0))) or 1.0
    sizes, p_values = [], []
    for chosen in (even, odd):
        power, noise = float((np.abs(mean[chosen]) ** 2).sum()), float(variance[chosen].sum())
        sizes.append(np.sqrt(2.0 * max(power - noise, 0.0)) / periodic.length / spread)
        ratio = power / max(noise, 1e-30 * max(power, 1e-300))
        p_values.append(float(fdtrc(2 * chosen.size, 2 * chosen.size * (count - 1), ratio)))
    level = float(np.sqrt(2.0 * variance[quiet].sum()) / periodic.length / spread)
    return Distortion(
        True,
        _reading(sizes, p_values, level, count),
        float(sizes[0]),
        float(sizes[1]),
        level,
        p_values[0],
        p_values[1],
    )


def _reading(sizes: list[float], p_values: list[float], noise: float, count: int) -> str:
    found = [
        f"{name} distortion of {percent(size)}"
        for name, size, p in zip(("even", "odd"), sizes, p_values, strict=True)
        if p <= LEVEL / 2.0
    ]
    against = f"of the output, against {percent(noise)} of noise in the mean of {count} periods"
    if not found:
        return f"At lines the input leaves out the output holds noise only ({percent(noise)}): no distortion"
    return f"At lines the input leaves out the output holds {' and '.join(found)} {against}"
