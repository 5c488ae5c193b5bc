"""What the point of a physical problem says to a reader: named parameters and their standard errors."""

import itertools

import numpy as np
from numpy.typing import NDArray

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.cells import errors_of_thresholds
from sysid.diagnosis.physics.evaluation import finite
from sysid.diagnosis.physics.laws import has_level, is_switch_without_level, with_level
from sysid.diagnosis.physics.problem import Problem
from sysid.diagnosis.physics.profile import profile_of, smooth
from sysid.diagnosis.structures.cells import read_cells
from sysid.diagnosis.structures.plain_errors import LOOSE, UNSEEN, plain_errors
from sysid.diagnosis.structures.structure import WHITE, Choice, FittedParameter
from sysid.diagnosis.structures.thresholds import with_threshold_errors

# Of the steps of a search's slopes: so far to each side of a minimum the mean slope is taken.
WIDER = 100.0
# A level that the other unknowns can take up to this share of its effect is one with them.
SAME_DIRECTION = 1e-3


def named_parameters(problem: Problem, x: Floats, errors: Floats) -> tuple[FittedParameter, ...]:
    """Return the parameters for a reader; errors are those of the coordinates."""
    setting = problem.setting
    values = setting.to_values(x[: problem.n_model])
    slopes = np.where(setting.positive, values, 1.0)
    found = [
        FittedParameter(p.name, float(value), float(error * slope), p.unit)
        for p, value, error, slope in zip(setting.searched, values, errors, slopes, strict=False)
    ]
    for choice, place in zip(problem.choices, problem.effect_places, strict=True):
        for parameter, value, error in zip(choice.form.parameters, x[place], errors[place], strict=True):
            unit = parameter.unit_with(setting.units)
            found.append(FittedParameter(parameter.name, float(value), float(error), unit, choice.name))
    return tuple(found)


def standard_errors(
    problem: Problem, point: Floats, left: Floats = WHITE, *, closely: bool = False
) -> Floats:
    """Return the standard error of each unknown; infinite where the output does not tell.

    Parameters
    ----------
    problem : Problem
    point : ndarray, shape (n_unknowns,)
    left : ndarray, shape (order + 1,), optional
        D(q) of the memory that is left in the problem's residual.
    closely : bool
        Whether to follow the likelihood where slopes do not hold; the point is a minimum then.

    Returns
    -------
    ndarray, shape (n_unknowns,)
    """
    slopes, free = slopes_of_both_sides(problem, point), smooth(problem) | _levels(problem)
    J = np.where(free, slopes, 0.0)
    relative = _relative_to_a_level(problem, point)
    J[:, relative & _levels(problem)] = 0.0  # beside it the others would seem known to rounding
    edges = problem.run_edges.tolist()
    runs = [slice(first, end) for first, end in itertools.pairwise(edges)]
    residual = problem.residual(point)
    errors = plain_errors(J, residual, runs, left)
    read = read_cells(
        problem.choices, problem.effect_places, point, problem.setting.record.y[problem.rows, 0]
    )
    if read is not None:
        cells, place = read
        spread = np.linalg.norm(residual) / np.sqrt(max(residual.size - problem.size, 1))
        errors *= cells.widening(problem.size, float(spread))
        errors[place] = cells.step_error
    errors[relative] = np.inf
    if closely and read is None and residual.any():
        followed = profile_of(problem, point, J, errors).standard_errors(smooth(problem))
        errors = np.where(np.isfinite(errors), followed, errors)
    return with_threshold_errors(errors, slopes, free, errors_of_thresholds(problem, point, runs, left))


def slopes_of_both_sides(problem: Problem, point: Floats) -> Floats:
    """Return the Jacobian by central differences.

    A minimum is often where a level just reaches its limit, or a body just stops: there the output has a
    kink.  Slopes that are each taken to one side, some before the kink and some behind it, make unknowns look
    well known that can move together without any change.
    """
    lower, upper = problem.bounds
    _, steps = problem.shifted(point, range(problem.size))
    ahead = np.minimum(point + WIDER * np.abs(steps), upper)
    behind = np.maximum(point - WIDER * np.abs(steps), lower)
    points = np.tile(point, (2 * point.size, 1))
    lanes = np.arange(point.size)
    points[lanes, lanes], points[point.size + lanes, lanes] = ahead, behind
    with np.errstate(all="ignore"):
        errors = problem.errors(points, rounded=False)
        slopes = (errors[: point.size] - errors[point.size :]) / (ahead - behind)[:, np.newaxis]
    return finite(slopes.T)


def _relative_to_a_level(problem: Problem, point: Floats) -> NDArray[np.bool_]:
    """Tell which unknowns are known only relative to the level of a switch, which counts as 1 if not given.

    A motor that is driven by a relay of unknown voltage has the same speed with all its constants scaled.
    """
    none, given = np.zeros(point.size, dtype=bool), _levels(problem)
    opened, whole, levels = _with_levels(problem, point)
    if not levels:
        return none
    with np.errstate(all="ignore"):
        J = finite(opened.jacobian(whole))
    own = np.delete(J, levels, axis=1)
    scale = np.linalg.norm(own, axis=0)
    scale[scale == 0.0] = 1.0
    for level in levels:
        change = J[:, level]
        moved = np.linalg.lstsq(own / scale, change, rcond=UNSEEN)[0]
        if np.linalg.norm(own / scale @ moved - change) < SAME_DIRECTION * np.linalg.norm(change):
            none[~given] |= np.abs(moved / scale) > LOOSE * np.abs(moved / scale).max()
            none |= given
    return none


def _levels(problem: Problem) -> NDArray[np.bool_]:
    """Tell which unknowns are levels of switches."""
    found = np.zeros(problem.size, dtype=bool)
    for choice, place in zip(problem.choices, problem.effect_places, strict=True):
        found[place.stop - 1] |= has_level(choice)
    return found


def _with_levels(problem: Problem, point: Floats) -> tuple[Problem, Floats, list[int]]:
    """Return a problem all of whose switches have a level, a point of it, and where the levels stand."""
    choices, parts, levels = [], [point[: problem.n_model]], []
    for choice, place in zip(problem.choices, problem.effect_places, strict=True):
        parts.append(point[place])
        if is_switch_without_level(choice):
            effect = with_level(choice.effect)
            choice = Choice(effect, effect.form(choice.form.name))
            parts.append(np.ones(1))
        choices.append(choice)
        if has_level(choice):
            levels.append(sum(part.size for part in parts) - 1)
    if not levels:
        return problem, point, levels
    opened = Problem(
        problem.setting, choices, problem.rows, problem.noise, problem.largest, problem.free_start
    )
    parts.append(point[problem.n_model + problem.n_effects :])
    return opened, np.concatenate(parts), levels
