"""Frequency bands of the error: what follows the input linearly there, and what is noise."""

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.diagnosis.comparison.series import Series
from sysid.linear.forms import Floats
from sysid.result_files import finite

LINES = 32
FEWEST_LINES = 16
MOST_BANDS = 24
Complexes = NDArray[np.complex128]


@dataclass(frozen=True)
class Band:
    """One frequency band.

    Attributes
    ----------
    low, high : float
        Its bounds [Hz].
    error_share, noise_share : float
        Share of the power of the whole error, and of the part that does not follow the input.
    coherence : float
        Share of the band's error that follows the input linearly, less what chance gives.
    explained : float
        That share of the whole error.
    p_value : float
        Of such a coherence by chance in any band.
    """

    low: float
    high: float
    error_share: float
    noise_share: float
    coherence: float
    explained: float
    p_value: float

    def to_json(self) -> dict[str, Any]:
        """Return the form of the JSON file."""
        return {
            "region": {"from_hz": self.low, "to_hz": self.high},
            "error_share": finite(self.error_share),
            "data_share": finite(self.noise_share),
            "coherence": finite(self.coherence),
            "p_value": finite(self.p_value),
        }


def band_shares(series: Series) -> tuple[Band, ...]:
    """Split the error's power by frequency into what follows the input and what does not.

    In each band the discrete Fourier transform of the error is regressed on that of the inputs,
    with a response and a transient that vary linearly over the band (Pintelon, Schoukens, Vandersteen
    and Barbé, 2010, Estimation of nonparametric noise and FRF models, MSSP 24: the local polynomial
    method).  Error and inputs pass the same whitening filter before, which leaves their relation as it
    is and the noise even.  The longest run of consecutive rows is used.

    Returns
    -------
    tuple of Band
        Empty where there are too few rows.
    """
    from scipy.special import fdtrc

    from sysid.linear.uncertainty import autoregression

    run = max(series.runs, key=lambda part: part.stop - part.start)
    e = series.residual[run] - float(series.residual[run].mean())
    noise, _ = autoregression([e])
    white = np.convolve(e, noise, mode="valid") if e.size > noise.size else np.empty(0)
    n = white.size
    edges = _edges(n)
    if edges.size < 2:
        return ()
    E = np.fft.rfft(white)
    U = np.column_stack([np.fft.rfft(np.convolve(u, noise, mode="valid")) for u in series.u[run].T])
    gain = 1.0 / np.abs(np.fft.rfft(noise, 2 * (E.size - 1) if n % 2 == 0 else 2 * E.size - 1)[: E.size]) ** 2
    sums = np.array([_split(E[a:b], U[a:b], gain[a:b]) for a, b in itertools.pairwise(edges)])
    total, left, freedom, taken, fit_white, left_white = sums.T
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (fit_white / taken) / (left_white / freedom)
    single = np.where((taken > 0) & (left_white > 0.0), fdtrc(taken, freedom, ratio), 1.0)
    p_values = -np.expm1(single.size * np.log1p(-np.minimum(single, 1.0 - 1e-16)))
    # The regression takes its share of pure noise, too.
    noise_power = np.minimum(left * (freedom + taken) / freedom, total)
    frequency = np.arange(E.size) / (n * series.record.period)
    return tuple(
        Band(
            float(frequency[a]),
            float(frequency[min(b, E.size - 1)]),
            float(total[i] / total.sum()),
            float(noise_power[i] / max(float(noise_power.sum()), 1e-300)),
            float(1.0 - noise_power[i] / total[i]) if total[i] > 0.0 else 0.0,
            float((total[i] - noise_power[i]) / total.sum()),
            float(p_values[i]),
        )
        for i, (a, b) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
    )


def _edges(n: int) -> NDArray[np.int64]:
    """Return the first line of each band, from line 1 on: equal at first, then in equal ratios."""
    lines = n // 2
    if lines < 2 * FEWEST_LINES:
        return np.empty(0, dtype=np.int64)
    count = int(np.clip(lines // LINES, 2, MOST_BANDS))
    edges = [1]
    while edges[-1] < lines and len(edges) <= count:
        left = count - len(edges) + 1
        growth = (lines / max(edges[-1], LINES)) ** (1.0 / left)
        edges.append(int(max(edges[-1] + FEWEST_LINES, round(max(edges[-1], LINES) * growth))))
    edges = [edge for edge in edges if edge < lines - FEWEST_LINES] + [lines]
    return np.asarray(edges, dtype=np.int64)


def _split(E: Complexes, U: Complexes, gain: Floats) -> tuple[float, ...]:
    """Return power and remaining power of the error, degrees of freedom, and the same two, whitened."""
    m = E.size
    slope = np.linspace(-1.0, 1.0, m)[:, np.newaxis]
    transient = np.hstack([np.ones((m, 1)), slope]).astype(np.complex128)
    Q = _basis(transient)
    rest = E - Q @ (Q.conj().T @ E)
    regressors = np.hstack([U, U * slope])
    regressors = regressors - Q @ (Q.conj().T @ regressors)
    size = np.linalg.norm(regressors, axis=0)
    known = size > 1e-9 * max(float(np.linalg.norm(U)), 1e-300)
    P = _basis(regressors[:, known] / size[known]) if known.any() else np.empty((m, 0), dtype=np.complex128)
    residual = rest - P @ (P.conj().T @ rest)
    left_white = float(np.sum(np.abs(residual) ** 2))
    fit_white = max(float(np.sum(np.abs(rest) ** 2)) - left_white, 0.0)
    total = float(np.sum(gain * np.abs(E) ** 2))
    left = float(np.sum(gain * np.abs(residual) ** 2)) * m / max(m - Q.shape[1], 1)
    freedom = 2.0 * max(m - Q.shape[1] - P.shape[1], 1)
    return total, left, freedom, 2.0 * P.shape[1], fit_white, left_white


def _basis(columns: Complexes) -> Complexes:
    left, values, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, values > 1e-9 * values[0]])
