"""Search for the parameters of effects in a physical model: grid, projection, descent, refinement."""

from collections.abc import Sequence
from itertools import product

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.evaluation import finite
from sysid.diagnosis.physics.problem import Problem
from sysid.diagnosis.structures.projection import orthonormal
from sysid.diagnosis.structures.thresholds import jumps
from sysid.separable.descent import Minimum, Residual

# Share of a strength's typical size at which its effect is measured; that of a dry friction is not linear
# and is measured at a size that it may have.
PROBE, DRY_PROBE = 1e-5, 0.05
# Searches start at these shares of the strengths that would be best if their effect were linear, and for a
# dry friction also at these shares of its typical size.
SHARES, DRY_SIZES = (1.0, 0.3), (0.1, 0.5)
# Points of the grid of several shapes: each is a simulation.
MOST_COMBINATIONS = 64
# Rows that are simulated at a time, in all runs together: 24 MB.
LANE_ROWS = 3_000_000
# Scans of a shape by which the output jumps, each around the best of the one before, and their points.
REFINEMENTS, REFINED_POINTS = 3, 25
# Stiffness and yield force of an elastic contact, relative to the forces in the model.
CONTACT_SHARES = ((0.3, 3.0, 30.0), (0.1, 0.3, 0.8))
RANK_TOLERANCE = 1e-9

Scored = tuple[float, Floats]


class Tangent:
    """The part of a residual that the model's other unknowns cannot take up, to first order."""

    def __init__(self, problem: Problem, point: Floats) -> None:
        with np.errstate(all="ignore"):
            self.basis = orthonormal(finite(problem.jacobian(point)), least=RANK_TOLERANCE)

    def outside(self, rows: Floats) -> Floats:
        """Return what is left of each row, shape (lanes, n_rows)."""
        return np.asarray(rows - (rows @ self.basis) @ self.basis.T)


def in_lanes(problem: Problem, points: Floats) -> Floats:
    """Return the residuals of many points, as many at a time as memory allows."""
    at_once = max(int(LANE_ROWS / max(problem.target.size, 1)), 1)
    with np.errstate(all="ignore"):
        return np.concatenate(
            [problem.errors(points[i : i + at_once]) for i in range(0, points.shape[0], at_once)]
        )


def grid_starts(problem: Problem, before: Problem, known: Floats, new: Sequence[int]) -> list[Scored]:
    """Return starting points over the grid of the new effects, the most promising first.

    A point is judged by what is left of its residual after the model's other unknowns have taken up
    what they can, to first order.

    Parameters
    ----------
    problem : Problem
        With all effects.
    before : Problem
        The same without the new effects.
    known : ndarray
        A point of ``before``.
    new : sequence of int
        Positions of the new effects.
    """
    tangent = Tangent(before, known)
    base = problem_point(problem, before, known)
    shapes, strengths = _places(problem, new)
    points = np.tile(base, (len(combinations := _combinations(problem, new)), 1))
    for place, values in zip(shapes, np.array(combinations).reshape(len(combinations), -1).T, strict=True):
        points[:, place] = values
    if strengths:
        points = _with_strengths(problem, points, strengths, tangent)
    left = tangent.outside(in_lanes(problem, points))
    costs = np.einsum("ij,ij->i", left, left)
    costs[~np.isfinite(costs)] = np.inf
    order = np.argsort(costs, kind="stable")
    return [(float(costs[i]), points[i]) for i in order if np.isfinite(costs[i])]


def problem_point(problem: Problem, before: Problem, known: Floats) -> Floats:
    """Return the point of a problem with more effects: the new ones at zero, or at their lower bound."""
    point = np.zeros(problem.size)
    point[: problem.n_model] = known[: problem.n_model]
    own = dict(zip((choice.name for choice in before.choices), before.effect_places, strict=True))
    for choice, place in zip(problem.choices, problem.effect_places, strict=True):
        if choice.name in own and choice in before.choices:
            point[place] = known[own[choice.name]]
    point[problem.n_model + problem.n_effects :] = known[before.n_model + before.n_effects :]
    lower, upper = problem.bounds
    return np.clip(point, lower, upper)


def _places(problem: Problem, new: Sequence[int]) -> tuple[list[int], list[int]]:
    shapes: list[int] = []
    strengths: list[int] = []
    for i in new:
        for j, parameter in enumerate(problem.choices[i].form.parameters):
            (strengths if parameter.is_strength else shapes).append(problem.effect_places[i].start + j)
    return shapes, strengths


def _combinations(problem: Problem, new: Sequence[int]) -> list[tuple[float, ...]]:
    """Return the values of the shape parameters to be tried, thinned out where they are too many."""
    axes = [axis for i in new for axis in shape_values(problem, i)]
    while len(axes) > 1 and np.prod([len(axis) for axis in axes]) > MOST_COMBINATIONS:
        longest = max(range(len(axes)), key=lambda k: len(axes[k]))
        axes[longest] = axes[longest][::2] if len(axes[longest]) > 2 else axes[longest][:1]
    return list(product(*axes))


