"""Physical models behind a quantiser, or behind a switch: what rows tell only to lie in a cell."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.evaluation import finite
from sysid.diagnosis.physics.laws import has_level
from sysid.diagnosis.physics.problem import Problem
from sysid.diagnosis.physics.search import Tangent
from sysid.diagnosis.structures.cells import inside_cells, read_cells
from sysid.diagnosis.structures.structure import WHITE
from sysid.diagnosis.structures.thresholds import (
    followed_smoothly,
    is_switched_by_input,
    middle_of_cell,
    threshold_errors,
    threshold_places,
)
from sysid.separable.descent import Minimum, Residual

# Of the search for what follows a threshold to the middle of its cell, and by what share the cost may differ.
EVALUATIONS, TOLERANCE, ROUNDING = 10, 1e-12, 1e-9


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
    read = read_cells(
        problem.choices, problem.effect_places, end.x, problem.setting.record.y[problem.rows, 0]
    )
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
    """Return a minimum with the thresholds of a switch in the middle of their cells, where it is as good.

    Only where the switch is the first map of the input, so that what it is given is the record's.
    """
    places, levels = _thresholds(problem)
    if not places:
        return end
    x = end.x.copy()
    for place in places:
        x[place] = middle_of_cell(levels, float(x[place]))
    if np.array_equal(problem.residual(x), problem.residual(end.x)):
        return replace(end, x=x)
    others = Problem(
        problem.setting, problem.choices, problem.rows, problem.noise, problem.largest, budget=problem.budget
    )
    others.held = ~followed_smoothly(problem.choices, problem.effect_places, problem.size)
    moved = others.descend_if_finite(x, EVALUATIONS, TOLERANCE)
    return end if moved is None or moved.cost > end.cost * (1.0 + ROUNDING) else moved


def errors_of_thresholds(
    problem: Problem, point: Floats, runs: Sequence[slice], left: Floats
) -> list[tuple[int, float]]:
    """Return where the thresholds of a switch stand and their standard errors.

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

    def cost(other: Floats) -> float:
        with np.errstate(all="ignore"):
            error = Tangent(problem, other).outside(problem.residual(other))
        driving = np.concatenate([np.convolve(left, error[run])[: error[run].size] for run in runs])
        size = float(driving @ driving)
        return size if np.isfinite(size) else np.inf

    return threshold_errors(places, levels, point, cost, problem.target.size - problem.size)


def _thresholds(problem: Problem) -> tuple[list[int], Floats]:
    """Return where the thresholds of a switch that is the first map of the input stand, and its levels."""
    first = next((i for i, choice in enumerate(problem.choices) if choice.effect.port == "input"), None)
    if first is None or not is_switched_by_input(problem.choices, first):
        return [], np.empty(0)
    u = problem.setting.record.u
    levels = np.unique(np.abs(np.concatenate([u[part, 0][problem.rows[part]] for part in problem.parts])))
    choice, place = problem.choices[first], problem.effect_places[first]
    level = [place.stop - 1] if has_level(choice) else []
    return [i for i in threshold_places(choice, place) if i not in level], levels
