"""Descents of a physical problem from several starts: where they end, and whether they agree."""

from collections.abc import Sequence

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.points import with_states
from sysid.diagnosis.physics.problem import Met, Problem
from sysid.diagnosis.physics.scatter import within_limits
from sysid.diagnosis.physics.search import grid_starts, problem_point, refined
from sysid.diagnosis.physics.starts import at_the_same_flow
from sysid.diagnosis.structures.structure import Effort
from sysid.physics.restarts import EXACT
from sysid.separable.descent import Minimum, Residual

# Most evaluations, tolerance and number of descents of each effort.
EVALUATIONS = (100, 14, 60)
TOLERANCES = (1e-7, 1e-4, 1e-7)
DESCENTS = (1, 2, 4)
# So many evaluations are spent on every start before the better ones are followed.
TRIED = 6
# Two searches agree when their root mean square errors differ by this share, and their outputs by less than
# that share of the error.
AGREEMENT, OUTPUT_AGREEMENT = 1e-3, 0.05
# What a model that lacks an effect cannot follow has many minima next to the best: after many restarts these
# may differ by a hundredth of the squared error.
NEARLY, NEARLY_SAME_OUTPUT = 5e-3, 0.1
# A value that was given is within some 20 %; it counts as one observed with this error, in logarithms, and
# while it moved by less than NEAR no other minimum is worth a search.
GIVEN_WITHIN, NEAR = 0.5, 0.25


def descents(problem: Problem, starts: Sequence[Floats]) -> list[Minimum[Residual]]:
    """Return where searches from model parameters end, the best first."""
    points = [with_states(problem, start) for start in starts]
    ends = [
        problem.descend_if_finite(point, EVALUATIONS[Effort.FINE], TOLERANCES[Effort.FINE])
        for point in points
    ]
    return sorted((end for end in ends if end is not None), key=cost_of)


def ends_beside(
    problem: Problem,
    before: Problem,
    known: Floats,
    new: Sequence[int],
    effort: Effort,
    found: Sequence[Minimum[Residual]] = (),
) -> list[Minimum[Residual]]:
    """Search from the best points of the grid, around the fit so far and around the nominal values.

    Searches that come to an end that a coarser search has ``found`` stop there.  Nothing is returned where
    the model diverges from all of these points.
    """
    tried = [*found, *_tried_beside(problem, before, known, new, effort, found)]
    if not tried:
        end = problem.descend_if_finite(problem_point(problem, before, known), 2, TOLERANCES[effort])
        if end is None:
            return []
        tried = [end]
    ends: list[Minimum[Residual]] = []
    for end in different(sorted(tried, key=cost_of))[: DESCENTS[effort]]:
        if not end.status.converged and not any(end is other for other in found):
            end = problem.descend(end.x, EVALUATIONS[effort] - TRIED, TOLERANCES[effort], _been_at(ends))
        ends.append(end)
    ends.sort(key=cost_of)
    # For a ranking the shapes of earlier effects stay where they are on the whole.
    scanned = None if effort is Effort.FINE else new
    ends[0] = refined(problem, ends[0], EVALUATIONS[Effort.COARSE], TOLERANCES[effort], scanned)
    return ends


def ends_without_colour(
    white: Problem, before: Problem, problem: Problem, known: Floats, new: Sequence[int], effort: Effort
) -> list[Minimum[Residual]]:
    """Search shortly under white noise; go on from there under the problem's own colour."""
    tried = _tried_beside(white, before, known, new, Effort.COARSE)
    if not tried:
        return []
    near = refined(white, min(tried, key=cost_of), EVALUATIONS[Effort.COARSE], TOLERANCES[Effort.COARSE], new)
    end = problem.descend_if_finite(near.x, EVALUATIONS[effort], TOLERANCES[effort])
    return [] if end is None else [end]


def _tried_beside(
    problem: Problem,
    before: Problem,
    known: Floats,
    new: Sequence[int],
    effort: Effort,
    found: Sequence[Minimum[Residual]] = (),
) -> list[Minimum[Residual]]:
    """Return where short searches from the best points of the grid have come to, each its own way."""
    points: list[Floats] = []
    for centre in _centres(problem, before, known, new):
        starts = grid_starts(problem, before, centre, new)[: DESCENTS[effort]]
        points += [within_limits(problem, point) for _, point in starts]
    ends = list(found)
    for x in points:
        end = problem.descend_if_finite(x, TRIED, TOLERANCES[effort], _been_at(ends))
        ends += [] if end is None else [end]
    return ends[len(found) :]


