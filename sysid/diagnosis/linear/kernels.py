"""Compiled recursions of a difference equation with forces fed back to its input.

z(k) = -a1 z(k-1) - ... + b1 v(k-1) + ... + constant + start(k), where v(k) is the input x(k) after up to two
drives that see z(k) and z(k) - z(k-1).  ``begin`` holds the first row of each experiment and, last, the
number of rows; nothing crosses the border between experiments.
"""

from collections.abc import Callable
from typing import Any, cast

import numba
import numpy as np
from numba import types

from sysid._compile import Kernel, compiled
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.effects.laws import Drive, drive_signature

# A run beyond this value has diverged.
LARGEST = 1e12

_number, _row, _index = types.float64, types.Array(types.float64, 1, "C"), types.Array(types.int64, 1, "C")
_matrix = types.Array(types.float64, 2, "C")
_drive = types.FunctionType(drive_signature())


def with_drives(*signature: Any) -> Callable[[Kernel], Kernel]:
    """Compile for one signature, so that any drive fits without compiling again."""

    def decorate(function: Kernel) -> Kernel:
        try:
            return cast(Kernel, numba.njit(list(signature), cache=True, nogil=True)(function))
        except RuntimeError:
            return cast(Kernel, numba.njit(list(signature), nogil=True)(function))

    return decorate


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
def simulate(x: Floats, a: Floats, b: Floats, constant: float, start: Floats, begin: Any, z: Floats) -> bool:
    """Fill ``z`` where nothing is fed back; return False if the run diverges."""
    order = a.shape[0]
    for e in range(begin.shape[0] - 1):
        for k in range(begin[e], begin[e + 1]):
            age = k - begin[e]
            value = constant
            for i in range(1, min(order, age) + 1):
                value += b[i - 1] * x[k - i] - a[i - 1] * z[k - i]
            if age < order:
                value += start[e, age]
            if not abs(value) < LARGEST:
                return False
            z[k] = value
    return True


@with_drives(
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
            acting = x[k]
            if n_drives > 0:
                speed = value - z[k - 1] if age > 0 else 0.0
                acting = first(acting, value, speed, p)
                if n_drives > 1:
                    acting = second(acting, value, speed, q)
            v[k] = acting
    return True


@with_drives(_row(_row, _row, _index, types.int64, _drive, _row, _drive, _row, _number, _number, _number))
def driven(
    x: Floats,
    z: Floats,
    begin: Any,
    n_drives: int,
    first: Drive,
    p: Floats,
    second: Drive,
    q: Floats,
    du: float,
    dz: float,
    dv: float,
) -> Floats:
    """Return v for a given z, with input, position and speed shifted: for its derivatives."""
    out = np.empty(x.shape[0])
    for e in range(begin.shape[0] - 1):
        for k in range(begin[e], begin[e + 1]):
            speed = (z[k] - z[k - 1] if k > begin[e] else 0.0) + dv
            acting = first(x[k] + du, z[k] + dz, speed, p)
            if n_drives > 1:
                acting = second(acting, z[k] + dz, speed, q)
            out[k] = acting
    return out


@compiled
def tangent(
    z: Floats,
    v: Floats,
    a: Floats,
    b: Floats,
    begin: Any,
    with_constant: bool,
    with_start: bool,
    feedback: bool,
    by_position: Floats,
    by_speed: Floats,
    inputs: Floats,
) -> Floats:
    """Return dz by a, b, the constant, the starts and changes ``inputs`` of v, shape (n_columns, n_rows).

    Without feedback the derivatives by a1, a2, ... are one filtered signal, shifted; those by b, too.
    """
    order, n_experiments, n_inputs = a.shape[0], begin.shape[0] - 1, inputs.shape[0]
    first_start = 2 * order + int(with_constant)
    n_own = first_start + (n_experiments * order if with_start else 0)
    out = np.zeros((n_own + n_inputs, z.shape[0]))
    changed = np.zeros(z.shape[0])
    for column in range(n_own + n_inputs):
        d = out[column]
        shifted = not feedback and column < 2 * order and column % order > 0
        for e in range(n_experiments):
            first, last = begin[e], begin[e + 1]
            if shifted:
                before = out[column - 1]
                for k in range(first + 1, last):
                    d[k] = before[k - 1]
                continue
            if column >= first_start and column < n_own and (column - first_start) // order != e:
                continue
            for k in range(first, last):
                age = k - first
                value = 0.0
                if column < order:
                    if age > column:
                        value = -z[k - column - 1]
                elif column < 2 * order:
                    if age > column - order:
                        value = v[k - column + order - 1]
                elif column < first_start or (column < n_own and age == (column - first_start) % order):
                    value = 1.0
                lags = min(order, age)
                for i in range(1, lags + 1):
                    value -= a[i - 1] * d[k - i]
                if feedback or column >= n_own:
                    for i in range(1, lags + 1):
                        value += b[i - 1] * changed[k - i]
                    changed[k] = inputs[column - n_own, k] if column >= n_own else 0.0
                    if feedback:
                        changed[k] += by_position[k] * value
                        if age > 0:
                            changed[k] += by_speed[k] * (value - d[k - 1])
                d[k] = value
    return out


@compiled
def chosen_filtered(values: Floats, used: Any, begin: Any, noise: Floats, first: Floats) -> Floats:
    """Return the used rows of each line of ``values`` (n_lines, n_rows), filtered by D(q).

    The first rows of each run have the weights ``first`` (order, order) of
    `sysid.diagnosis.structures.whitening`.
    """
    count = 0
    for k in range(used.shape[0]):
        count += used[k]
    out = np.empty((values.shape[0], count))
    for line in range(values.shape[0]):
        row = 0
        for e in range(begin.shape[0] - 1):
            run = 0
            for k in range(begin[e], begin[e + 1]):
                if not used[k]:
                    run = 0
                    continue
                if run < noise.shape[0] - 1:
                    value = 0.0
                    for lag in range(run + 1):
                        value += first[run, run - lag] * values[line, k - lag]
                else:
                    value = values[line, k]
                    for lag in range(1, noise.shape[0]):
                        value += noise[lag] * values[line, k - lag]
                out[line, row] = value
                row += 1
                run += 1
    return out
