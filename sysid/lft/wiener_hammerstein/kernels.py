"""Recursions of the Wiener-Hammerstein model, compiled: the output and all its derivatives in one pass.

A row passes three stages: the front block, the map (between samples, too, if it is asked for) and the back
block. Each linear block has the form of `sysid.linear`: second-order sections 1 + a1 q^-1 + a2 q^-2, whose
Kautz columns (two for each section, one for a last section of first order) take the block's input one sample
late and carry the weights, and a direct term with the last weight.  Inner loops run over many columns or many
rows, so that the processor takes several at a time.
"""

import numpy as np

from sysid._compile import compiled
from sysid.linear.forms import Floats
from sysid.nonlinearities.spline_kernels import clamped, local_basis

# Rows that are turned at a time: so many fit into the fastest cache.
TILE = 16


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
def add_weighted(signal: Floats, first: int, taps: Floats, out: Floats) -> None:
    """Add sum_q taps[q] signal[first + i + q] to ``out[i]``; the number of taps is a multiple of four.

    Loops run along the rows, four taps at a time, so that sums stay in registers.
    """
    for q in range(0, taps.shape[0], 4):
        t0, t1, t2, t3 = taps[q], taps[q + 1], taps[q + 2], taps[q + 3]
        s = signal[first + q : first + q + out.shape[0] + 3]
        for i in range(out.shape[0]):
            out[i] += t0 * s[i] + t1 * s[i + 1] + t2 * s[i + 2] + t3 * s[i + 3]


@compiled
def map_columns(
    front: Floats, knots: Floats, degree: int, extrapolation: int, coefficients: Floats, out: Floats
) -> None:
    """Fill the map's basis functions at z and w' times the derivatives of z; one signal a row of ``out``."""
    n_basis, n_rows = coefficients.shape[0], front.shape[1]
    full = clamped(knots, degree)
    values, rates, slope = np.empty(degree + 1), np.empty(degree + 1), np.zeros(n_rows)
    out[:n_basis] = 0.0
    for k in range(n_rows):
        first = local_basis(front[0, k], knots, full, degree, extrapolation, values, rates)
        for r in range(degree + 1):
            out[first + r, k] = values[r]
            slope[k] += rates[r] * coefficients[first + r]
    for c in range(1, front.shape[0]):
        for k in range(n_rows):
            out[n_basis + c - 1, k] = slope[k] * front[c, k]


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
    too, and the same taps limit its output to the band of the samples again.  ``front``, one signal a row,
    then begins 2 L samples before the first one of ``rows`` and ends 2 L after the last one; without points
    between, the map acts at samples alone.
    """
    n_between, length = taps.shape
    n_rows, n_signals, n_columns = rows.shape[0], rows.shape[1], front.shape[0]
    margin = length if n_between > 0 else 0
    total = np.empty((n_signals, n_rows))
    here = front[:, margin : margin + n_rows]
    map_columns(here, knots, degree, extrapolation, coefficients, total)
    points = np.empty((n_columns, n_rows + length))
    between = np.empty((n_signals, n_rows + length))
    for p in range(n_between):
        points[:] = 0.0
        for c in range(n_columns):
            add_weighted(front[c], 1, taps[p], points[c])
        map_columns(points, knots, degree, extrapolation, coefficients, between)
        backwards = taps[p, ::-1].copy()
        for c in range(n_signals):
            add_weighted(between[c], 0, backwards, total[c])
    share = 1.0 / (n_between + 1.0)
    for start in range(0, n_rows, TILE):
        for c in range(n_signals):
            for k in range(start, min(start + TILE, n_rows)):
                rows[k, c] = share * total[c, k]


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
