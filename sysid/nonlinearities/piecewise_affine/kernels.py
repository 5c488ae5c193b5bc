"""Compiled parts of piecewise affine regression: regions, normal equations, exact line searches.

A mode's sum of squared residuals comes from its sums of products, centred on its own means first, so that
points may enter and leave at the price of a few operations.  Coordinates are scaled before (`Scaled`).
"""

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]

DEPENDENT = 1e-10
"""A column is dependent when this share of its variance is all that the columns before it leave."""


@compiled
def fill_regions(z: Floats, separators: Floats, out: Labels) -> None:
    """Fill the index of the greatest affine function at each point, the first one at a tie."""
    n_z = z.shape[1]
    for k in range(z.shape[0]):
        best = -np.inf
        for i in range(separators.shape[0]):
            value = separators[i, n_z]
            for j in range(n_z):
                value += separators[i, j] * z[k, j]
            if value > best:
                best = value
                out[k] = i


@compiled
def fill_clusters(z: Floats, centres: Floats, rounds: int, nearest: Labels) -> float:
    """Move centres to the means of their points, in place; fill the nearest, return the sum of squares.

    It ends when nothing changes, or when a centre has lost all its points.
    """
    n, n_z = z.shape
    count = centres.shape[0]
    sums, sizes = np.zeros((count, n_z)), np.zeros(count)
    total = 0.0
    for _ in range(rounds):
        sums[:] = 0.0
        sizes[:] = 0.0
        total, moved = 0.0, False
        for k in range(n):
            least, own = np.inf, 0
            for i in range(count):
                distance = 0.0
                for j in range(n_z):
                    distance += (z[k, j] - centres[i, j]) ** 2
                if distance < least:
                    least, own = distance, i
            moved = moved or own != nearest[k]
            nearest[k] = own
            total += least
            sizes[own] += 1.0
            for j in range(n_z):
                sums[own, j] += z[k, j]
        if sizes.min() == 0.0:
            break
        for i in range(count):
            for j in range(n_z):
                centres[i, j] = sums[i, j] / sizes[i]
        if not moved:
            break
    return total


@compiled
def fill_values(z: Floats, theta: Floats, modes: Labels, out: Floats) -> None:
    """Fill w, shape (n_points, n_w), of the submodels (modes, n_z + 1, n_w)."""
    n_z = z.shape[1]
    for k in range(z.shape[0]):
        i = modes[k]
        for c in range(out.shape[1]):
            value = theta[i, n_z, c]
            for j in range(n_z):
                value += theta[i, j, c] * z[k, j]
            out[k, c] = value


@compiled
def fill_costs(z: Floats, w: Floats, theta: Floats, out: Floats) -> None:
    """Fill the squared residual of each point under each submodel, shape (n_points, modes)."""
    n_z = z.shape[1]
    for k in range(z.shape[0]):
        for i in range(theta.shape[0]):
            total = 0.0
            for c in range(w.shape[1]):
                value = w[k, c] - theta[i, n_z, c]
                for j in range(n_z):
                    value -= theta[i, j, c] * z[k, j]
                total += value * value
            out[k, i] = total


@compiled
def ascending(values: Floats) -> Labels:
    """Return the indices that sort values; a function of its own, for sorting is long to compile."""
    return np.argsort(values)


@compiled
def add_point(z: Floats, w: Floats, k: int, sign: float, sums: Floats) -> None:
    """Add point ``k`` to a mode's sums (or take it out): products of [1, z] with [1, z, w], and w^2."""
    n_z, n_w = z.shape[1], w.shape[1]
    sums[0, 0] += sign
    for j in range(n_z):
        sums[0, 1 + j] += sign * z[k, j]
        for i in range(j + 1):
            sums[1 + i, 1 + j] += sign * z[k, i] * z[k, j]
    for c in range(n_w):
        value = sign * w[k, c]
        sums[0, 1 + n_z + c] += value
        for j in range(n_z):
            sums[1 + j, 1 + n_z + c] += value * z[k, j]
        sums[1 + n_z, 1 + n_z + c] += value * w[k, c]


