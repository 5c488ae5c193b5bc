"""Descents of a physical problem from several starts: where they end, and whether they agree."""

from collections.abc import Sequence

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics_points import with_states
from sysid.diagnosis.physics_problem import Problem
from sysid.diagnosis.physics_scatter import within_limits
from sysid.diagnosis.physics_search import grid_starts, problem_point, refined
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


def descents(problem: Problem, starts: Sequence[Floats]) -> list[Minimum[Residual]]:
    """Return where searches from model parameters end, the best first."""
    points = [with_states(problem, start) for start in starts]
    ends = [
        problem.descend(point, EVALUATIONS[2], TOLERANCES[2])
        for point in points
        if np.isfinite(problem.cost(point))
    ]
    return sorted(ends, key=cost_of)


def ends_beside(
    problem: Problem, before: Problem, known: Floats, new: Sequence[int], effort: int
) -> list[Minimum[Residual]]:
    """Search from the best points of the grid, around the fit so far and around the nominal values."""
    found: list[Floats] = []
    for centre in _centres(problem, before, known):
        starts = grid_starts(problem, before, centre, new)[: DESCENTS[effort]]
        found += [within_limits(problem, point) for _, point in starts]
    tried = [problem.descend(x, TRIED, TOLERANCES[effort]) for x in found if np.isfinite(problem.cost(x))]
    if not tried:
        tried = [problem.descend(problem_point(problem, before, known), 2, TOLERANCES[effort])]
    ends = [
        end
        if end.status.converged
        else problem.descend(end.x, EVALUATIONS[effort] - TRIED, TOLERANCES[effort])
        for end in different(sorted(tried, key=cost_of))[: DESCENTS[effort]]
    ]
    ends.sort(key=cost_of)
    # For a ranking the shapes of earlier effects stay where they are on the whole.
    scanned = None if effort == 2 else new
    ends[0] = refined(problem, ends[0], EVALUATIONS[1], TOLERANCES[effort], scanned)
    return ends


def _centres(problem: Problem, before: Problem, known: Floats) -> list[Floats]:
    """Return the points without the new effects around which these are searched."""
    centres = [known]
    nominal = known.copy()
    nominal[: before.n_model] = problem.setting.nominal
    if not np.allclose(nominal, known, rtol=1e-3):
        centres.append(nominal)
    return centres


def cost_of(end: Minimum[Residual]) -> float:
    """Return the cost at which a search ended."""
    return end.cost


def agree(ends: Sequence[Minimum[Residual]]) -> bool:
    """Tell whether the best end, first in the list, was found more than once."""
    return sum(_same(ends[0], end) for end in ends) > 1


def different(ends: Sequence[Minimum[Residual]]) -> list[Minimum[Residual]]:
    """Leave out searches that have come to where a better one is already, or nearly so."""
    kept: list[Minimum[Residual]] = []
    for end in ends:
        if all(not _same(other, end) for other in kept):
            kept.append(end)
    return kept


def _same(best: Minimum[Residual], end: Minimum[Residual]) -> bool:
    """Tell whether two searches ended at the same error with the same output."""
    apart = float(np.linalg.norm(end.point.residual - best.point.residual))
    error = np.sqrt(best.cost)
    return bool(np.sqrt(end.cost) <= error * (1.0 + AGREEMENT) and apart <= OUTPUT_AGREEMENT * error)
