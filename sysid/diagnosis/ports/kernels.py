"""A linear plant with one static map in its loop, run and differentiated.

Functions take whole arrays and a row's number, and products are written out: with views of rows they would
cost a third more time, and the first use after an installation would wait for the words of errors about
shapes.
"""

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled, inlined
from sysid.nonlinearities.spline_kernels import LINEAR, clamped, local_basis

Floats = NDArray[np.float64]

# The basis goes on as a straight line: ``int(LINEAR)`` below, for a literal it would be compiled once more.
#
# What the map is fed with: a known signal, a combination of the states, the output, its rate of change;
# or the map stands behind the plant.
KNOWN, STATE, OUTPUT, RATE, BEHIND = 0, 1, 2, 3, 4


@compiled
def run_loop(
    A: Floats,
    B: Floats,
    C: Floats,
    D: Floats,
    E: Floats,
    G: float,
    H: Floats,
    K: Floats,
    v: Floats,
    known: Floats,
    mode: int,
    lag: int,
    sign: float,
    rate: float,
    limit: float,
    knots: Floats,
    degree: int,
    coefficients: Floats,
    start: Floats,
    y: Floats,
    z: Floats,
) -> bool:
    """Run x(k+1) = A x + B v + E s(k - lag), y = C x + D v + G s(k) with s = sign f(z).

    Returns whether the run stayed bounded; ``y`` and ``z`` take the output and the map's input.
    """
    n, n_rows = A.shape[0], v.shape[0]
    full = clamped(knots, degree)
    basis, slopes = np.empty(degree + 1), np.empty(degree + 1)
    state, following = start.copy(), np.empty(n)
    waiting = np.zeros(lag + 1)
    before = 0.0
    for k in range(n_rows):
        value = _combined(C, D, state, v, k)
        if not abs(value) < limit:
            return False
        if mode == KNOWN:
            z[k] = known[k]
        elif mode == STATE:
            z[k] = _combined(H, K, state, v, k)
        elif mode == RATE:
            z[k] = (value - before) * rate if k > 0 else 0.0
        else:
            z[k] = value
        before = value
        first = local_basis(z[k], knots, full, degree, int(LINEAR), basis, slopes)
        s = 0.0
        for r in range(degree + 1):
            s += basis[r] * coefficients[first + r]
        s *= sign
        y[k] = value + G * s
        if mode == BEHIND:
            s = 0.0
        if k == 0:
            for j in range(lag + 1):
                waiting[j] = s
        waiting[k % (lag + 1)] = s
        s = waiting[(k + 1) % (lag + 1)]
        _advance(A, B, E, v, k, s, state, following)
    return True


