"""A residual by itself: is it white, is it free of the input, how long does it remember."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.linear.forms import Floats
from sysid.result_files import finite

LARGEST_LAG = 25
FEWEST_BLOCKS = 8
BAND_LEVEL = 0.99
BAND = 2.5758293035489004  # 99.5 % quantile of the normal distribution
# A free run that misses no more of the signal misses none of what a sensor reads.
EXACT = 1e-9


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
    return corrected(np.arange(1, largest + 1), correlation, band)


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
        return corrected(lags, np.zeros(lags.size), np.full(lags.size, BAND / np.sqrt(n)))
    products = [
        e_centred[max(lag, 0) : n + min(lag, 0)] @ u_centred[max(-lag, 0) : n - max(lag, 0)]
        for lag in lags.tolist()
    ]
    reach = max(int(np.sqrt(n)) * 2, largest)
    rho_u, rho_e = autocorrelation(u, min(reach, n - 1)), autocorrelation(residual, min(reach, n - 1))
    taper = 1.0 - np.arange(rho_u.size) / rho_u.size
    variance = (1.0 + 2.0 * float(np.sum((rho_u * rho_e * taper)[1:]))) / n
    band = np.full(lags.size, BAND * np.sqrt(max(variance, 1.0 / n**2)))
    return corrected(lags, np.array(products) / size, band)


def corrected(
    lags: np.ndarray[tuple[int], np.dtype[np.int64]], correlation: Floats, band: Floats
) -> CorrelationTest:
    """Return the test, its p-value that of the largest excursion, corrected for the lags (Šidák)."""
    from math import erfc, expm1, log1p, sqrt

    largest = float(np.max(np.abs(correlation) / (band / BAND), initial=0.0))
    single = erfc(largest / sqrt(2.0))
    p_value = -expm1(lags.size * log1p(-single)) if single < 1.0 else 1.0
    return CorrelationTest(lags, correlation, band, float(p_value))


def block_length(series: Floats) -> int:
    """Return a block length over which a series forgets itself."""
    longest = max(series.size // FEWEST_BLOCKS, 1)
    correlation = autocorrelation(series, longest)
    # The sum is cut at the first correlation that is lost in its own noise.
    lost = np.flatnonzero(correlation < 2.0 / np.sqrt(series.size))
    cut = int(lost[0]) if lost.size else correlation.size
    time = 1.0 + 2.0 * float(correlation[1:cut].sum())
    return int(np.clip(np.ceil(max(2.0 * time, series.size ** (1.0 / 3.0))), 1, longest))


def autocorrelation(series: Floats, largest_lag: int) -> Floats:
    """Return the sample autocorrelation at lags 0 to ``largest_lag``."""
    centred = series - series.mean()
    n_fft = 1 << int(2 * series.size - 1).bit_length()
    spectrum = np.fft.rfft(centred, n_fft)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2, n_fft)[: largest_lag + 1]
    return np.asarray(covariance / covariance[0]) if covariance[0] > 0.0 else np.eye(1, largest_lag + 1)[0]
