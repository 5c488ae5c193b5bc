"""Tests of a residual: is it white, is it free of the input; and when it is largest."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.diagnosis.scores import autocorrelation, block_length, finite
from sysid.linear.forms import Floats

LARGEST_LAG = 25
BAND_LEVEL = 0.99
BAND = 2.5758293035489004  # 99.5 % quantile of the normal distribution
WINDOWS = 20
WINDOW_LEVEL = 0.01
LISTED_WINDOWS = 3
WINDOW_REPLICATES = 10_000


@dataclass(frozen=True)
class CorrelationTest:
    """Correlations against the band in which each lies with 99 % if there is nothing to find.

    Attributes
    ----------
    lags : ndarray of int
    correlation : ndarray
    band : ndarray
        Half width of the pointwise 99 % band at each lag.
    p_value : float
        Probability of an excursion at least as large anywhere, by Šidák's bound over all lags.
    """

    lags: np.ndarray[tuple[int], np.dtype[np.int64]]
    correlation: Floats
    band: Floats
    p_value: float

    @property
    def outside(self) -> int:
        """Number of lags outside their band."""
        return int((np.abs(self.correlation) > self.band).sum())

    @property
    def passed(self) -> bool:
        """Whether the largest excursion is compatible with chance at the 1 % level."""
        return self.p_value >= 1.0 - BAND_LEVEL

    def to_json(self) -> dict[str, Any]:
        """Return the form of the JSON file."""
        return {
            "lags": self.lags.tolist(),
            "correlation": [finite(value) for value in self.correlation],
            "band": [finite(value) for value in self.band],
            "level": BAND_LEVEL,
            "outside": self.outside,
            "p_value": finite(self.p_value),
            "passed": self.passed,
        }


def whiteness(residual: Floats) -> CorrelationTest:
    """Test whether a residual is white: autocorrelation at lags 1 to 25.

    Under whiteness each is normal with standard deviation 1/sqrt(N), whatever the distribution.
    """
    largest = min(LARGEST_LAG, residual.size // 4)
    correlation = autocorrelation(residual, largest)[1:]
    band = np.full(largest, BAND / np.sqrt(residual.size))
    return _tested(np.arange(1, largest + 1), correlation, band)


def input_independence(u: Floats, residual: Floats) -> CorrelationTest:
    """Test whether a residual is free of the input: cross-correlation at lags -25 to 25.

    If two stationary signals are independent, their correlation at any lag has the variance
    sum over k of rho_u(k) rho_e(k) / N (Bartlett): both may be coloured.  A positive lag means that
    the input comes first; excursions at negative lags are a sign of feedback.
    """
    n = residual.size
    largest = min(LARGEST_LAG, n // 4)
    u_centred, e_centred = u - u.mean(), residual - residual.mean()
    size = float(np.linalg.norm(u_centred) * np.linalg.norm(e_centred))
    lags = np.arange(-largest, largest + 1)
    if size == 0.0:
        return _tested(lags, np.zeros(lags.size), np.full(lags.size, BAND / np.sqrt(n)))
    products = [
        e_centred[max(lag, 0) : n + min(lag, 0)] @ u_centred[max(-lag, 0) : n - max(lag, 0)]
        for lag in lags.tolist()
    ]
    reach = max(int(np.sqrt(n)) * 2, largest)
    rho_u, rho_e = autocorrelation(u, min(reach, n - 1)), autocorrelation(residual, min(reach, n - 1))
    taper = 1.0 - np.arange(rho_u.size) / rho_u.size
    variance = (1.0 + 2.0 * float(np.sum((rho_u * rho_e * taper)[1:]))) / n
    band = np.full(lags.size, BAND * np.sqrt(max(variance, 1.0 / n**2)))
    return _tested(lags, np.array(products) / size, band)


def _tested(
    lags: np.ndarray[tuple[int], np.dtype[np.int64]], correlation: Floats, band: Floats
) -> CorrelationTest:
    from math import erfc, expm1, log1p, sqrt

    largest = float(np.max(np.abs(correlation) / (band / BAND), initial=0.0))
    single = erfc(largest / sqrt(2.0))
    p_value = -expm1(lags.size * log1p(-single)) if single < 1.0 else 1.0
    return CorrelationTest(lags, correlation, band, float(p_value))


@dataclass(frozen=True)
class Window:
    """A stretch of time with more than its share of the error.

    Attributes
    ----------
    first, last : int
        Rows of the scored stretch, the last one excluded.
    error_share, data_share : float
        Share of the squared error and of the rows.
    p_value : float
        Against the same error spread evenly, corrected for the number of windows.
    """

    first: int
    last: int
    error_share: float
    data_share: float
    p_value: float


def worst_windows(residual: Floats, seed: int = 0) -> tuple[Window, ...]:
    """Return the stretches of time that hold significantly more than their share of the error.

    Each of 20 equal windows is compared with windows of the same length drawn block by block from
    the whole stretch, as if the error were equally large everywhere.
    """
    squared = residual**2
    total = float(squared.sum())
    n_windows = min(WINDOWS, squared.size // 5)
    if n_windows < 2 or total == 0.0:
        return ()
    edges = np.linspace(0, squared.size, n_windows + 1).astype(int)
    length = int(edges[1])
    block = min(block_length(squared), length)
    wrapped = np.concatenate([[0.0], np.cumsum(np.concatenate([squared, squared[: block - 1]]))])
    block_sums = wrapped[block:] - wrapped[:-block]
    n_blocks = -(-length // block)
    draws = np.random.default_rng(seed).integers(0, squared.size, size=(WINDOW_REPLICATES, n_blocks))
    null = np.sort(block_sums[draws].mean(axis=1) / block)
    found = []
    for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        mean = float(squared[first:last].mean())
        above = null.size - int(np.searchsorted(null, mean, side="left"))
        p_value = min(1.0, n_windows * (above + 1) / (null.size + 1))
        share = float(squared[first:last].sum()) / total
        found.append(Window(first, last, share, (last - first) / squared.size, p_value))
    found.sort(key=lambda window: -window.error_share)
    return tuple(window for window in found if window.p_value <= WINDOW_LEVEL)[:LISTED_WINDOWS]
