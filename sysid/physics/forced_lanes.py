"""Runs of a plant with added forces side by side: the same arithmetic on several at a time.

All lanes make a step together (`sysid.physics.forced_steps`).  Only where dry friction changes its state
within a step does a lane go through the events of `sysid.physics.forced_kernels`, alone.  The law and the
method are those of `forced_runs` there; results differ by rounding.
"""

import math
from typing import Any

import numpy as np

from sysid._compile import compiled, inlined, part_of_kernels, uncounted
from sysid.linear.forms import Floats
from sysid.physics import forced_kernels as fk
from sysid.physics.forced_kernels import (
    MOST_CHATTER,
    MOST_STATES,
    SMOOTH,
    STUCK,
    OwnKernel,
    breaking_force,
    cut_step,
    mode_at_zero,
    spilled,
)
from sysid.physics.forced_steps import (
    AFTER,
    ALL,
    BLOCKS,
    BREAKS_AWAY,
    GAINS,
    LEVELS,
    MOVING,
    PLAIN,
    SIDE,
    SWINGS,
    WIDTH,
    Z,
    drift_of_all,
    step_of_all,
)
from sysid.physics.own_laws import NO_OWN_LAW, kernel_of

# Up to so many lanes take half of them; so few are not worth a vector.
HALF, FEW = 8, 1

_first, _second = fk.FIRST_CAP, fk.SECOND_CAP
_drive, _push, _read = fk.DRIVE, fk.PUSH, fk.READ


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
    plants = plants.copy()  # a kernel fills in what drives each lane
    curve, size, none = _costly(plants), 4 if n > 2 else 2, kernel_of(NO_OWN_LAW)
    levelled, stepped, drifted = curve in (LEVELS, ALL), step_of_all(size, curve), drift_of_all(size)
    for first in range(0, plants.shape[0], WIDTH):
        group = slice(first, first + WIDTH)
        group_runs(
            plants[group], n, same, by_input[group], direct[group], u[group] if u.shape[0] > 1 else u,
            starts[group], step, substeps, y[group], states[group], levelled, stepped, drifted, none,
        )  # fmt: skip


def _costly(plants: Floats) -> int:
    """Return which costly functions laws take: one of the bits, or all."""
    levelled = (plants[:, [fk.FIRST_POWER, fk.SECOND_POWER]] != 1.0).any()
    levelled = levelled or (plants[:, [_first, _second]] < np.inf).any()
    needed = {
        BREAKS_AWAY: plants[:, fk.BREAKAWAY].any(),
        SWINGS: plants[:, fk.GRAVITY].any(),
        GAINS: plants[:, fk.GAIN].any(),
        LEVELS: levelled,
    }
    found = [bit for bit, asked in needed.items() if asked]
    return ALL if len(found) > 1 else sum(found, PLAIN)


@inlined
def state_of(z: Floats, place: int) -> Any:
    """Return the state and memory of one lane."""
    return z[place], z[place + WIDTH], z[place + 2 * WIDTH], z[place + 3 * WIDTH], z[place + 4 * WIDTH]


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
    levelled: bool,
    stepped: Any,
    drifted: Any,
    none: OwnKernel,
) -> None:
    """Simulate up to WIDTH runs; where the drive stands in ``plants`` it is filled in."""
    lanes, m = plants.shape[0], u.shape[2]
    width = lanes if lanes <= FEW else (HALF if lanes <= HALF else WIDTH)
    w = np.zeros(BLOCKS * WIDTH)
    by_block, passed = np.zeros(n * m * WIDTH), np.zeros(m * WIDTH)
    signals, value, drift = np.zeros(m * WIDTH), np.zeros(WIDTH), np.zeros(WIDTH)
    rows: Floats = uncounted(plants)
    mode, chatter = np.zeros(WIDTH, dtype=np.int64), np.zeros(WIDTH, dtype=np.int64)
    dry, alive = np.zeros(WIDTH, dtype=np.bool_), np.zeros(WIDTH, dtype=np.bool_)
    slow = states.shape[1] > 0
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
        mode[i], dry[i], alive[i] = SMOOTH, i < lanes and (slides or bent), i < lanes
        slow = slow or dry[i]
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
                    mode[i] = (
                        mode_at_zero(rows[i], n, same, z, none) if z[0] == 0.0 else (1 if z[0] > 0.0 else -1)
                    )
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
            stepped(w, same, step, width)
            if sticks:
                drifted(w, same, drift, width)
            for i in range(lanes if slow or levelled else 0):
                if dry[i]:
                    trial = state_of(w, AFTER * WIDTH + i)
                    lasts = mode[i] * trial[0] >= 0.0
                    if mode[i] == STUCK:
                        holding = -drift[i] / w[_push * WIDTH + i]
                        forwards = holding < -breaking_force(rows[i], 1)
                        lasts = not (forwards or holding > breaking_force(rows[i], -1))
                    if not lasts:
                        z = state_of(w, Z * WIDTH + i)
                        end, mode[i], changes = cut_step(rows[i], n, same, z, trial, mode[i], step, none)
                        chatter[i] += changes
                        for j in range(MOST_STATES + 1):
                            w[(AFTER + j) * WIDTH + i] = end[j]
                elif levelled:
                    levels = spilled(rows[i], state_of(w, AFTER * WIDTH + i))
                    w[AFTER * WIDTH + i], w[(AFTER + 1) * WIDTH + i] = levels[0], levels[1]
            for j in range(MOST_STATES + 1):
                for i in range(width):
                    w[(Z + j) * WIDTH + i] = w[(AFTER + j) * WIDTH + i]


@part_of_kernels
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
