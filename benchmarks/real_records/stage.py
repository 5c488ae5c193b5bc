"""A stage against dry friction, simulated from stop to stop: apart from the library's own simulators."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from sysid._compile import compiled
from sysid.linear.forms import Floats

# The Stribeck rise of a step is that at its beginning; dry friction alone is exact for any step.
STEPS = 2
# At an end of a step so many changes between motion and rest are followed.
EVENTS = 6
READ_ROWS = 20


class Stage(NamedTuple):
    """Mass [kg], viscous [N s/m] and dry friction [N] forward and backward, constant force [N].

    ``rise`` [N] is by how much dry friction is larger near rest; it falls by exp(-(v / speed)^2).
    """

    mass: float
    viscous_forward: float
    viscous_backward: float
    dry: float
    constant: float
    rise: float = 0.0
    speed: float = 1.0


class Experiment(NamedTuple):
    """Drive force [N] and position [m] at a constant period [s]."""

    force: Floats
    position: Floats
    period: float


@compiled
def _simulate(
    stage: Floats, force: Floats, start: Floats, period: float, steps: int, x: Floats
) -> tuple[float, float]:
    mass, forward, backward, dry, constant, rise, speed = stage
    place, v = start[0], start[1]
    for k in range(force.shape[0]):
        x[k] = place
        drive = force[k] - constant
        for _ in range(steps):
            left = period / steps
            level = dry + rise * np.exp(-((v / speed) ** 2))
            for _ in range(EVENTS):
                if v == 0.0 and abs(drive) <= level:
                    break
                sign = np.sign(v) if v != 0.0 else np.sign(drive)
                damping = forward if sign > 0.0 else backward
                # v' = (final - v) / memory as long as the sense of motion is the same.
                memory, final = mass / damping, (drive - sign * level) / damping
                end = final + (v - final) * np.exp(-left / memory)
                took = left
                if v != 0.0 and end * sign < 0.0:
                    took, end = memory * np.log((final - v) / final), 0.0
                place += final * took + memory * (v - end)
                v = end
                left -= took
                if left <= 0.0:
                    break
    return place, v


def free_run(stage: Stage, force: Floats, start: Floats, period: float) -> Floats:
    """Return the position [m] at each sample from a start (position, velocity)."""
    x = np.empty(force.size)
    _simulate(np.array(stage, dtype=float), force, start, period, STEPS if stage.rise else 1, x)
    return x


def state_after(stage: Stage, force: Floats, start: Floats, period: float) -> Floats:
    """Return position and velocity after the last sample."""
    steps = STEPS if stage.rise else 1
    return np.array(
        _simulate(np.array(stage, dtype=float), force, start, period, steps, np.empty(force.size))
    )


def read_start(experiment: Experiment, rows: int = READ_ROWS) -> Floats:
    """Return position and velocity at the first row, by a parabola through the first rows."""
    t = np.arange(rows) * experiment.period
    return np.polynomial.polynomial.polyfit(t, experiment.position[:rows], 2)[:2]


def start_by_model(stage: Stage, experiment: Experiment, rows: int = READ_ROWS) -> Floats:
    """Return the start from which the model follows the first rows best, as the library's scores take it."""
    first = Experiment(experiment.force[:rows], experiment.position[:rows], experiment.period)
    units = np.array([1e-5, 1e-3])  # what a start of a few rows differs by

    def residual(point: Floats) -> Floats:
        return 1e6 * (free_run(stage, first.force, point * units, first.period) - first.position)

    found = least_squares(residual, read_start(experiment, rows) / units, method="lm")
    return np.asarray(found.x * units)


def free_run_error(stage: Stage, experiment: Experiment, start: Floats | None = None) -> Floats:
    """Return the error of the free run [m] at each row."""
    start = start_by_model(stage, experiment) if start is None else start
    return free_run(stage, experiment.force, start, experiment.period) - experiment.position


def score(stage: Stage, experiment: Experiment, skip: int = READ_ROWS) -> float:
    """Return the root mean square of the free-run error [mm] behind the first rows."""
    return rms(free_run_error(stage, experiment)[skip:])


def rms(error: Floats) -> float:
    """Return the root mean square [mm] of an error in m."""
    return 1e3 * float(np.sqrt(np.mean(error**2)))
