"""Searches for a linear model from several starts, until two agree in error and output."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.linear.forms import Complexes, Floats, poles_of, reflections_from_poles, without_alternation
from sysid.linear.reduction import Reduction, Segment, Structure
from sysid.linear.search import Search, search_poles
from sysid.linear.starts import least_squares_poles, pole_grid, steiglitz_mcbride_poles
from sysid.linear.subspace import Run, subspace_poles

# Searches run on at most this many rows, starts are ranked on fewer; the best goes on to the whole record.
SCREENING_ROWS = 10_000
RANKING_ROWS = 5_000
SEARCHED_STARTS, MOST_STARTS = 4, 12
FIRST_EVALUATIONS = 13
LEADING = 2
COARSE_STEP = 0.03
# Two searches agree when their errors differ by less than this share ...
AGREEMENT = 1e-3
# ... and their outputs by less than this share of the error.
OUTPUT_AGREEMENT = 0.05
EXACT = 1e-10


@dataclass(frozen=True)
class Restarts:
    """The best end of several searches.

    Attributes
    ----------
    search : Search
    agreeing : int
        How many ended at its error with its output, itself included.
    tried : int
    """

    search: Search
    agreeing: int
    tried: int

    @property
    def sentence(self) -> str:
        """Whether the searches agree."""
        return agreement(self.agreeing, self.tried)


def agreement(agreeing: int, tried: int) -> str:
    """Say whether searches agree."""
    if agreeing > 1:
        return f"{agreeing} of {tried} searches from different starts agree in error and output"
    return (
        f"{tried} searches from different starts disagree: the error has local minima, "
        "so compare other orders"
    )


def search_from_many(
    segments: tuple[Segment, ...], structure: Structure, extra: Sequence[Complexes], step: float
) -> Restarts:
    """Search from the best of all starts.

    Where no two searches agree, the next best starts are searched, down to a bound.

    Parameters
    ----------
    segments : tuple of Segment
    structure : Structure
    extra : sequence of ndarray of complex
        Further poles from which to search, as many as the order or one or two fewer.
    step : float
        Share of a standard error below which a step is not worth taking.
    """
    screening = shortened(segments, SCREENING_ROWS)
    size = float(np.sqrt(sum(float(s.y @ s.y) for s in screening)))
    ranked = ranked_starts(shortened(segments, RANKING_ROWS), structure, extra)[:MOST_STARTS]
    searches: list[Search] = []
    leading: list[Search] = []
    for first in range(0, len(ranked), SEARCHED_STARTS):
        batch = ranked[first : first + SEARCHED_STARTS]
        short = [search_poles(screening, structure, start, COARSE_STEP, FIRST_EVALUATIONS) for start in batch]
        short.sort(key=lambda search: search.cost)
        ahead = [search_poles(screening, structure, s.reflections, step) for s in short[:LEADING]]
        mirrored = [without_alternation(poles_of(end.reflections)) for end in ahead]
        starts = [reflections_from_poles(poles) for poles in mirrored if poles is not None]
        leading += ahead + [search_poles(screening, structure, start, step) for start in starts]
        searches += short[LEADING:]
        leading.sort(key=lambda search: search.cost)
        ends = leading + searches
        cost, output = leading[0].cost, _output(screening, structure, leading[0])
        near = [end for end in ends[1:] if same_error(cost, end.cost, size)]
        agreeing = 1 + sum(same_output(output, _output(screening, structure, s), cost, size) for s in near)
        if agreeing > 1:
            break
    best = leading[0]
    if sum(s.y.size for s in screening) < sum(s.y.size for s in segments):
        best = search_poles(segments, structure, best.reflections, step)
    return Restarts(best, agreeing, len(ends))


def same_error(best: float, other: float, size: float) -> bool:
    """Tell whether two costs, sums of squared errors, belong to equal errors; size is that of the data."""
    return bool(np.sqrt(other) <= np.sqrt(best) * (1.0 + AGREEMENT) + EXACT * size)


def same_output(first: Floats, second: Floats, cost: float, size: float) -> bool:
    """Tell whether two outputs differ by far less than their error."""
    apart = float(np.linalg.norm(second - first))
    return bool(apart <= OUTPUT_AGREEMENT * np.sqrt(cost) + 2.0 * EXACT * size)


def _output(segments: tuple[Segment, ...], structure: Structure, search: Search) -> Floats:
    return Reduction(segments, structure, search.reflections).output(search.projection)


def best_search(segments: tuple[Segment, ...], structure: Structure) -> Search:
    """Return the best of all searches for a structure."""
    return search_from_many(segments, structure, (), COARSE_STEP).search


def first_cost(segments: tuple[Segment, ...], structure: Structure) -> float:
    """Return the sum of squared errors of the best start, before any search."""
    start = ranked_starts(shortened(segments, RANKING_ROWS), structure, ())[0]
    return Reduction(segments, structure, start).cost


def shortened(segments: tuple[Segment, ...], rows: int) -> tuple[Segment, ...]:
    """Return the first rows of each experiment, so many in all."""
    total = sum(int(segment.used.sum()) for segment in segments)
    if total <= rows:
        return segments
    share = rows / total
    return tuple(s.shortened(max(int(share * s.used.sum()), 1)) for s in segments)


def ranked_starts(
    segments: tuple[Segment, ...], structure: Structure, extra: Sequence[Complexes]
) -> list[Floats]:
    """Return starts that differ, the best first."""
    order = structure.order
    least_squares = least_squares_poles(segments, structure)
    candidates: list[Complexes] = [least_squares]
    candidates += steiglitz_mcbride_poles(segments, structure, least_squares)
    runs = [Run(segment.u, segment.y[:, np.newaxis], segment.used) for segment in segments]
    subspace = subspace_poles(runs, range(order, order + 1)).get(order, [])
    candidates += subspace
    for poles in subspace[:1]:
        candidates += steiglitz_mcbride_poles(segments, structure, poles)
    n_rows = max(segment.y.size for segment in segments)
    if order <= 2:
        candidates += pole_grid(order, n_rows)
    for poles in extra:
        missing = order - poles.size
        if missing == 0:
            candidates.append(poles)
        elif missing in (1, 2):
            candidates += [np.concatenate([poles, more]) for more in pole_grid(missing, n_rows)]
    costs: list[tuple[float, Floats]] = []
    for poles in candidates:
        start = reflections_from_poles(np.concatenate([poles, np.zeros(order - poles.size)]))
        cost = Reduction(segments, structure, start).cost
        if np.isfinite(cost):
            costs.append((cost, start))
    costs.sort(key=lambda pair: pair[0])
    distinct: list[Floats] = []
    for _, start in costs:
        if all(np.abs(start - other).max() > 1e-3 for other in distinct):
            distinct.append(start)
    return distinct
