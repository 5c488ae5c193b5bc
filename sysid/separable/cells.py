"""Compiled exact search over one parameter whose regressors are affine between knots.

The regressors of row k are fixed columns and lagged samples of a signal x(k; a) = p_k + a q_k.
Between two knots of a (a cell) p and q are constant, so the Gram matrix of [fixed, p, q, y] gives
cost and slope at every a of the cell, and moving to the next cell changes the few rows in which the
changed sample appears.  One pass over the cells is therefore linear in the number of samples.  The Gram
matrix only ranks the minima; whatever is returned comes from an orthogonal factorisation.
"""

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled
from sysid.separable.rows import (
    CELL_LEFT,
    CELL_RIGHT,
    COST,
    DEPENDENT,
    EVENTS,
    FLAT,
    HIGH,
    LOW,
    POINT,
    fill_row,
)

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

MAX_MINIMA = 16
"""Local minima kept, the lowest first; all are counted."""

_PLATEAU = 1e-12  # cost differences below this share of |y|^2 are rounding


@compiled
def _gram(fixed: Floats, y: Floats, times: Indices, lags: Indices, p: Floats, q: Floats) -> Floats:
    """Return the Gram matrix of the columns [fixed, p lagged, q lagged, y]."""
    n_fixed, n_lags = fixed.shape[1], lags.size
    d = n_fixed + 2 * n_lags + 1
    gram = np.zeros((d, d))
    z = np.empty(d)
    for row in range(y.size):
        fill_row(fixed, y, times, lags, p, q, row, z)
        for i in range(d):
            for j in range(i + 1):
                gram[i, j] += z[i] * z[j]
    for i in range(d):
        for j in range(i):
            gram[j, i] = gram[i, j]
    return gram


@compiled
def _change_sample(
    gram: Floats,
    fixed: Floats,
    y: Floats,
    times: Indices,
    row_of_time: Indices,
    lags: Indices,
    p: Floats,
    q: Floats,
    z: Floats,
    k: int,
    new_p: float,
    new_q: float,
) -> None:
    """Give sample ``k`` a new offset and slope in every row in which it appears."""
    change_p, change_q = new_p - p[k], new_q - q[k]
    n_fixed, n_lags = fixed.shape[1], lags.size
    d = n_fixed + 2 * n_lags + 1
    for j in range(n_lags):
        time = k + lags[j]
        if time >= row_of_time.size or row_of_time[time] < 0:
            continue
        fill_row(fixed, y, times, lags, p, q, row_of_time[time], z)
        for part in range(2):
            change = change_p if part == 0 else change_q
            column = n_fixed + part * n_lags + j
            for i in range(d):
                if i != column:
                    gram[i, column] += change * z[i]
                    gram[column, i] = gram[i, column]
            gram[column, column] += change * (2.0 * z[column] + change)
            z[column] += change
    p[k], q[k] = new_p, new_q


@compiled
def _cost(gram: Floats, n_fixed: int, n_lags: int, a: float, work: Floats, theta: Floats) -> float:
    """Cost and (in ``theta``) parameters at ``a`` from the Gram matrix, dependent columns left out."""
    n = n_fixed + n_lags
    y = n_fixed + 2 * n_lags
    for i in range(n_fixed):
        for j in range(i + 1):
            work[i, j] = gram[i, j]
        work[n, i] = gram[y, i]
    for i in range(n_lags):
        pi, qi = n_fixed + i, n_fixed + n_lags + i
        for j in range(n_fixed):
            work[pi, j] = gram[pi, j] + a * gram[qi, j]
        for j in range(i + 1):
            pj, qj = n_fixed + j, n_fixed + n_lags + j
            work[pi, pj] = gram[pi, pj] + a * (gram[pi, qj] + gram[qi, pj] + a * gram[qi, qj])
        work[n, pi] = gram[y, pi] + a * gram[y, qi]
    work[n, n] = gram[y, y]
    for i in range(n + 1):
        for j in range(i + 1):
            value = work[i, j]
            for k in range(j):
                value -= work[i, k] * work[j, k]
            if j < i:
                work[i, j] = value / work[j, j] if work[j, j] > 0.0 else 0.0
            elif i < n:
                work[i, i] = np.sqrt(value) if value > DEPENDENT * work[i, i] else 0.0
            else:
                work[n, n] = max(value, 0.0)
    for i in range(n - 1, -1, -1):
        value = work[n, i]
        for k in range(i + 1, n):
            value -= work[k, i] * theta[k]
        theta[i] = value / work[i, i] if work[i, i] > 0.0 else 0.0
    return float(work[n, n])


