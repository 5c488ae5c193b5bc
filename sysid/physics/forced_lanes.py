"""Runs of a plant with added forces side by side: the same arithmetic on several at a time.

A step is one loop over lanes of arithmetic without branches or calls, which the compiler turns into
vector instructions.  Only where dry friction changes its state within a step does a lane go through the
events of `sysid.physics.forced_kernels`, alone.  The law and the method are those of `forced_runs` there;
results differ by rounding.
"""

import math
from typing import Any, cast

import numba
import numpy as np

from sysid._compile import Kernel, compiled
from sysid.linear.forms import Floats
from sysid.physics import forced_kernels as fk
from sysid.physics.forced_kernels import (
    MOST_CHATTER,
    MOST_STATES,
    SMOOTH,
    STUCK,
    breaking_force,
    cut_step,
    mode_at_zero,
    moved,
    spilled,
)

# Lanes side by side: two vectors of the widest instructions, so that one need not wait for the other.
WIDTH = 16
# Up to so many lanes take half of them; so few are not worth a vector.
HALF, FEW = 8, 1
# Where things stand, in blocks of WIDTH: the coefficients of `forced_kernels`, states, side, motion.
Z, SIDE, MOVING = fk.SIZE, fk.SIZE + MOST_STATES + 1, fk.SIZE + MOST_STATES + 2
BLOCKS = MOVING + 1
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


def branchless(function: Kernel) -> Kernel:
    """Compile a function into its callers, without the branch of a check for division by zero."""
    return cast(Kernel, numba.njit(forceinline=True, nogil=True, error_model="numpy")(function))


@branchless
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


@branchless
def hyperbolic_tangent(x: float) -> float:
    """Return tanh(x), to rounding beside 1."""
    e = falling(2.0 * abs(x))
    t = (1.0 - e) / (1.0 + e)
    return t if x > 0.0 else -t


@branchless
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


@branchless
def lane_rates(w: Floats, i: int, n: int, same: bool, curve: int, z: Any, side: float, moving: float) -> Any:
    """Return the derivative of states and memory of one lane, as `forced_kernels.rates` does.

    ``curve`` tells which of the costly functions are needed.
    """
    z0, z1, z2, z3, memory = z
    s0, s1 = z0, z1
    t0, t1 = z0, z1
    if curve & LEVELS:
        s0, s1 = min(z0, w[_first * WIDTH + i]), min(z1, w[_second * WIDTH + i])
        r0, r1 = math.sqrt(max(s0, 0.0)), math.sqrt(max(s1, 0.0))
        t0 = s0 if w[fk.FIRST_POWER * WIDTH + i] == 1.0 else r0
        t1 = s1 if w[fk.SECOND_POWER * WIDTH + i] == 1.0 else r1
    position = z0 if same else z1
    forward, back = w[fk.FRICTION_FORWARD * WIDTH + i], w[fk.FRICTION_BACK * WIDTH + i]
    dry = forward if side > 0.0 else back
    force = w[fk.CONSTANT * WIDTH + i] - w[fk.DRAG * WIDTH + i] * z0 * abs(z0)
    force -= w[fk.CUBIC * WIDTH + i] * position * position * position
    force -= w[fk.YIELD * WIDTH + i] * memory
    factor = 1.0
    if curve & BREAKS_AWAY:
        ratio = z0 / w[fk.STRIBECK_SPEED * WIDTH + i]
        dry += w[fk.BREAKAWAY * WIDTH + i] * falling(ratio * ratio)
    if curve & SWINGS:
        force -= w[fk.GRAVITY * WIDTH + i] * sine(w[fk.WAVE_NUMBER * WIDTH + i] * position)
    if curve & GAINS:
        output = w[_read * WIDTH + i] * s0 + w[(_read + 1) * WIDTH + i] * s1
        output += (
            w[(_read + 2) * WIDTH + i] * z2 + w[(_read + 3) * WIDTH + i] * z3 + w[(_read + 4) * WIDTH + i]
        )
        factor += w[fk.GAIN * WIDTH + i] * hyperbolic_tangent(output / w[fk.GAIN_SCALE * WIDTH + i])
    force -= side * dry
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
    # Here the stiffness of the elastic-plastic element stands divided by its yield force.
    bend = w[fk.LOOP_BEND * WIDTH + i]
    change = w[fk.ELASTIC * WIDTH + i] * (z0 * (1.0 - bend * abs(memory)) - abs(z0) * memory)
    return moving * d0, d1, d2, d3, change