@compiled
def squares(sums: Floats, n_z: int, work: Floats) -> float:
    """Return a mode's sum of squared residuals; a column without variance of its own is left out.

    ``sums`` and ``work`` have shape (n_z + 2, 1 + n_z + n_w).
    """
    count = sums[0, 0]
    if count < 0.5:
        return 0.0
    columns = sums.shape[1] - 1
    total = 0.0
    for c in range(n_z, columns):
        total += sums[1 + n_z, 1 + c] - sums[0, 1 + c] * sums[0, 1 + c] / count
    for i in range(n_z):  # Cholesky factor of the centred products, with w's columns carried along
        mean = sums[0, 1 + i] / count
        spread = sums[1 + i, 1 + i] - mean * sums[0, 1 + i]
        pivot = spread
        for a in range(i):
            pivot -= work[a, i] * work[a, i]
        if pivot <= DEPENDENT * max(spread, 0.0) or pivot <= 1e-14 * sums[1 + i, 1 + i]:
            for j in range(i, columns):
                work[i, j] = 0.0
            continue
        root = np.sqrt(pivot)
        work[i, i] = root
        for j in range(i + 1, columns):
            value = sums[1 + i, 1 + j] - mean * sums[0, 1 + j]
            for a in range(i):
                value -= work[a, i] * work[a, j]
            work[i, j] = value / root
        for c in range(n_z, columns):
            total -= work[i, c] * work[i, c]
    return max(total, 0.0)


@compiled
def solve(sums: Floats, n_z: int, work: Floats, theta: Floats) -> float:
    """Fill a mode's submodel, shape (n_z + 1, n_w), and return its sum of squared residuals."""
    total = squares(sums, n_z, work)
    count = max(sums[0, 0], 1.0)
    for c in range(theta.shape[1]):
        for i in range(n_z - 1, -1, -1):
            value = work[i, n_z + c]
            for j in range(i + 1, n_z):
                value -= work[i, j] * theta[j, c]
            theta[i, c] = value / work[i, i] if work[i, i] > 0.0 else 0.0
        value = sums[0, 1 + n_z + c]
        for j in range(n_z):
            value -= theta[j, c] * sums[0, 1 + j]
        theta[n_z, c] = value / count
    return total


@compiled
def fit_modes(z: Floats, w: Floats, labels: Labels, theta: Floats, counts: Labels) -> float:
    """Fill every mode's submodel by least squares; return the sum of squares; labels < 0 are left out."""
    n_z, n_w = z.shape[1], w.shape[1]
    modes = theta.shape[0]
    sums = np.zeros((modes, n_z + 2, 1 + n_z + n_w))
    for k in range(z.shape[0]):
        if labels[k] >= 0:
            add_point(z, w, k, 1.0, sums[labels[k]])
    work = np.zeros((n_z + 2, 1 + n_z + n_w))
    total = 0.0
    for i in range(modes):
        counts[i] = int(sums[i, 0, 0] + 0.5)
        if counts[i] > 0:
            total += solve(sums[i], n_z, work, theta[i])
    return total


@compiled
def thresholds(z: Floats, rows: Floats, i: int, d: Floats, rival: Labels, out: Floats, gain: Floats) -> None:
    """Fill where each point enters or leaves region ``i`` when its row becomes ``rows[i] + t d``.

    ``rival`` is the region that holds the point otherwise; with ``gain`` > 0 it is in region ``i`` for
    t > ``out``, with ``gain`` < 0 for t < ``out``.
    """
    n_z = z.shape[1]
    for k in range(z.shape[0]):
        own, gain[k] = rows[i, n_z], d[n_z]
        for j in range(n_z):
            own += rows[i, j] * z[k, j]
            gain[k] += d[j] * z[k, j]
        best = -np.inf
        for r in range(rows.shape[0]):
            if r != i:
                value = rows[r, n_z]
                for j in range(n_z):
                    value += rows[r, j] * z[k, j]
                if value > best:
                    best = value
                    rival[k] = r
        if abs(gain[k]) > 1e-300:
            out[k] = (best - own) / gain[k]
        else:
            out[k] = np.inf if own < best else -np.inf  # never in region i, or always
            gain[k] = 1.0


@compiled
def between(low: float, high: float) -> float:
    """Return a step between two thresholds, near zero where one of them is missing."""
    if np.isfinite(low) and np.isfinite(high):
        return 0.5 * (low + high)
    if np.isfinite(low):
        return low + 0.1 * (abs(low) + 1e-3)
    if np.isfinite(high):
        return high - 0.1 * (abs(high) + 1e-3)
    return 0.0


