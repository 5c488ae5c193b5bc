"""Physical models behind a quantiser, or behind a switch: what rows tell only to lie in a cell."""

from dataclasses import replace

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.evaluation import finite
from sysid.diagnosis.physics.problem import Problem
from sysid.diagnosis.structures.cells import Cells, cells_of, inside_cells, place_of_quantiser
from sysid.diagnosis.structures.structure import WHITE
from sysid.diagnosis.structures.thresholds import is_switched_by_input, middle_of_cell
from sysid.separable.descent import Minimum, Residual


def read_cells(problem: Problem, point: Floats) -> tuple[Cells, int] | None:
    """Return what the readings say, and where the step stands, if a quantiser is the last of the sensor."""
    quantiser = place_of_quantiser(problem.choices)
    if quantiser is None:
        return None
    place = problem.effect_places[quantiser].start
    cells = cells_of(problem.setting.record.y[problem.rows, 0], float(point[place]))
    return None if cells is None else (cells, place)


def within_cells(problem: Problem, end: Minimum[Residual]) -> Minimum[Residual]:
    """Go on behind a quantiser by the cells that were read, if that lowers the error.

    Parameters
    ----------
    problem : Problem
    end : Minimum
        Of the squared error, where a search without slopes of the quantiser came to rest.

    Returns
    -------
    Minimum
        The same where there is no quantiser, or noise hides its steps.
    """
    read = read_cells(problem, end.x)
    if read is None:
        return end
    cells, place = read
    plain = Problem(
        problem.setting, problem.choices, problem.rows, WHITE, problem.largest, budget=problem.budget
    )
    bounds = problem.bounds

    def output(x: Floats) -> Floats:
        with np.errstate(all="ignore"):
            return np.asarray(plain.outputs(np.clip(x, *bounds)[np.newaxis], rounded=False)[0])

    def slopes(x: Floats) -> Floats:
        with np.errstate(all="ignore"):
            return finite(plain.jacobian(np.clip(x, *bounds)))

    start = end.x.copy()
    start[place] = cells.step
    better = problem.descend_if_finite(inside_cells(cells, output, slopes, start), 1, 0.0)
    return end if better is None or better.cost > end.cost else better


def with_thresholds_between(problem: Problem, end: Minimum[Residual]) -> Minimum[Residual]:
    """Return a minimum with the threshold of a switch in the middle of its cell, where nothing changes.

    Only where the switch is the first map of the input, so that what it is given is the record's.
    """
    first = next((i for i, choice in enumerate(problem.choices) if choice.effect.port == "input"), None)
    if first is None or not is_switched_by_input(problem.choices[first]):
        return end
    u = problem.setting.record.u
    levels = np.unique(np.abs(np.concatenate([u[part, 0][problem.rows[part]] for part in problem.parts])))
    x = end.x.copy()
    for shape in problem.choices[first].form.shapes:
        place = problem.effect_places[first].start + shape
        x[place] = middle_of_cell(levels, float(x[place]))
    moved = problem.residual(x)
    return replace(end, x=x) if np.array_equal(moved, problem.residual(end.x)) else end
