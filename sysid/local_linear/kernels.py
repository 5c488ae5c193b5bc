"""Compiled loops over time that are no batch: weights and their slopes, products of rows, one adjoint."""

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