@compiled
def _slope(gram: Floats, n_fixed: int, n_lags: int, a: float, theta: Floats) -> float:
    """d(cost)/da at ``a``, where ``theta`` are the parameters."""
    y = n_fixed + 2 * n_lags
    slope = 0.0
    for i in range(n_lags):
        qi = n_fixed + n_lags + i
        inner = gram[qi, y]
        for j in range(n_fixed):
            inner -= gram[qi, j] * theta[j]
        for j in range(n_lags):
            inner -= (gram[qi, n_fixed + j] + a * gram[qi, n_fixed + n_lags + j]) * theta[n_fixed + j]
        slope -= 2.0 * theta[n_fixed + i] * inner
    return slope


@compiled
def _stationary_point(
    gram: Floats,
    n_fixed: int,
    n_lags: int,
    left: float,
    slope_left: float,
    right: float,
    slope_right: float,
    work: Floats,
    theta: Floats,
) -> float:
    """Root of the slope between a falling left and a rising right end (Illinois false position)."""
    tolerance = 4e-16 * (abs(left) + abs(right)) + 1e-300
    side = 0
    for _ in range(60):
        a = (left * slope_right - right * slope_left) / (slope_right - slope_left)
        if not left < a < right:
            a = 0.5 * (left + right)
        _cost(gram, n_fixed, n_lags, a, work, theta)
        slope = _slope(gram, n_fixed, n_lags, a, theta)
        if slope == 0.0:
            return a
        if slope < 0.0:
            left, slope_left = a, slope
            if side < 0:
                slope_right *= 0.5
            side = -1
        else:
            right, slope_right = a, slope
            if side > 0:
                slope_left *= 0.5
            side = 1
        if right - left <= tolerance:
            break
    return 0.5 * (left + right)


# State of the walk along the profile: direction, highest cost since the last minimum, minima seen.
_RISING, _TOP, _SEEN = range(3)


@compiled
def _keep(minima: Floats, point: Floats) -> None:
    """Insert a local minimum into the list of the lowest ones."""
    i = MAX_MINIMA - 1
    if point[COST] >= minima[i, COST]:
        return
    while i > 0 and minima[i - 1, COST] > point[COST]:
        minima[i] = minima[i - 1]
        i -= 1
    minima[i] = point


@compiled
def _visit(state: Floats, candidate: Floats, minima: Floats, point: Floats, tolerance: float) -> None:
    """Take the next point of the profile; a minimum is a fall followed by a rise beyond rounding."""
    cost = point[COST]
    if state[_RISING] == 0.0:
        if cost < candidate[COST]:
            candidate[:] = point
        elif cost > candidate[COST] + tolerance:
            _keep(minima, candidate)
            state[_SEEN] += 1
            state[_RISING] = 1.0
            state[_TOP] = cost
    elif cost > state[_TOP]:
        state[_TOP] = cost
    elif cost < state[_TOP] - tolerance:
        state[_RISING] = 0.0
        candidate[:] = point


@compiled
def _visit_cell(
    gram: Floats,
    n_fixed: int,
    n_lags: int,
    left: float,
    right: float,
    events: int,
    flat: bool,
    longest: float,
    cost: float,
    state: Floats,
    candidate: Floats,
    minima: Floats,
    work: Floats,
    theta: Floats,
) -> float:
    """Walk along the profile of the cost inside one cell.

    ``cost`` is the cost at its left end if ``theta`` holds the parameters there, otherwise -1; what is
    returned has the same meaning at its right end.
    """
    y = gram.shape[0] - 1
    tolerance = _PLATEAU * gram[y, y]
    point = np.empty(POINT)
    point[CELL_LEFT], point[CELL_RIGHT], point[EVENTS] = left, right, events
    point[FLAT] = 1.0 if flat else 0.0
    if flat:
        point[LOW], point[HIGH] = left, right
        point[COST] = _cost(gram, n_fixed, n_lags, left, work, theta)
        _visit(state, candidate, minima, point, tolerance)
        return -1.0
    n_parts = max(1, int(np.ceil((right - left) / longest)))
    a = left
    if cost < 0.0:
        cost = _cost(gram, n_fixed, n_lags, a, work, theta)
    slope = _slope(gram, n_fixed, n_lags, a, theta)
    searched = False
    for part in range(n_parts):
        point[LOW] = point[HIGH] = a
        point[COST] = cost
        _visit(state, candidate, minima, point, tolerance)
        b = right if part == n_parts - 1 else left + (part + 1) * (right - left) / n_parts
        cost_b = _cost(gram, n_fixed, n_lags, b, work, theta)
        slope_b = _slope(gram, n_fixed, n_lags, b, theta)
        searched = slope < 0.0 < slope_b
        if searched:
            root = _stationary_point(gram, n_fixed, n_lags, a, slope, b, slope_b, work, theta)
            point[LOW] = point[HIGH] = root
            point[COST] = _cost(gram, n_fixed, n_lags, root, work, theta)
            _visit(state, candidate, minima, point, tolerance)
        a, cost, slope = b, cost_b, slope_b
    point[LOW] = point[HIGH] = right
    point[COST] = cost
    _visit(state, candidate, minima, point, tolerance)
    return -1.0 if searched else cost


