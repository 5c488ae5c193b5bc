"""How fast the printed algorithm converges, and what sets its speed."""

import math
import time
from collections.abc import Mapping

import numpy as np

from replications.giri import setting
from replications.giri.setting import Floats
from sysid.excitation import impulse_levels
from sysid.linear.simulation import simulate_polynomial
from sysid.recursive import (
    Kaczmarz,
    ProjectionGradient,
    Recursive,
    RecursiveLeastSquares,
    averaged_rate,
    convergence_rate,
    recover,
    regressors,
    stationary_period,
)
from sysid.recursive.base import Snapshot

TARGETS = ("1e-2", "1e-3", "1e-6")
PERIODS = 1500
"""Periods of the noise-free run: its error falls to 1e-9, far above rounding."""

STEPS = (0.25, 0.5, 1.0, 1.5, 1.75, 1.9)
RADII = (5.0, 6.0, 10.0, setting.LARGE_RADIUS)
OUTPUT_UNITS = (1.0, 3.0, 10.0, 100.0)
"""The output is measured in units so many times the paper's."""


def stationary_rows(unit: float = 1.0) -> Floats:
    """Return the regressors of a period in the steady state, the output in another unit."""
    u = impulse_levels(setting.LEVELS, setting.ORDER)
    return stationary_period(setting.A, setting.composite() / unit, u, setting.LEVELS)[0]


def relative_error(kept: Floats, true: Floats | None = None) -> Floats:
    """Return ||theta - theta*|| / ||theta*|| of each row."""
    reference = setting.theta_star() if true is None else true
    return np.asarray(np.linalg.norm(kept - reference, axis=1) / np.linalg.norm(reference))


def first_below(error: Floats, target: float) -> float:
    """Return the number, from 1, of the first entry at or below the target; NaN if there is none."""
    hits = np.flatnonzero(error <= target)
    return float(hits[0] + 1) if hits.size else np.nan


def time_constant(rate: float) -> float:
    """Return the periods in which the error shrinks by the factor e; infinite if it does not shrink."""
    return -1.0 / math.log(rate) if 0.0 < rate < 1.0 else math.inf


def periods_needed(estimator: Recursive, periods: int, target: float, unit: float = 1.0) -> float:
    """Return the periods from a zero start until the relative error at the end of one meets the target."""
    u, y = setting.experiment(periods)
    true = setting.theta_star().copy()
    true[setting.ORDER :] /= unit
    kept, _ = estimator.run(u, y / unit, every=setting.PERIOD)
    return first_below(relative_error(kept, true), target)


def convergence_numbers() -> dict[str, float]:
    """Return rates, periods and samples to given errors."""
    rows = stationary_rows()
    u, y = setting.experiment(PERIODS)
    gradient = ProjectionGradient(setting.ORDER, setting.LEVELS, radius=setting.LARGE_RADIUS)
    kept, _ = gradient.run(u, y, every=setting.PERIOD)
    error = relative_error(kept)
    least_squares = RecursiveLeastSquares(setting.ORDER, setting.LEVELS, initial_covariance=1e6)
    each_sample, _ = least_squares.run(u[: 10 * setting.PERIOD], y[: 10 * setting.PERIOD])
    rate, averaged = convergence_rate(rows), averaged_rate(rows)
    numbers = {
        "theta_star_norm": float(np.linalg.norm(setting.theta_star())),
        "rate_per_period": rate,
        "rate_from_averaged_matrix": averaged,
        # In the last fifth the slowest mode alone is left.
        "rate_per_period/simulated": float((error[-1] / error[-301]) ** (1 / 300)),
        "time_constant": time_constant(rate),
        "time_constant/averaged": time_constant(averaged),
        **{f"periods_to_{target}": first_below(error, float(target)) for target in TARGETS},
        "rls_samples_to_1e-6": first_below(relative_error(each_sample), 1e-6),
    }
    slow = Kaczmarz(setting.ORDER, setting.LEVELS)
    numbers["kaczmarz/rate_per_period"] = convergence_rate(rows, offset=0.0)
    numbers["kaczmarz/periods_to_1e-2"] = periods_needed(slow, 400, 1e-2)
    return numbers


