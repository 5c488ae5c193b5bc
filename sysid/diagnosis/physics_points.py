"""Points of a physical problem: taken over from another problem, and completed by initial states."""

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics_problem import Problem


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


def with_states(problem: Problem, coordinates: Floats) -> Floats:
    """Return a point whose initial states fit best, the rest as given."""
    point = np.concatenate([coordinates, np.zeros(problem.size - coordinates.size)])
    if problem.n_starts == 0:
        return point
    point[coordinates.size :] = np.tile(problem.setting.rest, len(problem.parts))
    problem.held[: coordinates.size] = True
    with np.errstate(all="ignore"):
        found = problem.descend(point, 8, 1e-6).x if np.isfinite(problem.cost(point)) else point
    problem.held[:] = False
    return found
