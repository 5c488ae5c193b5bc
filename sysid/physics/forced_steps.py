"""One step of a plant with added forces on several lanes at once, compiled for what a law needs.

A step is a loop over lanes of arithmetic without branches or calls, which the compiler turns into vector
instructions.  Costly functions are in it only where a law takes them; each such step is compiled when it is
asked for the first time, which takes a second.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from sysid._compile import called_by_kernels, inlined
from sysid.linear.forms import Floats
from sysid.physics import forced_kernels as fk
from sysid.physics.forced_kernels import MOST_STATES, moved

# Lanes side by side: two vectors of the widest instructions, so that one need not wait for the other.
WIDTH = 16
# Where things stand, in blocks of WIDTH: the coefficients of `forced_kernels` without laws of the user's own,
# states, side, motion, states after a step.  All are in one array, so that the compiler knows which of them
# cannot overlap.
Z, SIDE, MOVING = fk.SIZE, fk.SIZE + MOST_STATES + 1, fk.SIZE + MOST_STATES + 2
AFTER = MOVING + 1
BLOCKS = AFTER + MOST_STATES + 1
# What takes a costly function, by bits: exp of the speed, sine of the position, tanh of the output, root
# and rim of a level.
PLAIN, BREAKS_AWAY, SWINGS, GAINS, LEVELS, ALL = 0, 1, 2, 4, 8, 15
DRIFTS = ALL - BREAKS_AWAY
# exp(-FARTHEST) is nothing beside 1.
FARTHEST = 40.0
# pi in two parts, of which the first has so few digits that small multiples of it are exact.
PI_HEAD, PI_TAIL = 3.14159265160560607910, 1.98418714791870343106e-9

# Coefficients of the exponential's series.
_E2, _E3, _E4, _E5, _E6, _E7, _E8, _E9, _E10 = (1.0 / math.factorial(k) for k in range(2, 11))
_E11, _E12, _E13, _E14, _E15, _E17, _E19 = (1.0 / math.factorial(k) for k in (11, 12, 13, 14, 15, 17, 19))

_first, _second = fk.FIRST_CAP, fk.SECOND_CAP
_steady, _drive, _push, _read = fk.STEADY, fk.DRIVE, fk.PUSH, fk.READ


@inlined
def falling(t: float) -> float:
    """Return exp(-t) for t >= 0: Taylor's series of a sixty-fourth of t, squared six times.

    The series is summed in pairs, pairs of pairs and so on: next to no operation waits for the one before.
    """
    r = -min(t, FARTHEST) / 64.0
    r2 = r * r
    r4 = r2 * r2
    low = (1.0 + r) + r2 * (_E2 + _E3 * r) + r4 * ((_E4 + _E5 * r) + r2 * (_E6 + _E7 * r))
    high = (_E8 + _E9 * r) + r2 * (_E10 + _E11 * r) + r4 * ((_E12 + _E13 * r) + r2 * (_E14 + _E15 * r))
    s = low + r4 * r4 * high
    s *= s
    s *= s
    s *= s
    s *= s
    s *= s
    return s * s


@inlined
def hyperbolic_tangent(x: float) -> float:
    """Return tanh(x), to rounding beside 1."""
    e = falling(2.0 * abs(x))
    t = (1.0 - e) / (1.0 + e)
    return t if x > 0.0 else -t


@inlined
def sine(x: float) -> float:
    """Return sin(x): the multiple of pi next to x is taken off, then Taylor's series in pairs."""
    turns = np.floor(x * (1.0 / math.pi) + 0.5)
    r: float = (x - turns * PI_HEAD) - turns * PI_TAIL
    q = r * r
    q2 = q * q
    q4 = q2 * q2
    low = (1.0 - _E3 * q) + q2 * (_E5 - _E7 * q) + q4 * ((_E9 - _E11 * q) + q2 * (_E13 - _E15 * q))
    s = low + q4 * q4 * (_E17 - _E19 * q)
    odd = turns - 2.0 * np.floor(0.5 * turns)
    value: float = (1.0 - 2.0 * odd) * r * s
    return value


