"""Where searches start: random draws around what is known, drawn closer around the best."""

import numpy as np

from sysid.linear.forms import Floats
from sysid.physics.problem import Problem
from sysid.separable.descent import levenberg_marquardt

# Spread of the logarithm of a positive parameter, or share of the size of another.
UNKNOWN, UNCERTAIN = 7.0, 0.3
LINEAR_UNKNOWN = 10.0
ROUNDS = (1.0, 0.3, 0.1)
DRAWS = 80
FEW_DRAWS = 16
SURVIVORS = 12
FIRST_EVALUATIONS = 12
SEED = 20_240

Draw = tuple[float, Floats]


def starting_points(problem: Problem, count: int, batch: int = 0) -> list[Floats]:
    """Return starting points that differ, the best first; other draws for each batch.

    Draws lie around the start values, wide for free parameters and near for uncertain ones; each
    round draws around the best so far, closer.  Where little is known, a low error often marks a
    simpler model that the search cannot leave, so the ranking is that after a few steps from many
    places, the given start values and the best of the first round among them.  The draws are the same
    in every call.
    """
    generator = np.random.default_rng(SEED + batch)
    low, high = (bound[: len(problem.names)] for bound in problem.bounds())
    centre = np.clip(problem.coordinates(problem.simulator.values()), low, high)
    width = draw_widths(problem, centre)
    near = all(parameter.status == "uncertain" for parameter in problem.parameters)
    found: list[Draw] = []
    _add(problem, found, centre)
    given = found.copy()
    elsewhere = problem.folded(centre)  # start values that ring so fast are meant so
    for share in ROUNDS[:1] if near else ROUNDS:
        centres = [point for _, point in found[:SURVIVORS]] if share < 1.0 and found else [centre]
        for number in range(FEW_DRAWS if near else DRAWS):
            base = centres[number % len(centres)][: centre.size]
            draw = base + share * width * generator.uniform(-1.0, 1.0, centre.size)
            draw = np.clip(draw, low, high)
            if elsewhere or not problem.folded(draw):
                _add(problem, found, draw)
        found.sort(key=_cost)
        if share == 1.0:
            given += [(cost, point) for cost, point in found[:SURVIVORS]]
    if near:
        return _distinct(found, width, count)
    chosen = [*given, *((np.inf, point) for point in _distinct(found, width, SURVIVORS))]
    advanced = sorted((_advanced(problem, point) for _, point in chosen), key=_cost)
    return _distinct(advanced, width, count)


def _cost(draw: Draw) -> float:
    return draw[0]


def _advanced(problem: Problem, point: Floats) -> Draw:
    """Return where a few steps of the search lead."""
    problem.use_steps(None)
    lower, upper = problem.bounds()
    with np.errstate(all="ignore"):
        end = levenberg_marquardt(
            problem.residual,
            problem.jacobian,
            np.clip(point, lower, upper),
            bounds=(lower, upper),
            max_evaluations=FIRST_EVALUATIONS,
        )
    return end.cost, end.x


def draw_widths(problem: Problem, centre: Floats) -> Floats:
    """Return how far draws may lie from the start values, in search coordinates.

    Three standard deviations where there is a prior.
    """
    size = np.maximum(np.abs(centre), 1.0)
    widths = []
    for parameter, positive, scale in zip(problem.parameters, problem.positive, size, strict=True):
        known = parameter.status == "uncertain"
        if parameter.prior is not None:
            share = 3.0 * parameter.prior.std
            widths.append(min(share / parameter.start, UNKNOWN) if positive else share)
        elif positive:
            widths.append(UNCERTAIN if known else UNKNOWN)
        else:
            widths.append((UNCERTAIN if known else LINEAR_UNKNOWN) * scale)
    return np.array(widths)


def _add(problem: Problem, found: list[Draw], coordinates: Floats) -> None:
    problem.use_steps(None)
    point = problem.point(coordinates)
    if point is not None:
        residual = problem.residual(point)
        found.append((float(residual @ residual), point))


def _distinct(found: list[Draw], width: Floats, count: int) -> list[Floats]:
    """Choose the best points that are not close to a better one."""
    chosen: list[Floats] = []
    for distance in (0.15, 0.03):
        for _, point in found:
            if len(chosen) < count and all(
                np.abs((point - other)[: width.size] / width).max(initial=0.0) > distance for other in chosen
            ):
                chosen.append(point)
    return chosen
