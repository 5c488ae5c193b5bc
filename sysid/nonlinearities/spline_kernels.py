"""B-splines, compiled: basis, slopes and derivatives by the knots at single points.

Knots stand with the first and the last one repeated ``degree`` times (clamped), so that the first
coefficient is the value at the left end and the last one that at the right end.
"""

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled

Floats = NDArray[np.float64]

CONSTANT, LINEAR = 0, 1


@compiled
def interval_of(z: float, knots: Floats) -> int:
    """Return the interval [knots[i], knots[i + 1]) that holds ``z``; the last one takes its right end."""
    first, last = 0, knots.shape[0] - 1
    while last - first > 1:
        middle = (first + last) // 2
        if z < knots[middle]:
            last = middle
        else:
            first = middle
    return first


@compiled
def clamped(knots: Floats, degree: int) -> Floats:
    """Return the knots with both ends repeated ``degree`` times more."""
    n = knots.shape[0]
    full = np.empty(n + 2 * degree)
    for i in range(full.shape[0]):
        full[i] = knots[min(max(i - degree, 0), n - 1)]
    return full


@compiled
def local_basis(
    z: float, knots: Floats, full: Floats, degree: int, extrapolation: int, values: Floats, slopes: Floats
) -> int:
    """Fill values and slopes of the ``degree + 1`` basis functions alive at ``z``; return the first one.

    Outside the knots the basis goes on as a straight line or stays constant.
    """
    n = knots.shape[0]
    inside = min(max(z, knots[0]), knots[n - 1])
    i = interval_of(inside, knots)
    last = i + degree  # the interval's place among the clamped knots
    values[0] = 1.0
    for d in range(1, degree + 1):
        if d == degree:  # values still holds the basis of one degree less, which gives the slopes
            for r in range(degree + 1):
                slope = 0.0
                if r > 0:
                    slope += values[r - 1] / (full[last + r] - full[last + r - degree])
                if r < degree:
                    slope -= values[r] / (full[last + r + 1] - full[last + r + 1 - degree])
                slopes[r] = degree * slope
        carried = 0.0
        for r in range(d):
            right, left = full[last + r + 1], full[last + r + 1 - d]
            share = values[r] / (right - left)
            values[r] = carried + (right - inside) * share
            carried = (inside - left) * share
        values[d] = carried
    if z != inside:
        for r in range(degree + 1):
            if extrapolation == LINEAR:
                values[r] += slopes[r] * (z - inside)
            else:
                slopes[r] = 0.0
    return i


@compiled
def fill_basis(
    z: Floats, knots: Floats, degree: int, extrapolation: int, basis: Floats, slopes: Floats
) -> None:
    """Fill the basis and its slopes, shape (n_points, n_basis); both must hold zeros."""
    full = clamped(knots, degree)
    values, rates = np.empty(degree + 1), np.empty(degree + 1)
    for k in range(z.shape[0]):
        first = local_basis(z[k], knots, full, degree, extrapolation, values, rates)
        for r in range(degree + 1):
            basis[k, first + r] = values[r]
            slopes[k, first + r] = rates[r]


@compiled
def fill_values(
    z: Floats,
    knots: Floats,
    degree: int,
    extrapolation: int,
    coefficients: Floats,
    values: Floats,
    slopes: Floats,
) -> None:
    """Fill values and slopes of one spline, shape (n_points,)."""
    full = clamped(knots, degree)
    local, rates = np.empty(degree + 1), np.empty(degree + 1)
    for k in range(z.shape[0]):
        first = local_basis(z[k], knots, full, degree, extrapolation, local, rates)
        value, slope = 0.0, 0.0
        for r in range(degree + 1):
            value += local[r] * coefficients[first + r]
            slope += rates[r] * coefficients[first + r]
        values[k], slopes[k] = value, slope


@compiled
def fill_by_knots(
    z: Floats, knots: Floats, degree: int, extrapolation: int, coefficients: Floats, out: Floats
) -> None:
    """Fill the derivatives of the spline by its knots, coefficients held, shape (n_points, n_knots).

    Inside, de Boor's recursion for the value is differentiated by every knot it meets; a repeated
    end knot moves with all its copies.
    """
    n = knots.shape[0]
    full = clamped(knots, degree)
    control = np.empty(degree + 1)
    moved = np.empty((degree + 1, n))
    for k in range(z.shape[0]):
        for j in range(n):
            out[k, j] = 0.0
        if z[k] < knots[0] or z[k] > knots[n - 1]:
            at_left = z[k] < knots[0]
            end, inner = (0, 1) if at_left else (n - 1, n - 2)
            c = coefficients.shape[0]
            rise = coefficients[1] - coefficients[0] if at_left else coefficients[c - 2] - coefficients[c - 1]
            slope = degree * rise / (knots[inner] - knots[end])
            if extrapolation == LINEAR:
                stretch = (z[k] - knots[end]) / (knots[inner] - knots[end])
                out[k, end] = -slope + slope * stretch
                out[k, inner] = -slope * stretch
            continue
        i = interval_of(z[k], knots)
        for r in range(degree + 1):
            control[r] = coefficients[i + r]
            for j in range(n):
                moved[r, j] = 0.0
        for d in range(1, degree + 1):
            for r in range(degree, d - 1, -1):
                left, right = i + r, i + r + degree + 1 - d  # places among the clamped knots
                width = full[right] - full[left]
                share = (z[k] - full[left]) / width
                rise = control[r] - control[r - 1]
                for j in range(n):
                    moved[r, j] = share * moved[r, j] + (1.0 - share) * moved[r - 1, j]
                moved[r, min(max(left - degree, 0), n - 1)] += rise * (share - 1.0) / width
                moved[r, min(max(right - degree, 0), n - 1)] -= rise * share / width
                control[r] += (share - 1.0) * rise
        for j in range(n):
            out[k, j] = moved[degree, j]