def _been_at(ends: Sequence[Minimum[Residual]]) -> Met:
    """Return what tells whether a search has come to the end of another one, and no lower."""
    ends = list(ends)
    return lambda point: any(end.cost <= point.cost and _same(end, point) for end in ends)


def _centres(problem: Problem, before: Problem, known: Floats, new: Sequence[int]) -> list[Floats]:
    """Return the points without the new effects around which these are searched."""
    replaced = any(problem.choices[i].name == "sqrt_outflow" for i in new)
    centres = [at_the_same_flow(problem.setting, known) if replaced else known]
    nominal = known.copy()
    nominal[: before.n_model] = problem.setting.nominal
    if not np.allclose(nominal, known, rtol=1e-3):
        centres.append(_nearer(before, nominal))
    return centres


def _nearer(problem: Problem, nominal: Floats) -> Floats:
    """Return the nominal values with the initial states of a fit, or from rest if that comes nearer.

    A plant that has run off with its parameters may start anywhere: with a time constant of nothing, the
    speed of the first sample is of no account.
    """
    if problem.n_starts == 0:
        return nominal
    resting = nominal.copy()
    resting[problem.n_model + problem.n_effects :] = np.tile(problem.setting.rest, len(problem.parts))
    with np.errstate(all="ignore"):
        errors = problem.errors(np.array([nominal, resting]))
        costs = np.nan_to_num(np.einsum("ij,ij->i", errors, errors), nan=np.inf)
    return resting if costs[1] < costs[0] else nominal


def cost_of(end: Minimum[Residual]) -> float:
    """Return the cost at which a search ended."""
    return end.cost


def agree(ends: Sequence[Minimum[Residual]], target: Floats) -> bool:
    """Tell whether the best end, first in the list, was found more than once."""
    return sum(_same(ends[0], end, floor=_rounding(target)) for end in ends) > 1


def _rounding(target: Floats) -> float:
    """Return the error below which searches differ by nothing that was measured."""
    return EXACT * float(np.linalg.norm(target))


def nearly_agree(ends: Sequence[Minimum[Residual]]) -> bool:
    """Tell whether another of many searches ended next to the best."""
    return sum(_same(ends[0], end, NEARLY, NEARLY_SAME_OUTPUT) for end in ends) > 1


def likeliest(problem: Problem, ends: Sequence[Minimum[Residual]]) -> Minimum[Residual]:
    """Return the end of least error, the start values counting as observations.

    Two tanks whose outflows change places, and the gain with them, have the same output: the record says
    nothing of which is which, the values that were given do.
    """
    variance = max(min(end.cost for end in ends) / max(problem.target.size - problem.size, 1), 1e-300)

    def squares(end: Minimum[Residual]) -> float:
        return end.cost / variance + float(np.sum((_moved_by(problem, end.x) / GIVEN_WITHIN) ** 2))

    return min(ends, key=squares)


def likelier_from_start_values(problem: Problem, point: Floats) -> Floats:
    """Return where a search ended, or where one from the start values ends if that is likelier."""
    if np.abs(_moved_by(problem, point)).max(initial=0.0) < NEAR:
        return point
    given = point.copy()
    given[: problem.n_model] -= _moved_by(problem, point)
    here = problem.descend(point, EVALUATIONS[Effort.REFIT], TOLERANCES[Effort.REFIT])
    there = problem.descend_if_finite(given, EVALUATIONS[Effort.FINE], TOLERANCES[Effort.FINE])
    if there is None or likeliest(problem, [here, there]) is here:
        return point
    return there.x


def _moved_by(problem: Problem, point: Floats) -> Floats:
    """Return how far the parameters of which a value was given are from it, in logarithms."""
    searched = problem.setting.searched
    given = np.array([p.positive and p.status == "uncertain" for p in searched], dtype=bool)
    return np.where(given, point[: problem.n_model] - problem.setting.nominal, 0.0)


def different(ends: Sequence[Minimum[Residual]]) -> list[Minimum[Residual]]:
    """Leave out searches that have come to where a better one is already, or nearly so."""
    kept: list[Minimum[Residual]] = []
    for end in ends:
        if all(not _same(other, end) for other in kept):
            kept.append(end)
    return kept


def _same(
    best: Minimum[Residual],
    end: Minimum[Residual] | Residual,
    cost: float = AGREEMENT,
    output: float = OUTPUT_AGREEMENT,
    floor: float = 0.0,
) -> bool:
    """Tell whether two searches ended at the same error with the same output."""
    error = np.sqrt(best.cost)
    if not np.sqrt(end.cost) <= error * (1.0 + cost) + floor:
        return False
    point = end if isinstance(end, Residual) else end.point
    return bool(np.linalg.norm(point.residual - best.point.residual) <= output * error + 2.0 * floor)