@branchless
def lane_step(w: Floats, i: int, n: int, same: bool, curve: int, step: float, after: Floats) -> None:
    """Fill ``after`` with the state of one lane after a classical Runge-Kutta step."""
    side, moving = w[SIDE * WIDTH + i], w[MOVING * WIDTH + i]
    x0, x1, x2 = w[Z * WIDTH + i], w[(Z + 1) * WIDTH + i], w[(Z + 2) * WIDTH + i]
    x = (x0, x1, x2, w[(Z + 3) * WIDTH + i], w[(Z + 4) * WIDTH + i])
    a = lane_rates(w, i, n, same, curve, x, side, moving)
    b = lane_rates(w, i, n, same, curve, moved(x, a, 0.5 * step), side, moving)
    c = lane_rates(w, i, n, same, curve, moved(x, b, 0.5 * step), side, moving)
    d = lane_rates(w, i, n, same, curve, moved(x, c, step), side, moving)
    sixth = step / 6.0
    after[i] = x[0] + sixth * (a[0] + 2.0 * (b[0] + c[0]) + d[0])
    after[WIDTH + i] = x[1] + sixth * (a[1] + 2.0 * (b[1] + c[1]) + d[1])
    after[2 * WIDTH + i] = x[2] + sixth * (a[2] + 2.0 * (b[2] + c[2]) + d[2])
    after[3 * WIDTH + i] = x[3] + sixth * (a[3] + 2.0 * (b[3] + c[3]) + d[3])
    after[4 * WIDTH + i] = x[4] + sixth * (a[4] + 2.0 * (b[4] + c[4]) + d[4])


@compiled
def step_of_all(w: Floats, n: int, same: bool, curve: int, step: float, after: Floats, width: int) -> None:
    """Step the first ``width`` lanes; each case is a loop of its own, or it would not become vectors."""
    if n > 2:
        if curve == PLAIN:
            for i in range(width):
                lane_step(w, i, 4, same, PLAIN, step, after)
        elif curve == BREAKS_AWAY:
            for i in range(width):
                lane_step(w, i, 4, same, BREAKS_AWAY, step, after)
        elif curve == SWINGS:
            for i in range(width):
                lane_step(w, i, 4, same, SWINGS, step, after)
        elif curve == GAINS:
            for i in range(width):
                lane_step(w, i, 4, same, GAINS, step, after)
        elif curve == LEVELS:
            for i in range(width):
                lane_step(w, i, 4, same, LEVELS, step, after)
        else:
            for i in range(width):
                lane_step(w, i, 4, same, ALL, step, after)
    else:
        if curve == PLAIN:
            for i in range(width):
                lane_step(w, i, 2, same, PLAIN, step, after)
        elif curve == BREAKS_AWAY:
            for i in range(width):
                lane_step(w, i, 2, same, BREAKS_AWAY, step, after)
        elif curve == SWINGS:
            for i in range(width):
                lane_step(w, i, 2, same, SWINGS, step, after)
        elif curve == GAINS:
            for i in range(width):
                lane_step(w, i, 2, same, GAINS, step, after)
        elif curve == LEVELS:
            for i in range(width):
                lane_step(w, i, 2, same, LEVELS, step, after)
        else:
            for i in range(width):
                lane_step(w, i, 2, same, ALL, step, after)


@compiled
def drift_of_all(w: Floats, n: int, same: bool, after: Floats, drift: Floats, width: int) -> None:
    """Fill in how fast the velocity of each lane would change at the end of a step, were it not held."""
    if n > 2:
        for i in range(width):
            drift[i] = free_drift(w, i, 4, same, after)
    else:
        for i in range(width):
            drift[i] = free_drift(w, i, 2, same, after)


