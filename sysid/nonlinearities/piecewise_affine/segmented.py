"""Scalar z: the best piecewise affine map by dynamic programming over its breakpoints, exactly."""

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]


def best_breakpoints(z: Floats, w: Floats, modes: int, least: int) -> tuple[Floats, Floats] | None:
    """Return the breakpoints of the best map of ``modes`` pieces, and the cost of 1 to ``modes`` pieces.

    Parameters
    ----------
    z : ndarray, shape (n_points,)
        In any order; points of equal z stay together.
    w : ndarray, shape (n_points, n_w)
    modes, least : int
        Number of pieces, and of points in each of them at least.

    Returns
    -------
    tuple of ndarray, or None
        Midpoints between neighbours, ascending; costs, infinite for a number of pieces that is not
        possible.  None where ``modes`` pieces are not possible.
    """
    order = np.argsort(z, kind="stable")
    ascending, n = z[order], z.size
    cost = np.full((modes + 1, n + 1), np.inf)
    came = np.zeros((modes + 1, n + 1), dtype=np.intp)
    _whole(ascending, w[order], least, cost[1])
    _best_cuts(ascending, w[order], least, cost, came)
    if not np.isfinite(cost[modes, n]):
        return None
    cuts, end = [], n
    for k in range(modes, 1, -1):
        end = int(came[k, end])
        cuts.append(end)
    found = np.array(cuts[::-1], dtype=np.intp)
    return 0.5 * (ascending[found - 1] + ascending[found]), cost[1:, n]


@compiled
def _whole(z: Floats, w: Floats, least: int, cost: Floats) -> None:
    """Fill the sum of squares about one line of the first k points, for every k."""
    n, n_w = w.shape
    mean_w, cross, square = np.zeros(n_w), np.zeros(n_w), np.zeros(n_w)
    mean_z = spread = 0.0
    for k in range(n):
        off = z[k] - mean_z
        mean_z += off / (k + 1)
        spread += off * (z[k] - mean_z)
        segment = 0.0
        for c in range(n_w):
            miss = w[k, c] - mean_w[c]
            mean_w[c] += miss / (k + 1)
            square[c] += miss * (w[k, c] - mean_w[c])
            cross[c] += off * (w[k, c] - mean_w[c])
            segment += square[c] - (cross[c] * cross[c] / spread if spread > 0.0 else 0.0)
        if k + 1 >= least:
            cost[k + 1] = max(segment, 0.0)


@compiled
def _best_cuts(z: Floats, w: Floats, least: int, cost: Floats, came: Labels) -> None:
    """Fill the least sum of squares of the first n points in k >= 2 segments, and where the last begins.

    ``cost`` and ``came`` have shape (modes + 1, n + 1).  A segment's sum of squares grows from right to
    left by Welford's recursion, which loses no digits; since it never falls, the scan ends where it alone
    is more than the best found.
    """
    n, n_w = w.shape
    modes = cost.shape[0] - 1
    mean_w, cross, square = np.empty(n_w), np.empty(n_w), np.empty(n_w)
    for end in range(2 * least, n + 1):
        if end < n and z[end] == z[end - 1]:
            continue
        mean_z = spread = 0.0
        for c in range(n_w):
            mean_w[c] = cross[c] = square[c] = 0.0
        most = min(modes, end // least)
        for begin in range(end - 1, least - 1, -1):
            count = end - begin
            off = z[begin] - mean_z
            mean_z += off / count
            spread += off * (z[begin] - mean_z)
            segment = 0.0
            for c in range(n_w):
                miss = w[begin, c] - mean_w[c]
                mean_w[c] += miss / count
                square[c] += miss * (w[begin, c] - mean_w[c])
                cross[c] += off * (w[begin, c] - mean_w[c])
                segment += square[c] - (cross[c] * cross[c] / spread if spread > 0.0 else 0.0)
            if count < least or z[begin] == z[begin - 1]:
                continue
            segment = max(segment, 0.0)
            worst = 0.0
            for k in range(2, most + 1):
                total = cost[k - 1, begin] + segment
                if total < cost[k, end]:
                    cost[k, end] = total
                    came[k, end] = begin
                worst = max(worst, cost[k, end])
            if segment > worst:
                break
