"""Search for the parameters of a new effect: grid of its shapes, all else refitted at each point."""

from collections.abc import Iterable
from itertools import product

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.levenberg import Minimum, minimise
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.linear.starts import with_regressed_coefficients
from sysid.diagnosis.structures.structure import Effort

# A grid of two shapes is searched whole up to this size, beyond it one shape after the other.
LARGEST_PRODUCT = 50
# Iterations at each point of the grid, enough to rank them, and from the best ones for a ranking or an end.
GRID_ITERATIONS, COARSE_ITERATIONS, FINE_ITERATIONS = 3, 8, 40
# A start from a regression helps if it lowers the cost to this share.
MUCH_BETTER = 0.8
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


class EffectSearch:
    """Search over the shapes of the last effect of a chain.

    Parameters
    ----------
    chain : Chain
    data : Data
    noise : ndarray
    starts : sequence of ndarray
        Values of the parameters before those of the new effect; each is tried.
    """

    def __init__(self, chain: Chain, data: Data, noise: Floats, starts: Iterable[Floats]) -> None:
        self.chain, self.data, self.noise = chain, data, noise
        self.starts = list(starts)
        self.place = chain.places(data)[-1]
        self.form = chain.choices[-1].form
        self.shapes = np.array(self.form.shapes, dtype=np.intp) + self.place.start
        size = chain.size(data)
        self.others = np.ones(size, dtype=bool)
        self.others[self.shapes] = False
        grids = self.form.starts(data.u, data.y[data.used], data.period)
        lower, upper = chain.bounds(data)
        self.grids = [
            np.unique(np.clip(g, lower[i], upper[i])) for g, i in zip(grids, self.shapes, strict=True)
        ]
        self.found: dict[tuple[float, ...], Minimum] = {}

    def search(self, effort: Effort, near: Floats | None = None) -> list[Minimum]:
        """Return minima, best first; ``near`` are shapes worth trying besides the grid."""
        if not self.grids:
            points = [self.joined(start, ()) for start in self.starts]
            if self.chain.choices[-1].effect.port == "output":
                regressed = with_regressed_coefficients(self.chain, self.data, points[0])
                points += [] if regressed is None else [regressed]
            return _ranked([self._minimise(point, effort) for point in points])
        if near is not None:
            self._at(tuple(near))
        for shapes in self.grid_points():
            self._at(shapes)
        self._with_regression()
        if len(self.grids) > 1 and np.prod([g.size for g in self.grids]) > LARGEST_PRODUCT:
            self._one_by_one()
        leaders = self._leaders(1 + 2 * effort if self.form.smooth else 1 + effort)
        if not self.form.smooth:
            leaders = [self._narrowed(leader, effort) for leader in leaders]
            return _ranked(leaders)
        return _ranked([self._minimise(leader.point, effort) for leader in leaders])

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
        if start.size == self.place.stop:
            whole = start.copy()
            whole[self.shapes] = shapes
            return whole
        own = np.zeros(self.place.stop - self.place.start)
        own[self.shapes - self.place.start] = shapes
        return np.concatenate([start, own])

    def _at(self, shapes: tuple[float, ...], iterations: int = GRID_ITERATIONS) -> Minimum | None:
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
        end = minimise(self.chain, self.data, start, self.noise, free=self.others, iterations=iterations)
        if end is not None:
            self.found[shapes] = end
        return end

    def _with_regression(self) -> None:
        """Try starts from an equation-error regression where they help at some points of the grid.

        With a strong effect the model without it is so far off that a search from it ends elsewhere.
        """
        ranked = sorted(self.found, key=lambda shapes: self.found[shapes].cost)
        if not ranked or self.chain.choices[-1].effect.port not in ("input", "output"):
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
        end = minimise(self.chain, self.data, start, self.noise, free=self.others, iterations=GRID_ITERATIONS)
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

    def _narrowed(self, leader: Minimum, effort: Effort) -> Minimum:
        """Narrow each shape down by golden sections between its neighbours on the grid.

        For maps that jump: the cost is piecewise constant in the shape, so a slope says nothing.
        """
        best, rounds = leader, (1 if len(self.grids) == 1 else 2)
        steps = 8 if effort < 2 else 14
        for _ in range(rounds):
            for i, grid in enumerate(self.grids):
                centre = best.point[self.shapes]
                place = int(np.searchsorted(grid, centre[i]))
                low = grid[max(place - 1, 0)]
                high = grid[min(place + 1, grid.size - 1)]
                best = self._golden(best, i, float(low), float(high), steps)
                # The cost has small steps of its own: look once more around the best.
                for part in (0.12, 0.015) if effort is Effort.FINE else ():
                    middle, reach = float(best.point[self.shapes[i]]), part * float(high - low)
                    best = self._golden(
                        best, i, max(middle - reach, float(grid[0])), middle + reach, steps // 2
                    )
        done = minimise(
            self.chain, self.data, best.point, self.noise, free=self.others,
            iterations=FINE_ITERATIONS if effort is Effort.FINE else COARSE_ITERATIONS,
        )  # fmt: skip
        return done if done is not None else best

    def _golden(self, best: Minimum, i: int, low: float, high: float, steps: int) -> Minimum:
        def at(value: float) -> float:
            nonlocal best
            point = best.point.copy()
            point[self.shapes[i]] = value
            end = minimise(
                self.chain, self.data, point, self.noise, free=self.others, iterations=GRID_ITERATIONS
            )
            if end is not None and end.cost < best.cost:
                best = end
            return np.inf if end is None else end.cost

        left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        at_left, at_right = at(left), at(right)
        for _ in range(steps):
            if at_left < at_right:
                high, right, at_right = right, left, at_left
                left = high - GOLDEN * (high - low)
                at_left = at(left)
            else:
                low, left, at_left = left, right, at_right
                right = low + GOLDEN * (high - low)
                at_right = at(right)
        return best


def _ranked(minima: Iterable[Minimum | None]) -> list[Minimum]:
    return sorted((m for m in minima if m is not None), key=lambda m: m.cost)
