"""Compiled simulation of a linear plant with added forces: Runge-Kutta steps between located events.

One compiled program serves every model of up to four states and every sum of effects: each effect
only sets its coefficients in one law that holds all terms.

Between two changes of the state of dry friction (sliding to one side, sliding to the other, sticking)
the motion is smooth and a Runge-Kutta step of fourth order holds.  A step over a change is cut at the
change: the velocity is zero there to rounding, and the force that would hold the body decides whether
it sticks.  So nothing is regularised, and the error stays of fourth order in the step.

The states are z0 .. z3 with the velocity first and the position second, or the levels of the tanks in
this order; memory is the state of the elastic-plastic element.
"""

import math
from collections.abc import Callable
from typing import cast

import numpy as np

from sysid._compile import compiled, inlined, part_of_kernels
from sysid.linear.forms import Floats

State = tuple[float, float, float, float, float]
# Laws of the user's own: the force ``law(0, position, velocity, w)``, the factor of the input
# ``law(1, output, 0, w)``.
OwnKernel = Callable[[int, float, float, Floats], float]

MOST_STATES = 4
# Where things stand in the vector of coefficients w: A by rows, constant rates, rates by the input,
# rates by the force, output by the states and its constant; then the law.
A, STEADY, DRIVE, PUSH, READ, LAW = 0, 16, 20, 24, 28, 33
FRICTION_FORWARD, FRICTION_BACK = LAW, LAW + 1  # sliding friction to either side
BREAKAWAY, STRIBECK_SPEED = LAW + 2, LAW + 3  # how much more friction at rest, and how fast it is lost
DRAG, CUBIC = LAW + 4, LAW + 5
GRAVITY, WAVE_NUMBER, CONSTANT = LAW + 6, LAW + 7, LAW + 8
ELASTIC, YIELD = LAW + 9, LAW + 10  # stiffness and yield force of the elastic-plastic element
GAIN, GAIN_SCALE = LAW + 11, LAW + 12
FIRST_POWER, SECOND_POWER = LAW + 13, LAW + 14  # of the levels, with which the outflows go
FIRST_CAP, SECOND_CAP = LAW + 15, LAW + 16
CAUGHT = LAW + 17  # share of what the first tank overflows that the second one catches
LOOP_BEND = LAW + 18  # how the elastic-plastic element softens on the way out and back alike
OWN = LAW + 19  # whether there are laws of the user's own, whose parameters come behind
SIZE = LAW + 20

# Modes; 1 and -1 are sliding to either side.  numba compiles once more for each plain number it is given.
SMOOTH, STUCK = cast(int, np.int64(2)), cast(int, np.int64(0))
# Changes that are located in one step; a body that chatters faster is held until the step's end.
MOST_EVENTS = 12
# A run with more changes than this in each sample is given up: its body is next to massless.
MOST_CHATTER = 10
ROOT_STEPS = 60
# An event's velocity or force is zero to this share of its change over the step.
EVENT_TOLERANCE = 1e-13


@inlined
def sliding_friction(w: Floats, velocity: float, side: int) -> float:
    """Return the dry friction while sliding to one side."""
    total = w[FRICTION_FORWARD] if side > 0 else w[FRICTION_BACK]
    if w[BREAKAWAY] != 0.0:
        ratio = velocity / w[STRIBECK_SPEED]
        total += w[BREAKAWAY] * math.exp(-ratio * ratio)
    friction: float = -side * total
    return friction


@inlined
def smooth_force(w: Floats, position: float, velocity: float, memory: float) -> float:
    """Return the sum of the forces that are continuous in position, velocity and memory."""
    force: float = w[CONSTANT] - w[DRAG] * velocity * abs(velocity)
    force -= w[CUBIC] * position * position * position
    if w[GRAVITY] != 0.0:
        force -= w[GRAVITY] * math.sin(w[WAVE_NUMBER] * position)
    force -= w[YIELD] * memory
    return force


@inlined
def outflow(level: float, power: float) -> float:
    """Return a power of a level, the root by the faster function."""
    full = max(level, 0.0)
    flow: float = math.sqrt(full) if power == 0.5 else full**power
    return flow


