"""Steps of a simulation so fine that what they do wrong drowns in the noise."""

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.problem import COARSE_STEP, Problem

# Halving the steps must change the output by less than this share of the residual: over some thousands of
# rows, all of it in one direction, that is a third of a standard error.
UNSEEN_CHANGE = 0.005
HALVINGS = 3


def enough_steps(problem: Problem, point: Floats) -> float:
    """Return the largest step of a simulation, in rates, that is fine enough for a record's noise.

    Parameters
    ----------
    problem : Problem
        With the coarsest steps.
    point : ndarray, shape (n_unknowns,)
        Where a search ended.

    Returns
    -------
    float
        ``COARSE_STEP``, or a part of it.
    """
    largest = COARSE_STEP
    if problem.exact and not problem.setting.plant.always_steps:
        return largest
    noise = float(np.sqrt(np.mean(problem.residual(point) ** 2)))
    output = _output(problem, point, largest)
    for _ in range(HALVINGS):
        finer = _output(problem, point, 0.5 * largest)
        change = float(np.sqrt(np.mean((finer - output) ** 2)))
        if not change > UNSEEN_CHANGE * noise:
            break
        largest, output = 0.5 * largest, finer
    return largest


def _output(problem: Problem, point: Floats, largest: float) -> Floats:
    stepped = Problem(problem.setting, problem.choices, problem.rows, problem.noise, largest)
    with np.errstate(all="ignore"):
        return np.asarray(stepped.outputs(point[np.newaxis], rounded=False)[0])