@inlined
def plain_force(w: Floats, i: int, same: bool, z0: float, z1: float, memory: float) -> float:
    """Return the sum of the forces on one lane that take no costly function."""
    position = z0 if same else z1
    force: float = w[fk.CONSTANT * WIDTH + i] - w[fk.DRAG * WIDTH + i] * z0 * abs(z0)
    force -= w[fk.CUBIC * WIDTH + i] * position * position * position
    force -= w[fk.YIELD * WIDTH + i] * memory
    return force


@inlined
def linear_rates(
    w: Floats, i: int, n: int, t0: float, t1: float, z2: float, z3: float, factor: float, force: float
) -> Any:
    """Return the derivative of the states of one lane under its input, taken so many times, and a force."""
    d0 = w[_steady * WIDTH + i] + factor * w[_drive * WIDTH + i] + w[_push * WIDTH + i] * force
    d1 = (
        w[(_steady + 1) * WIDTH + i]
        + factor * w[(_drive + 1) * WIDTH + i]
        + w[(_push + 1) * WIDTH + i] * force
    )
    d0 += w[i] * t0 + w[WIDTH + i] * t1
    d1 += w[4 * WIDTH + i] * t0 + w[5 * WIDTH + i] * t1
    d2 = 0.0
    d3 = 0.0
    if n > 2:
        d0 += w[2 * WIDTH + i] * z2 + w[3 * WIDTH + i] * z3
        d1 += w[6 * WIDTH + i] * z2 + w[7 * WIDTH + i] * z3
        d2 = w[(_steady + 2) * WIDTH + i] + factor * w[(_drive + 2) * WIDTH + i]
        d2 += w[(_push + 2) * WIDTH + i] * force + w[8 * WIDTH + i] * t0 + w[9 * WIDTH + i] * t1
        d2 += w[10 * WIDTH + i] * z2 + w[11 * WIDTH + i] * z3
        d3 = w[(_steady + 3) * WIDTH + i] + factor * w[(_drive + 3) * WIDTH + i]
        d3 += w[(_push + 3) * WIDTH + i] * force + w[12 * WIDTH + i] * t0 + w[13 * WIDTH + i] * t1
        d3 += w[14 * WIDTH + i] * z2 + w[15 * WIDTH + i] * z3
    return d0, d1, d2, d3


@inlined
def lane_rates(w: Floats, i: int, n: int, same: bool, curve: int, z: Any, side: float, moving: float) -> Any:
    """Return the derivative of states and memory of one lane, as `forced_kernels.rates` does.

    ``curve`` tells which of the costly functions are needed: what depends on it is compiled for each anew.
    """
    z0, z1, z2, z3, memory = z
    s0, s1 = z0, z1
    t0, t1 = z0, z1
    if curve & LEVELS:
        s0, s1 = min(z0, w[_first * WIDTH + i]), min(z1, w[_second * WIDTH + i])
        r0, r1 = math.sqrt(max(s0, 0.0)), math.sqrt(max(s1, 0.0))
        t0 = s0 if w[fk.FIRST_POWER * WIDTH + i] == 1.0 else r0
        t1 = s1 if w[fk.SECOND_POWER * WIDTH + i] == 1.0 else r1
    forward, back = w[fk.FRICTION_FORWARD * WIDTH + i], w[fk.FRICTION_BACK * WIDTH + i]
    dry = forward if side > 0.0 else back
    force = plain_force(w, i, same, z0, z1, memory)
    factor = 1.0
    if curve & BREAKS_AWAY:
        ratio = z0 / w[fk.STRIBECK_SPEED * WIDTH + i]
        dry += w[fk.BREAKAWAY * WIDTH + i] * falling(ratio * ratio)
    if curve & SWINGS:
        force -= w[fk.GRAVITY * WIDTH + i] * sine(w[fk.WAVE_NUMBER * WIDTH + i] * (z0 if same else z1))
    if curve & GAINS:
        output = w[_read * WIDTH + i] * s0 + w[(_read + 1) * WIDTH + i] * s1
        output += (
            w[(_read + 2) * WIDTH + i] * z2 + w[(_read + 3) * WIDTH + i] * z3 + w[(_read + 4) * WIDTH + i]
        )
        factor += w[fk.GAIN * WIDTH + i] * hyperbolic_tangent(output / w[fk.GAIN_SCALE * WIDTH + i])
    d0, d1, d2, d3 = linear_rates(w, i, n, t0, t1, z2, z3, factor, force - side * dry)
    # Here the stiffness of the elastic-plastic element stands divided by its yield force.
    bend = w[fk.LOOP_BEND * WIDTH + i]
    change = w[fk.ELASTIC * WIDTH + i] * (z0 * (1.0 - bend * abs(memory)) - abs(z0) * memory)
    return moving * d0, d1, d2, d3, change


