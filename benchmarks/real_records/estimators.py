"""Ways to fit a stage to one experiment: what is minimised, and where the start comes from."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.optimize import least_squares
from scipy.signal import butter, savgol_filter, sosfiltfilt

from benchmarks.real_records.stage import Experiment, Stage, free_run, read_start
from sysid.linear.forms import Floats

Filter = Callable[[Floats], Floats]
EVALUATIONS = 800
# Free runs weighed by a colour, and forces, are looked at in means of 20 ms: below 25 Hz is all the motion.
MEAN_OF = 20
LARGEST_ORDER = 12
PASS_HZ = 20.0
SMOOTHED_ROWS = 21
# The forces of a motion are known some 0.1 s away from the ends, where the filters have settled.
ENDS = 100


@dataclass(frozen=True)
class Structure:
    """Which numbers of a stage are searched, their usual sizes, and the stage that they make."""

    name: str
    sizes: tuple[float, ...]
    typical: tuple[float, ...]
    stage: Callable[[Floats], Stage]


COULOMB = Structure(
    "dry friction",
    (95.0, 200.0, 20.0, 3.0),
    (95.0, 203.0, 20.0, -3.2),
    lambda p: Stage(p[0], p[1], p[1], p[2], p[3]),
)
STRIBECK = Structure(
    "dry friction, larger near rest",
    (95.0, 200.0, 20.0, 3.0, 3.0, 0.02),
    (95.0, 203.0, 20.0, -3.2, 3.0, 0.03),
    lambda p: Stage(p[0], p[1], p[1], p[2], p[3], p[4], abs(p[5]) + 5e-3),
)
TWO_SIDED = Structure(
    "dry friction, viscous by direction",
    (95.0, 200.0, 200.0, 20.0, 3.0),
    (95.0, 170.0, 240.0, 20.0, -0.3),
    lambda p: Stage(p[0], p[1], p[2], p[3], p[4]),
)
STRUCTURES = (COULOMB, STRIBECK, TWO_SIDED)


def random_starts(structure: Structure, count: int, seed: int = 0) -> list[Floats]:
    """Return the typical numbers, and further ones that differ by 20 %."""
    rng = np.random.default_rng(seed)
    typical = np.array(structure.typical)
    return [typical, *(typical * (1.0 + 0.2 * rng.standard_normal(typical.size)) for _ in range(count - 1))]


def by_free_run(
    structure: Structure,
    experiment: Experiment,
    start: str,
    points: list[Floats],
    weigh: Filter | None = None,
) -> list[tuple[float, Stage]]:
    """Return cost and stage of each search for the least free-run error, the best first.

    ``start`` is "free": searched with the rest; "read": that of the first rows; or "rest".
    """
    force, measured, period = experiment
    n = len(structure.sizes)
    scale = np.array([*structure.sizes, *([1e-3, 1e-2] if start == "free" else [])])
    opening = np.zeros(2) if start == "rest" else read_start(experiment)

    def residual(x: Floats) -> Floats:
        stage = structure.stage((x * scale)[:n])
        if min(stage[:3]) <= 5.0:
            return residual_of(np.ones(measured.size))
        begin = (x * scale)[n:] if start == "free" else opening
        return residual_of(free_run(stage, force, begin, period) - measured)

    def residual_of(error: Floats) -> Floats:
        return error if weigh is None else weigh(error)

    found = []
    for point in points:
        x = np.concatenate([point, opening if start == "free" else []]) / scale
        end = _minimised(residual, x)
        found.append((float(end.cost), structure.stage((end.x * scale)[:n])))
    return sorted(found, key=lambda pair: pair[0])


def by_weighed_free_run(
    structure: Structure, experiment: Experiment, points: list[Floats], rounds: int = 4
) -> Stage:
    """Return the stage of the least free-run error weighed by its colour, found in turn with it."""
    stage = by_free_run(structure, experiment, "read", points)[0][1]
    for _ in range(rounds):
        error = means(
            free_run(stage, experiment.force, read_start(experiment), experiment.period) - experiment.position
        )
        whiten = whitening(error)
        stage = by_free_run(structure, experiment, "read", points, lambda e, w=whiten: w(means(e)))[0][1]
    return stage


def by_pieces(structure: Structure, experiment: Experiment, length: float, points: list[Floats]) -> Stage:
    """Return the stage of the least error in free runs over pieces, started from the smoothed motion."""
    force, measured, period = experiment
    place = savgol_filter(measured, SMOOTHED_ROWS, 3)
    speed = savgol_filter(measured, SMOOTHED_ROWS, 3, deriv=1, delta=period)
    count, scale = int(length / period), np.array(structure.sizes)
    firsts = range(SMOOTHED_ROWS, measured.size - count + 1, count)

    def residual(x: Floats) -> Floats:
        stage = structure.stage(x * scale)
        if min(stage[:3]) <= 5.0:
            return np.ones(count * len(firsts))
        return np.concatenate(
            [
                free_run(stage, force[i : i + count], np.array([place[i], speed[i]]), period)
                - measured[i : i + count]
                for i in firsts
            ]
        )

    ends = [_minimised(residual, point / scale) for point in points]
    return structure.stage(min(ends, key=lambda end: end.cost).x * scale)


def _minimised(residual: Callable[[Floats], Floats], x: Floats):
    # Where a body stops the free run has kinks: differences of 1e-6 look past none of them.
    return least_squares(residual, x, method="lm", diff_step=1e-6, xtol=1e-9, ftol=1e-9, max_nfev=EVALUATIONS)


@dataclass(frozen=True)
class ForceFit:
    """A stage by the forces of the measured motion: its numbers, their covariance, and what is left [N]."""

    numbers: Floats
    covariance: Floats
    left: Floats
    structure: Structure

    @property
    def stage(self) -> Stage:
        """The fitted stage."""
        return self.structure.stage(self.numbers)


def by_forces(structure: Structure, experiment: Experiment, weighed: bool = False) -> ForceFit:
    """Fit the drive force by acceleration, velocity and sense of the measured motion: linear least squares.

    Unweighed, the covariance is that of a residual whose memory ends after 3 s (Newey and West 1987).
    """
    X, force = forces_of(structure, experiment)
    numbers = np.linalg.lstsq(X, force, rcond=None)[0]
    if not weighed:
        left = force - X @ numbers
        return ForceFit(
            numbers, _covariance(X, left, int(3.0 / (MEAN_OF * experiment.period))), left, structure
        )
    for _ in range(10):
        whiten = whitening(force - X @ numbers)
        rows, target = np.column_stack([whiten(column) for column in X.T]), whiten(force)
        numbers = np.linalg.lstsq(rows, target, rcond=None)[0]
    innovation = target - rows @ numbers
    covariance = np.var(innovation) * np.linalg.inv(rows.T @ rows)
    return ForceFit(numbers, covariance, force - X @ numbers, structure)


def forces_of(structure: Structure, experiment: Experiment) -> tuple[Floats, Floats]:
    """Return what each number of a stage multiplies in the drive force, and that force, as means."""
    sos = butter(4, PASS_HZ, fs=1.0 / experiment.period, output="sos")

    def smooth(signal: Floats) -> Floats:
        return np.asarray(sosfiltfilt(sos, signal))

    v = np.gradient(smooth(experiment.position), experiment.period)
    viscous = [np.maximum(v, 0.0), np.minimum(v, 0.0)] if structure is TWO_SIDED else [v]
    columns = [np.gradient(v, experiment.period), *map(smooth, [*viscous, np.sign(v), np.ones_like(v)])]
    inner = slice(ENDS, -ENDS)
    rows = np.column_stack([means(column[inner]) for column in columns])
    return rows, means(smooth(experiment.force)[inner])


def means(signal: Floats, count: int = MEAN_OF) -> Floats:
    """Return the means of consecutive rows."""
    return signal[: signal.size // count * count].reshape(-1, count).mean(axis=1)


def whitening(error: Floats) -> Filter:
    """Return the filter that makes an error white: an autoregression, its order by BIC."""
    found = []
    for order in range(1, LARGEST_ORDER + 1):
        past = sliding_window_view(error[:-1], order)[:, ::-1]
        weights = np.linalg.lstsq(past, error[order:], rcond=None)[0]
        left = error[order:] - past @ weights
        found.append((left.size * np.log(np.mean(left**2)) + order * np.log(left.size), weights))
    d = np.concatenate([[1.0], -min(found, key=lambda pair: pair[0])[1]])
    return lambda signal: np.convolve(signal, d, "valid")


def _covariance(X: Floats, left: Floats, memory: int) -> Floats:
    pulls = X * left[:, np.newaxis]
    total = pulls.T @ pulls
    for lag in range(1, memory):
        shifted = pulls[lag:].T @ pulls[:-lag]
        total += (1.0 - lag / memory) * (shifted + shifted.T)
    inverse = np.linalg.inv(X.T @ X)
    return np.asarray(inverse @ total @ inverse)
