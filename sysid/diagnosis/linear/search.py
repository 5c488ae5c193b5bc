"""Search for the parameters of a new effect: grid of its shapes, all else refitted at each point."""

from collections.abc import Callable, Iterable, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.lengthening import lengthened
from sysid.diagnosis.linear.levenberg import Minimum, minimise
from sysid.diagnosis.linear.narrowing import Narrowing
from sysid.diagnosis.linear.restarts import AGREEMENT
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.linear.starts import with_regressed_coefficients
from sysid.diagnosis.structures.structure import Effort
from sysid.diagnosis.structures.thresholds import jumps

# A grid of two shapes is searched whole up to this size, beyond it one shape after the other.
LARGEST_PRODUCT = 50
# Iterations at each point of the grid, enough to rank them, and from the best ones for a ranking or an end.
GRID_ITERATIONS, COARSE_ITERATIONS, FINE_ITERATIONS = 3, 8, 40
# Of the cost: fits on the grid are compared and gone on from, what is below this share decides nothing.
GRID_TOLERANCE = 1e-4
# A start from a regression helps if it lowers the cost to this share.
MUCH_BETTER = 0.8
# Golden sections between two neighbours of a point of the grid.
COARSE_SECTIONS, FINE_SECTIONS = 8, 14
# A leader whose cost exceeds the best one by this factor after a first search has lost.
FAR = 1.1


# The best fit of all else at shapes that were tried.
Found = dict[tuple[float, ...], Minimum]


class Grid(NamedTuple):
    """What was found on the grid of an effect, and the starts of its search."""

    starts: list[Floats]
    found: Found


