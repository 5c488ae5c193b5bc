"""What quick searches reach that simulate dry friction step by step: their free-run error is not smooth."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from benchmarks.real_records.stage import READ_ROWS, Experiment, rms
from sysid._compile import compiled
from sysid.linear.forms import Floats

EXPLICIT, SPEED_FIRST, PROXIMAL = 0, 1, 2
RECURSIONS = {
    "sign of the speed, explicit step": EXPLICIT,
    "sign of the speed, speed first": SPEED_FIRST,
    "friction that stops within a step": PROXIMAL,
}
# Mass, viscous and dry friction, constant force: the published numbers first, then a few rough guesses.
STARTS = (
    (95.1, 203.5, 20.4, -3.2),
    (100.0, 200.0, 20.0, 0.0),
    (50.0, 100.0, 10.0, 0.0),
    (100.0, 100.0, 30.0, 1.0),
)
METHODS = (("lm", "linear"), ("trf", "linear"), ("trf", "soft_l1"))
DIFFERENCES = (None, 1e-3)
SIZES = np.array([95.0, 203.0, 20.0, 3.0])


@dataclass(frozen=True)
class Stop:
    """Where a search stopped: error [mm] in the experiment that it was fitted to and in the other one."""

    fitted: float
    tested: float


@compiled
def stepped(recursion: int, numbers: Floats, force: Floats, place: float, period: float) -> Floats:
    """Return the position at each sample from rest, one Euler step to each sample."""
    mass, viscous, dry, constant = numbers
    x = np.empty(force.size)
    v = 0.0
    for k in range(force.size):
        x[k] = place
        before = v
        if recursion == PROXIMAL:
            free = v + period * (force[k] - constant - viscous * v) / mass
            v = np.sign(free) * max(abs(free) - period * dry / mass, 0.0)
        else:
            v += period * (force[k] - constant - viscous * v - dry * np.sign(v)) / mass
        place += period * (before if recursion == EXPLICIT else v)
    return x


def stops(recursion: int, first: Experiment, second: Experiment) -> list[Stop]:
    """Return where searches stop, from each start by each method."""

    def error(numbers: Floats, experiment: Experiment) -> Floats:
        place = experiment.position[0]
        return stepped(recursion, numbers, experiment.force, place, experiment.period) - experiment.position

    def residual(x: Floats) -> Floats:
        return 1e3 * error(x * SIZES, first)

    found = []
    for start in STARTS:
        for method, loss in METHODS:
            for step in DIFFERENCES:
                x = least_squares(
                    residual, np.array(start) / SIZES, method=method, loss=loss, diff_step=step
                ).x
                errors = (error(x * SIZES, e)[skip:] for e, skip in ((first, 0), (second, READ_ROWS)))
                found.append(Stop(*(rms(e) for e in errors)))
    return found
