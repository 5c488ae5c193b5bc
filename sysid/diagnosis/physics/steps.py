"""Steps of a simulation so fine that what they do wrong drowns in the noise."""

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.problem import COARSE_STEP, Problem

# Halving the steps must change the output by less than this share of the residual: over some thousands of
# rows, all of it in one direction, that is a third of a standard error.
UNSEEN_CHANGE = 0.005
HALVINGS = 3
# How often the largest step is halved, at most, until a slow plant takes more steps in a sample.
VAIN_HALVINGS = 12


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
        shorter = _halved(problem, point, largest)
        finer = _output(problem, point, shorter)
        change = float(np.sqrt(np.mean((finer - output) ** 2)))
        if not change > UNSEEN_CHANGE * noise:
            break
        largest, output = shorter, finer
    return largest


def _halved(problem: Problem, point: Floats, largest: float) -> float:
    """Return a largest step by which a sample has at least twice as many steps.

    A plant slower than its sampling takes one step in a sample by many a largest step, while a law inside it
    may be far faster: of steps that stay as they are nothing could be learnt.
    """
    plant, values = problem.setting.plant, problem.setting.values_of(point)
    few = plant.substeps(values, largest)[0]
    shorter = 0.5 * largest
    for _ in range(VAIN_HALVINGS):
        if plant.substeps(values, shorter)[0] >= 2 * few:
            break
        shorter *= 0.5
    return shorter


def _output(problem: Problem, point: Floats, largest: float) -> Floats:
    stepped = Problem(problem.setting, problem.choices, problem.rows, problem.noise, largest)
    with np.errstate(all="ignore"):
        return np.asarray(stepped.outputs(point[np.newaxis], rounded=False)[0])
