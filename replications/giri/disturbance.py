"""Proposition 5.2: the parameter error is proportional to the size of the disturbance."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from replications.giri import setting
from replications.giri.setting import Floats
from sysid.linear.simulation import simulate_polynomial
from sysid.montecarlo import Study
from sysid.recursive import ProjectionGradient, regressors

KINDS = ("uniform", "gaussian", "constant", "sinusoidal", "alternating")
RANDOM_KINDS = KINDS[:2]
AMPLITUDES = ("1e-5", "1e-4", "1e-3", "1e-2", "1e-1")
"""Four decades of z, over which the output varies between -20 and 20."""

BEYOND = "1"
"""An amplitude at which z in the regressors is no longer negligible."""

PERIODS = 1000
SETTLING = 400
"""Periods left out: five time constants of the algorithm."""

FREQUENCY = 0.3
"""Frequency of the sinusoidal disturbance [rad/sample]."""


@lru_cache(maxsize=4)
def _noise_free(periods: int) -> tuple[Floats, Floats]:
    return setting.experiment(periods)


def disturbance(kind: str, rng: np.random.Generator, n: int) -> Floats:
    """Return a disturbance z of amplitude 1 (uniform: half width; Gaussian: standard deviation)."""
    if kind == "uniform":
        return rng.uniform(-1.0, 1.0, n)
    if kind == "gaussian":
        return rng.standard_normal(n)
    phase = rng.uniform(0.0, 2.0 * np.pi)
    sign = 1.0 if phase < np.pi else -1.0
    if kind == "constant":
        return np.full(n, sign)
    if kind == "alternating":
        return np.asarray(sign * (-1.0) ** np.arange(n))
    return np.asarray(np.sin(FREQUENCY * np.arange(n) + phase), dtype=np.float64)


@dataclass(frozen=True)
class DisturbedRun:
    """One disturbance in all its amplitudes: mean of ||theta error|| and of the increments over mean |eta|.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    periods : int
        Periods measured, after the settling ones.
    """

    kind: str
    periods: int = PERIODS

    def estimator(self) -> ProjectionGradient:
        """Return the algorithm (4.1), started at the truth so that the disturbance alone moves it."""
        return ProjectionGradient(
            setting.ORDER, setting.LEVELS, radius=setting.LARGE_RADIUS, start=setting.theta_star()
        )

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return ratios and sizes by amplitude."""
        u, y = _noise_free(SETTLING + self.periods)
        z = disturbance(self.kind, rng, u.size)
        eta = simulate_polynomial([1.0, *setting.A], [1.0], z)
        first = SETTLING * setting.PERIOD
        mean_eta = float(np.mean(np.abs(eta[first:])))
        found: dict[str, float] = {}
        for name in (*AMPLITUDES, BEYOND):
            size = float(name)
            kept, _ = self.estimator().run(u, y + size * z)
            error = float(np.mean(np.linalg.norm(kept[first:] - setting.theta_star(), axis=1)))
            moved = float(np.mean(np.linalg.norm(np.diff(kept[first:], axis=0), axis=1)))
            found |= {
                f"error/{name}": error,
                f"eta/{name}": size * mean_eta,
                f"ratio/{name}": error / (size * mean_eta),
                f"increment_ratio/{name}": moved / (size * mean_eta),
            }
            rows = regressors(u, y + size * z, setting.ORDER, setting.LEVELS)
            posterior = y + size * z - np.einsum("ij,ij->i", rows, kept)
            found[f"posterior_ratio/{name}"] = float(np.mean(np.abs(posterior[first:]))) / (size * mean_eta)
        return found


def ratio_numbers(kind: str, study: Study) -> dict[str, float]:
    """Return the ratio over four decades, its standard error and exponent, and what 4.1 bounds."""
    mean = study.mean()
    ratios = np.array([mean[f"ratio/{name}"] for name in AMPLITUDES])
    log_eta = np.log([mean[f"eta/{name}"] for name in AMPLITUDES])
    log_error = np.log([mean[f"error/{name}"] for name in AMPLITUDES])
    found = {
        f"noise_ratio/{kind}": float(ratios.mean()),
        # The amplitudes share their draws, so the mean over them is no more certain than one of them.
        f"noise_ratio/{kind}/std_error": study.standard_error()["ratio/1e-3"],
        f"noise_ratio/{kind}/spread": float(np.ptp(ratios) / ratios.mean()),
        f"noise_slope/{kind}": float(np.polyfit(log_eta, log_error, 1)[0]),
        f"noise_ratio/{kind}/at-1": mean[f"ratio/{BEYOND}"],
    }
    for name in (*AMPLITUDES, BEYOND):
        found[f"disturbance/{kind}/error/{name}"] = mean[f"error/{name}"]
        found[f"disturbance/{kind}/eta/{name}"] = mean[f"eta/{name}"]
    for quantity in ("increment_ratio", "posterior_ratio"):
        values = [mean[f"{quantity}/{name}"] for name in AMPLITUDES]
        found[f"proposition-4.1/{quantity}/{kind}"] = float(np.mean(values))
        found[f"proposition-4.1/{quantity}/{kind}/spread"] = float(np.ptp(values) / np.mean(values))
    return found
