"""Recursions of the Wiener-Hammerstein model, compiled: the output and all its derivatives in one pass.

A row passes three stages: the front block, the map (between samples, too, if it is asked for) and the back
block. Each linear block has the form of `sysid.linear`: second-order sections 1 + a1 q^-1 + a2 q^-2, whose
Kautz columns (two for each section, one for a last section of first order) take the block's input one sample
late and carry the weights, and a direct term with the last weight.  Inner loops run over the columns, so that
the processor takes several of them at a time.
"""

import numpy as np

from sysid._compile import compiled
from sysid.linear.forms import Floats
from sysid.nonlinearities.spline_kernels import clamped, local_basis


@compiled
def block_step(a1: Floats, a2: Floats, order: int, late: float, state: Floats, columns: Floats) -> None:
    """Take one sample, already late by one, into the Kautz columns of a block, shape (order,)."""
    value = late
    for j in range(a1.shape[0]):
        last, before = state[j, 0], state[j, 1]
        x = value - a1[j] * last - a2[j] * before
        if 2 * j + 1 < order:
            columns[2 * j] = x + last
            columns[2 * j + 1] = x - last
            value = a2[j] * x + a1[j] * last + before
        else:
            columns[2 * j] = x
        state[j, 1] = last
        state[j, 0] = x


@compiled
def pole_step(a1: Floats, a2: Floats, order: int, output: float, state: Floats, columns: Floats) -> None:
    """Give -q^-1 output / A_j and -q^-2 output / A_j: the output's derivatives by a1_j and a2_j, B held."""
    for j in range(a1.shape[0]):
        last, before = state[j, 0], state[j, 1]
        columns[2 * j] = -last
        if 2 * j + 1 < order:
            columns[2 * j + 1] = -before
        state[j, 1] = last
        state[j, 0] = output - a1[j] * last - a2[j] * before


@compiled
def front_rows(
    u: Floats,
    late: Floats,
    a1: Floats,
    a2: Floats,
    weights: Floats,
    state: Floats,
    pole_state: Floats,
    rows: Floats,
) -> None:
    """Fill z = G1 u and, where ``rows`` has room, its derivatives by (a1_1, a2_1, ...) and the weights.

    ``late``, shape (1,), holds the sample before; all states are carried on.
    """
    order = weights.shape[0] - 1
    wanted = rows.shape[1] > 1
    columns, poles = np.empty(order), np.empty(order)
    for k in range(u.shape[0]):
        block_step(a1, a2, order, late[0], state, columns)
        late[0] = u[k]
        z = weights[order] * u[k]
        for i in range(order):
            z += weights[i] * columns[i]
        rows[k, 0] = z
        if wanted:
            pole_step(a1, a2, order, z, pole_state, poles)
            for i in range(order):
                rows[k, 1 + i] = poles[i]
                rows[k, 1 + order + i] = columns[i]
            rows[k, 1 + 2 * order] = u[k]


@compiled
def map_point(
    front: Floats,
    knots: Floats,
    full: Floats,
    degree: int,
    extrapolation: int,
    coefficients: Floats,
    values: Floats,
    slopes: Floats,
    out: Floats,
) -> None:
    """Give the map's basis functions at z = front[0] and the slope times the derivatives of z."""
    n_basis, n_columns = coefficients.shape[0], front.shape[0]
    first = local_basis(front[0], knots, full, degree, extrapolation, values, slopes)
    for c in range(n_basis):
        out[c] = 0.0
    slope = 0.0
    for r in range(degree + 1):
        out[first + r] = values[r]
        slope += slopes[r] * coefficients[first + r]
    for c in range(1, n_columns):
        out[n_basis + c - 1] = slope * front[c]


