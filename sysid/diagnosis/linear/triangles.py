"""Compiled least squares on lines: the triangular factor, and damped steps from it."""

from typing import Any

import numpy as np

from sysid._compile import compiled
from sysid.diagnosis.effects.base import Floats

# Element by element: for an assignment of whole rows numba compiles the words of an error about shapes, which
# the first use after an installation would wait for.

# What is left of a line outside those before it, as a share of its length, is rounding below this.
ROUNDING = 1e-13


@compiled
def triangle(lines: Floats, error: Floats) -> tuple[Floats, Floats]:
    r"""Return R and c of :math:`\min_d \|lines^T d - error\|^2 = \min_d \|R d - c\|^2 + rest`.

    By modified Gram-Schmidt with the error as one more line: backward stable, as Householder's reflections
    are, and long lines stay long.  Both arguments are overwritten.

    Parameters
    ----------
    lines : ndarray, shape (n_unknowns, n_rows)
    error : ndarray, shape (n_rows,)

    Returns
    -------
    R : ndarray, shape (n_unknowns, n_unknowns)
        Upper triangular; a row of zeros for a line that depends on those before it.
    c : ndarray, shape (n_unknowns,)

    References
    ----------
    Björck (1967), Solving linear least squares problems by Gram-Schmidt orthogonalization, BIT 7.

    Examples
    --------
    >>> R, c = triangle(np.array([[1.0, 1.0, 1.0], [0.0, 1.0, 2.0]]), np.array([1.0, 3.0, 5.0]))
    >>> np.linalg.solve(R, c).round(12).tolist()
    [1.0, 2.0]
    """
    n = lines.shape[0]
    R, c = np.zeros((n, n)), np.zeros(n)
    lengths = np.empty(n)
    for i in range(n):
        lengths[i] = np.sqrt(np.dot(lines[i], lines[i]))
    for i in range(n):
        q = lines[i]
        length = np.sqrt(np.dot(q, q))
        if length <= ROUNDING * lengths[i]:
            continue
        R[i, i] = length
        for k in range(q.shape[0]):
            q[k] /= length
        if i + 1 < n:
            shares = np.dot(lines[i + 1 :], q)
            for j in range(i + 1, n):
                R[i, j] = shares[j - i - 1]
        for j in range(i + 1, n):
            _take(R[i, j], q, lines[j])
        c[i] = np.dot(q, error)
        _take(c[i], q, error)
    return R, c


@compiled
def _take(share: float, q: Floats, line: Floats) -> None:
    for k in range(q.shape[0]):
        line[k] -= share * q[k]


@compiled
def scaled_triangle(
    lines: Floats, error: Floats, held_low: Any, held_high: Any
) -> tuple[Floats, Floats, Floats]:
    """Return R and c of lines of unit length, and their lengths; lines are overwritten.

    A line whose step would lead down from ``held_low`` or up from ``held_high``, where its unknown is at a
    bound, is left out; so is a line of zeros.  R or c are not finite where a line or the error is not.
    """
    n = lines.shape[0]
    lengths = np.empty(n)
    for i in range(n):
        uphill = np.dot(lines[i], error)
        length = np.sqrt(np.dot(lines[i], lines[i]))
        if length == 0.0 or (held_low[i] and uphill < 0.0) or (held_high[i] and uphill > 0.0):
            lengths[i] = 1.0
            for k in range(lines.shape[1]):
                lines[i, k] = 0.0
        else:
            lengths[i] = length
            for k in range(lines.shape[1]):
                lines[i, k] /= length
    R, c = triangle(lines, error.copy())
    return R, c, lengths


@compiled
def stepped(
    point: Floats, places: Any, step: Floats, lengths: Floats, lower: Floats, upper: Floats
) -> Floats:
    """Return a point moved at some places, by a step in units of 1 / ``lengths``, and drawn within bounds."""
    moved = point.copy()
    for i in range(places.shape[0]):
        moved[places[i]] += step[i] / lengths[i]
    for i in range(moved.shape[0]):
        moved[i] = min(max(moved[i], lower[i]), upper[i])
    return moved


@compiled
def damped_step(R: Floats, c: Floats, damping: float) -> tuple[Floats, float]:
    """Return the d that minimises ``|R d - c|^2 + damping |d|^2``, and what it takes from the first part."""
    n = c.shape[0]
    # R above a multiple of the identity, turned on its side.
    lines, error = np.zeros((n, 2 * n)), np.zeros(2 * n)
    for j in range(n):
        for i in range(j + 1):
            lines[j, i] = R[i, j]
        lines[j, n + j] = np.sqrt(damping)
        error[j] = c[j]
    S, e = triangle(lines, error)
    d = np.zeros(n)
    for i in range(n - 1, -1, -1):
        value = e[i]
        for j in range(i + 1, n):
            value -= S[i, j] * d[j]
        d[i] = value / S[i, i]
    lowered = 0.0
    for i in range(n):
        left = c[i]
        for j in range(i, n):
            left -= R[i, j] * d[j]
        lowered += c[i] ** 2 - left**2
    return d, lowered
