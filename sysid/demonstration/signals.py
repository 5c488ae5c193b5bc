"""Excitations of the demonstration records: bounded bandwidth, many amplitudes."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def draw_excitation(rng: np.random.Generator, n: int, bandwidth: float) -> tuple[str, Floats]:
    """Draw an excitation of unit root mean square.

    Parameters
    ----------
    rng : numpy.random.Generator
    n : int
        Number of samples.
    bandwidth : float
        Where the plant's gain has fallen [rad/sample]; the excitation reaches about that far.

    Returns
    -------
    kind : str
    u : ndarray, shape (n,)

    Examples
    --------
    >>> kind, u = draw_excitation(np.random.default_rng(3), 1000, 0.4)
    >>> round(float(np.sqrt(np.mean(u**2))), 12)
    1.0
    """
    kinds = sorted(EXCITATIONS)
    kind = kinds[int(rng.integers(len(kinds)))]
    u = EXCITATIONS[kind](rng, n, bandwidth)
    return kind, u / np.sqrt(np.mean(u**2))


def _multisine(rng: np.random.Generator, n: int, bandwidth: float) -> Floats:
    period = n // int(rng.integers(1, 5))
    reach = rng.uniform(0.7, 2.0) * bandwidth * period / (2 * np.pi)
    highest = min(max(round(reach), 8), period // 2 - 1)
    count = min(int(rng.integers(8, 41)), highest)
    lines = rng.choice(np.arange(1, highest + 1), count, replace=False)
    phase = rng.uniform(0, 2 * np.pi, count)
    time = np.arange(n)[:, np.newaxis]
    return np.asarray(np.cos(2 * np.pi * lines * time / period + phase).sum(axis=1))


def _filtered_noise(rng: np.random.Generator, n: int, bandwidth: float) -> Floats:
    from scipy.signal import butter, lfilter

    cut = float(np.clip(rng.uniform(0.5, 1.5) * bandwidth / np.pi, 0.01, 0.9))
    b, a = butter(int(rng.integers(1, 3)), cut)
    return np.asarray(lfilter(b, a, rng.standard_normal(n + 500))[500:])


def _random_steps(rng: np.random.Generator, n: int, bandwidth: float) -> Floats:
    shortest = max(2, round(1.0 / bandwidth))
    holds = rng.integers(shortest, 3 * shortest + 3, n)
    return np.repeat(rng.uniform(-1.0, 1.0, n), holds)[:n]


def _multilevel(rng: np.random.Generator, n: int, bandwidth: float) -> Floats:
    levels = np.linspace(-1.0, 1.0, int(rng.integers(11, 22)))
    hold = max(1, round(rng.uniform(0.5, 1.5) / bandwidth))
    return np.repeat(rng.choice(levels, -(-n // hold)), hold)[:n]


def _sweep(rng: np.random.Generator, n: int, bandwidth: float) -> Floats:
    """Return sweeps up and down whose amplitude rises and falls, at rates of their own."""
    time = np.arange(n)
    low, high = 0.03 * bandwidth, rng.uniform(1.0, 2.0) * bandwidth
    length = n / rng.uniform(3.0, 6.0)
    triangle = np.abs((time / length) % 2.0 - 1.0)
    phase = np.cumsum(low * (high / low) ** (1.0 - triangle))
    envelope = 1.0 + 0.7 * np.sin(2 * np.pi * time / (n / rng.uniform(7.0, 11.0)) + rng.uniform(0, 6))
    return np.asarray(envelope * np.sin(phase))


EXCITATIONS: dict[str, Callable[[np.random.Generator, int, float], Floats]] = {
    "multisine": _multisine,
    "filtered noise": _filtered_noise,
    "random steps": _random_steps,
    "levels": _multilevel,
    "sweep": _sweep,
}