@compiled
def best_step(z: Floats, w: Floats, rows: Floats, i: int, d: Floats, least: int) -> tuple[float, float]:
    """Move one separator along ``d`` to the exact minimum of the sum of squares; return (t, cost).

    All submodels are fitted anew at every step: a point that crosses is a rank-one change of two modes.
    Regions of fewer than ``least`` points are not admitted; the cost is infinite if none is.
    """
    n, n_z, n_w = z.shape[0], z.shape[1], w.shape[1]
    regions = rows.shape[0]
    rival, place, gain = np.empty(n, np.intp), np.empty(n), np.empty(n)
    thresholds(z, rows, i, d, rival, place, gain)
    sums = np.zeros((regions, n_z + 2, 1 + n_z + n_w))
    for k in range(n):
        inside = gain[k] < 0.0 or place[k] == -np.inf
        add_point(z, w, k, 1.0, sums[i if inside else rival[k]])
    work = np.zeros((n_z + 2, 1 + n_z + n_w))
    cost = np.empty(regions)
    small = 0
    for r in range(regions):
        cost[r] = squares(sums[r], n_z, work)
        small += sums[r, 0, 0] < least - 0.5
    order = ascending(place)
    first = 0
    while first < n and place[order[first]] == -np.inf:
        first += 1
    best, step = np.inf, 0.0
    touched = np.zeros(regions, np.bool_)
    for position in range(first, n + 1):
        here = place[order[position]] if position < n else np.inf
        before = place[order[position - 1]] if position > first else -np.inf
        if before == -np.inf or here > before + 1e-12 * abs(before):
            small = 0
            for r in range(regions):
                if touched[r]:
                    cost[r] = squares(sums[r], n_z, work)
                    touched[r] = False
                small += sums[r, 0, 0] < least - 0.5
            if small == 0:
                total = cost.sum()
                if total < best:
                    best, step = total, between(before, here)
        if here == np.inf:
            break
        k = order[position]
        leaves, enters = (rival[k], i) if gain[k] > 0.0 else (i, rival[k])
        add_point(z, w, k, -1.0, sums[leaves])
        add_point(z, w, k, 1.0, sums[enters])
        touched[leaves] = True
        touched[enters] = True
    return step, best


@compiled
def best_step_of_costs(z: Floats, costs: Floats, rows: Floats, i: int, d: Floats) -> tuple[float, float]:
    """Move one separator along ``d`` to the least sum of given costs (n_points, regions); (t, change)."""
    n = z.shape[0]
    rival, place, gain = np.empty(n, np.intp), np.empty(n), np.empty(n)
    thresholds(z, rows, i, d, rival, place, gain)
    order = ascending(place)
    total = now = 0.0
    for k in range(n):
        change = costs[k, i] - costs[k, rival[k]]
        if gain[k] < 0.0 or place[k] == -np.inf:
            total += change
        if (gain[k] > 0.0) == (place[k] < 0.0):
            now += change
    best, step = now, 0.0
    before = -np.inf
    for position in range(n + 1):
        here = place[order[position]] if position < n else np.inf
        if here > before and total < best:
            best, step = total, between(before, here)
        if here == np.inf:
            break
        if here > -np.inf:
            k = order[position]
            change = costs[k, i] - costs[k, rival[k]]
            total += change if gain[k] > 0.0 else -change
        before = here
    return step, best - now


@compiled
def centred(z: Floats, rows: Floats, directions: Floats) -> Floats:
    """Return separators in the middle of all those that part the points in the same way.

    From one to the next, a separator moves along a direction to the middle of the range that no point
    crosses; the mean of all is nearer to the centre of that cell than any one of them.
    """
    n, n_z = z.shape[0], z.shape[1]
    regions = rows.shape[0]
    now, mean = rows.copy(), np.zeros(rows.shape)
    rival, place, gain = np.empty(n, np.intp), np.empty(n), np.empty(n)
    for s in range(directions.shape[0]):
        i = s % regions if regions > 2 else 1  # of two rows only the difference counts
        thresholds(z, now, i, directions[s], rival, place, gain)
        low, high = -np.inf, np.inf
        for k in range(n):
            if place[k] < 0.0:
                low = max(low, place[k])
            else:
                high = min(high, place[k])
        if np.isfinite(low) and np.isfinite(high):
            for j in range(n_z + 1):
                now[i, j] += 0.5 * (low + high) * directions[s, j]
        size = 0.0
        for r in range(regions):
            for j in range(n_z + 1):
                size += (now[r, j] - now[0, j]) ** 2
        size = np.sqrt(size) if size > 0.0 else 1.0
        for r in range(regions):
            for j in range(n_z + 1):
                mean[r, j] += (now[r, j] - now[0, j]) / (size * directions.shape[0])
    return mean
