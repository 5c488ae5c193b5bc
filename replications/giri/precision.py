"""How precise the estimates are with noise: the printed algorithm, its kin and the bound."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from replications.giri import setting
from replications.giri.setting import Floats
from replications.studies import parameters_of
from sysid.bounds import least_squares_bound
from sysid.linear.simulation import simulate_polynomial
from sysid.recursive import Kaczmarz, ProjectionGradient, RecursiveLeastSquares, Snapshot, recover, structured
from sysid.recursive import regressors as regressor_rows

NOISES = ("equation", "output")
"""White eta (an equation error), or white z (a disturbance of the output, as in (2.1a))."""

NOISE = 0.1
"""Standard deviation of the white noise; the output has 12."""

SIZES = (25, 50, 100, 200, 400)
"""Numbers of periods."""

METHODS = ("gradient", "kaczmarz", "least-squares", "structured")
_LONG = 400


@dataclass(frozen=True)
class NoisyRun:
    """One experiment with Gaussian noise, identified by every method.

    Attributes
    ----------
    noise : str
        One of `NOISES`.
    periods : int
        Length of the experiment.
    """

    noise: str
    periods: int

    def experiment(self, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Return input and output."""
        draws = NOISE * rng.standard_normal(self.periods * setting.PERIOD)
        if self.noise == "equation":
            return setting.experiment(self.periods, equation_error=draws)
        return setting.experiment(self.periods, disturbance=draws)

    def identify(self, u: Floats, y: Floats) -> dict[str, Snapshot]:
        """Return what each method finds, all from a zero start."""
        every = u.size
        gradient = ProjectionGradient(setting.ORDER, setting.LEVELS, radius=setting.LARGE_RADIUS)
        kaczmarz = Kaczmarz(setting.ORDER, setting.LEVELS)
        least_squares = RecursiveLeastSquares(setting.ORDER, setting.LEVELS)
        for estimator in (gradient, kaczmarz, least_squares):
            estimator.run(u, y, every=every)
        return {
            "gradient": gradient.snapshot(),
            "kaczmarz": kaczmarz.snapshot(),
            "least-squares": least_squares.snapshot(),
            "structured": structured(least_squares),
        }

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return the identifiable parameters by method."""
        found: dict[str, float] = {}
        for method, snapshot in self.identify(*self.experiment(rng)).items():
            values = recover(snapshot)
            each = [*values.a, values.b[1], values.K1, values.K2, values.H1, values.H2]
            found |= {
                f"{method}/{name}": float(value) for name, value in zip(setting.PARAMETERS, each, strict=True)
            }
        return found


def case_name(noise: str, periods: int) -> str:
    """Return the id of a study."""
    return f"noise/{noise}/periods={periods}"


def bound(noise: str, periods: int) -> dict[str, float]:
    """Return the standard deviations at the Cramér-Rao bound for Gaussian noise.

    With b_1 = 1 and the segments as parameters: seven numbers, not the ten composite ones.
    """
    std = np.sqrt(_variances(noise) / (periods * setting.PERIOD))
    return dict(zip(setting.PARAMETERS, std.tolist(), strict=True))


@lru_cache(maxsize=len(NOISES))
def _variances(noise: str) -> Floats:
    """Return the variances at the bound for a single sample."""
    jacobian = output_sensitivities(_LONG) if noise == "output" else _prediction_sensitivities()
    return np.diag(least_squares_bound([jacobian], NOISE**2, 1))


def composite_derivative() -> Floats:
    """Return d theta / d (a1, a2, b2, K1, K2, H1, H2), shape (10, 7)."""
    levels = np.array(setting.LEVELS)
    gains = setting.gains()
    positive = levels > 0
    # d_j = K + H / V_j on the side of V_j.
    by_segment = np.column_stack([positive, ~positive, positive / levels, ~positive / levels]).astype(float)
    found = np.zeros((setting.theta_star().size, len(setting.PARAMETERS)))
    found[:2, :2] = np.eye(2)
    for j, gain in enumerate(gains):
        row = setting.ORDER * (1 + j)
        found[row + 1, 2] = gain
        for i, b in enumerate(setting.B):
            found[row + i, 3:] = b * by_segment[j]
    return found


def _prediction_sensitivities() -> Floats:
    """Return the derivative of the one-step prediction from a long record with equation noise."""
    rng = np.random.default_rng(20041201)
    u, y = NoisyRun("equation", 10 * _LONG).experiment(rng)
    rows = regressor_rows(u, y, setting.ORDER, setting.LEVELS)
    return np.asarray(rows @ composite_derivative())


def output_sensitivities(periods: int) -> Floats:
    """Return the derivative of the noise-free output: Phi of that output, filtered by 1/A."""
    u, y = setting.experiment(periods)
    rows = regressor_rows(u, y, setting.ORDER, setting.LEVELS) @ composite_derivative()
    return np.column_stack([simulate_polynomial([1.0], [1.0, *setting.A], column) for column in rows.T])


def entry_name(noise: str, method: str, periods: int) -> str:
    """Return the id of a method's entry among the Monte-Carlo results."""
    return f"{noise}/{method}/periods={periods}"


def slope_numbers(monte_carlo: Mapping[str, Mapping[str, object]]) -> dict[str, float]:
    """Return the RMSE at every length and the exponent of its fall."""
    found: dict[str, float] = {}
    for noise in NOISES:
        for method in METHODS:
            entries = [parameters_of(monte_carlo[entry_name(noise, method, n)]) for n in SIZES]
            for name in setting.PARAMETERS:
                rmse = [float(entry[name]["rmse"] or np.nan) for entry in entries]
                key = f"{noise}/{method}/{name}"
                found |= {f"rmse/{key}/{n}": value for n, value in zip(SIZES, rmse, strict=True)}
                found[f"slope/{key}"] = float(np.polyfit(np.log(SIZES), np.log(rmse), 1)[0])
    return found
