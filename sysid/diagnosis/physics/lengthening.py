"""A search of a physical problem on longer and longer openings of its rows."""

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.physics.problem import Problem
from sysid.diagnosis.structures.lengthening import ITERATIONS, TOLERANCE, openings
from sysid.separable.descent import Minimum, Residual

# How many times as many rows the next opening has, in one search after the other: which way leads past a stop
# that is missed is a matter of luck, and coarse ways take the least time.
FACTORS = (2.0, 1.5, 1.25)


def lengthened(
    problem: Problem, end: Minimum[Residual], evaluations: int, tolerance: float
) -> Minimum[Residual]:
    """Search again from an end on longer and longer openings of the rows; return the best of all ends.

    Parameters
    ----------
    problem : Problem
    end : Minimum
    evaluations : int
        Most evaluations of a last search on all rows.
    tolerance : float
        Of a last search.
    """
    begin = np.array([0, *(part.stop for part in problem.setting.record.slices)])
    for factor in FACTORS:
        point = end.x
        for rows in openings(problem.rows, begin, factor):
            near = _on(problem, rows).descend_if_finite(point, ITERATIONS, TOLERANCE)
            point = point if near is None else near.x
        again = problem.descend_if_finite(point, evaluations, tolerance)
        end = end if again is None or again.cost >= end.cost else again
    return end


def _on(problem: Problem, rows: Mask) -> Problem:
    """Return the same problem on other rows of the same experiments."""
    return Problem(
        problem.setting, problem.choices, rows, problem.noise, problem.largest, problem.free_start,
        problem.budget,
    )  # fmt: skip
