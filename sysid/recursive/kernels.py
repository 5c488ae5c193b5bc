"""Compiled steps of the recursive estimators; arguments are trusted, never checked here.

A step takes the regressor of sample t, corrects the estimate with y(t), and then shifts u(t) and
y(t) into the regressor of sample t + 1.  The input comes as the number of its level, -1 for zero.
"""

import math

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

FORGOTTEN = 1e-140
"""A diagonal element of R below this holds no information: it comes from forgetting alone."""


@compiled
def shift(phi: Floats, order: int, level: int, value: float, y: float) -> None:
    """Move every lag of the regressor (3.8b) by one sample and put the newest in front."""
    for block in range(0, phi.size, order):
        for i in range(block + order - 1, block, -1):
            phi[i] = phi[i - 1]
        phi[block] = 0.0
    phi[0] = -y
    if level >= 0:
        phi[order * (1 + level)] = value


@compiled
def gradient_step(
    theta: Floats,
    phi: Floats,
    order: int,
    step: float,
    offset: float,
    radius: float,
    level: int,
    value: float,
    y: float,
) -> float:
    """Normalised gradient with projection on a ball, (4.1); return the prediction error.

    ``offset`` is the 1 of the printed denominator; with 0 this is Kaczmarz's method.
    """
    error, size = y, offset
    for i in range(phi.size):
        error -= phi[i] * theta[i]
        size += phi[i] * phi[i]
    if size > 0.0:
        gain = step * error / size
        square = 0.0
        for i in range(phi.size):
            theta[i] += gain * phi[i]
            square += theta[i] * theta[i]
        # Written as a condition, the projection never divides by the norm of a zero vector.
        if square > radius * radius:
            shrink = radius / math.sqrt(square)
            for i in range(phi.size):
                theta[i] *= shrink
    shift(phi, order, level, value, y)
    return error


@compiled
def least_squares_step(
    theta: Floats,
    phi: Floats,
    factor: Floats,
    order: int,
    root: float,
    level: int,
    value: float,
    y: float,
) -> float:
    """Recursive least squares by Givens rotations of [R z]; return the prediction error.

    ``factor`` (p + 1, p + 1) holds the triangle R, beside it z = Q^T y, and in its last row the row
    that is rotated in; ``root`` is the square root of the forgetting factor.
    """
    p = phi.size
    error = y
    for i in range(p):
        error -= phi[i] * theta[i]
        factor[p, i] = phi[i]
    factor[p, p] = y
    if root != 1.0:
        for i in range(p):
            for j in range(i, p + 1):
                factor[i, j] *= root
    for i in range(p):
        low = factor[p, i]
        if low == 0.0:
            continue
        high = factor[i, i]
        length = math.hypot(high, low)
        c, s = high / length, low / length
        factor[i, i] = length
        for j in range(i + 1, p + 1):
            upper, lower = factor[i, j], factor[p, j]
            factor[i, j] = c * upper + s * lower
            factor[p, j] = c * lower - s * upper
    for i in range(p - 1, -1, -1):
        rest = factor[i, p]
        for j in range(i + 1, p):
            rest -= factor[i, j] * theta[j]
        # What was forgotten down to nothing keeps its last estimate; 0/0 would be no better.
        if abs(factor[i, i]) > FORGOTTEN:
            theta[i] = rest / factor[i, i]
    shift(phi, order, level, value, y)
    return error


@compiled
def gradient_run(
    theta: Floats,
    phi: Floats,
    order: int,
    step: float,
    offset: float,
    radius: float,
    values: Floats,
    levels: Indices,
    y: Floats,
    errors: Floats,
    kept: Floats,
    every: int,
) -> None:
    """Run many steps; row i of ``kept`` is the estimate after (i + 1) ``every`` samples."""
    for t in range(y.size):
        level = levels[t]
        value = values[level] if level >= 0 else 0.0
        errors[t] = gradient_step(theta, phi, order, step, offset, radius, level, value, y[t])
        if (t + 1) % every == 0:
            kept[t // every] = theta


@compiled
def least_squares_run(
    theta: Floats,
    phi: Floats,
    factor: Floats,
    order: int,
    root: float,
    values: Floats,
    levels: Indices,
    y: Floats,
    errors: Floats,
    kept: Floats,
    every: int,
) -> None:
    """Run many steps; row i of ``kept`` is the estimate after (i + 1) ``every`` samples."""
    for t in range(y.size):
        level = levels[t]
        value = values[level] if level >= 0 else 0.0
        errors[t] = least_squares_step(theta, phi, factor, order, root, level, value, y[t])
        if (t + 1) % every == 0:
            kept[t // every] = theta


@compiled
def regressor_rows(order: int, values: Floats, levels: Indices, y: Floats, rows: Floats) -> None:
    """Write the regressor of every sample, from rest."""
    phi = np.zeros(rows.shape[1])
    for t in range(y.size):
        rows[t] = phi
        level = levels[t]
        shift(phi, order, level, values[level] if level >= 0 else 0.0, y[t])
