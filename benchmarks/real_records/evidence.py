"""What the test error of one positioning experiment can mean for a model that was fitted to another."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import butter, savgol_filter, sosfiltfilt

from benchmarks.real_records.estimators import ForceFit, Structure, by_free_run, random_starts
from benchmarks.real_records.stage import Experiment, Stage, free_run, read_start, rms, score, state_after
from sysid.linear.forms import Floats

SPEEDS = (0.042, 0.083, 0.125)  # m/s: the plateaus of the reference motion
PLATEAU, RESTLESS, PLATEAU_ROWS = 0.01, 0.15, 81
# A disturbance is observed so fast [rad/s], far above the motion and far below the sampling rate.
OBSERVER = 60.0


@dataclass(frozen=True)
class Plateau:
    """Mean drive force [N] at a constant speed [m/s] in both experiments, and its spread over the cycles."""

    speed: float
    first: float
    second: float
    spread: float


def plateaus(first: Experiment, second: Experiment, mass: float, cycle: float) -> list[Plateau]:
    """Return what the drive needs at each constant speed, acceleration taken off."""
    found = []
    for speed in (*SPEEDS, *(-v for v in SPEEDS)):
        values = [_plateau(experiment, speed, mass, cycle) for experiment in (first, second)]
        spread = max(float(np.std(by_cycle, ddof=1)) for by_cycle in values)
        found.append(Plateau(speed, float(values[0].mean()), float(values[1].mean()), spread))
    return found


def _plateau(experiment: Experiment, speed: float, mass: float, cycle: float) -> Floats:
    sos = butter(4, 20.0, fs=1.0 / experiment.period, output="sos")
    v = np.gradient(sosfiltfilt(sos, experiment.position), experiment.period)
    acceleration = np.gradient(v, experiment.period)
    force = sosfiltfilt(sos, experiment.force) - mass * acceleration
    steady = (np.abs(v - speed) < PLATEAU) & (np.abs(acceleration) < RESTLESS)
    steady = np.convolve(steady, np.ones(PLATEAU_ROWS), "same") > PLATEAU_ROWS - 1
    number = (np.arange(v.size) * experiment.period / cycle).astype(int)
    means = [force[steady & (number == i)] for i in range(number[-1] + 1)]
    return np.array([values.mean() for values in means if values.size])


def force_that_is_missing(stage: Stage, experiment: Experiment) -> Floats:
    """Return the force [N] with which a stage follows the measured motion: that of a fast observer."""
    measured, period = experiment.position, experiment.period
    place = savgol_filter(measured, 31, 3)
    speed = savgol_filter(measured, 31, 3, deriv=1, delta=period)
    stiffness, damping = stage.mass * OBSERVER**2, 1.6 * stage.mass * OBSERVER
    missing, state = np.empty(measured.size), read_start(experiment)
    for k in range(measured.size):
        missing[k] = stiffness * (place[k] - state[0]) + damping * (speed[k] - state[1])
        state = state_after(stage, experiment.force[k : k + 1] + missing[k], state, period)
    return missing


def repeated(stage: Stage, first: Experiment, second: Experiment) -> tuple[float, float]:
    """Return the error [mm] in both experiments of a stage that is made to repeat the first one exactly."""
    missing = force_that_is_missing(stage, first)
    errors = [
        rms((free_run(stage, e.force + missing, read_start(e), e.period) - e.position)[20:])
        for e in (first, second)
    ]
    return errors[0], errors[1]


def refitted(stage: Stage, experiment: Experiment, name: str, width: float) -> tuple[float, float]:
    """Return the value of one number that suits an experiment best, all others kept, and the score [mm]."""
    centre = getattr(stage, name)
    places = np.linspace(-width, width, 41)

    def scored(shift: float) -> float:
        return score(stage._replace(**{name: centre + shift}), experiment)

    best = places[int(np.argmin([scored(shift) for shift in places]))]
    step = places[1] - places[0]
    end = minimize_scalar(
        scored, bounds=(best - step, best + step), method="bounded", options={"xatol": 1e-4}
    )
    return centre + float(end.x), float(end.fun)


def scores_of_draws(fit: ForceFit, experiment: Experiment, count: int, seed: int = 0) -> Floats:
    """Return the scores [mm] of stages drawn from what a fit is sure of."""
    draws = np.random.default_rng(seed).multivariate_normal(fit.numbers, fit.covariance, count)
    return np.array([score(fit.structure.stage(numbers), experiment) for numbers in draws])


def scores_of_restarts(
    structure: Structure, first: Experiment, second: Experiment, start: str, count: int, within: float = 1.1
) -> tuple[Floats, Floats]:
    """Return fit errors and scores [mm] of the searches that end nearly as low as the best one."""
    found = by_free_run(structure, first, start, random_starts(structure, count, seed=1))
    n = first.position.size
    errors = np.array([1e3 * np.sqrt(2.0 * cost / n) for cost, _ in found])
    close = errors < within * errors.min()
    scores = np.array([score(stage, second) for (_, stage), ok in zip(found, close, strict=True) if ok])
    return errors[close], scores
