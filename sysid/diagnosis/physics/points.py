"""Points of a physical problem: taken over from another problem, and completed by initial states."""

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.problem import Problem

# Evaluations of a search for initial states, and how many candidates are followed.
LINEAR_STATES, NONLINEAR_STATES = 8, 30
FOLLOWED = 3


def moved(old: Problem, problem: Problem, x: Floats) -> Floats:
    """Return a point with what another problem's point says about the same unknowns."""
    point = np.zeros(problem.size)
    point[: problem.n_model] = x[: old.n_model]
    for i, choice in enumerate(problem.choices):
        if choice in old.choices:
            point[problem.effect_places[i]] = x[old.effect_places[old.choices.index(choice)]]
    order = problem.setting.plant.order
    rest = problem.setting.rest
    first = {part.start: k for k, part in enumerate(old.parts)}
    for number, part in enumerate(problem.parts if problem.n_starts else []):
        place = problem.n_model + problem.n_effects + number * order
        k = first.get(part.start)
        where = old.n_model + old.n_effects + (k or 0) * order
        point[place : place + order] = rest if k is None or not old.n_starts else x[where : where + order]
    return point


def with_states(problem: Problem, coordinates: Floats, states: Floats | None = None) -> Floats:
    """Return a point whose initial states fit best, the rest as given.

    Parameters
    ----------
    problem : Problem
    coordinates : ndarray, shape (n_model + n_effects,)
    states : ndarray, shape (n_candidates, n_states), optional
        From which the search starts, beside rest.  A linear model needs none: its error is quadratic in its
        initial state.  An empty or a full tank does not feel a small change of its level.
    """
    rest = np.tile(problem.setting.rest, len(problem.parts))
    if problem.n_starts == 0:
        return np.asarray(coordinates)
    starts = [rest] if states is None else [rest, *(np.tile(state, len(problem.parts)) for state in states)]
    points = np.array([np.concatenate([coordinates, start]) for start in starts])
    with np.errstate(all="ignore"):
        errors = problem.errors(points)
        costs = np.nan_to_num(np.einsum("ij,ij->i", errors, errors), nan=np.inf)
        if not np.isfinite(costs).any():
            return np.asarray(points[0])
        problem.held[: coordinates.size] = True
        chosen = points[np.argsort(costs, kind="stable")[:FOLLOWED]]
        evaluations = LINEAR_STATES if states is None else NONLINEAR_STATES
        ends = [
            problem.descend(point, evaluations, 1e-6) for point in chosen if np.isfinite(problem.cost(point))
        ]
        problem.held[:] = False
    return min(ends, key=lambda end: end.cost).x
