"""Search around where a search ended: a limit that is reached or not leaves many minima beside the best."""

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.laws import coefficients
from sysid.diagnosis.physics.problem import Problem
from sysid.physics.forced import LAW_NAMES
from sysid.separable.descent import Minimum, Residual

# So many points are drawn in a round, searched so far, and the best of them followed.
DRAWS, TRIED, FOLLOWED = 24, 10, 3
ROUNDS = 4
# Draws are this far off, in logarithms or relative to the size of the unknown.
SPREAD = 0.5
# A round is worth another one if it lowers the cost by this share.
WORTHWHILE = 0.01
SEED = 13
CAPS = (LAW_NAMES.index("first_cap"), LAW_NAMES.index("second_cap"))


def has_limits(problem: Problem) -> bool:
    """Tell whether an effect limits a level of the model."""
    return any(choice.effect.port == "flow" and choice.form.parameters for choice in problem.choices)


def is_rugged(problem: Problem) -> bool:
    """Tell whether a search from one start is likely to stop at a poor minimum.

    Under a law with free powers, limits of the levels are reached at other times for every change of them.
    """
    return has_limits(problem) and any(choice.form.refines for choice in problem.choices)


def within_limits(problem: Problem, x: Floats) -> Floats:
    """Return a point whose initial levels are not above their limits.

    There they would not matter, so that no search that follows slopes moves them again.
    """
    levels = problem.setting.plant.port.levels
    if not problem.n_starts or not levels or not has_limits(problem):
        return x
    point = x.copy()
    caps = coefficients(problem.choices, [x[place] for place in problem.effect_places])[list(CAPS)]
    order = problem.setting.plant.order
    starts = point[problem.n_model + problem.n_effects :].reshape(-1, order)
    for state, cap in zip(levels, caps, strict=False):
        starts[:, state] = np.minimum(starts[:, state], cap)
    return point


def scattered(
    problem: Problem, best: Minimum[Residual], evaluations: int, tolerance: float
) -> Minimum[Residual]:
    """Search on from points drawn around the best so far, until a round of draws finds nothing better.

    Parameters
    ----------
    problem : Problem
    best : Minimum
    evaluations : int
        Most evaluations of a search that is followed.
    tolerance : float
        Of the followed searches.
    """
    generator = np.random.default_rng(SEED)
    for _ in range(ROUNDS):
        before = best.cost
        drawn = (_drawn(problem, best.x, generator) for _ in range(DRAWS))
        tried = [problem.descend(x, TRIED, tolerance) for x in drawn if np.isfinite(problem.cost(x))]
        tried.sort(key=lambda end: end.cost)
        for end in tried[:FOLLOWED]:
            found = problem.descend(within_limits(problem, end.x), evaluations, tolerance)
            best = found if found.cost < best.cost else best
        if best.cost > (1.0 - WORTHWHILE) * before:
            break
    return best


def _drawn(problem: Problem, x: Floats, generator: np.random.Generator) -> Floats:
    """Return a point around another: logarithms are shifted, other unknowns scaled."""
    lower, upper = problem.bounds
    step = SPREAD * generator.uniform(-1.0, 1.0, x.size)
    point = x * np.exp(step)
    shifted = np.zeros(x.size, dtype=bool)
    shifted[: problem.n_model] = problem.setting.positive
    shifted |= x == 0.0
    point = np.where(shifted, x + step * np.where(x == 0.0, problem.sizes, 1.0), point)
    return within_limits(problem, np.clip(point, lower, upper))
