"""Compiled refinement of one minimum by an orthogonal factorisation inside its cell."""

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled
from sysid.separable.rows import CELL_LEFT, CELL_RIGHT, DEPENDENT, EVENTS, FLAT, HIGH, LOW, fill_row

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_BLOCK = 256  # rows factored at a time: stays in the first-level cache


@compiled
def triangular_factor(
    fixed: Floats, y: Floats, times: Indices, lags: Indices, p: Floats, q: Floats, a: float
) -> Floats:
    """R of [fixed, x lagged, q lagged, y] with x = p + a q, by blocked Householder reflections."""
    n_fixed, n_lags = fixed.shape[1], lags.size
    d = n_fixed + 2 * n_lags + 1
    # Column-wise storage keeps every inner loop contiguous; the first d entries hold R.
    work = np.zeros((d, d + _BLOCK))
    z = np.empty(d)
    start = 0
    while start < y.size:
        rows = min(_BLOCK, y.size - start)
        for i in range(rows):
            fill_row(fixed, y, times, lags, p, q, start + i, z)
            for j in range(n_lags):
                z[n_fixed + j] += a * z[n_fixed + n_lags + j]
            for j in range(d):
                work[j, d + i] = z[j]
        for j in range(d):
            head = work[j, j]
            tail = 0.0
            for i in range(d, d + rows):
                tail += work[j, i] * work[j, i]
            if tail == 0.0:
                continue
            beta = -np.copysign(np.sqrt(head * head + tail), head)
            v = head - beta
            factor = 2.0 / (v * v + tail)
            work[j, j] = beta
            for c in range(j + 1, d):
                inner = v * work[c, j]
                for i in range(d, d + rows):
                    inner += work[j, i] * work[c, i]
                inner *= factor
                work[c, j] -= inner * v
                for i in range(d, d + rows):
                    work[c, i] -= inner * work[j, i]
        start += rows
    r = np.zeros((d, d))
    for j in range(d):
        for i in range(j + 1):
            r[i, j] = work[j, i]
    return r


@compiled
def _solve(r: Floats, n: int, theta: Floats) -> bool:
    """Back substitution for the first ``n`` columns against the last; False if they are dependent."""
    last = r.shape[1] - 1
    for i in range(n - 1, -1, -1):
        norm = 0.0
        for k in range(i + 1):
            norm += r[k, i] * r[k, i]
        if r[i, i] * r[i, i] <= DEPENDENT * norm or norm == 0.0:
            return False
        value = r[i, last]
        for k in range(i + 1, n):
            value -= r[i, k] * theta[k]
        theta[i] = value / r[i, i]
    return True


@compiled
def polish(
    fixed: Floats,
    y: Floats,
    times: Indices,
    lags: Indices,
    offset: Floats,
    slope: Floats,
    sample: Indices,
    new_offset: Floats,
    new_slope: Floats,
    minimum: Floats,
) -> tuple[bool, float, Floats, Floats, Floats, Floats]:
    """Refine one minimum by orthogonal factorisation inside its cell.

    Returns
    -------
    regular : bool
        False when the regressors are dependent there (parameters and residual are then not set).
    a : float
        Parameter; the midpoint of a flat cell.
    theta, residual, r, signal : ndarray
        Linear parameters, residual, factor of [fixed, x, q, y], and the signal x at ``a``.
    """
    n_fixed, n_lags = fixed.shape[1], lags.size
    n = n_fixed + n_lags
    p, q = offset.copy(), slope.copy()
    for event in range(int(minimum[EVENTS])):
        p[sample[event]], q[sample[event]] = new_offset[event], new_slope[event]
    a = 0.5 * (minimum[LOW] + minimum[HIGH])
    r = triangular_factor(fixed, y, times, lags, p, q, a)
    theta, residual = np.zeros(n), np.zeros(y.size)
    regular = _solve(r, n, theta)
    if regular and minimum[FLAT] == 0.0:
        for _ in range(5):
            # Gauss-Newton step in a: project r onto (I - QQ^T) q beta, all inside R.
            along, norm, cost, size = 0.0, 0.0, 0.0, 0.0
            for i in range(n, r.shape[0]):
                column = 0.0
                for j in range(n_lags):
                    column += r[i, n + j] * theta[n_fixed + j]
                along += column * r[i, r.shape[0] - 1]
                norm += column * column
                cost += r[i, r.shape[0] - 1] ** 2
            size = minimum[CELL_RIGHT] - minimum[CELL_LEFT]
            if norm == 0.0:
                break
            b = min(max(a + along / norm, minimum[CELL_LEFT]), minimum[CELL_RIGHT])
            if abs(b - a) <= 1e-13 * (abs(a) + size):
                break
            trial = triangular_factor(fixed, y, times, lags, p, q, b)
            trial_theta = np.zeros(n)
            if not _solve(trial, n, trial_theta):
                break
            trial_cost = 0.0
            for i in range(n, r.shape[0]):
                trial_cost += trial[i, r.shape[0] - 1] ** 2
            if trial_cost >= cost:
                break
            a, r, theta = b, trial, trial_theta
    signal = p + a * q
    if regular:
        for row in range(y.size):
            value = y[row]
            for i in range(n_fixed):
                value -= fixed[row, i] * theta[i]
            for j in range(n_lags):
                value -= signal[times[row] - lags[j]] * theta[n_fixed + j]
            residual[row] = value
    return regular, a, theta, residual, r, signal