def shape_values(problem: Problem, effect: int) -> list[list[float]]:
    """Return the values of each shape parameter of an effect that are tried first."""
    setting, rows = problem.setting, problem.rows
    form, first = problem.choices[effect].form, problem.effect_places[effect].start
    if form.state:  # stiffness and yield force, relative to the forces in the model
        return [
            [float(problem.sizes[first + j] * share) for share in shares]
            for j, shares in zip(form.shapes, CONTACT_SHARES, strict=False)
        ]
    found = []
    for parameter in form.parameters:
        if parameter.grid is None:
            continue
        if parameter.grid.scale == "speed deviation":  # the model's speed, not the output's difference
            values = np.array(parameter.grid.points) * setting.sizes["v"]
        elif parameter.grid.scale == "duration":  # of the longest experiment, rows that are held out included
            longest = max(part.stop - part.start for part in problem.parts)
            values = np.array(parameter.grid.points) * setting.record.period * longest
        else:
            values = setting.tried(parameter.grid, rows)
        found.append(np.unique(np.clip(values, parameter.minimum, parameter.maximum)).tolist())
    return found


def _with_strengths(problem: Problem, points: Floats, strengths: list[int], tangent: Tangent) -> Floats:
    """Give each point the strengths that lower the residual most, to first order, and shares of them."""
    lower, upper = problem.bounds
    dry = any(choice.effect.dry for choice in problem.choices)
    probe = (DRY_PROBE if dry else PROBE) * problem.sizes[strengths]
    count = len(strengths)
    probes = np.repeat(points, count, axis=0)
    for j, place in enumerate(strengths):
        probes[j::count, place] = probe[j]
    plain = points.copy()
    responses = in_lanes(problem, probes)
    starts = in_lanes(problem, plain)
    found = []
    for number, point in enumerate(points):
        at_zero = starts[number]
        with np.errstate(all="ignore"):  # a law of the user's own may diverge
            D = (responses[number * count : (number + 1) * count] - at_zero) / probe[:, np.newaxis]
            norms = np.linalg.norm(D, axis=1)
        if not (np.isfinite(norms).all() and np.isfinite(at_zero).all()):
            continue
        outside = tangent.outside(np.vstack([D, at_zero]))
        norms = np.linalg.norm(outside[:-1], axis=1)
        norms[norms == 0.0] = 1.0
        best = -np.linalg.lstsq((outside[:-1] / norms[:, np.newaxis]).T, outside[-1], rcond=1e-9)[0] / norms
        for share in SHARES:
            chosen = point.copy()
            chosen[strengths] = np.clip(share * best, lower[strengths], upper[strengths])
            found.append(chosen)
        for size in DRY_SIZES if dry else ():
            chosen = point.copy()
            chosen[strengths] = np.clip(size * problem.sizes[strengths], lower[strengths], upper[strengths])
            found.append(chosen)
    return np.array(found) if found else points


def refined(
    problem: Problem,
    minimum: Minimum[Residual],
    evaluations: int,
    tolerance: float,
    effects: Sequence[int] | None = None,
) -> Minimum[Residual]:
    """Search the shape parameters on which the output depends by jumps: scan, descend, scan closer.

    Those of all effects by default, or of some by their positions.
    """
    lower, upper = problem.bounds
    for place, grid in _jumping(problem, range(len(problem.choices)) if effects is None else effects):
        low, high = _neighbours(grid, minimum.x[place])
        for _ in range(REFINEMENTS):
            values = np.clip(np.linspace(low, high, REFINED_POINTS), lower[place], upper[place])
            points = np.tile(minimum.x, (REFINED_POINTS, 1))
            points[:, place] = values
            errors = Tangent(problem, minimum.x).outside(in_lanes(problem, points))
            costs = np.nan_to_num(np.einsum("ij,ij->i", errors, errors), nan=np.inf)
            trial = problem.descend_if_finite(points[int(np.argmin(costs))], evaluations, tolerance)
            minimum = trial if trial is not None and trial.cost < minimum.cost else minimum
            width = 1.5 * (high - low) / (REFINED_POINTS - 1)
            low, high = minimum.x[place] - width, minimum.x[place] + width
    return minimum


def _jumping(problem: Problem, effects: Sequence[int]) -> list[tuple[int, list[float]]]:
    """Return the shape parameters on which the output depends by jumps, with their grids."""
    found = []
    for i in effects:
        choice, place = problem.choices[i], problem.effect_places[i]
        if jumps(problem.choices, i):
            grids = shape_values(problem, i)
            found += [(place.start + j, grid) for j, grid in zip(choice.form.shapes, grids, strict=True)]
    return [item for item in found if len(item[1]) > 1]


def _neighbours(grid: list[float], value: float) -> tuple[float, float]:
    """Return the points of a grid on either side of a value."""
    below = [point for point in grid if point < 0.999 * value]
    above = [point for point in grid if point > 1.001 * value]
    return below[-1] if below else 0.5 * value, above[0] if above else 2.0 * value