@inlined
def rates(w: Floats, n: int, same: bool, z: State, mode: int, own: OwnKernel) -> State:
    """Return the derivative of states and memory; the velocity's as if no dry friction acted when stuck."""
    z0, z1, z2, z3, memory = z
    s0, s1 = min(z0, w[FIRST_CAP]), min(z1, w[SECOND_CAP])
    factor = 1.0
    if w[GAIN] != 0.0 or w[OWN] != 0.0:
        output = w[READ] * s0 + w[READ + 1] * s1 + w[READ + 2] * z2 + w[READ + 3] * z3 + w[READ + 4]
        if w[GAIN] != 0.0:
            factor += w[GAIN] * math.tanh(output / w[GAIN_SCALE])
        if w[OWN] != 0.0:
            factor *= own(1, output, 0.0, w)
    if w[FIRST_POWER] != 1.0:
        s0 = outflow(s0, w[FIRST_POWER])
    if w[SECOND_POWER] != 1.0:
        s1 = outflow(s1, w[SECOND_POWER])
    position = z0 if same else z1
    force = smooth_force(w, position, z0, memory)
    if w[OWN] != 0.0:
        force -= own(0, position, z0, w)
    if mode == 1 or mode == -1:
        force += sliding_friction(w, z0, mode)
    d0 = w[STEADY] + factor * w[DRIVE] + w[PUSH] * force + w[A] * s0 + w[A + 1] * s1
    d1 = w[STEADY + 1] + factor * w[DRIVE + 1] + w[PUSH + 1] * force + w[A + 4] * s0 + w[A + 5] * s1
    d2 = d3 = 0.0
    if n > 2:
        d0 += w[A + 2] * z2 + w[A + 3] * z3
        d1 += w[A + 6] * z2 + w[A + 7] * z3
        d2 = w[STEADY + 2] + factor * w[DRIVE + 2] + w[PUSH + 2] * force
        d2 += w[A + 8] * s0 + w[A + 9] * s1 + w[A + 10] * z2 + w[A + 11] * z3
        d3 = w[STEADY + 3] + factor * w[DRIVE + 3] + w[PUSH + 3] * force
        d3 += w[A + 12] * s0 + w[A + 13] * s1 + w[A + 14] * z2 + w[A + 15] * z3
    change = 0.0
    if w[YIELD] > 0.0:
        change = w[ELASTIC] / w[YIELD] * (z0 * (1.0 - w[LOOP_BEND] * abs(memory)) - abs(z0) * memory)
    return d0, d1, d2, d3, change


@inlined
def spilled(w: Floats, z: State) -> State:
    """Return the levels cut off at the rims, what the first tank spilled in part in the second one.

    What has risen above a rim in a step has run over, whenever in the step that was: so no water is lost,
    and the run depends on the limits without jumps.
    """
    over = max(z[0] - w[FIRST_CAP], 0.0)
    if over > 0.0:
        z = (w[FIRST_CAP], z[1] + w[CAUGHT] * over, z[2], z[3], z[4])
    return z[0], min(z[1], w[SECOND_CAP]), z[2], z[3], z[4]


@inlined
def moved(z: State, d: State, step: float) -> State:
    """Return the state moved along a rate."""
    return (
        z[0] + step * d[0],
        z[1] + step * d[1],
        z[2] + step * d[2],
        z[3] + step * d[3],
        z[4] + step * d[4],
    )


@inlined
def kept(d: State, mode: int) -> State:
    """Return the rates with the velocity's zero when stuck."""
    return (0.0 if mode == STUCK else d[0]), d[1], d[2], d[3], d[4]


@inlined
def fourth_order_step(
    w: Floats, n: int, same: bool, z: State, mode: int, step: float, own: OwnKernel
) -> State:
    """Return the state after a classical Runge-Kutta step."""
    a = kept(rates(w, n, same, z, mode, own), mode)
    b = kept(rates(w, n, same, moved(z, a, 0.5 * step), mode, own), mode)
    c = kept(rates(w, n, same, moved(z, b, 0.5 * step), mode, own), mode)
    d = kept(rates(w, n, same, moved(z, c, step), mode, own), mode)
    sixth = step / 6.0
    return (
        z[0] + sixth * (a[0] + 2.0 * (b[0] + c[0]) + d[0]),
        z[1] + sixth * (a[1] + 2.0 * (b[1] + c[1]) + d[1]),
        z[2] + sixth * (a[2] + 2.0 * (b[2] + c[2]) + d[2]),
        z[3] + sixth * (a[3] + 2.0 * (b[3] + c[3]) + d[3]),
        z[4] + sixth * (a[4] + 2.0 * (b[4] + c[4]) + d[4]),
    )


