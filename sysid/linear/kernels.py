"""Recursions of linear filters, compiled.

Sign convention: A(q) = 1 + a1 q^-1 + ..., so that y(k) = -a1 y(k-1) - ... .
"""

import numpy as np

from sysid._compile import compiled
from sysid.linear.forms import Floats


@compiled
def polynomial_filter(b: Floats, a: Floats, u: Floats, state: Floats, y: Floats) -> None:
    """Filter ``u`` by B/A into ``y`` in transposed direct form; ``state`` is carried on.

    ``b`` and ``a`` have equal length, ``a[0]`` is 1, ``state`` has one element less.
    """
    order = a.shape[0] - 1
    for k in range(u.shape[0]):
        value = b[0] * u[k]
        if order > 0:
            value += state[0]
        for i in range(order - 1):
            state[i] = state[i + 1] + b[i + 1] * u[k] - a[i + 1] * value
        if order > 0:
            state[order - 1] = b[order] * u[k] - a[order] * value
        y[k] = value


@compiled
def state_space_filter(
    A: Floats, B: Floats, C: Floats, D: Floats, u: Floats, state: Floats, y: Floats
) -> None:
    """Run x(k+1) = A x + B u, y = C x + D u into ``y``; ``state`` is carried on.

    Explicit loops: a matrix product of this size costs thirty times more inside the recursion.
    """
    order, n_inputs, n_outputs = A.shape[0], B.shape[1], C.shape[0]
    following = np.empty(order)
    for k in range(u.shape[0]):
        for i in range(n_outputs):
            value = 0.0
            for j in range(order):
                value += C[i, j] * state[j]
            for j in range(n_inputs):
                value += D[i, j] * u[k, j]
            y[k, i] = value
        for i in range(order):
            value = 0.0
            for j in range(order):
                value += A[i, j] * state[j]
            for j in range(n_inputs):
                value += B[i, j] * u[k, j]
            following[i] = value
        for i in range(order):
            state[i] = following[i]


@compiled
def kautz_columns(signal: Floats, a1: Floats, a2: Floats, order: int, state: Floats, columns: Floats) -> None:
    """Fill the columns that span (1, q^-1, ..., q^-(n-1)) signal / A for A = A1 A2 ... .

    Each section A_j = 1 + a1_j q^-1 + a2_j q^-2 gives two columns, x(k) + x(k-1) and x(k) - x(k-1),
    and hands the signal on through the all-pass filter with the same poles: for white noise all
    columns are orthogonal, wherever the poles lie (Kautz functions).  A last section of first
    order gives one column.  ``columns`` has shape (order, n_rows); ``state`` (n_sections, 2).
    """
    n_sections = a1.shape[0]
    for k in range(signal.shape[0]):
        value = signal[k]
        for j in range(n_sections):
            last, before = state[j, 0], state[j, 1]
            x = value - a1[j] * last - a2[j] * before
            if 2 * j + 1 < order:
                columns[2 * j, k] = x + last
                columns[2 * j + 1, k] = x - last
                value = a2[j] * x + a1[j] * last + before
            else:
                columns[2 * j, k] = x
            state[j, 1] = last
            state[j, 0] = x


@compiled
def all_pole_filter(signal: Floats, a1: Floats, a2: Floats, state: Floats, out: Floats) -> None:
    """Filter by 1 / (A1 A2 ...) into ``out``; ``state`` has shape (n_sections, 2)."""
    for k in range(signal.shape[0]):
        value = signal[k]
        for j in range(a1.shape[0]):
            value -= a1[j] * state[j, 0] + a2[j] * state[j, 1]
            state[j, 1] = state[j, 0]
            state[j, 0] = value
        out[k] = value


@compiled
def sensitivity_columns(
    output: Floats, a1: Floats, a2: Floats, order: int, state: Floats, columns: Floats
) -> None:
    """Fill d(output)/d(a1_j) = -q^-1 output / A_j and d(output)/d(a2_j) = -q^-2 output / A_j.

    This is the derivative of B u / (A1 A2 ...) with B held; ``columns`` has shape (order, n_rows).
    """
    for j in range(a1.shape[0]):
        last, before = state[j, 0], state[j, 1]
        both = 2 * j + 1 < order
        for k in range(output.shape[0]):
            columns[2 * j, k] = -last
            if both:
                columns[2 * j + 1, k] = -before
            value = output[k] - a1[j] * last - a2[j] * before
            before = last
            last = value
        state[j, 0], state[j, 1] = last, before


@compiled
def section_states(A: Floats, B: Floats, start: Floats, u: Floats, x: Floats, S: Floats) -> None:
    """Fill the states of x(k+1) = A x + B u for two states, shape (2, n_rows), and their derivatives.

    ``S`` has shape (2, 6 + 2 n_inputs, n_rows) and holds the derivatives by the entries of A, of B (both row
    by row) and of the initial state; with an empty last axis none are computed.
    """
    m, n_rows = u.shape[1], u.shape[0]
    wanted = S.shape[2] > 0
    columns = 6 + 2 * m
    now, following = np.zeros((2, columns)), np.zeros((2, columns))
    now[0, 4 + 2 * m] = 1.0
    now[1, 5 + 2 * m] = 1.0
    x0, x1 = start[0], start[1]
    for k in range(n_rows):
        x[0, k] = x0
        x[1, k] = x1
        if wanted:
            for c in range(columns):
                S[0, c, k] = now[0, c]
                S[1, c, k] = now[1, c]
                following[0, c] = A[0, 0] * now[0, c] + A[0, 1] * now[1, c]
                following[1, c] = A[1, 0] * now[0, c] + A[1, 1] * now[1, c]
            following[0, 0] += x0
            following[0, 1] += x1
            following[1, 2] += x0
            following[1, 3] += x1
            for j in range(m):
                following[0, 4 + j] += u[k, j]
                following[1, 4 + m + j] += u[k, j]
            for c in range(columns):
                now[0, c] = following[0, c]
                now[1, c] = following[1, c]
        y0 = A[0, 0] * x0 + A[0, 1] * x1
        y1 = A[1, 0] * x0 + A[1, 1] * x1
        for j in range(m):
            y0 += B[0, j] * u[k, j]
            y1 += B[1, j] * u[k, j]
        x0, x1 = y0, y1
