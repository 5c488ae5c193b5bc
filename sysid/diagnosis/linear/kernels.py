"""Compiled recursions of a difference equation with forces fed back to its input: its runs.

z(k) = -a1 z(k-1) - ... + b1 v(k-1) + ... + constant + start(k), where v(k) is the input x(k) after up to two
drives that see z(k) and z(k) - z(k-1).  ``begin`` holds the first row of each experiment and, last, the
number of rows; nothing crosses the border between experiments.
"""

from typing import Any

import numba
import numpy as np
from numba import types

from sysid._compile import compiled, compiled_for
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.effects.laws import Drive, drive_signature

# A run beyond this value has diverged.
LARGEST = 1e12

_number, _row, _index = types.float64, types.Array(types.float64, 1, "C"), types.Array(types.int64, 1, "C")
_matrix = types.Array(types.float64, 2, "C")
_drive = types.FunctionType(drive_signature())


@compiled
def is_stable(a: Floats) -> bool:
    """Tell whether all poles lie within the unit circle (Schur-Cohn: no reflection above 1).

    A pole on the circle, an integrator, is let through with its rounding.
    """
    current = a.copy()
    for order in range(a.shape[0], 0, -1):
        reflection = current[order - 1]
        if not abs(reflection) <= 1.0 + 1e-9:
            return False
        if abs(reflection) >= 1.0:
            return True
        following = current.copy()
        for i in range(order - 1):
            following[i] = (current[i] - reflection * current[order - 2 - i]) / (1.0 - reflection**2)
        current = following
    return True


@compiled
def add_delayed(x: Floats, b: Floats, first: int, last: int, out: Floats) -> None:
    """Add b1 x(k-1) + b2 x(k-2) + ... to the rows from ``first`` to ``last`` of ``out``."""
    for i in range(b.shape[0]):
        weight = b[i]
        for k in range(first + i + 1, last):
            out[k] += weight * x[k - i - 1]


@compiled
def all_pole(d: Floats, a: Floats, first: int, last: int) -> None:
    """Filter the rows from ``first`` to ``last`` by 1/A, in place and from rest.

    The usual orders keep what they remember in registers: half the time.
    """
    order = a.shape[0]
    opened = min(first + order, last)
    for k in range(first, opened):
        for i in range(k - first, 0, -1):
            d[k] -= a[i - 1] * d[k - i]
    if opened == last:
        return
    if order == 1:
        one = d[first]
        for k in range(opened, last):
            one = d[k] - a[0] * one
            d[k] = one
    elif order == 2:
        one, two = d[first + 1], d[first]
        for k in range(opened, last):
            one, two = (d[k] - a[1] * two) - a[0] * one, one
            d[k] = one
    elif order == 3:
        one, two, three = d[first + 2], d[first + 1], d[first]
        for k in range(opened, last):
            one, two, three = ((d[k] - a[2] * three) - a[1] * two) - a[0] * one, one, two
            d[k] = one
    else:
        one = d[opened - 1]
        for k in range(opened, last):
            value = d[k]
            for i in range(order, 1, -1):
                value -= a[i - 1] * d[k - i]
            one = value - a[0] * one
            d[k] = one


@compiled
def simulate(x: Floats, a: Floats, b: Floats, constant: float, start: Floats, begin: Any, z: Floats) -> bool:
    """Fill ``z`` where nothing is fed back; return False if the run diverges."""
    for e in range(begin.shape[0] - 1):
        first, last = begin[e], begin[e + 1]
        for k in range(first, last):
            z[k] = constant
        for age in range(min(a.shape[0], last - first)):
            z[first + age] += start[e, age]
        add_delayed(x, b, first, last, z)
        all_pole(z, a, first, last)
        for k in range(first, last):
            if not abs(z[k]) < LARGEST:
                return False
    return True


