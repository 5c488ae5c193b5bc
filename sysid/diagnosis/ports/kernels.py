"""A linear plant with one static map in its loop, run and differentiated.

Products and copies of rows are written out: as functions of views they would cost a third more time, and
the first use after an installation would wait for the words of errors about shapes.
"""

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled
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
    n, m, n_rows = A.shape[0], v.shape[1], v.shape[0]
    full = clamped(knots, degree)
    basis, slopes = np.empty(degree + 1), np.empty(degree + 1)
    state, following = start.copy(), np.empty(n)
    waiting = np.zeros(lag + 1)
    before = 0.0
    for k in range(n_rows):
        value = 0.0
        for j in range(n):
            value += C[j] * state[j]
        for j in range(m):
            value += D[j] * v[k, j]
        if not abs(value) < limit:
            return False
        if mode == KNOWN:
            z[k] = known[k]
        elif mode == STATE:
            z[k] = 0.0
            for j in range(n):
                z[k] += H[j] * state[j]
            for j in range(m):
                z[k] += K[j] * v[k, j]
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
        for i in range(n):
            value = E[i] * s
            for j in range(n):
                value += A[i, j] * state[j]
            for j in range(m):
                value += B[i, j] * v[k, j]
            following[i] = value
        for i in range(n):
            state[i] = following[i]
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
    n, m, n_rows = A.shape[0], v.shape[1], v.shape[0]
    n_plant, n_map = dA.shape[0], coefficients.shape[0]
    width = n_plant + n_map + n
    full = clamped(knots, degree)
    basis, slopes = np.empty(degree + 1), np.empty(degree + 1)
    state, following = start.copy(), np.empty(n)
    moved, moved_on = np.zeros((width, n)), np.empty(n)
    for i in range(n):
        moved[n_plant + n_map + i, i] = 1.0
    waiting, waiting_moved = np.zeros(lag + 1), np.zeros((lag + 1, width))
    before, before_moved = 0.0, np.zeros(width)
    out, fed, force = np.empty(width), np.empty(width), np.empty(width)
    for k in range(n_rows):
        value = 0.0
        for j in range(n):
            value += C[j] * state[j]
        for j in range(m):
            value += D[j] * v[k, j]
        for q in range(width):
            slope = 0.0
            for j in range(n):
                slope += C[j] * moved[q, j]
            if q < n_plant:
                for j in range(n):
                    slope += dC[q, j] * state[j]
                for j in range(m):
                    slope += dD[q, j] * v[k, j]
            out[q] = slope
        sensed = 0.0
        if mode == KNOWN:
            sensed = known[k]
            for q in range(width):
                fed[q] = 0.0
        elif mode == STATE:
            for j in range(n):
                sensed += H[j] * state[j]
            for j in range(m):
                sensed += K[j] * v[k, j]
            for q in range(width):
                slope = 0.0
                for j in range(n):
                    slope += H[j] * moved[q, j]
                if q < n_plant:
                    for j in range(n):
                        slope += dH[q, j] * state[j]
                    for j in range(m):
                        slope += dK[q, j] * v[k, j]
                fed[q] = slope
        elif mode == RATE:
            if k > 0:
                sensed = (value - before) * rate
                for q in range(width):
                    fed[q] = (out[q] - before_moved[q]) * rate
            else:
                for q in range(width):
                    fed[q] = 0.0
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
            if q < n_plant:
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
        for q in range(width):
            for i in range(n):
                slope = E[i] * waiting_moved[place, q]
                for j in range(n):
                    slope += A[i, j] * moved[q, j]
                if q < n_plant:
                    slope += dE[q, i] * s
                    for j in range(n):
                        slope += dA[q, i, j] * state[j]
                    for j in range(m):
                        slope += dB[q, i, j] * v[k, j]
                moved_on[i] = slope
            for i in range(n):
                moved[q, i] = moved_on[i]
        for i in range(n):
            value = E[i] * s
            for j in range(n):
                value += A[i, j] * state[j]
            for j in range(m):
                value += B[i, j] * v[k, j]
            following[i] = value
        for i in range(n):
            state[i] = following[i]
