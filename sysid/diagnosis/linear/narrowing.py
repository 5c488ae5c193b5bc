"""Golden sections for shapes of maps that jump, where a slope says nothing."""

from collections.abc import Callable, Sequence

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.levenberg import Minimum

GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
# The cost has small steps of its own: it is looked at once more around the best, in these parts of the range.
CLOSER = (0.12, 0.015)
# Of the values between which a threshold moves in vain, so many on either side are tried at a time.
NEIGHBOURS, MOST_WALKS = 3, 12
# So many values are looked at until these are found.
FARTHEST = 40


class Narrowing:
    """The search for the shapes of a map between the neighbours of a leader on the grid.

    Parameters
    ----------
    leader : Minimum
    shapes : ndarray of int
        Places of the shapes in a point.
    grids : sequence of ndarray
        Values of each shape that were tried.
    fit : callable
        Fits all but the shapes from a point, as far as a comparison needs.
    cell : callable
        What the map does under the shapes of a point: a threshold moves between two samples in vain.
        None where that cannot be told without a fit.
    """

    def __init__(
        self,
        leader: Minimum,
        shapes: np.ndarray,
        grids: Sequence[Floats],
        fit: Callable[[Floats], Minimum | None],
        cell: Callable[[Floats], bytes | None],
    ) -> None:
        self.best = leader
        self.shapes, self.grids = shapes, grids
        self.fit, self.cell = fit, cell
        self.seen: dict[bytes, float] = {}

    def sweep(self, steps: int, closer: bool) -> None:
        """Narrow down one shape after the other by golden sections, if asked to with closer looks."""
        for i, grid in enumerate(self.grids):
            place = int(np.searchsorted(grid, self.best.point[self.shapes[i]]))
            low, high = float(grid[max(place - 1, 0)]), float(grid[min(place + 1, grid.size - 1)])
            self._golden(i, low, high, steps)
            for part in CLOSER if closer else ():
                middle, reach = float(self.best.point[self.shapes[i]]), part * (high - low)
                self._golden(i, max(middle - reach, float(grid[0])), middle + reach, steps // 2)

    def walk(self, levels: Floats) -> None:
        """Go on from cell to cell as long as one of the next ones is better.

        Parameters
        ----------
        levels : ndarray
            In rising order: between two of them a threshold moves in vain.
        """
        middles = 0.5 * (levels[1:] + levels[:-1])
        for _ in range(MOST_WALKS):
            before = self.best.cost
            for i in range(len(self.grids)):
                place = int(np.searchsorted(levels, self.best.point[self.shapes[i]])) - 1
                self._step(i, middles[max(place, 0) :])
                self._step(i, middles[: max(place, 0)][::-1])
            if self.best.cost >= before:
                return

    def _step(self, i: int, values: Floats) -> None:
        """Try a threshold in the next few cells on one side.

        A switch that holds passes most levels in vain: it is they at which it does turn that count.
        """
        point, tried = self.best.point.copy(), 0
        last = self.cell(point)
        for value in values[:FARTHEST].tolist():
            point[self.shapes[i]] = value
            cell = self.cell(point)
            if cell is not None and cell == last:
                continue
            last, tried = cell, tried + 1
            self._cost(i, value)
            if tried > NEIGHBOURS:
                return

    def _golden(self, i: int, low: float, high: float, steps: int) -> None:
        left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        at_left, at_right = self._cost(i, left), self._cost(i, right)
        for _ in range(steps):
            if at_left < at_right:
                high, right, at_right = right, left, at_left
                left = high - GOLDEN * (high - low)
                at_left = self._cost(i, left)
            else:
                low, left, at_left = left, right, at_right
                right = low + GOLDEN * (high - low)
                at_right = self._cost(i, right)

    def _cost(self, i: int, value: float) -> float:
        """Return the cost with a shape elsewhere, all else fitted from the best so far."""
        point = self.best.point.copy()
        point[self.shapes[i]] = value
        cell = self.cell(point)
        if cell is not None and cell in self.seen:
            return self.seen[cell]
        end = self.fit(point)
        cost = np.inf if end is None else end.cost
        if end is not None and cost < self.best.cost:
            self.best = end
        if cell is not None:
            self.seen[cell] = cost
        return cost
