"""The free run of a physical model over a whole record, whatever rows it was fitted on."""

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.points import with_states
from sysid.diagnosis.physics.problem import Problem
from sysid.diagnosis.structures.structure import WHITE
from sysid.linear.simulation import first_rows

# So many of the states that the model has passed are tried as the initial state of a new experiment.
VISITED = 64


def free_run(problem: Problem, x: Floats) -> Floats:
    """Return the free run over every row, initial states of experiments without rows estimated."""
    record = problem.setting.record
    output = np.empty(record.n_samples)
    fitted = {part.start: number for number, part in enumerate(problem.parts)}
    for part in record.slices:
        number = fitted.get(part.start)
        if number is None and problem.n_starts:
            output[part] = _of_new_experiment(problem, x, part)
        else:
            output[part] = problem.run(part, x[np.newaxis], number)[0]
    return output


def _of_new_experiment(problem: Problem, x: Floats, part: slice) -> Floats:
    """Return the free run of an experiment that has no rows in the fit."""
    record = problem.setting.record
    y = record.y[part, 0]
    used, count = first_rows(y, record.skip.get(str(record.split[part][0]), 0), problem.setting.plant.order)
    own = problem.n_model + problem.n_effects
    if not count:
        return np.asarray(problem.run(part, x[np.newaxis], None)[0])
    rows = np.zeros(record.n_samples, dtype=bool)
    rows[part] = used
    local = Problem(problem.setting, problem.choices, rows, WHITE, problem.largest)
    end = with_states(local, x[:own], None if problem.exact else _visited(problem, x))
    return np.asarray(local.run(part, end[np.newaxis], 0)[0])


def _visited(problem: Problem, x: Floats) -> Floats:
    """Return states that the model passes in the experiments of the fit, shape (n_candidates, n_states)."""
    passed = []
    for number, part in enumerate(problem.parts):
        states = np.empty((1, part.stop - part.start, problem.setting.plant.order))
        problem.run(part, x[np.newaxis], number, states)
        passed.append(states[0])
    every: Floats = np.concatenate(passed)
    finite = np.flatnonzero(np.isfinite(every).all(axis=1))
    chosen = np.linspace(0, finite.size - 1, min(VISITED, finite.size)).astype(int)
    return np.asarray(every[finite[chosen]])


def runs(problem: Problem, points: Floats) -> Floats:
    """Return free runs over every row, experiments without rows of the fit from rest."""
    numbers = {part.start: number for number, part in enumerate(problem.parts)}
    return np.concatenate(
        [problem.run(part, points, numbers.get(part.start)) for part in problem.setting.record.slices], axis=1
    )