def setting_effects() -> dict[str, float]:
    """Return the effect of step, projection radius and unit of the output on the speed."""
    rows = stationary_rows()
    found: dict[str, float] = {}
    for step in STEPS:
        found[f"step/{step:g}/rate"] = convergence_rate(rows, step)
        found[f"step/{step:g}/averaged"] = averaged_rate(rows, step)
    u, y = setting.experiment(PERIODS)
    for radius in RADII:
        gradient = ProjectionGradient(setting.ORDER, setting.LEVELS, radius=radius)
        kept, _ = gradient.run(u, y, every=setting.PERIOD)
        error = relative_error(kept)
        found[f"radius/{radius:g}/periods_to_1e-2"] = first_below(error, 1e-2)
        found[f"radius/{radius:g}/last_error"] = float(error[-1])
    for unit in OUTPUT_UNITS:
        name = f"output-unit/{unit:g}"
        gradient = ProjectionGradient(setting.ORDER, setting.LEVELS, radius=setting.LARGE_RADIUS)
        found[f"{name}/rate"] = convergence_rate(stationary_rows(unit))
        found[f"{name}/kaczmarz_rate"] = convergence_rate(stationary_rows(unit), offset=0.0)
        found[f"{name}/periods_to_1e-2"] = periods_needed(gradient, 400, 1e-2, unit)
    return found


def figure_3(periods: int = 400) -> dict[str, object]:
    """Return the estimates against time: figure 3a and 3b, and least squares beside them."""
    u, y = setting.experiment(periods)
    gradient = ProjectionGradient(setting.ORDER, setting.LEVELS, radius=setting.LARGE_RADIUS)
    every = setting.PERIOD
    kept, _ = gradient.run(u, y, every=every)
    least_squares = RecursiveLeastSquares(setting.ORDER, setting.LEVELS)
    fast, _ = least_squares.run(u, y, every=every)
    return {
        "samples": (every * np.arange(1, periods + 1)).tolist(),
        "theta": kept.T,
        "segments": {name: values.tolist() for name, values in _segments(kept).items()},
        "relative_error": {"gradient": relative_error(kept), "least squares": relative_error(fast)},
    }


def _segments(kept: Floats) -> Mapping[str, Floats]:
    found = []
    for row in kept:
        values = recover(Snapshot(0, row, setting.ORDER, setting.LEVELS))
        found.append([values.b[1], values.K1, values.K2, values.H1, values.H2])
    return dict(zip(("b2", "K1", "K2", "H1", "H2"), np.array(found).T, strict=True))


def update_seconds(updates: int = 20_000) -> dict[str, float]:
    """Return the measured time of one call of `update` by algorithm, best of three rounds [s]."""
    u, y = setting.experiment(-(-updates // setting.PERIOD))
    samples = list(zip(u.tolist(), y.tolist(), strict=True))
    found = {}
    for kind in (ProjectionGradient, Kaczmarz, RecursiveLeastSquares):
        estimator = kind(setting.ORDER, setting.LEVELS)
        estimator.update(0.0, 0.0)  # compiled before the clock starts
        rounds = []
        for _ in range(3):
            began = time.perf_counter()
            for sample in samples:
                estimator.update(*sample)
            rounds.append(time.perf_counter() - began)
        found[f"update/{estimator.algorithm}"] = min(rounds) / len(samples)
    return found


def proposition_4_1() -> dict[str, float]:
    """Return the quantities of Proposition 4.1, with excitation and without.

    Without: one level in place of four, so that most parameters are never excited.
    """
    found: dict[str, float] = {}
    true = setting.theta_star()
    full, y = setting.experiment(PERIODS)
    poor = np.where(full == setting.LEVELS[3], full, 0.0)
    records = {
        "excited": (full, y),
        "not-excited": (
            poor,
            simulate_polynomial([0.0, *setting.B], [1.0, *setting.A], setting.SEGMENTS(poor)),
        ),
    }
    for name, (u, output) in records.items():
        gradient = ProjectionGradient(setting.ORDER, setting.LEVELS, radius=setting.LARGE_RADIUS)
        kept, errors = gradient.run(u, output)
        path = np.vstack([np.zeros_like(true), kept])
        distance = np.linalg.norm(path - true, axis=1)
        increments = np.linalg.norm(np.diff(path, axis=0), axis=1)
        rows = regressors(u, output, setting.ORDER, setting.LEVELS)
        posterior = output - np.einsum("ij,ij->i", rows, kept)  # (4.1d)
        found |= {
            f"proposition-4.1/{name}/largest_growth_of_error": float(np.max(np.diff(distance))),
            f"proposition-4.1/{name}/sum_of_squared_increments": float(np.sum(increments**2)),
            f"proposition-4.1/{name}/sum_of_squared_posterior_errors": float(np.sum(posterior**2)),
            f"proposition-4.1/{name}/last_increment": float(increments[-setting.PERIOD :].max()),
            f"proposition-4.1/{name}/last_prediction_error": float(np.abs(errors[-setting.PERIOD :]).max()),
            f"proposition-4.1/{name}/last_relative_error": float(distance[-1] / np.linalg.norm(true)),
        }
    found["proposition-4.1/bound"] = float(true @ true)
    return found