@compiled
def sweep(
    fixed: Floats,
    y: Floats,
    times: Indices,
    row_of_time: Indices,
    lags: Indices,
    lower: float,
    upper: float,
    offset: Floats,
    slope: Floats,
    knot: Floats,
    sample: Indices,
    new_offset: Floats,
    new_slope: Floats,
    longest: float,
) -> tuple[Floats, int]:
    """Walk through every cell of the parameter and return the lowest local minima of the cost.

    Parameters
    ----------
    fixed : ndarray, shape (n_rows, n_fixed)
        Regressors that do not depend on the parameter.
    y : ndarray, shape (n_rows,)
        Data.
    times, row_of_time : ndarray of int, shapes (n_rows,) and (n_samples,)
        Sample index of each row and row of each sample (-1: none).
    lags : ndarray of int, shape (n_lags,)
        Lags of the signal that enter a row.
    lower, upper : float
        Range of the parameter.
    offset, slope, knot, sample, new_offset, new_slope : ndarray
        The signal as `sysid.separable.pieces.AffinePieces` describes it.
    longest : float
        Smooth cells longer than this are examined in several parts.

    Returns
    -------
    minima : ndarray, shape (MAX_MINIMA, 7)
        Local minima, lowest first; unused rows have infinite cost.
    n_minima : int
        Number of all local minima, those at the bounds included.
    """
    n_fixed, n_lags = fixed.shape[1], lags.size
    n = n_fixed + n_lags
    p, q = offset.copy(), slope.copy()
    gram = _gram(fixed, y, times, lags, p, q)
    work, theta, z = np.zeros((n + 1, n + 1)), np.zeros(n), np.empty(n + n_lags + 1)
    used = np.zeros(p.size, dtype=np.bool_)
    for row in range(times.size):
        for j in range(n_lags):
            used[times[row] - lags[j]] = True
    sloping = 0
    for k in range(p.size):
        if used[k] and q[k] != 0.0:
            sloping += 1
    minima = np.full((MAX_MINIMA, POINT), np.inf)
    candidate = np.full(POINT, np.inf)
    state = np.zeros(3)
    left = lower
    event = 0
    cell_events = 0
    cost = -1.0
    while True:
        right = knot[event] if event < knot.size else upper
        # A knot that changes no row does not end a cell: look ahead to the first that does.
        if event < knot.size:
            k = sample[event]
            if not used[k] or (new_offset[event] == p[k] and new_slope[event] == q[k]):
                p[k], q[k] = new_offset[event], new_slope[event]
                event += 1
                continue
        if right > left:
            cost = _visit_cell(
                gram, n_fixed, n_lags, left, right, cell_events, sloping == 0, longest, cost,
                state, candidate, minima, work, theta,
            )  # fmt: skip
        if event >= knot.size:
            break
        while event < knot.size and knot[event] == right:
            k = sample[event]
            if used[k]:
                sloping += int(new_slope[event] != 0.0) - int(q[k] != 0.0)
                # Where the signal does not jump, cost and parameters carry over to the next cell.
                if new_offset[event] + right * new_slope[event] != p[k] + right * q[k]:
                    cost = -1.0
            _change_sample(
                gram, fixed, y, times, row_of_time, lags, p, q, z, k, new_offset[event], new_slope[event]
            )
            event += 1
        left = right
        cell_events = event
    if state[_RISING] == 0.0:
        _keep(minima, candidate)
        state[_SEEN] += 1
    return minima, int(state[_SEEN])
