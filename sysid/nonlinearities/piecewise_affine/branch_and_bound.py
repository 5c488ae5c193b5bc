"""Two modes in the plane, exactly and for many points: branch and bound over all lines.

A cell is a range of directions and distances of a line.  Points that all its lines have on the same side
give a lower bound, for squares of residuals only grow as points join a mode; the others are passed on to
the halves of the cell.  A cell of few such points is settled by turning a line about each of them.
"""

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled
from sysid.nonlinearities.piecewise_affine.dichotomies import add_to_side, explained, separating

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]

FEW = 12
"""A cell of so many open points is settled at once."""
SECTORS = 8
MOST_WORK = 3e8
"""Looking at so many points takes some seconds."""
DEEPEST = 80
"""So often a cell is halved at most; only coinciding points stay open as long."""


def best_line_of_all(
    z: Floats, w: Floats, least: int, most_work: float = MOST_WORK
) -> tuple[float, Floats, float] | None:
    """Return the best of all lines: its cost, h of shape (3,), and what no line goes below.

    The last number is the cost itself if the search came to its end, which it does in far less time than
    turning a line about every point takes, unless there is little but noise.

    Parameters
    ----------
    z, w : ndarray, shapes (n_points, 2) and (n_points, n_w)
        Scaled.
    least : int
        Points on each side at least.
    most_work : float
        The search is cut short after looking at so many points.

    Returns
    -------
    tuple, or None
        None where no line is admitted.
    """
    best = np.array([np.inf, 0.0, 0.0, 0.0])
    below = search(z, w, least, most_work, best)
    cost, low, high, pivot = best
    if not np.isfinite(cost):
        return None
    return float(cost), separating(z, int(pivot), low, high), float(below)


@compiled
def put(source: Floats, target: Floats) -> None:
    """Copy a row; a loop is far quicker to compile than an assignment of slices."""
    for j in range(source.shape[0]):
        target[j] = source[j]


@compiled
def residual_squares(sums: Floats, n_w: int) -> float:
    """Return a side's sum of squared residuals; the last entry of ``sums`` is that of the outputs."""
    rest: float = sums[6 + 3 * n_w] - explained(sums, n_w)
    return max(rest, 0.0)


@compiled
def add_with_power(z: Floats, w: Floats, k: int, sums: Floats) -> None:
    """Add point ``k`` to a side's sums."""
    add_to_side(z, w, k, 1.0, sums)
    for c in range(w.shape[1]):
        sums[6 + 3 * w.shape[1]] += w[k, c] * w[k, c]


@compiled
def settle(
    z: Floats, w: Floats, open_: Labels, cell: Floats, left: Floats, right: Floats, least: int, best: Floats
) -> None:
    """Try all lines of a cell that touch one of its open points; improve ``best`` (cost, low, high, pivot).

    Between two events, where the line meets another open point or leaves the cell, nothing changes sides.
    """
    n_w = w.shape[1]
    count = open_.shape[0]
    events = np.empty(count + 6)
    sums, other = np.empty(left.shape[0]), np.empty(left.shape[0])
    for pivot in open_:
        x, y = z[pivot, 0], z[pivot, 1]
        number = 2
        events[0], events[1] = cell[0], cell[1]
        for q in open_:
            dx, dy = z[q, 0] - x, z[q, 1] - y
            if dx != 0.0 or dy != 0.0:
                angle = np.arctan2(dy, dx)
                if angle < 0.0:
                    angle += np.pi
                if cell[0] < angle < cell[1]:
                    events[number] = angle
                    number += 1
        radius, phase = np.hypot(x, y), np.arctan2(y, x)  # distance radius sin(phase - angle)
        for side in range(2, 4):
            if abs(cell[side]) < radius:
                turn = np.arcsin(cell[side] / radius)
                for angle in (phase - turn, phase - np.pi + turn):
                    angle = angle - 2.0 * np.pi * np.floor(angle / (2.0 * np.pi))
                    if cell[0] < angle < cell[1] and number < events.shape[0]:
                        events[number] = angle
                        number += 1
        for event in range(1, number):  # few: an insertion sort
            place, value = event, events[event]
            while place > 0 and events[place - 1] > value:
                events[place] = events[place - 1]
                place -= 1
            events[place] = value
        for event in range(number - 1):
            low, high = events[event], events[event + 1]
            if high <= low + 1e-12:
                continue
            sine, cosine = np.sin(0.5 * (low + high)), np.cos(0.5 * (low + high))
            distance = cosine * y - sine * x
            if not cell[2] <= distance <= cell[3]:
                continue
            put(left, sums)
            put(right, other)
            for q in open_:
                together = z[q, 0] == x and z[q, 1] == y
                if together or cosine * z[q, 1] - sine * z[q, 0] > distance:
                    add_with_power(z, w, q, sums)
                else:
                    add_with_power(z, w, q, other)
            if sums[0] > least - 0.5 and other[0] > least - 0.5:
                cost = residual_squares(sums, n_w) + residual_squares(other, n_w)
                if cost < best[0]:
                    best[0], best[1], best[2], best[3] = cost, low, high, pivot


