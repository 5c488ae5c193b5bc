"""Physical models behind a quantiser, or behind a switch: what rows tell only to lie in a cell."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.evaluation import finite
from sysid.diagnosis.physics.laws import LEVEL
from sysid.diagnosis.physics.problem import Problem
from sysid.diagnosis.physics.search import Tangent, in_lanes
from sysid.diagnosis.structures.cells import Cells, cells_of, inside_cells, place_of_quantiser
from sysid.diagnosis.structures.structure import WHITE
from sysid.diagnosis.structures.thresholds import is_switched_by_input, middle_of_cell, threshold_error
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
    places, levels = _thresholds(problem)
    if not places:
        return end
    x = end.x.copy()
    for place in places:
        x[place] = middle_of_cell(levels, float(x[place]))
    moved = problem.residual(x)
    return replace(end, x=x) if np.array_equal(moved, problem.residual(end.x)) else end


def threshold_errors(
    problem: Problem, point: Floats, runs: Sequence[slice], left: Floats
) -> list[tuple[int, float]]:
    """Return where the thresholds of a switch stand and their standard errors.

    Slopes say nothing of them: the output changes only where the switch turns at another row.

    Parameters
    ----------
    problem : Problem
    point : ndarray, shape (n_unknowns,)
    runs : sequence of slice
        Rows that follow one another.
    left : ndarray
        D(q) of the memory that is left in the problem's residual.
    """
    places, levels = _thresholds(problem)
    if not places:
        return []
    tangent = Tangent(problem, point)

    def costs(points: Floats) -> Floats:
        errors = tangent.outside(in_lanes(problem, points))
        driving = np.array(
            [np.concatenate([np.convolve(left, row[run])[: row[run].size] for run in runs]) for row in errors]
        )
        return np.asarray(np.nan_to_num(np.einsum("ij,ij->i", driving, driving), nan=np.inf))

    best = float(costs(point[np.newaxis])[0])
    variance = max(best / max(problem.target.size - problem.size, 1), 1e-300)
    found = []
    for place in places:

        def rises(values: Floats, place: int = place) -> Floats:
            points = np.tile(point, (values.size, 1))
            points[:, place] = values
            return (costs(points) - best) / variance

        found.append((place, threshold_error(levels, float(point[place]), rises)))
    return found


def _thresholds(problem: Problem) -> tuple[list[int], Floats]:
    """Return where the thresholds of a switch that is the first map of the input stand, and its levels."""
    first = next((i for i, choice in enumerate(problem.choices) if choice.effect.port == "input"), None)
    if first is None or not is_switched_by_input(problem.choices, first):
        return [], np.empty(0)
    u = problem.setting.record.u
    levels = np.unique(np.abs(np.concatenate([u[part, 0][problem.rows[part]] for part in problem.parts])))
    parameters, start = problem.choices[first].form.parameters, problem.effect_places[first].start
    inputs = [p.unit == "[u]" and not p.is_strength and p.name != LEVEL for p in parameters]
    return [start + i for i in np.flatnonzero(inputs).tolist()], levels
