"""Compiled simulators of the demonstration plants, written apart from the models that are fitted.

They share no line with those models: what both had from one place would be wrong in both and not be seen.

A force is a vector of `FORCE_SIZE` numbers, every entry zero when its law is absent:

====  ==========================================================
0     quadratic drag, f = c v |v|
1     cubic stiffness, f = k x^3
2     gravity on a pendulum, f = g sin(x)
3     constant force, f = f0
4     cubic damping, f = c v^3
5, 6  presliding hysteresis, f = F z with l dz/dt = v - |v| z (Dahl's law)
7, 8  dry friction against positive and against negative motion
9     how much the breakaway force exceeds the sliding one, as a share (Stribeck)
10    velocity at which that excess has fallen to 1/e
====  ==========================================================
"""

import math

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled

Floats = NDArray[np.float64]

FORCE_SIZE = 11
_FREE, _STUCK = 2, 0
_BISECTIONS = 40
_EVENTS = 50


@compiled
def _smooth_force(force: Floats, position: float, velocity: float) -> float:
    total: float = force[0] * velocity * abs(velocity) + force[1] * position**3
    total += force[2] * math.sin(position) + force[3] + force[4] * velocity**3
    return total


@compiled
def difference_response(a: Floats, b: Floats, u: Floats, force: Floats, gain: Floats) -> Floats:
    """Simulate y = B/A w, w = u (1 + g tanh(y / scale)) - force(y, y - y before), from rest.

    Parameters
    ----------
    a, b : ndarray, shape (order,)
        A = 1 + a1 q^-1 + ... and B = b1 q^-1 + ....
    u : ndarray, shape (n_samples,)
    force : ndarray, shape (FORCE_SIZE,)
        Without dry friction and presliding.
    gain : ndarray, shape (2,)
        g and scale of the operating-point gain.

    Returns
    -------
    ndarray, shape (n_samples,)
    """
    n, order = u.size, a.size
    y, w = np.zeros(n), np.zeros(n)
    before = 0.0
    for k in range(n):
        value = 0.0
        for i in range(1, min(order, k) + 1):
            value += b[i - 1] * w[k - i] - a[i - 1] * y[k - i]
        y[k] = value
        w[k] = u[k] * (1.0 + gain[0] * math.tanh(value / gain[1])) - _smooth_force(
            force, value, value - before
        )
        before = value
    return y


@compiled
def _derivative(
    matrix: Floats,
    column: Floats,
    u: float,
    places: NDArray[np.int64],
    inverse_mass: float,
    force: Floats,
    gain: Floats,
    mode: int,
    x: Floats,
    slope: Floats,
) -> float:
    """Fill `slope` with dx/dt and return the net force on the rubbing body without its dry friction."""
    position, velocity, output = places[0], places[1], places[2]
    n = column.size
    driven = u * (1.0 + gain[0] * math.tanh(x[output] / gain[1]))
    for i in range(n):
        total = column[i] * driven
        for j in range(n):
            total += matrix[i, j] * x[j]
        slope[i] = total
    v = x[velocity]
    slope[n] = (v - abs(v) * x[n]) / force[6] if force[6] > 0.0 else 0.0
    against = _smooth_force(force, x[position], v) + force[5] * x[n]
    net: float = slope[velocity] / inverse_mass - against
    dry = 0.0
    if mode == 1 or mode == -1:
        excess = force[9] * math.exp(-((v / force[10]) ** 2)) if force[10] > 0.0 else 0.0
        dry = (force[7] if mode == 1 else -force[8]) * (1.0 + excess)
    slope[velocity] = 0.0 if mode == 0 else inverse_mass * (net - dry)
    return net


@compiled
def _runge_kutta(
    matrix: Floats,
    column: Floats,
    u: float,
    places: NDArray[np.int64],
    inverse_mass: float,
    force: Floats,
    gain: Floats,
    mode: int,
    x: Floats,
    step: float,
    work: Floats,
) -> None:
    """Write the state after `step` into ``work[5]``; ``work`` has 6 rows."""
    n = x.size
    _derivative(matrix, column, u, places, inverse_mass, force, gain, mode, x, work[0])
    for stage in range(1, 4):
        share = step if stage == 3 else 0.5 * step
        for i in range(n):
            work[4, i] = x[i] + share * work[stage - 1, i]
        _derivative(matrix, column, u, places, inverse_mass, force, gain, mode, work[4], work[stage])
    for i in range(n):
        work[5, i] = x[i] + step / 6.0 * (work[0, i] + 2.0 * work[1, i] + 2.0 * work[2, i] + work[3, i])


@compiled
def _grip(net: float, force: Floats) -> int:
    """Return the motion that starts from rest: -1, 0 (held by dry friction) or 1."""
    if net > force[7] * (1.0 + force[9]):
        return 1
    if net < -force[8] * (1.0 + force[9]):
        return -1
    return 0


