"""Two modes in the plane: the best dividing line, by turning a line about the points.

Every way to part points by a line can be had by a line that touches one of them, the pivot, which goes to
its left; half a turn about each pivot therefore meets them all.  Each point that the line passes is a
rank-one change of both modes.
"""

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled
from sysid.nonlinearities.piecewise_affine.kernels import ascending

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]


def best_line(z: Floats, w: Floats, pivots: Labels, least: int) -> tuple[float, Floats, int] | None:
    """Return the best line that touches one of the pivots.

    Parameters
    ----------
    z, w : ndarray, shapes (n_points, 2) and (n_points, n_w)
        Scaled.
    pivots : ndarray of int
        All points: then no line is better.
    least : int
        Points on each side at least.

    Returns
    -------
    tuple, or None
        The sum of squares, h of shape (3,) and the pivot's number; None where no line is admitted.
    """
    found = np.empty((pivots.size, 3))
    _turn(z, w, pivots, least, found)
    best = int(np.argmin(found[:, 0]))
    cost, low, high = found[best]
    if not np.isfinite(cost):
        return None
    pivot = int(pivots[best])
    return float(cost), separating(z, pivot, low, high), pivot


def separating(z: Floats, pivot: int, low: float, high: float) -> Floats:
    """Return h of a line of a direction between two, just beside the pivot, which is on its left."""
    angle = 0.5 * (low + high)
    normal = np.array([-np.sin(angle), np.cos(angle)])  # points to the left of the line's direction
    offset = (z - z[pivot]) @ normal
    right = offset[offset < -1e-12]
    shift = 0.5 * float(-right.max()) if right.size else 0.5
    return np.append(normal, shift - z[pivot] @ normal)


@compiled
def add_to_side(z: Floats, w: Floats, k: int, sign: float, sums: Floats) -> None:
    """Change a side's sums: count, x, y, xx, xy, yy, then w, wx, wy of each output."""
    x, y = z[k, 0], z[k, 1]
    sums[0] += sign
    sums[1] += sign * x
    sums[2] += sign * y
    sums[3] += sign * x * x
    sums[4] += sign * x * y
    sums[5] += sign * y * y
    for c in range(w.shape[1]):
        value = sign * w[k, c]
        sums[6 + 3 * c] += value
        sums[7 + 3 * c] += value * x
        sums[8 + 3 * c] += value * y


@compiled
def explained(sums: Floats, n_w: int) -> float:
    """Return the sum of squares that an affine submodel explains, its mean included."""
    count = sums[0]
    if count < 0.5:
        return 0.0
    share = 1.0 / count
    x, y = sums[1] * share, sums[2] * share
    xx, xy, yy = sums[3] - x * sums[1], sums[4] - x * sums[2], sums[5] - y * sums[2]
    determinant = xx * yy - xy * xy
    plane = determinant > 1e-10 * xx * yy
    inverse = 1.0 / determinant if plane else 0.0
    total = 0.0
    for c in range(n_w):
        s = sums[6 + 3 * c]
        wx, wy = sums[7 + 3 * c] - x * s, sums[8 + 3 * c] - y * s
        total += s * s * share
        if plane:
            total += (wx * wx * yy - 2.0 * wx * wy * xy + wy * wy * xx) * inverse
        elif xx >= yy and xx > 0.0:  # all on a line
            total += wx * wx / xx
        elif yy > 0.0:
            total += wy * wy / yy
    return total


@compiled
def _turn(z: Floats, w: Floats, pivots: Labels, least: int, found: Floats) -> None:
    """Fill cost and range of angles of the best line about each pivot, shape (n_pivots, 3).

    Lines that turn by less than 1e-12 before the next point are passed over: no line in floating
    point tells such points apart.
    """
    n, n_w = w.shape
    everything, left, right = np.zeros(6 + 3 * n_w), np.zeros(6 + 3 * n_w), np.zeros(6 + 3 * n_w)
    power = 0.0
    for k in range(n):
        add_to_side(z, w, k, 1.0, everything)
        for c in range(n_w):
            power += w[k, c] * w[k, c]
    angle, leaves = np.empty(n), np.empty(n, np.bool_)
    for a in range(pivots.shape[0]):
        pivot = pivots[a]
        found[a, 0] = np.inf
        found[a, 1] = found[a, 2] = 0.0
        left[:] = 0.0
        together = 0
        for k in range(n):
            dx, dy = z[k, 0] - z[pivot, 0], z[k, 1] - z[pivot, 1]
            if dx == 0.0 and dy == 0.0:
                angle[k] = np.inf  # goes with the pivot
                together += 1
                add_to_side(z, w, k, 1.0, left)
                continue
            leaves[k] = dy > 0.0 or (dy == 0.0 and dx > 0.0)  # from left to right as the line passes
            if leaves[k]:
                angle[k] = np.arctan2(dy, dx)
                add_to_side(z, w, k, 1.0, left)
            else:
                angle[k] = np.arctan2(-dy, -dx) if dy < 0.0 else 0.0
        order = ascending(angle)
        events = n - together
        if events == 0:
            continue
        before = angle[order[events - 1]] - np.pi
        for event in range(events):
            here = angle[order[event]]
            if here > before + 1e-12 and left[0] > least - 0.5 and n - left[0] > least - 0.5:
                for j in range(left.shape[0]):
                    right[j] = everything[j] - left[j]
                cost = power - explained(left, n_w) - explained(right, n_w)
                if cost < found[a, 0]:
                    found[a, 0] = max(cost, 0.0)
                    found[a, 1] = before
                    found[a, 2] = here
            k = order[event]
            add_to_side(z, w, k, -1.0 if leaves[k] else 1.0, left)
            before = here
