"""Compiled slopes of drives: how the input that acts follows what they see and their parameters."""

from typing import Any

import numba
import numpy as np
from numba import types

from sysid._compile import compiled_for
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.effects.laws import Rows, rows_signature
from sysid.diagnosis.linear.differences import STEP, central_difference, first_step
from sysid.diagnosis.linear.kernels import spread

_row, _mask = types.Array(types.float64, 1, "C"), types.Array(types.boolean, 1, "C")
_matrix, _rows = types.Array(types.float64, 2, "C"), types.FunctionType(rows_signature())


@numba.njit(inline="always")  # as a function of its own it would have to be compiled for pointers
def _drive(
    x: Floats, z: Floats, speed: Floats, n_drives: int, first: Rows, p: Floats, second: Rows, q: Floats,
    v: Floats,
) -> None:  # fmt: skip
    first(x, z, speed, p, v)
    if n_drives > 1:
        second(v, z, speed, q, v)


@compiled_for(_matrix(_row, _row, _row, types.int64, _rows, _row, _rows, _row, types.boolean, _mask, _mask))
def drive_slopes(
    x: Floats,
    z: Floats,
    speed: Floats,
    n_drives: int,
    first: Rows,
    p: Floats,
    second: Rows,
    q: Floats,
    scaled: bool,
    wanted: Any,
    strengths: Any,
) -> Floats:
    """Return the derivative of v by input, position, speed and parameters, shape (3 + n_wanted, n_rows).

    Parameters
    ----------
    x, z, speed : ndarray, shape (n_rows,)
        Input before the drives, position and speed.
    n_drives, first, p, second, q
        How many drives there are, and each with its parameters.
    scaled : bool
        Whether a drive scales the input: forces are taken from it and leave its slope as it is, one.
    wanted, strengths : ndarray of bool, shape (n_parameters,)
        Which of the parameters ``p`` and ``q`` are asked for, and in which of them the drives are linear.
    """
    n_rows, line = x.shape[0], 3
    p, q = p.copy(), q.copy()
    ahead, behind = np.empty(n_rows), np.empty(n_rows)
    n_wanted = 0
    for number in range(wanted.shape[0]):
        n_wanted += wanted[number]
    out = np.empty((3 + n_wanted, n_rows))
    for k in range(n_rows):
        out[0, k] = 1.0
    for i in range(0 if scaled else 1, 3):
        seen = x if i == 0 else (z if i == 1 else speed)
        step, above, below = STEP * spread(seen), np.empty(n_rows), np.empty(n_rows)
        for k in range(n_rows):
            above[k], below[k] = seen[k] + step, seen[k] - step
        for moved, acting in ((above, ahead), (below, behind)):
            u, position = moved if i == 0 else x, moved if i == 1 else z
            _drive(u, position, moved if i == 2 else speed, n_drives, first, p, second, q, acting)
        central_difference(ahead, behind, step, out[i])
    for number in range(wanted.shape[0]):
        if not wanted[number]:
            continue
        own, place = (p, number) if number < p.shape[0] else (q, number - p.shape[0])
        value, felt = own[place], False
        step = first_step(value, strengths[number])
        while not felt:
            own[place] = value + step
            _drive(x, z, speed, n_drives, first, p, second, q, ahead)
            own[place] = value - step
            _drive(x, z, speed, n_drives, first, p, second, q, behind)
            felt = central_difference(ahead, behind, step, out[line]) or not strengths[number]
            step *= 1e4
        own[place] = value
        line += 1
    return out