@compiled
def mechanics_response(
    matrix: Floats,
    column: Floats,
    places: NDArray[np.int64],
    inverse_mass: float,
    u: Floats,
    period: float,
    substeps: int,
    force: Floats,
    gain: Floats,
) -> Floats:
    """Simulate dx/dt = A x + B u with forces and dry friction on one body; the input is held.

    Runge-Kutta steps of fourth order; where the body stops or breaks away the step is cut at that
    instant, found by bisection, so dry friction costs no accuracy.

    Parameters
    ----------
    matrix, column : ndarray, shapes (n, n) and (n,)
        A and B.
    places : ndarray of int, shape (3,)
        Which states are position and velocity of the body, and the output.
    inverse_mass : float
    u : ndarray, shape (n_samples,)
    period : float
        Sampling period [s].
    substeps : int
        Steps a sample.
    force : ndarray, shape (FORCE_SIZE,)
    gain : ndarray, shape (2,)

    Returns
    -------
    ndarray, shape (n_samples,)
        The output at the sampling instants, the first at rest.
    """
    n = column.size
    x = np.zeros(n + 1)
    work = np.zeros((6, n + 1))
    y = np.empty(u.size)
    velocity = places[1]
    rubbing = force[7] > 0.0 or force[8] > 0.0
    mode = _STUCK if rubbing else _FREE
    for k in range(u.size):
        y[k] = x[places[2]]
        for _ in range(substeps):
            left = period / substeps
            for _event in range(_EVENTS):
                if mode == _STUCK:
                    net = _derivative(
                        matrix, column, u[k], places, inverse_mass, force, gain, mode, x, work[0]
                    )
                    mode = _grip(net, force)
                _runge_kutta(matrix, column, u[k], places, inverse_mass, force, gain, mode, x, left, work)
                if not _passed(matrix, column, u[k], places, inverse_mass, force, gain, mode, work):
                    x[:] = work[5]
                    break
                early, late = 0.0, left
                for _cut in range(_BISECTIONS):
                    middle = 0.5 * (early + late)
                    _runge_kutta(
                        matrix, column, u[k], places, inverse_mass, force, gain, mode, x, middle, work
                    )
                    if _passed(matrix, column, u[k], places, inverse_mass, force, gain, mode, work):
                        late = middle
                    else:
                        early = middle
                _runge_kutta(matrix, column, u[k], places, inverse_mass, force, gain, mode, x, late, work)
                x[:] = work[5]
                x[velocity] = 0.0
                left -= late
                mode = _STUCK
                if left <= 0.0:
                    break
    return y


@compiled
def _passed(
    matrix: Floats,
    column: Floats,
    u: float,
    places: NDArray[np.int64],
    inverse_mass: float,
    force: Floats,
    gain: Floats,
    mode: int,
    work: Floats,
) -> bool:
    """Tell whether the step has gone past a stop (sliding) or a breakaway (held)."""
    if mode == 2:
        return False
    if mode == 0:
        net = _derivative(matrix, column, u, places, inverse_mass, force, gain, mode, work[5], work[0])
        return _grip(net, force) != 0
    return bool(mode * work[5, places[1]] < 0.0)


@compiled
def tanks_response(
    outflow: Floats,
    pump: float,
    root: bool,
    rim: float,
    u: Floats,
    period: float,
    substeps: int,
    gain: Floats,
) -> Floats:
    """Simulate two tanks in cascade from empty; the input is held.

    x1' = pump u - q1, x2' = q1 - q2, q = outflow x or outflow sqrt(x); what rises above the rim is lost.

    Parameters
    ----------
    outflow : ndarray, shape (2,)
    pump : float
    root : bool
        Whether the outflow goes with the square root of the level.
    rim : float
        Largest level of both tanks, inf for none.
    u : ndarray, shape (n_samples,)
    period : float
    substeps : int
    gain : ndarray, shape (2,)
        g and scale of the operating-point gain.

    Returns
    -------
    ndarray, shape (n_samples,)
        Level of the lower tank.
    """
    upper, lower = 0.0, 0.0
    y = np.empty(u.size)
    step = period / substeps
    slopes = np.zeros((4, 2))  # the first is read (times zero) before it is written
    for k in range(u.size):
        y[k] = lower
        for _ in range(substeps):
            for stage in range(4):
                share = 0.0 if stage == 0 else (step if stage == 3 else 0.5 * step)
                before = max(stage - 1, 0)
                # Within a step, too, nothing stands above the rim: it would flow on otherwise.
                one = min(upper + share * slopes[before, 0], rim)
                two = min(lower + share * slopes[before, 1], rim)
                if root:
                    first, second = (
                        outflow[0] * math.sqrt(max(one, 0.0)),
                        outflow[1] * math.sqrt(max(two, 0.0)),
                    )
                else:
                    first, second = outflow[0] * one, outflow[1] * two
                driven = pump * u[k] * (1.0 + gain[0] * math.tanh(two / gain[1]))
                slopes[stage, 0] = driven - first
                slopes[stage, 1] = first - second
            upper += step / 6.0 * (slopes[0, 0] + 2.0 * slopes[1, 0] + 2.0 * slopes[2, 0] + slopes[3, 0])
            lower += step / 6.0 * (slopes[0, 1] + 2.0 * slopes[1, 1] + 2.0 * slopes[2, 1] + slopes[3, 1])
            upper, lower = min(upper, rim), min(lower, rim)
    return y


@compiled
def backlash(u: Floats, upper: float, lower: float) -> Floats:
    """Return the play operator's output: it follows u - upper upwards and u + lower downwards."""
    x = np.empty(u.size)
    output = 0.0
    for k in range(u.size):
        output = min(max(output, u[k] - upper), u[k] + lower)
        x[k] = output
    return x


@compiled
def rate_limit(u: Floats, rate: float) -> Floats:
    """Return what follows u by at most `rate` a sample, from zero."""
    x = np.empty(u.size)
    output = 0.0
    for k in range(u.size):
        output += min(max(u[k] - output, -rate), rate)
        x[k] = output
    return x


@compiled
def hysteresis_relay(u: Floats, threshold: float) -> Floats:
    """Return the sign of the last input beyond the threshold, zero before the first."""
    x = np.empty(u.size)
    output = 0.0
    for k in range(u.size):
        if u[k] > threshold:
            output = 1.0
        elif u[k] < -threshold:
            output = -1.0
        x[k] = output
    return x