@part_of_kernels
def called_step(w: Floats, n: int, same: bool, z: State, mode: int, step: float, own: OwnKernel) -> State:
    """Return the same as `fourth_order_step`, where speed is not worth the code."""
    after: State = fourth_order_step(w, n, same, z, mode, step, own)
    return after


@inlined
def breaking_force(w: Floats, side: int) -> float:
    """Return the dry friction that has to be overcome at rest."""
    force: float = (w[FRICTION_FORWARD] if side > 0 else w[FRICTION_BACK]) + w[BREAKAWAY]
    return force


@part_of_kernels
def holding_force(w: Floats, n: int, same: bool, z: State, own: OwnKernel) -> float:
    """Return the force that keeps a body at zero velocity."""
    holding: float = -rates(w, n, same, z, STUCK, own)[0] / w[PUSH]
    return holding


@part_of_kernels
def margin(w: Floats, n: int, same: bool, z: State, mode: int, own: OwnKernel) -> float:
    """Return what is positive as long as the mode lasts."""
    if mode != STUCK:
        return mode * z[0]
    holding = holding_force(w, n, same, z, own)
    return min(holding + breaking_force(w, 1), breaking_force(w, -1) - holding)


@part_of_kernels
def mode_at_zero(w: Floats, n: int, same: bool, z: State, own: OwnKernel) -> int:
    """Return how a body at zero velocity goes on: stuck, or sliding to one side."""
    holding = holding_force(w, n, same, z, own)
    if holding < -breaking_force(w, 1):
        return 1
    if holding > breaking_force(w, -1):
        return -1
    return STUCK


@compiled
def rates_at(w: Floats, n: int, same: bool, z: State, dry: bool, own: OwnKernel) -> State:
    """Return the derivative of states and memory at an instant, for callers in Python."""
    mode = SMOOTH
    if dry:
        mode = mode_at_zero(w, n, same, z, own) if z[0] == 0.0 else (1 if z[0] > 0.0 else -1)
    now: State = kept(rates(w, n, same, z, mode, own), mode)
    return now


@part_of_kernels
def time_of_event(
    w: Floats, n: int, same: bool, z: State, mode: int, near: float, far: float, end: State, own: OwnKernel
) -> tuple[float, State]:
    """Return the step at whose end the mode ends, and the state there; ``end`` is that after ``far``.

    Each parabola has the margin, and its slope, of the last point, and the margin at the nearest one on the
    other side, so that its root lies between them.  At first the slope is the rate at which a body slows
    down, where it slides; then that of a secant, for under coarse steps a run does not follow its rates.
    """
    other, at_other = near, margin(w, n, same, z, mode, own)
    if near > 0.0:
        at_other = margin(w, n, same, called_step(w, n, same, z, mode, near, own), mode, own)
    last, value = far, margin(w, n, same, end, mode, own)
    size = at_other - value
    slope = size / (other - last) if mode == STUCK else mode * rates(w, n, same, end, mode, own)[0]
    for _ in range(ROOT_STEPS):
        width = other - last
        if width == 0.0:
            break
        bend = (at_other - value - slope * width) / (width * width)
        root = math.sqrt(max(slope * slope - 4.0 * bend * value, 0.0))
        # The form of the root in which nothing cancels, whatever is next to zero.
        sum_of_both = -0.5 * (slope + math.copysign(root, slope))
        falls = slope != 0.0 and (slope < 0.0) == ((value < 0.0) == (width < 0.0))
        before, at_before = last, value
        last += value / sum_of_both if falls else math.copysign(sum_of_both / bend, width)
        end = called_step(w, n, same, z, mode, last, own)
        value = margin(w, n, same, end, mode, own)
        if abs(value) <= EVENT_TOLERANCE * size or abs(last - before) <= 1e-15 * far:
            break
        if (value < 0.0) != (at_before < 0.0):
            other, at_other = before, at_before
        slope = (value - at_before) / (last - before)
    return last, end


