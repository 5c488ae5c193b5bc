"""Search for a Wiener-Hammerstein model: from many starts on few rows to one on all of them."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sysid.errors import IdentifiabilityError
from sysid.lft.between_samples import HALF_LENGTH
from sysid.lft.wiener_hammerstein.model import WienerHammerstein
from sysid.lft.wiener_hammerstein.reduction import Point, Problem
from sysid.lft.wiener_hammerstein.starts import with_knots
from sysid.linear.forms import Floats
from sysid.linear.reduction import Segment
from sysid.linear.restarts import shortened
from sysid.separable.descent import Minimum, descend

SCREENING_ROWS = 8_000
LEADING_ROWS = 20_000
SCREENING_INTERVALS, LEADING_INTERVALS = 12, 24
SEARCHED_STARTS = 12
LEADING = 3
SCREENING_EVALUATIONS = 25
EVALUATIONS = 80
# A search stops when its next step is below this share of a standard error.
COARSE_STEP, FINE_STEP = 0.03, 1e-3
# Two searches agree when their errors differ by less than this share: knots follow the range of the map's
# input, so that the same minimum comes with slightly different maps.
AGREEMENT = 5e-2
LARGEST_REFLECTION = 1.0 - 1e-6
ROUNDS = 2


@dataclass(frozen=True)
class Found:
    """Where a search ended.

    Attributes
    ----------
    model : WienerHammerstein
    problem : Problem
    minimum : Minimum
    """

    model: WienerHammerstein
    problem: Problem
    minimum: Minimum[Point]

    @property
    def rms(self) -> float:
        """Root mean square of the residual."""
        return float(np.sqrt(self.minimum.cost / self.problem.n_rows))


@dataclass(frozen=True)
class Screening:
    """The best model of a multi-start on few rows, and whether others ended there.

    A model that was given has no searches.
    """

    model: WienerHammerstein
    n_searches: int
    agree: bool


def screen(
    segments: tuple[Segment, ...],
    starts: list[WienerHammerstein],
    progress: Callable[[int, int], None] | None = None,
) -> Screening:
    """Search from the best starts on few rows, then from the best ends on more."""
    few, more = shortened(segments, SCREENING_ROWS), shortened(segments, LEADING_ROWS)
    if not starts:
        raise IdentifiabilityError(
            "no allocation of the linear approximation's poles gives a model: choose higher orders"
        )
    ends = []
    starts = starts[:SEARCHED_STARTS]
    for count, start in enumerate(starts):
        ends.append(search(few, start, SCREENING_INTERVALS, COARSE_STEP, SCREENING_EVALUATIONS))
        if progress is not None:
            progress(count + 1, len(starts) + LEADING)
    ends.sort(key=lambda end: end.rms)
    leading = []
    for end in ends[:LEADING]:
        leading.append(search(more, end.model, LEADING_INTERVALS, COARSE_STEP))
        if progress is not None:
            progress(len(starts) + len(leading), len(starts) + LEADING)
    leading.sort(key=lambda end: end.rms)
    best = leading[0]
    near = [end for end in leading if end.rms <= (1.0 + AGREEMENT) * best.rms]
    return Screening(best.model, len(ends), len(near) > 1 or len(ends) == 1)


def refine(segments: tuple[Segment, ...], start: WienerHammerstein, intervals: int) -> Found:
    """Search on all rows to the last digit; the knots follow the range of the map's input."""
    found = search(segments, start, intervals, COARSE_STEP)
    for _ in range(ROUNDS - 1):
        found = search(segments, found.model, intervals, FINE_STEP)
    return found


def search(
    segments: tuple[Segment, ...],
    start: WienerHammerstein,
    intervals: int,
    smallest_step: float,
    max_evaluations: int = EVALUATIONS,
) -> Found:
    """Minimise the sum of squared simulation errors from one start.

    Reflection coefficients stay in a box, so that no iterate is unstable.
    """
    rows = _inner(segments, start.oversampling)
    problem = Problem(rows, with_knots(start, rows, intervals))
    bounds = _box(problem)
    freedom = max(problem.n_rows - problem.start.size - problem.n_basis, 1)
    energy = sum(float(s.y[s.used] @ s.y[s.used]) for s in rows)
    minimum = descend(
        lambda x: Point(problem, x),
        np.clip(problem.start, *bounds),
        bounds=bounds,
        tolerance=0.0,
        negligible=smallest_step**2 * problem.start.size / freedom,
        zero=1e-24 * energy,
        max_evaluations=max_evaluations,
    )
    return Found(minimum.point.model, problem, minimum)


def _inner(segments: tuple[Segment, ...], oversampling: int) -> tuple[Segment, ...]:
    """Leave out the last rows of each experiment: a map between samples would need later inputs there."""
    if oversampling == 1:
        return segments
    found = []
    for segment in segments:
        used = segment.used.copy()
        used[max(used.size - 2 * HALF_LENGTH, 0) :] = False
        found.append(replace(segment, used=used))
    return tuple(found)


def _box(problem: Problem) -> tuple[Floats, Floats]:
    n1, n2 = problem.template.orders
    upper = np.full(problem.free.size, np.inf)
    upper[:n1] = LARGEST_REFLECTION
    upper[2 * n1 + 1 : 2 * n1 + 1 + n2] = LARGEST_REFLECTION
    free = upper[problem.free]
    return -free, free