@compiled
def divide(
    z: Floats, w: Floats, open_: Labels, cell: Floats, left: Floats, right: Floats, rest: Labels, least: int
) -> tuple[int, float]:
    """Sort a cell's open points into its certain sides; return how many stay open, and the lower bound.

    ``left`` and ``right`` grow by the points that are certain now, ``rest`` takes the others.
    """
    n_w = w.shape[1]
    middle, half = 0.5 * (cell[0] + cell[1]), 0.5 * (cell[1] - cell[0])
    sine, cosine = np.sin(middle), np.cos(middle)
    swing, sag = np.sin(half), 1.0 - np.cos(half)
    count = 0
    for k in open_:
        distance = cosine * z[k, 1] - sine * z[k, 0]
        along = cosine * z[k, 0] + sine * z[k, 1]
        reach = abs(along) * swing + abs(distance) * sag
        if distance - reach > cell[3]:
            add_with_power(z, w, k, left)
        elif distance + reach < cell[2]:
            add_with_power(z, w, k, right)
        else:
            rest[count] = k
            count += 1
    bound = residual_squares(left, n_w) + residual_squares(right, n_w)
    if left[0] + count < least - 0.5 or right[0] + count < least - 0.5:
        bound = np.inf
    return count, bound


@compiled
def search(z: Floats, w: Floats, least: int, most_work: float, best: Floats) -> float:
    """Improve ``best`` (cost, low, high, pivot) to the best line of all; return what no line goes below.

    That is the best cost itself, unless more than ``most_work`` points had to be looked at.
    """
    n, n_w = w.shape
    size = 7 + 3 * n_w
    radius = 0.0
    for k in range(n):
        radius = max(radius, np.hypot(z[k, 0], z[k, 1]))
    radius *= 1.0 + 1e-9
    room = SECTORS + 2 * DEEPEST
    cells, lefts, rights = np.empty((room, 4)), np.zeros((room, size)), np.zeros((room, size))
    bounds, depths = np.zeros(room), np.zeros(room, np.intp)
    begins, counts = np.zeros(room, np.intp), np.zeros(room, np.intp)
    stored = np.empty(n * (SECTORS + 4), np.intp)
    top = 0
    for sector in range(SECTORS):
        cells[top, 0], cells[top, 1] = np.pi * sector / SECTORS, np.pi * (sector + 1) / SECTORS
        cells[top, 2], cells[top, 3] = -radius, radius
        begins[top], counts[top] = sector * n, n
        for k in range(n):
            stored[sector * n + k] = k
        top += 1
    work = 0.0
    halves = np.empty((2, 4))
    sides = np.empty((2, 2, size))
    lists = np.empty((2, n), np.intp)
    for_half, bound_of = np.zeros(2, np.intp), np.zeros(2)
    while top > 0:
        top -= 1
        if bounds[top] >= best[0]:
            continue
        if work > most_work:
            lowest: float = best[0]
            for a in range(top + 1):
                lowest = min(lowest, bounds[a])
            return lowest
        begin, count, depth = begins[top], counts[top], depths[top]
        open_ = stored[begin : begin + count].copy()
        cell = cells[top].copy()
        if count <= FEW or depth >= DEEPEST:
            settle(z, w, open_, cell, lefts[top], rights[top], least, best)
            work += 8.0 * count * count
            continue
        work += 2.0 * count
        middle, half = 0.5 * (cell[0] + cell[1]), 0.5 * (cell[1] - cell[0])
        sine, cosine = np.sin(middle), np.cos(middle)
        along = 0.0
        for k in open_:
            along += abs(cosine * z[k, 0] + sine * z[k, 1])
        by_angle = 2.0 * np.sin(half) * along / count > cell[3] - cell[2]
        for a in range(2):
            put(cell, halves[a])
            if by_angle:
                halves[a, 1 - a] = middle
            else:
                halves[a, 3 - a] = 0.5 * (cell[2] + cell[3])
            put(lefts[top], sides[a, 0])
            put(rights[top], sides[a, 1])
            for_half[a], bound_of[a] = divide(
                z, w, open_, halves[a], sides[a, 0], sides[a, 1], lists[a], least
            )
        first = 0 if bound_of[0] >= bound_of[1] else 1  # the lower bound goes on top of the stack
        place = begin
        for a in (first, 1 - first):
            if bound_of[a] >= best[0] or for_half[a] == 0:
                continue
            if place + for_half[a] > stored.shape[0]:
                grown = np.empty(2 * stored.shape[0] + for_half[a], np.intp)
                for k in range(place):
                    grown[k] = stored[k]
                stored = grown
            put(halves[a], cells[top])
            put(sides[a, 0], lefts[top])
            put(sides[a, 1], rights[top])
            bounds[top], depths[top] = bound_of[a], depth + 1
            begins[top], counts[top] = place, for_half[a]
            for k in range(for_half[a]):
                stored[place + k] = lists[a, k]
            place += for_half[a]
            top += 1
    reached: float = best[0]
    return reached
