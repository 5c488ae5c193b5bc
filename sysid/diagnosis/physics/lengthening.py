"""A search of a physical problem on longer and longer openings of its rows."""

import numpy as np

from sysid.diagnosis.physics.problem import Problem
from sysid.diagnosis.structures.lengthening import ITERATIONS, TOLERANCE, openings
from sysid.separable.descent import Minimum, Residual

# How many times as many rows the next opening has; fewer of them than of a chain, for each takes longer.
FACTOR = 1.25


def lengthened(
    problem: Problem, end: Minimum[Residual], evaluations: int, tolerance: float
) -> Minimum[Residual]:
    """Search again from an end on longer and longer openings of the rows; return the better of both ends.

    Parameters
    ----------
    problem : Problem
    end : Minimum
    evaluations : int
        Most evaluations of the last search.
    tolerance : float
        Of the last search.
    """
    slices = problem.setting.record.slices
    begin = np.array([0, *(part.stop for part in slices)])
    point = end.x
    for rows in openings(problem.rows, begin, FACTOR):
        shorter = Problem(
            problem.setting, problem.choices, rows, problem.noise, problem.largest, problem.free_start,
            problem.budget,
        )  # fmt: skip
        near = shorter.descend_if_finite(point, ITERATIONS, TOLERANCE)
        point = point if near is None else near.x
    again = problem.descend_if_finite(point, evaluations, tolerance)
    return end if again is None or again.cost >= end.cost else again