@compiled
def differentiate_loop(
    A: Floats,
    B: Floats,
    C: Floats,
    D: Floats,
    E: Floats,
    G: float,
    H: Floats,
    K: Floats,
    dA: Floats,
    dB: Floats,
    dC: Floats,
    dD: Floats,
    dE: Floats,
    dG: Floats,
    dH: Floats,
    dK: Floats,
    v: Floats,
    known: Floats,
    mode: int,
    lag: int,
    sign: float,
    rate: float,
    knots: Floats,
    degree: int,
    coefficients: Floats,
    start: Floats,
    J: Floats,
) -> None:
    """Fill the derivatives of the output, shape (n_rows, n_parameters + n_coefficients + n_states).

    The columns belong to the plant's parameters, the map's coefficients and the initial state.
    """
    n, n_rows = A.shape[0], v.shape[0]
    n_plant, n_map = dA.shape[0], coefficients.shape[0]
    width = n_plant + n_map + n
    full = clamped(knots, degree)
    basis, slopes = np.empty(degree + 1), np.empty(degree + 1)
    state, following = start.copy(), np.empty(n)
    # One line for each state: all columns go through a weight side by side, and most weights are zero.
    moved, moved_on = np.zeros((n, width)), np.empty((n, width))
    for i in range(n):
        moved[i, n_plant + n_map + i] = 1.0
    by_state, by_input = _entries(dA), _entries(dB)
    waiting, waiting_moved = np.zeros(lag + 1), np.zeros((lag + 1, width))
    before, before_moved = 0.0, np.zeros(width)
    out, fed, force = np.empty(width), np.zeros(width), np.empty(width)
    for k in range(n_rows):
        value = _combined(C, D, state, v, k)
        _sensed(C, dC, dD, moved, state, v[k], out)
        sensed = 0.0
        if mode == KNOWN:
            sensed = known[k]
        elif mode == STATE:
            sensed = _combined(H, K, state, v, k)
            _sensed(H, dH, dK, moved, state, v[k], fed)
        elif mode == RATE:
            per_row = rate if k > 0 else 0.0
            sensed = (value - before) * per_row
            for q in range(width):
                fed[q] = (out[q] - before_moved[q]) * per_row
        else:
            sensed = value
            for q in range(width):
                fed[q] = out[q]
        before = value
        for q in range(width):
            before_moved[q] = out[q]
        first = local_basis(sensed, knots, full, degree, int(LINEAR), basis, slopes)
        s, rise = 0.0, 0.0
        for r in range(degree + 1):
            s += basis[r] * coefficients[first + r]
            rise += slopes[r] * coefficients[first + r]
        s *= sign
        for q in range(width):
            force[q] = sign * rise * fed[q]
        for r in range(degree + 1):
            force[n_plant + first + r] += sign * basis[r]
        for q in range(width):
            J[k, q] = out[q] + G * force[q]
        for q in range(n_plant):
            J[k, q] += dG[q] * s
        if mode == BEHIND:
            s = 0.0
            for q in range(width):
                force[q] = 0.0
        if k == 0:
            for j in range(lag + 1):
                waiting[j] = s
                for q in range(width):
                    waiting_moved[j, q] = force[q]
        waiting[k % (lag + 1)] = s
        for q in range(width):
            waiting_moved[k % (lag + 1), q] = force[q]
        place = (k + 1) % (lag + 1)
        s = waiting[place]
        for i in range(n):
            for q in range(width):
                moved_on[i, q] = E[i] * waiting_moved[place, q]
            for j in range(n):
                weight = A[i, j]
                if weight != 0.0:
                    for q in range(width):
                        moved_on[i, q] += weight * moved[j, q]
            for q in range(n_plant):
                moved_on[i, q] += dE[q, i] * s
        _add_products(by_state, dA, state, moved_on)
        _add_products(by_input, dB, v[k], moved_on)
        for i in range(n):
            for q in range(width):
                moved[i, q] = moved_on[i, q]
        _advance(A, B, E, v, k, s, state, following)


@inlined
def _combined(by_state: Floats, by_input: Floats, state: Floats, v: Floats, k: int) -> float:
    """Return a combination of the states and of the inputs of row k."""
    value = 0.0
    for j in range(by_state.shape[0]):
        value += by_state[j] * state[j]
    for j in range(by_input.shape[0]):
        value += by_input[j] * v[k, j]
    return value


@inlined
def _advance(
    A: Floats, B: Floats, E: Floats, v: Floats, k: int, s: float, state: Floats, following: Floats
) -> None:
    """Move the state on by a row: A x + B v + E s; ``following`` is room to work in."""
    for i in range(state.shape[0]):
        value = E[i] * s
        for j in range(state.shape[0]):
            value += A[i, j] * state[j]
        for j in range(v.shape[1]):
            value += B[i, j] * v[k, j]
        following[i] = value
    for i in range(state.shape[0]):
        state[i] = following[i]


@compiled
def _sensed(
    weights: Floats, d_state: Floats, d_input: Floats, moved: Floats, state: Floats, v: Floats, out: Floats
) -> None:
    """Fill how a combination of states and inputs changes, its own weights included."""
    for q in range(out.shape[0]):
        out[q] = 0.0
    for j in range(weights.shape[0]):
        for q in range(out.shape[0]):
            out[q] += weights[j] * moved[j, q]
    for q in range(d_state.shape[0]):
        for j in range(d_state.shape[1]):
            out[q] += d_state[q, j] * state[j]
        for j in range(d_input.shape[1]):
            out[q] += d_input[q, j] * v[j]


@compiled
def _entries(weights: Floats) -> NDArray[np.int64]:
    """Return the places of weights other than zero, shape (n_entries, 3)."""
    count = 0
    found = np.empty((weights.size, 3), dtype=np.int64)
    for q in range(weights.shape[0]):
        for i in range(weights.shape[1]):
            for j in range(weights.shape[2]):
                if weights[q, i, j] != 0.0:
                    found[count, 0], found[count, 1], found[count, 2] = q, i, j
                    count += 1
    return found[:count]


@compiled
def _add_products(entries: NDArray[np.int64], weights: Floats, signal: Floats, out: Floats) -> None:
    """Add to each state's line what the weights other than zero make of a signal."""
    for e in range(entries.shape[0]):
        q, i, j = entries[e, 0], entries[e, 1], entries[e, 2]
        out[i, q] += weights[q, i, j] * signal[j]