@branchless
def free_drift(w: Floats, i: int, n: int, same: bool, after: Floats) -> float:
    """Return the rate of the velocity of one lane without dry friction."""
    x0, x1, x2 = after[i], after[WIDTH + i], after[2 * WIDTH + i]
    x = (x0, x1, x2, after[3 * WIDTH + i], after[4 * WIDTH + i])
    rate: float = lane_rates(w, i, n, same, DRIFTS, x, 0.0, 1.0)[0]
    return rate


@compiled
def has_levels(w: Floats) -> bool:
    """Tell whether a law takes roots of levels or cuts them off."""
    powers = w[fk.FIRST_POWER] != 1.0 or w[fk.SECOND_POWER] != 1.0
    return bool(powers or w[_first] < np.inf or w[_second] < np.inf)


@compiled
def state_of(z: Floats, place: int) -> Any:
    """Return the state and memory of one lane."""
    return z[place], z[place + WIDTH], z[place + 2 * WIDTH], z[place + 3 * WIDTH], z[place + 4 * WIDTH]


@compiled
def lane_runs(
    plants: Floats,
    n: int,
    same: bool,
    by_input: Floats,
    direct: Floats,
    u: Floats,
    starts: Floats,
    step: float,
    substeps: int,
    y: Floats,
    states: Floats,
) -> None:
    """Simulate several runs; arguments as those of `forced_kernels.forced_runs`."""
    for first in range(0, plants.shape[0], WIDTH):
        last = min(first + WIDTH, plants.shape[0])
        group_runs(
            plants[first:last], n, same, by_input[first:last], direct[first:last],
            u[first:last] if u.shape[0] > 1 else u, starts[first:last], step, substeps,
            y[first:last], states[first:last],
        )  # fmt: skip