@compiled
def map_rows(
    front: Floats,
    taps: Floats,
    knots: Floats,
    degree: int,
    extrapolation: int,
    coefficients: Floats,
    rows: Floats,
) -> None:
    """Fill the map's basis functions and w' times the derivatives of z, averaged over a sampling period.

    ``taps``, shape (n_between, 2 L), interpolate z at so many points between two samples; the map acts there,
    too, and the same taps limit its output to the band of the samples again.  ``front`` then begins 2 L rows
    before the first one of ``rows`` and ends 2 L rows after the last one; without points between, the map
    acts at samples alone.
    """
    n_between, length = taps.shape
    n_rows, n_signals, n_columns = rows.shape[0], rows.shape[1], front.shape[1]
    full = clamped(knots, degree)
    values, slopes = np.empty(degree + 1), np.empty(degree + 1)
    margin = length if n_between > 0 else 0
    for k in range(n_rows):
        map_point(
            front[k + margin], knots, full, degree, extrapolation, coefficients, values, slopes, rows[k]
        )
    if n_between == 0:
        return
    between = np.empty((n_rows + length, n_signals))
    point = np.empty(n_columns)
    for p in range(n_between):
        for i in range(n_rows + length):
            point[:] = 0.0
            for q in range(length):
                tap = taps[p, q]
                for c in range(n_columns):
                    point[c] += tap * front[i + 1 + q, c]
            map_point(point, knots, full, degree, extrapolation, coefficients, values, slopes, between[i])
        for k in range(n_rows):
            for q in range(length):
                tap = taps[p, q]
                for c in range(n_signals):
                    rows[k, c] += tap * between[k + length - 1 - q, c]
    for k in range(n_rows):
        for c in range(n_signals):
            rows[k, c] /= n_between + 1.0


@compiled
def back_rows(
    signals: Floats,
    a1: Floats,
    a2: Floats,
    weights: Floats,
    late: Floats,
    filters: Floats,
    rows: Floats,
) -> None:
    """Filter all columns of ``signals`` by the back block into the first columns of ``rows``.

    ``late`` holds the signals of the row before, ``filters`` the states, shape (n_sections, 2, n_signals).
    """
    n_signals, order = signals.shape[1], weights.shape[0] - 1
    for k in range(signals.shape[0]):
        for c in range(n_signals):
            rows[k, c] = weights[order] * signals[k, c]
        for j in range(a1.shape[0]):
            first, second = a1[j], a2[j]
            if 2 * j + 1 < order:
                now, then = weights[2 * j] + weights[2 * j + 1], weights[2 * j] - weights[2 * j + 1]
            else:
                now, then = weights[2 * j], 0.0
            for c in range(n_signals):
                last, before = filters[j, 0, c], filters[j, 1, c]
                x = late[c] - first * last - second * before
                rows[k, c] += now * x + then * last
                late[c] = second * x + first * last + before
                filters[j, 1, c] = last
                filters[j, 0, c] = x
        for c in range(n_signals):
            late[c] = signals[k, c]


@compiled
def back_derivatives(
    w: Floats,
    late: Floats,
    a1: Floats,
    a2: Floats,
    weights: Floats,
    state: Floats,
    pole_state: Floats,
    rows: Floats,
) -> None:
    """Fill the derivatives of G2 w by (a1_1, a2_1, ...) and by the weights of G2."""
    order = weights.shape[0] - 1
    for k in range(w.shape[0]):
        block_step(a1, a2, order, late[0], state, rows[k, order : 2 * order])
        late[0] = w[k]
        rows[k, 2 * order] = w[k]
        output = weights[order] * w[k]
        for i in range(order):
            output += weights[i] * rows[k, order + i]
        pole_step(a1, a2, order, output, pole_state, rows[k, :order])


@compiled
def all_pole_rows(noise: Floats, rows: Floats, first: int) -> None:
    """Filter each column by 1/D in place from row ``first`` on; the rows before hold earlier results."""
    for k in range(first, rows.shape[0]):
        for i in range(1, min(noise.shape[0], k + 1)):
            for c in range(rows.shape[1]):
                rows[k, c] -= noise[i] * rows[k - i, c]