class EffectSearch:
    """Search over the shapes of one effect of a chain.

    Parameters
    ----------
    chain : Chain
    data : Data
    noise : ndarray
    starts : sequence of ndarray
        Points of the chain, with or without the parameters of the effect; each is tried.
    found : dict, optional
        What a search of the same kind has found on the grid.
    which : int
        Place of the effect among those of the chain; the last one by default.
    """

    def __init__(
        self,
        chain: Chain,
        data: Data,
        noise: Floats,
        starts: Iterable[Floats],
        found: Found | None = None,
        which: int = -1,
    ) -> None:
        self.chain, self.data, self.noise = chain, data, noise
        self.starts = list(starts)
        self.which = which % len(chain.choices)
        self.place, self.choice = chain.places(data)[which], chain.choices[which]
        self.form = self.choice.form
        self.smooth = not jumps(chain.choices, self.which)
        self.shapes = np.array(self.form.shapes, dtype=np.intp) + self.place.start
        size = chain.size(data)
        self.others = np.ones(size, dtype=bool)
        self.others[self.shapes] = False
        lower, upper = chain.bounds(data)
        tried = [data.tried(p.grid) for p in self.form.parameters if p.grid is not None]
        self.grids = [
            np.unique(np.clip(values, lower[i], upper[i]))
            for values, i in zip(tried, self.shapes, strict=True)
        ]
        self.found: Found = {} if found is None else dict(found)

    def searched(self) -> Grid:
        """Search the grid, if the effect has one, and return what there is."""
        if self.grids:
            self._search_grid()
        return Grid(self.starts, self.found)

    def search(self, effort: Effort) -> list[Minimum]:
        """Return minima, best first."""
        ends = self._ends(effort)
        if effort is Effort.FINE and self.chain.drives and not agree(ends):
            again = lengthened(self.chain, self.data, ends[0].point, self.noise, FINE_ITERATIONS)
            ends = ranked([*ends, again])
        return ends

    def _ends(self, effort: Effort) -> list[Minimum]:
        """Return where the searches from the best starts end, the best first."""
        if not self.grids:
            points = [self.joined(start, ()) for start in self.starts]
            if self.choice.effect.port == "output":
                regressed = with_regressed_coefficients(self.chain, self.data, points[0])
                points += [] if regressed is None else [regressed]
            return ranked([self._minimise(point, effort) for point in points])
        if not self.found:
            self._search_grid()
        leaders = self._leaders(1 + 2 * effort if self.smooth else 1 + effort)
        if not self.smooth:
            return self._narrowed(leaders, effort)
        return self._descended(leaders, effort)

    def _search_grid(self) -> None:
        for shapes in self.grid_points():
            self._at(shapes)
        self._with_regression()
        if len(self.grids) > 1 and np.prod([g.size for g in self.grids]) > LARGEST_PRODUCT:
            self._one_by_one()

    def grid_points(self) -> list[tuple[float, ...]]:
        """Return the points of the grid, of two shapes only the diagonal if the whole is too large."""
        if not self.grids or np.prod([g.size for g in self.grids]) <= LARGEST_PRODUCT:
            return list(product(*self.grids))
        return list(zip(*self.grids, strict=False))

    def _minimise(self, point: Floats, effort: Effort) -> Minimum | None:
        iterations = FINE_ITERATIONS if effort is Effort.FINE else COARSE_ITERATIONS
        return minimise(self.chain, self.data, point, self.noise, iterations=iterations)

    def joined(self, start: Floats, shapes: tuple[float, ...]) -> Floats:
        """Return a point with these shapes; strengths of zero unless the start says more."""
        if start.size == self.others.size:
            whole = start.copy()
            whole[self.shapes] = shapes
            return whole
        own = np.zeros(self.place.stop - self.place.start)
        own[self.shapes - self.place.start] = shapes
        return np.concatenate([start[: self.place.start], own, start[self.place.start :]])

    def _at(self, shapes: tuple[float, ...]) -> Minimum | None:
        """Fit all but the shapes, from the best known start; remember the result."""
        if shapes in self.found:
            return self.found[shapes]
        points = [self.joined(start, shapes) for start in self.starts]
        if self.found:
            nearest = min(self.found, key=lambda other: self._distance(other, shapes))
            moved = self.found[nearest].point.copy()
            moved[self.shapes] = shapes
            points.append(moved)
        start = self._better(points)
        if start is None:
            return None
        end = self._with_shapes_held(start)
        if end is not None:
            self.found[shapes] = end
        return end

    def _with_shapes_held(self, start: Floats) -> Minimum | None:
        """Minimise over all but the shapes, as far as a comparison needs."""
        return minimise(
            self.chain, self.data, start, self.noise, free=self.others,
            iterations=GRID_ITERATIONS, tolerance=GRID_TOLERANCE,
        )  # fmt: skip

    def _with_regression(self) -> None:
        """Try starts from an equation-error regression where they help at some points of the grid.

        With a strong effect the model without it is so far off that a search from it ends elsewhere.
        """
        ranked = sorted(self.found, key=lambda shapes: self.found[shapes].cost)
        if not ranked or self.choice.effect.port not in ("input", "output"):
            return
        helped = False
        for shapes in {ranked[0], ranked[len(ranked) // 2], ranked[-1]}:
            helped |= self._regressed_at(shapes)
        for shapes in ranked if helped else ():
            self._regressed_at(shapes)

    def _regressed_at(self, shapes: tuple[float, ...]) -> bool:
        """Search from the regression at a point of the grid; tell whether it found something much better."""
        before = self.found[shapes]
        start = with_regressed_coefficients(self.chain, self.data, before.point)
        if start is None:
            return False
        end = self._with_shapes_held(start)
        if end is None or end.cost >= before.cost:
            return False
        self.found[shapes] = end
        return end.cost < MUCH_BETTER * before.cost

    def _better(self, points: list[Floats]) -> Floats | None:
        """Return the point of least cost as it is; None if all diverge."""
        if len(points) == 1:
            return points[0]
        best, least = None, np.inf
        for point in points:
            run = self.chain.run(self.data, point)
            if run is not None:
                error = self.chain.error(self.data, run, self.noise)
                cost = float(error @ error)
                if cost < least:
                    best, least = point, cost
        return best

    def _distance(self, a: tuple[float, ...], b: tuple[float, ...]) -> float:
        spans = [float(np.ptp(grid)) or 1.0 for grid in self.grids]
        return sum(abs(p - q) / span for p, q, span in zip(a, b, spans, strict=True))

    def _one_by_one(self) -> None:
        """Search one shape after the other, from the diagonal of the grid."""
        for _ in range(2):
            for i, grid in enumerate(self.grids):
                best = self._leaders(1)
                if not best:
                    return
                centre = best[0].point[self.shapes]
                for value in grid:
                    shapes = centre.copy()
                    shapes[i] = value
                    self._at(tuple(shapes.tolist()))

    def _leaders(self, count: int) -> list[Minimum]:
        """Return the best points of the grid that are not neighbours of a better one."""
        leaders: list[tuple[tuple[float, ...], Minimum]] = []
        for shapes, minimum in sorted(self.found.items(), key=lambda item: item[1].cost):
            if all(not self._neighbours(shapes, other) for other, _ in leaders):
                leaders.append((shapes, minimum))
            if len(leaders) == count:
                break
        return [minimum for _, minimum in leaders]

    def _neighbours(self, a: tuple[float, ...], b: tuple[float, ...]) -> bool:
        places = zip(self.grids, a, b, strict=True)
        return all(abs(int(np.searchsorted(g, p)) - int(np.searchsorted(g, q))) <= 1 for g, p, q in places)

    def _descended(self, leaders: list[Minimum], effort: Effort) -> list[Minimum]:
        """Search over all from the leaders of the grid."""
        ends: list[Minimum] = []
        for leader in leaders:
            end = self._minimise(leader.point, Effort.COARSE)
            near = end is not None and (not ends or end.cost <= FAR * ends[0].cost)
            if end is not None and near and effort is Effort.FINE and not end.converged:
                end = self._minimise(end.point, effort) or end
            ends = ranked([*ends, end])
        return ends

    def _narrowed(self, leaders: list[Minimum], effort: Effort) -> list[Minimum]:
        """Narrow down the shapes of a map that jumps around the leaders of the grid."""
        ends: list[Minimum] = []
        fine = effort is Effort.FINE
        levels = self._levels(leaders) if fine else np.empty(0)
        for leader in leaders:
            narrowing = Narrowing(
                leader, self.shapes, self.grids, self._with_shapes_held, self._cells(leader.point)
            )
            for number in range(1 if len(self.grids) == 1 else 2):
                if number and ends and narrowing.best.cost > FAR * ends[0].cost:
                    break  # what is left to narrow down brings it nowhere near the best
                narrowing.sweep(FINE_SECTIONS if fine else COARSE_SECTIONS, fine)
            if fine and levels.size:
                narrowing.walk(levels)
            done = minimise(
                self.chain, self.data, narrowing.best.point, self.noise, free=self.others,
                iterations=FINE_ITERATIONS if fine else COARSE_ITERATIONS,
            )  # fmt: skip
            ends = ranked([*ends, narrowing.best if done is None else done])
        return ends

    def _levels(self, leaders: list[Minimum]) -> Floats:
        """Return the sizes that a jumping map of the input is given, in rising order; none of other maps."""
        if self.choice.effect.port != "input" or not leaders:
            return np.empty(0)
        return np.unique(np.abs(self._before(leaders[0].point)))

    def _before(self, point: Floats) -> Floats:
        """Return what the effect is given, where that is a map of the input."""
        chain = self.chain
        plain = Chain(chain.order, chain.choices[: self.which], chain.constant, chain.free_start)
        return plain.mapped(self.data, point)

    def _cells(self, point: Floats) -> Callable[[Floats], bytes | None]:
        """Return what tells the cell of a map of the input: what it makes of it under given strengths."""
        apply = self.form.apply
        if self.choice.effect.port != "input" or apply is None:
            return lambda point: None
        before = self._before(point)
        # With a strength of zero no shape would tell, nor with one at which a map does as it does elsewhere.
        strengths = np.where(point == 0.0, 0.5, point)

        def cell(point: Floats) -> bytes:
            own = np.where(self.others, strengths, point)[self.place]
            return self.data.by_experiment(apply, before, own).tobytes()

        return cell


def agree(ends: Sequence[Minimum]) -> bool:
    """Tell whether no other end than the best, first in the list, was found, or another as good."""
    return len(ends) < 2 or ends[1].cost <= ends[0].cost * (1.0 + AGREEMENT)


def ranked(minima: Iterable[Minimum | None]) -> list[Minimum]:
    """Return the minima that there are, best first."""
    return sorted((m for m in minima if m is not None), key=lambda m: m.cost)


def with_map_before(
    chain: Chain, data: Data, noise: Floats, which: int, ends: list[Minimum], effort: Effort
) -> list[Minimum]:
    """Return ends of a search, best first, with those where a map before it is searched anew beside it.

    What has strengths alone is searched from where the map before it stands: a dead zone before a jump is at
    first as wide as both of them together make it, and from there the jump shows nothing.
    """
    choices = chain.choices
    if choices[which].effect.port != "input" or choices[which].form.shapes:
        return ends
    before = [i for i, c in enumerate(choices[:which]) if c.effect.port == "input" and c.form.shapes]
    if not before:
        return ends
    search = EffectSearch(chain, data, noise, [ends[0].point], which=before[-1])
    return ranked([*ends, *search.search(Effort.COARSE if search.smooth else effort)])
