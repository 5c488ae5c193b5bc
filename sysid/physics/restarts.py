"""Searches for the parameters of a physical model from several starts, until two agree."""

from collections.abc import Callable

import numpy as np

from sysid.errors import ModelError
from sysid.linear.forms import Floats
from sysid.linear.reduction import Segment
from sysid.physics.matching import matched_points
from sysid.physics.problem import Problem
from sysid.physics.starts import draw_widths, starting_points
from sysid.separable.descent import Minimum, Residual, Status, levenberg_marquardt

RANKING_ROWS = 2_000
SCREENING_ROWS = 10_000
SEARCHED_STARTS = 8
# Starts are drawn again, so many times in all, until two searches agree.
BATCHES = 4
MATCHED_STARTS = 4
SCREENING_EVALUATIONS = 80
EVALUATIONS = 300
# Two searches agree when their errors differ by less than this share ...
AGREEMENT = 1e-3
# ... and their outputs by less than this share of the error.
OUTPUT_AGREEMENT = 0.05
EXACT = 1e-9


def search_from_many(
    problem: Problem, progress: Callable[[int, int], None] | None = None
) -> tuple[Minimum[Residual], int, int]:
    """Search from the best of all starts; return the best end, how many agree with it, how many ran.

    Where no second search ends as the best one does, further batches of starts are drawn.
    """
    screening = problem.with_segments(_shortened(problem.segments, SCREENING_ROWS))
    ranking = problem.with_segments(_shortened(problem.segments, RANKING_ROWS))
    count = len(problem.names)
    # Start values that ring faster than half the sampling rate are meant so; others should not get there.
    meant = problem.folded(problem.coordinates(problem.simulator.values()))
    ends: list[Minimum[Residual]] = []
    folded: list[Minimum[Residual]] = []
    for batch in range(BATCHES):
        starts = _starts(ranking, screening, batch)
        for number, (coordinates, states) in enumerate(starts):
            screening.use_steps(None)
            point = screening.point(coordinates, _all_states(screening, states))
            if point is not None:
                end = descend(screening, point, SCREENING_EVALUATIONS)
                (ends if meant or not screening.folded(end.x) else folded).append(end)
            if progress is not None and batch == 0:  # what comes after is the exception
                progress(number + 1, len(starts) + 1)
        ends = ends or folded
        if not ends:
            raise ModelError(
                f"model {problem.model.name!r} diverges from every start: give start values nearer to the "
                "plant's"
            )
        ends.sort(key=lambda end: end.cost)
        if ends[0].status is Status.MAX_EVALUATIONS:
            ends[0] = descend(screening, ends[0].x, EVALUATIONS)
        best = ends[0]
        agreeing = 1 + sum(_same(best, end, screening) for end in ends[1:])
        if agreeing > 1:
            break
    if screening.n_rows < problem.n_rows:
        problem.use_steps(screening.simulator.substeps)
        point = problem.point(best.x[:count], _all_states(problem, screening.states_of(best.x)))
        if point is None:
            raise ModelError(
                f"model {problem.model.name!r} fits the first {screening.n_rows} rows and diverges later: "
                "give start values nearer to the plant's"
            )
        best = descend(problem, point, EVALUATIONS)
    else:
        problem.use_steps(screening.simulator.substeps)
        best = descend(problem, best.x, EVALUATIONS)
    return best, agreeing, len(ends)


def _starts(problem: Problem, screening: Problem, batch: int) -> list[tuple[Floats, Floats]]:
    """Return parameters and initial states from which to search.

    Where parameters are not known, the first come from a linear model that was identified before
    (`sysid.physics.matching`).  A free response from far away can hide what the input does, so where
    initial states are estimated too, half of the others come from runs at rest.
    """
    count = len(problem.names)
    found = [(p[:count], problem.states_of(p)) for p in starting_points(problem, SEARCHED_STARTS, batch)]
    if all(parameter.status == "uncertain" for parameter in problem.parameters):
        return found
    matched = _matched(screening) if batch == 0 else []
    if not problem.free_start:
        return matched + found[: SEARCHED_STARTS - len(matched)]
    at_rest = problem.at_rest()
    forced = [
        (p[:count], at_rest.states_of(p)) for p in starting_points(at_rest, SEARCHED_STARTS // 2, batch)
    ]
    return (matched + forced + found)[:SEARCHED_STARTS]


def _matched(problem: Problem) -> list[tuple[Floats, Floats]]:
    """Return starts with the transfer function of an identified model, each with its initial states."""
    problem.use_steps(None)
    centre = problem.coordinates(problem.simulator.values())
    points = matched_points(problem.of_output(0), centre, draw_widths(problem, centre), MATCHED_STARTS)
    placed = [problem.point(point) for point in points]
    return [(p[: centre.size], problem.states_of(p)) for p in placed if p is not None]


def _all_states(problem: Problem, known: Floats) -> Floats:
    missing = len(problem.segments) - known.shape[0]
    return np.vstack([known, np.tile(problem.simulator.rest(), (missing, 1))])


def descend(problem: Problem, point: Floats, evaluations: int) -> Minimum[Residual]:
    """Search from a point, within the bounds."""
    lower, upper = problem.bounds()
    with np.errstate(all="ignore"):
        return levenberg_marquardt(
            problem.residual,
            problem.jacobian,
            np.clip(point, lower, upper),
            bounds=(lower, upper),
            max_evaluations=evaluations,
        )


def _same(best: Minimum[Residual], end: Minimum[Residual], problem: Problem) -> bool:
    """Tell whether two searches ended at the same error with the same output."""
    floor = EXACT * np.sqrt(sum(float(np.sum((s.y * problem.weights) ** 2)) for s in problem.segments))
    error, other = np.sqrt(best.cost), np.sqrt(end.cost)
    apart = float(np.linalg.norm(end.point.residual - best.point.residual))
    return bool(
        other <= error * (1.0 + AGREEMENT) + floor and apart <= OUTPUT_AGREEMENT * error + 2.0 * floor
    )


def agreement(agreeing: int, tried: int) -> str:
    """Say whether searches agree."""
    if agreeing > 1:
        return f"{agreeing} of {tried} searches from different starts agree in error and output"
    return (
        f"{tried} searches from different starts disagree: the error has local minima, "
        "so give start values nearer to the plant's"
    )


def _shortened(segments: tuple[Segment, ...], rows: int) -> tuple[Segment, ...]:
    """Return the first experiments and rows, so many in all."""
    chosen: list[Segment] = []
    left = rows
    for segment in segments:
        if left <= 0:
            break
        count = int(segment.used.sum())
        chosen.append(segment if count <= left else segment.shortened(left))
        left -= count
    return tuple(chosen)