@inlined
def lane_step(w: Floats, i: int, n: int, same: bool, curve: int, step: float) -> None:
    """Fill in the state of one lane after a classical Runge-Kutta step."""
    side, moving = w[SIDE * WIDTH + i], w[MOVING * WIDTH + i]
    x0, x1, x2 = w[Z * WIDTH + i], w[(Z + 1) * WIDTH + i], w[(Z + 2) * WIDTH + i]
    x = (x0, x1, x2, w[(Z + 3) * WIDTH + i], w[(Z + 4) * WIDTH + i])
    a = lane_rates(w, i, n, same, curve, x, side, moving)
    b = lane_rates(w, i, n, same, curve, moved(x, a, 0.5 * step), side, moving)
    c = lane_rates(w, i, n, same, curve, moved(x, b, 0.5 * step), side, moving)
    d = lane_rates(w, i, n, same, curve, moved(x, c, step), side, moving)
    sixth = step / 6.0
    w[AFTER * WIDTH + i] = x[0] + sixth * (a[0] + 2.0 * (b[0] + c[0]) + d[0])
    w[(AFTER + 1) * WIDTH + i] = x[1] + sixth * (a[1] + 2.0 * (b[1] + c[1]) + d[1])
    w[(AFTER + 2) * WIDTH + i] = x[2] + sixth * (a[2] + 2.0 * (b[2] + c[2]) + d[2])
    w[(AFTER + 3) * WIDTH + i] = x[3] + sixth * (a[3] + 2.0 * (b[3] + c[3]) + d[3])
    w[(AFTER + 4) * WIDTH + i] = x[4] + sixth * (a[4] + 2.0 * (b[4] + c[4]) + d[4])


@inlined
def free_drift(w: Floats, i: int, n: int, same: bool) -> float:
    """Return the rate of the velocity of one lane without dry friction."""
    x0, x1, x2 = w[AFTER * WIDTH + i], w[(AFTER + 1) * WIDTH + i], w[(AFTER + 2) * WIDTH + i]
    x = (x0, x1, x2, w[(AFTER + 3) * WIDTH + i], w[(AFTER + 4) * WIDTH + i])
    rate: float = lane_rates(w, i, n, same, DRIFTS, x, 0.0, 1.0)[0]
    return rate


@lru_cache(maxsize=32)
def step_of_all(n: int, curve: int) -> Callable[[Floats, bool, float, int], None]:
    """Return what fills in the states of the first lanes after a step.

    Parameters
    ----------
    n : int
        States: up to 2 or up to 4.
    curve : int
        Costly functions that are needed, one of the bits or all.

    Returns
    -------
    callable
        Of the lanes, whether position and velocity are one, the step [s], and how many lanes there are; for
        kernels alone.
    """

    @called_by_kernels("void(f8[::1], b1, f8, i8)")
    def stepped(w: Floats, same: bool, step: float, width: int) -> None:
        for i in range(width):
            lane_step(w, i, n, same, curve, step)

    return stepped


@lru_cache(maxsize=2)
def drift_of_all(n: int) -> Callable[[Floats, bool, Floats, int], None]:
    """Return what fills in how fast velocities would change at the end of a step, were they not held.

    Arguments as those of `step_of_all`, with room for the rates.
    """

    @called_by_kernels("void(f8[::1], b1, f8[::1], i8)")
    def drifted(w: Floats, same: bool, drift: Floats, width: int) -> None:
        for i in range(width):
            drift[i] = free_drift(w, i, n, same)

    return drifted
