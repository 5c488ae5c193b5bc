"""The likelihood of a physical model around the point of a fit."""

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.budget import Budget
from sysid.diagnosis.physics.problem import Problem
from sysid.diagnosis.physics.steps import enough_steps
from sysid.diagnosis.structures.plain_errors import UNSEEN
from sysid.diagnosis.structures.profile import End, Profile
from sysid.diagnosis.structures.thresholds import followed_smoothly
from sysid.errors import UsageError

# Of each search for where the other unknowns follow.
EVALUATIONS, TOLERANCE = 30, 1e-6
# Steps of the simulations that walks may take.
STEPS = 20e6


def profile_of(problem: Problem, point: Floats, J: Floats, errors: Floats) -> Profile:
    """Return the likelihood of a problem around its minimum.

    Parameters
    ----------
    problem : Problem
    point : ndarray, shape (n_unknowns,)
    J : ndarray, shape (n_rows, n_unknowns)
        Slopes.
    errors : ndarray, shape (n_unknowns,)
        Standard errors as they tell them; infinite where the output does not tell.
    """
    largest = enough_steps(problem, point)
    walked = Problem(
        problem.setting, problem.choices, problem.rows, problem.noise, largest, budget=Budget(STEPS)
    )
    lower, upper = problem.bounds
    logarithmic = np.zeros(point.size, dtype=bool)
    logarithmic[: problem.n_model] = problem.setting.positive

    def cost_at(x: Floats) -> float:
        with np.errstate(all="ignore"):
            return walked.cost(np.clip(x, lower, upper))

    def follow(x: Floats, free: Mask) -> End | None:
        if walked.budget.left <= 0.0:
            return None
        walked.held = ~free
        try:
            end = walked.descend(x, EVALUATIONS, TOLERANCE)
        except UsageError:
            return None
        return End(end.x, end.cost)

    inverse = _inverse(J)
    with np.errstate(all="ignore"):
        variances = np.where(np.isfinite(errors), errors**2 / np.diag(inverse), np.inf)
    return Profile(
        End(point, walked.cost(point)), inverse, variances, logarithmic, smooth(problem), cost_at, follow
    )


def smooth(problem: Problem) -> Mask:
    """Tell which unknowns the output follows smoothly: all but the shapes of what jumps."""
    return followed_smoothly(problem.choices, problem.effect_places, problem.size)


def _inverse(J: Floats) -> Floats:
    """Return the pseudo-inverse of J'J, without directions that the output does not show."""
    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0.0] = 1.0
    _, sizes, right = np.linalg.svd(J / scale, full_matrices=False)
    seen = sizes > UNSEEN * sizes.max(initial=0.0)
    root = (right[seen] / sizes[seen, np.newaxis]).T / scale[:, np.newaxis]
    return np.asarray(root @ root.T)