@part_of_kernels
def cut_step(
    w: Floats, n: int, same: bool, z: State, trial: State, mode: int, step: float, own: OwnKernel
) -> tuple[State, int, int]:
    """Return state, mode and number of changes after a step cut where sliding turns or sticking ends.

    ``trial`` is the state after the whole step, were there no change.
    """
    left = step
    for changes in range(MOST_EVENTS):
        if not margin(w, n, same, trial, mode, own) < 0.0:
            return trial, mode, changes
        near, far = 0.0, left
        if margin(w, n, same, z, mode, own) <= 0.0:
            # The body has just begun to move: look for a shorter step after which it still does.
            near = 0.5 * left
            while near > 1e-9 * step:
                nearer = called_step(w, n, same, z, mode, near, own)
                if margin(w, n, same, nearer, mode, own) > 0.0:
                    break
                far, near, trial = near, 0.5 * near, nearer
            else:
                near = -1.0
        before, taken = mode, 0.0
        if near >= 0.0:
            taken, z = time_of_event(w, n, same, z, mode, near, far, trial, own)
        z = (0.0, z[1], z[2], z[3], z[4])
        left -= taken
        mode = mode_at_zero(w, n, same, z, own)
        if before == STUCK and mode == STUCK:  # at the edge to rounding: the force goes on growing
            middle = 0.5 * (breaking_force(w, -1) - breaking_force(w, 1))
            mode = -1 if holding_force(w, n, same, z, own) > middle else 1
        elif near < 0.0 and mode == before:  # it cannot move to this side, nor to the other
            mode = STUCK
        if left <= 0.0:
            return z, mode, changes + 1
        trial = called_step(w, n, same, z, mode, left, own)
    if mode != STUCK:
        trial = called_step(w, n, same, z, STUCK, left, own)
    return (0.0, trial[1], trial[2], trial[3], trial[4]), STUCK, MOST_EVENTS


@compiled
def forced_runs(
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
    own: OwnKernel,
) -> None:
    """Simulate several runs (lanes) of a plant with added forces.

    Parameters
    ----------
    plants : ndarray, shape (lanes, SIZE or more)
        Coefficients of each lane, those of the input are filled here; parameters of the user's own laws.
    n : int
        Number of states.
    same : bool
        Whether the position is the velocity itself, as for the speed of a motor.
    by_input : ndarray, shape (lanes, 4, m)
        Rates by each input.
    direct : ndarray, shape (lanes, m)
        Output by each input.
    u : ndarray, shape (1 or lanes, n_samples, m)
    starts : ndarray, shape (lanes, 4)
    step : float
        Length of a Runge-Kutta step.
    substeps : int
        Steps in a sample.
    y : ndarray, shape (lanes, n_samples)
        Not a number from where a run diverges on.
    states : ndarray, shape (lanes, n_samples, 4), or with 0 samples
        Filled where it has room.
    own : kernel
        The user's own law, see `sysid.physics.own_laws`.
    """
    m = u.shape[2]
    w = np.empty(plants.shape[1])
    for lane in range(plants.shape[0]):
        source = lane if u.shape[0] > 1 else 0
        w[:] = plants[lane]
        dry = w[FRICTION_FORWARD] > 0.0 or w[FRICTION_BACK] > 0.0 or w[BREAKAWAY] != 0.0
        z = (starts[lane, 0], starts[lane, 1], starts[lane, 2], starts[lane, 3], 0.0)
        mode, chatter = SMOOTH, 0
        for k in range(u.shape[1]):
            z = (min(z[0], w[FIRST_CAP]), min(z[1], w[SECOND_CAP]), z[2], z[3], z[4])
            value = (
                w[READ] * z[0] + w[READ + 1] * z[1] + w[READ + 2] * z[2] + w[READ + 3] * z[3] + w[READ + 4]
            )
            for j in range(m):
                value += direct[lane, j] * u[source, k, j]
            y[lane, k] = value
            if states.shape[1] > 0:
                states[lane, k, 0], states[lane, k, 1] = z[0], z[1]
                states[lane, k, 2], states[lane, k, 3] = z[2], z[3]
            if not math.isfinite(value) or chatter > MOST_CHATTER * u.shape[1]:
                y[lane, k:] = np.nan
                break
            for i in range(n):
                rate = 0.0
                for j in range(m):
                    rate += by_input[lane, i, j] * u[source, k, j]
                w[DRIVE + i] = rate
            if dry:
                mode = mode_at_zero(w, n, same, z, own) if z[0] == 0.0 else (1 if z[0] > 0.0 else -1)
            for _ in range(substeps):
                if not dry:
                    z = spilled(w, fourth_order_step(w, n, same, z, SMOOTH, step, own))
                    continue
                trial = fourth_order_step(w, n, same, z, mode, step, own)
                if mode != STUCK and mode * trial[0] >= 0.0:
                    z = trial
                    continue
                z, mode, changes = cut_step(w, n, same, z, trial, mode, step, own)
                chatter += changes
