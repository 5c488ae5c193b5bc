"""Compiled runs of a linear plant without added forces: exact for an input that is held between samples."""

import math

import numpy as np

from sysid._compile import compiled, part_of_kernels
from sysid.linear.forms import Floats
from sysid.physics.forced_kernels import MOST_STATES, READ, STEADY, A


@compiled
def linear_runs(
    plants: Floats,
    n: int,
    by_input: Floats,
    direct: Floats,
    u: Floats,
    starts: Floats,
    period: float,
    y: Floats,
    states: Floats,
) -> None:
    """Simulate several runs of a plant without added forces, exactly for an input held between samples.

    Arguments as those of `sysid.physics.forced_kernels.forced_runs`.
    """
    m = u.shape[2]
    size = n + m + 1
    M, F, power = np.empty((size, size)), np.empty((size, size)), np.empty((size, size))
    G, H = np.zeros((MOST_STATES, MOST_STATES)), np.zeros((MOST_STATES, m + 1))
    for lane in range(plants.shape[0]):
        source = lane if u.shape[0] > 1 else 0
        w = plants[lane]
        M[:] = 0.0
        for i in range(n):
            for j in range(n):
                M[i, j] = w[A + 4 * i + j] * period
            for j in range(m):
                M[i, n + j] = by_input[lane, i, j] * period
            M[i, n + m] = w[STEADY + i] * period
        exponential(M, F, power)
        for i in range(n):
            for j in range(n):
                G[i, j] = F[i, j]
            for j in range(m + 1):
                H[i, j] = F[i, n + j]
        # Four states whatever n, in variables of their own: loops and arrays would take most of the time.
        a0, a1, a2, a3 = G[0, 0], G[0, 1], G[0, 2], G[0, 3]
        b0, b1, b2, b3 = G[1, 0], G[1, 1], G[1, 2], G[1, 3]
        c0, c1, c2, c3 = G[2, 0], G[2, 1], G[2, 2], G[2, 3]
        d0, d1, d2, d3 = G[3, 0], G[3, 1], G[3, 2], G[3, 3]
        r0, r1, r2, r3, steady = w[READ], w[READ + 1], w[READ + 2], w[READ + 3], w[READ + 4]
        x0, x1, x2, x3 = starts[lane, 0], starts[lane, 1], starts[lane, 2], starts[lane, 3]
        for k in range(u.shape[1]):
            value = (r0 * x0 + r1 * x1) + (r2 * x2 + r3 * x3) + steady
            e0, e1, e2, e3 = H[0, m], H[1, m], H[2, m], H[3, m]
            for j in range(m):
                v = u[source, k, j]
                value += direct[lane, j] * v
                e0, e1, e2, e3 = e0 + H[0, j] * v, e1 + H[1, j] * v, e2 + H[2, j] * v, e3 + H[3, j] * v
            y[lane, k] = value
            if states.shape[1] > 0:
                states[lane, k, 0], states[lane, k, 1] = x0, x1
                states[lane, k, 2], states[lane, k, 3] = x2, x3
            x0, x1, x2, x3 = (
                e0 + (a0 * x0 + a1 * x1) + (a2 * x2 + a3 * x3),
                e1 + (b0 * x0 + b1 * x1) + (b2 * x2 + b3 * x3),
                e2 + (c0 * x0 + c1 * x1) + (c2 * x2 + c3 * x3),
                e3 + (d0 * x0 + d1 * x1) + (d2 * x2 + d3 * x3),
            )


@part_of_kernels
def exponential(M: Floats, F: Floats, power: Floats) -> None:
    """Fill F with exp(M): Taylor's series of a matrix halved until it is small, then squared."""
    size = M.shape[0]
    norm = 0.0
    for i in range(size):
        row = 0.0
        for j in range(size):
            row += abs(M[i, j])
        norm = max(norm, row)
    if not math.isfinite(norm):
        F[:] = np.nan
        return
    squarings = 0
    while norm > 0.25 and squarings < 60:
        norm *= 0.5
        squarings += 1
    scale = 0.5**squarings
    # Element by element: an assignment of whole arrays would take seconds to compile.
    term = np.zeros((size, size))
    for i in range(size):
        for j in range(size):
            F[i, j] = term[i, j] = 1.0 if i == j else 0.0
    for order in range(1, 12):  # 0.25**12 / 12! is below rounding
        multiplied(term, M, scale, power)
        for i in range(size):
            for j in range(size):
                term[i, j] = power[i, j] / order
                F[i, j] += term[i, j]
    for _ in range(squarings):
        multiplied(F, F, 1.0, power)
        for i in range(size):
            for j in range(size):
                F[i, j] = power[i, j]


@part_of_kernels
def multiplied(left: Floats, right: Floats, factor: float, product: Floats) -> None:
    """Fill ``product`` with the product of two square matrices and a factor."""
    size = left.shape[0]
    for i in range(size):
        for j in range(size):
            value = 0.0
            for s in range(size):
                value += left[i, s] * right[s, j]
            product[i, j] = value * factor