@compiled
def free_run(
    x: Floats, point: Floats, order: int, with_constant: bool, with_start: bool, begin: Any, z: Floats
) -> bool:
    """Fill ``z`` where nothing is fed back; return False if a pole is unstable or the run diverges.

    ``point`` begins with a, b, the constant and the starts, if there are any.
    """
    a, b = point[:order], point[order : 2 * order]
    if not is_stable(a):
        return False
    constant, n_experiments, first = 0.0, begin.shape[0] - 1, 2 * order
    if with_constant:
        constant = point[first]
        first += 1
    start = np.zeros((n_experiments, order))
    if with_start:
        for e in range(n_experiments):
            for age in range(order):
                start[e, age] = point[first + e * order + age]
    return simulate(x, a, b, constant, start, begin, z)


@compiled
def spread(signal: Floats) -> float:
    """Return the standard deviation, one for a signal that does not move."""
    middle, total = 0.0, 0.0
    for value in signal:
        middle += value
    middle /= signal.shape[0]
    for value in signal:
        total += (value - middle) ** 2
    return np.sqrt(total / signal.shape[0]) or 1.0


@numba.njit(inline="always")  # handed on to a function of its own, a drive costs twice its time
def drive_at(
    x: float, position: float, speed: float, n_drives: int, first: Drive, p: Floats, second: Drive, q: Floats
) -> float:
    """Return the input after the drives."""
    acting = first(x, position, speed, p)
    if n_drives > 1:
        acting = second(acting, position, speed, q)
    return acting


@compiled_for(
    types.boolean(
        _row, _row, _row, _number, _matrix, _index, types.int64, _drive, _row, _drive, _row, _row, _row
    )
)
def simulate_driven(
    x: Floats,
    a: Floats,
    b: Floats,
    constant: float,
    start: Floats,
    begin: Any,
    n_drives: int,
    first: Drive,
    p: Floats,
    second: Drive,
    q: Floats,
    z: Floats,
    v: Floats,
) -> bool:
    """Fill ``z`` and ``v``; return False if the run diverges.  ``start`` has shape (n_experiments, order)."""
    order = a.shape[0]
    for e in range(begin.shape[0] - 1):
        for k in range(begin[e], begin[e + 1]):
            age = k - begin[e]
            value = constant
            for i in range(1, min(order, age) + 1):
                value += b[i - 1] * v[k - i] - a[i - 1] * z[k - i]
            if age < order:
                value += start[e, age]
            if not abs(value) < LARGEST:
                return False
            z[k] = value
            speed = value - z[k - 1] if age > 0 else 0.0
            v[k] = drive_at(x[k], value, speed, n_drives, first, p, second, q)
    return True


@compiled
def speed_of(z: Floats, begin: Any) -> Floats:
    """Return the first difference within each experiment, zero in its first row."""
    speed = np.zeros(z.shape[0])
    for e in range(begin.shape[0] - 1):
        for k in range(begin[e] + 1, begin[e + 1]):
            speed[k] = z[k] - z[k - 1]
    return speed


@compiled
def chosen_filtered(values: Floats, runs: Any, noise: Floats, first: Floats) -> Floats:
    """Return the used rows of each line of ``values`` (n_lines, n_rows), filtered by D(q).

    ``runs`` (n_runs, 2) says where runs of used rows begin and end.  The first rows of each have the weights
    ``first`` (order, order) of `sysid.diagnosis.structures.whitening`.
    """
    n_used = 0
    for number in range(runs.shape[0]):
        n_used += runs[number, 1] - runs[number, 0]
    out = np.empty((values.shape[0], n_used))
    for line in range(values.shape[0]):
        row = 0
        for number in range(runs.shape[0]):
            start, length = runs[number, 0], runs[number, 1] - runs[number, 0]
            signal, kept = values[line, start : start + length], out[line, row : row + length]
            for k in range(length):
                kept[k] = signal[k]
            for lag in range(1, min(noise.shape[0], length)):
                weight = noise[lag]
                for k in range(lag, length):
                    kept[k] += weight * signal[k - lag]
            for k in range(min(noise.shape[0] - 1, length)):
                kept[k] = 0.0
                for lag in range(k + 1):
                    kept[k] += first[k, k - lag] * signal[k - lag]
            row += length
    return out
