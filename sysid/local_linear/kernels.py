"""Compiled loops over time that are no batch: weights, one simulation and its drives, adjoints.

The loops of `forward` and `backward` know the sizes of the model when they are compiled, so that short
loops are written out.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import cast

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled

Floats = NDArray[np.float64]


@compiled
def soft_weights(
    scheduling: Floats, centres: Floats, widths: Floats, weights: Floats, slopes: Floats
) -> None:
    """Fill the weights (3)-(4), and the slopes of log r_i by width and by centre.

    The largest exponent is taken off before exp, so that a point far from every centre has weights too.
    ``slopes`` has the shape (n_steps, 2, n_models, n_scheduling).
    """
    n_models, n_scheduling = centres.shape
    for k in range(scheduling.shape[0]):
        largest = -np.inf
        for i in range(n_models):
            exponent = 0.0
            for d in range(n_scheduling):
                off, width = scheduling[k, d] - centres[i, d], widths[i, d]
                slope = -2.0 * width * off
                slopes[k, 0, i, d] = slope * off
                slopes[k, 1, i, d] = -slope * width
                exponent -= (width * off) ** 2
            weights[k, i] = exponent
            largest = max(largest, exponent)
        total = 0.0
        for i in range(n_models):
            weights[k, i] = np.exp(weights[k, i] - largest)
            total += weights[k, i]
        for i in range(n_models):
            weights[k, i] /= total


@compiled
def row_products(left: Floats, right: Floats, out: Floats, first: int) -> None:
    """Fill out[k, 0, first:] with the Kronecker product of the rows left[k] and right[k]."""
    n_right = right.shape[1]
    for k in range(left.shape[0]):
        for i in range(left.shape[1]):
            weight = left[k, i]
            begin = first + i * n_right
            for b in range(n_right):
                out[k, 0, begin + b] = weight * right[k, b]


@compiled
def adjoint(A: Floats, source: Floats, mu: Floats) -> Floats:
    """Fill mu[k], the adjoint of x(k+1): mu(k-1) = A_k' mu(k) + source(k), zero at the end; return mu(-1)."""
    n_steps, n = source.shape
    before = np.zeros(n)
    for k in range(n_steps - 1, -1, -1):
        for e in range(n):
            mu[k, e] = before[e]
        for e in range(n):
            total = source[k, e]
            for b in range(n):
                total += A[k, b, e] * mu[k, b]
            before[e] = total
    return before


@compiled
def weight_drives(weights: Floats, slopes: Floats, local: Floats, mixed: Floats, out: Floats) -> None:
    """Fill out[k, e, (kind, i, d)] with p_i slope (local_i - mixed)_e: derivative of a mixture by (w, c).

    ``local`` has the shape (n_steps, n_models, n_states), ``mixed`` is its mean under the weights.
    """
    n_steps, n_models, n = local.shape
    n_scheduling = slopes.shape[3]
    for k in range(n_steps):
        column = 0
        for kind in range(2):
            for i in range(n_models):
                for d in range(n_scheduling):
                    factor = weights[k, i] * slopes[k, kind, i, d]
                    for e in range(n):
                        out[k, e, column] = factor * (local[k, i, e] - mixed[k, e])
                    column += 1


@lru_cache(maxsize=64)
def output_slopes(n: int, p: int) -> Callable[[Floats, float, Floats, int], None]:
    """Return what fills the derivative of sign C x by the entries of C: x(k) on a block diagonal.

    It is called as ``fill(x, sign, out, first)``, with ``out`` of shape (n_steps, p, any).
    """

    def fill(x, sign, out, first):  # type: ignore[no-untyped-def]
        for k in range(out.shape[0]):
            for o in range(p):
                for j in range(n * p):
                    out[k, o, first + j] = 0.0
                for b in range(n):
                    out[k, o, first + o * n + b] = sign * x[k, b]

    return cast(Callable[[Floats, float, Floats, int], None], compiled(fill))


Forward = Callable[[Floats, Floats, Floats, Floats, Floats, Floats, Floats, Floats], None]
Backward = Callable[[Floats, Floats, Floats, Floats, Floats, Floats, Floats, Floats, Floats, Floats], None]


@lru_cache(maxsize=64)
def forward(n: int, s: int, n_channels: int, q: int) -> Forward:
    """Return the simulation that leaves the drives of all sensitivities behind.

    It is called as ``forward(weights, slopes, inputs, gains, start, x, drives, moves)``; ``gains`` has the
    shape (n + n_channels, s * n) and holds the transposes of [A_i B_i O_i] side by side.  It fills x(0) ...
    x(n_samples), ``drives`` with p kron x and ``moves`` with p_i slope (local step i - x(k+1)), see
    `weight_drives`.
    """
    columns, factors = s * n, s * q

    def run(weights, slopes, inputs, gains, start, x, drives, moves):  # type: ignore[no-untyped-def]
        step = np.empty(columns)
        for e in range(n):
            x[0, e] = start[e]
        for k in range(weights.shape[0]):
            for j in range(columns):
                step[j] = 0.0
            for b in range(n_channels):
                u = inputs[k, b]
                for j in range(columns):
                    step[j] += u * gains[n + b, j]
            for b in range(n):
                state = x[k, b]
                for j in range(columns):
                    step[j] += state * gains[b, j]
            for e in range(n):
                total = 0.0
                for i in range(s):
                    total += weights[k, i] * step[i * n + e]
                x[k + 1, e] = total
            for i in range(s):
                weight = weights[k, i]
                for b in range(n):
                    drives[k, 0, i * n + b] = weight * x[k, b]
                for d in range(q):
                    by_width, by_centre = weight * slopes[k, 0, i, d], weight * slopes[k, 1, i, d]
                    for e in range(n):
                        off = step[i * n + e] - x[k + 1, e]
                        moves[k, e, i * q + d] = by_width * off
                        moves[k, e, factors + i * q + d] = by_centre * off

    return cast(Forward, compiled(run))


@lru_cache(maxsize=64)
def backward(n: int, s: int, q: int, p: int) -> Backward:
    """Return the backward pass that sums the gradient while it goes.

    It is called as ``backward(A, C, r, x, drives, moves, mu, by_A, by_C, by_weights)``: ``mu`` is filled with
    the adjoint of x(k+1), and the other three are added to.
    """
    columns, factors = s * n, 2 * s * q

    def run(A, C, r, x, drives, moves, mu, by_A, by_C, by_weights):  # type: ignore[no-untyped-def]
        before = np.zeros(n)
        for k in range(A.shape[0] - 1, -1, -1):
            for e in range(n):
                mu[k, e] = before[e]
            for e in range(n):
                total = 0.0
                for o in range(p):
                    total += r[k, o] * C[o, e]
                for b in range(n):
                    total += A[k, b, e] * mu[k, b]
                before[e] = total
            for e in range(n):
                now = mu[k, e]
                for j in range(columns):
                    by_A[e, j] += now * drives[k, 0, j]
                for j in range(factors):
                    by_weights[j] += now * moves[k, e, j]
            for o in range(p):
                for b in range(n):
                    by_C[o, b] += r[k, o] * x[k, b]

    return cast(Backward, compiled(run))