@compiled
def group_runs(
    plants: Floats,
    n: int,
    same: bool,
    by_input: Floats,
    direct: Floats,
    u: Floats,
    starts: Floats,
    step: float,
    substeps: int,
    y: Floats,
    states: Floats,
) -> None:
    """Simulate up to WIDTH runs."""
    lanes, m = plants.shape[0], u.shape[2]
    width = lanes if lanes <= FEW else (HALF if lanes <= HALF else WIDTH)
    w, after = np.zeros(BLOCKS * WIDTH), np.zeros((MOST_STATES + 1) * WIDTH)
    by_block, passed = np.zeros(n * m * WIDTH), np.zeros(m * WIDTH)
    signals, value, drift = np.zeros(m * WIDTH), np.zeros(WIDTH), np.zeros(WIDTH)
    rows = plants.copy()
    mode, chatter = np.full(WIDTH, SMOOTH), np.zeros(WIDTH, dtype=np.int64)
    dry, alive = np.zeros(WIDTH, dtype=np.bool_), np.zeros(WIDTH, dtype=np.bool_)
    curve = PLAIN
    for i in range(width):
        lane = min(i, lanes - 1)  # what fills the vector up repeats the last lane
        for j in range(fk.SIZE):
            w[j * WIDTH + i] = plants[lane, j]
        yields = plants[lane, fk.YIELD] > 0.0
        w[fk.ELASTIC * WIDTH + i] = plants[lane, fk.ELASTIC] / plants[lane, fk.YIELD] if yields else 0.0
        for j in range(MOST_STATES):
            w[(Z + j) * WIDTH + i] = starts[lane, j]
        w[MOVING * WIDTH + i] = 1.0
        for c in range(m):
            passed[c * WIDTH + i] = direct[lane, c]
            for j in range(n):
                by_block[(c * n + j) * WIDTH + i] = by_input[lane, j, c]
        bent = plants[lane, fk.BREAKAWAY] != 0.0
        slides = plants[lane, fk.FRICTION_FORWARD] > 0.0 or plants[lane, fk.FRICTION_BACK] > 0.0
        dry[i], alive[i] = i < lanes and (slides or bent), i < lanes
        curve |= BREAKS_AWAY if bent else PLAIN
        curve |= SWINGS if plants[lane, fk.GRAVITY] != 0.0 else PLAIN
        curve |= GAINS if plants[lane, fk.GAIN] != 0.0 else PLAIN
        curve |= LEVELS if has_levels(plants[lane]) else PLAIN
    slow = bool(dry.any()) or states.shape[1] > 0
    for k in range(u.shape[1]):
        for c in range(m):
            for i in range(width):
                signals[c * WIDTH + i] = u[min(i, lanes - 1) if u.shape[0] > 1 else 0, k, c]
        if not driven_and_read(w, n, m, by_block, passed, signals, value, width) or slow:
            running = False
            for i in range(lanes):
                if not alive[i]:
                    continue
                if states.shape[1] > 0:
                    for j in range(MOST_STATES):
                        states[i, k, j] = w[(Z + j) * WIDTH + i]
                if not math.isfinite(value[i]) or chatter[i] > MOST_CHATTER * u.shape[1]:
                    y[i, k:] = np.nan
                    alive[i] = dry[i] = False
                    continue
                running = True
                if dry[i]:
                    for j in range(n):
                        rows[i, _drive + j] = w[(_drive + j) * WIDTH + i]
                    z = state_of(w, Z * WIDTH + i)
                    mode[i] = mode_at_zero(rows[i], n, same, z) if z[0] == 0.0 else (1 if z[0] > 0.0 else -1)
            if not running:
                break
        for i in range(lanes):
            if alive[i]:
                y[i, k] = value[i]
        for _ in range(substeps):
            sticks = False
            for i in range(lanes if slow else 0):
                if dry[i]:
                    sticks = sticks or mode[i] == STUCK
                    w[SIDE * WIDTH + i] = float(mode[i])
                    w[MOVING * WIDTH + i] = 0.0 if mode[i] == STUCK else 1.0
            step_of_all(w, n, same, curve, step, after, width)
            if sticks:
                drift_of_all(w, n, same, after, drift, width)
            for i in range(lanes if slow or curve & LEVELS else 0):
                if dry[i]:
                    trial = state_of(after, i)
                    lasts = mode[i] * trial[0] >= 0.0
                    if mode[i] == STUCK:
                        holding = -drift[i] / w[_push * WIDTH + i]
                        forwards = holding < -breaking_force(rows[i], 1)
                        lasts = not (forwards or holding > breaking_force(rows[i], -1))
                    if not lasts:
                        z = state_of(w, Z * WIDTH + i)
                        end, mode[i], changes = cut_step(rows[i], n, same, z, mode[i], step)
                        chatter[i] += changes
                        for j in range(MOST_STATES + 1):
                            after[j * WIDTH + i] = end[j]
                elif curve & LEVELS:
                    levels = spilled(rows[i], state_of(after, i))
                    after[i], after[WIDTH + i] = levels[0], levels[1]
            for j in range(MOST_STATES + 1):
                for i in range(width):
                    w[(Z + j) * WIDTH + i] = after[j * WIDTH + i]


@compiled
def driven_and_read(
    w: Floats, n: int, m: int, by_block: Floats, passed: Floats, signals: Floats, value: Floats, width: int
) -> bool:
    """Cut levels at their limits, fill in outputs and rates by the inputs; tell whether all is finite."""
    for i in range(width):
        w[Z * WIDTH + i] = min(w[Z * WIDTH + i], w[_first * WIDTH + i])
        w[(Z + 1) * WIDTH + i] = min(w[(Z + 1) * WIDTH + i], w[_second * WIDTH + i])
        total = w[_read * WIDTH + i] * w[Z * WIDTH + i] + w[(_read + 1) * WIDTH + i] * w[(Z + 1) * WIDTH + i]
        total += w[(_read + 2) * WIDTH + i] * w[(Z + 2) * WIDTH + i]
        total += w[(_read + 3) * WIDTH + i] * w[(Z + 3) * WIDTH + i] + w[(_read + 4) * WIDTH + i]
        value[i] = total
    for j in range(n):
        for i in range(width):
            w[(_drive + j) * WIDTH + i] = 0.0
    for c in range(m):
        for i in range(width):
            value[i] += passed[c * WIDTH + i] * signals[c * WIDTH + i]
        for j in range(n):
            for i in range(width):
                w[(_drive + j) * WIDTH + i] += by_block[(c * n + j) * WIDTH + i] * signals[c * WIDTH + i]
    finite = True
    for i in range(width):
        finite &= math.isfinite(value[i])
    return finite
