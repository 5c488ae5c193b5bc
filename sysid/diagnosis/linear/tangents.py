"""Compiled recursions of small changes along a run of `sysid.diagnosis.linear.kernels`."""

from typing import Any

import numpy as np

from sysid._compile import compiled
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.kernels import add_delayed, all_pole


@compiled
def tangent(
    z: Floats,
    v: Floats,
    a: Floats,
    b: Floats,
    begin: Any,
    with_constant: bool,
    wanted: Any,
    inputs: Floats,
) -> Floats:
    """Return dz where nothing is fed back, by the equation's own parameters and by changes of v.

    The derivatives by a1, a2, ... are one filtered signal, shifted; those by b, too.

    Parameters
    ----------
    z, v : ndarray, shape (n_rows,)
    a, b : ndarray, shape (order,)
    begin : ndarray of int, shape (n_experiments + 1,)
    with_constant : bool
    wanted : ndarray of bool, shape (n_own,)
        Which of a, b, constant and starts are asked for.
    inputs : ndarray, shape (n_inputs, n_rows)
        Changes of v.

    Returns
    -------
    ndarray, shape (n_wanted + n_inputs, n_rows)
    """
    order, n_own = a.shape[0], wanted.shape[0]
    out = np.zeros((np.sum(wanted) + inputs.shape[0], z.shape[0]))
    own, line = np.empty(z.shape[0]), 0
    for column in range(2 * order):
        if column % order == 0 and wanted[column : column + order].any():
            _filtered_before(z if column == 0 else v, -1.0 if column == 0 else 1.0, a, begin, own)
        if wanted[column]:
            for e in range(begin.shape[0] - 1):
                for k in range(begin[e] + column % order, begin[e + 1]):
                    out[line, k] = own[k - column % order]
            line += 1
    for column in range(2 * order, n_own):
        if wanted[column]:
            _kick(column - 2 * order - int(with_constant), order, begin, out[line])
            for e in range(begin.shape[0] - 1):
                all_pole(out[line], a, begin[e], begin[e + 1])
            line += 1
    for i in range(inputs.shape[0]):
        for e in range(begin.shape[0] - 1):
            add_delayed(inputs[i], b, begin[e], begin[e + 1], out[line])
            all_pole(out[line], a, begin[e], begin[e + 1])
        line += 1
    return out


@compiled
def _filtered_before(signal: Floats, sign: float, a: Floats, begin: Any, out: Floats) -> None:
    """Fill ``out`` with the signal of a sample before, through 1/A."""
    for e in range(begin.shape[0] - 1):
        first, last = begin[e], begin[e + 1]
        if first < last:
            out[first] = 0.0
        for k in range(first + 1, last):
            out[k] = sign * signal[k - 1]
        all_pole(out, a, first, last)


@compiled
def _kick(number: int, order: int, begin: Any, d: Floats) -> None:
    """Add what the constant (-1) or a start adds to the equation."""
    if number < 0:
        d += 1.0
    else:
        row = begin[number // order] + number % order
        if row < begin[number // order + 1]:
            d[row] = 1.0


@compiled
def tangent_driven(
    z: Floats,
    v: Floats,
    a: Floats,
    b: Floats,
    begin: Any,
    with_constant: bool,
    wanted: Any,
    by_position: Floats,
    by_speed: Floats,
    inputs: Floats,
) -> Floats:
    """Return dz as `tangent` does, where v follows z by its slopes.

    With v put in, each change is a filter of what it stands beside, with weights that move with time.
    """
    columns, order = np.flatnonzero(wanted), a.shape[0]
    own = columns.shape[0]
    out = np.zeros((own + inputs.shape[0], z.shape[0]))
    W = _moving_weights(a, b, begin, by_position, by_speed)
    for e in range(begin.shape[0] - 1):
        first, last = begin[e], begin[e + 1]
        for line in range(out.shape[0]):
            d = out[line]
            if line < own:
                _fill_own(d, columns[line], order, with_constant, e, z, v, first, last)
            else:
                add_delayed(inputs[line - own], b, first, last, d)
            for k in range(first, last):
                value = d[k]
                for i in range(min(order + 1, k - first), 0, -1):
                    value += W[k, i - 1] * d[k - i]
                d[k] = value
    return out


@compiled
def _moving_weights(a: Floats, b: Floats, begin: Any, by_position: Floats, by_speed: Floats) -> Floats:
    """Return the weights in row k of dz one row, two rows, ... before."""
    order = a.shape[0]
    W = np.zeros((by_position.shape[0], order + 1))
    for e in range(begin.shape[0] - 1):
        for k in range(begin[e], begin[e + 1]):
            for i in range(1, min(order, k - begin[e]) + 1):
                speed = by_speed[k - i] if k - i > begin[e] else 0.0
                W[k, i - 1] += b[i - 1] * (by_position[k - i] + speed) - a[i - 1]
                W[k, i] -= b[i - 1] * speed
    return W


@compiled
def _fill_own(
    d: Floats,
    column: int,
    order: int,
    with_constant: bool,
    e: int,
    z: Floats,
    v: Floats,
    first: int,
    last: int,
) -> None:
    """Fill in what an own parameter stands beside in an experiment: a signal before, a one or nothing."""
    shared = 2 * order + int(with_constant)
    if column < order:
        for k in range(first + column + 1, last):
            d[k] = -z[k - column - 1]
    elif column < 2 * order:
        for k in range(first + column - order + 1, last):
            d[k] = v[k - column + order - 1]
    elif column < shared:
        d[first:last] = 1.0
    elif (column - shared) // order == e and first + (column - shared) % order < last:
        d[first + (column - shared) % order] = 1.0


@compiled
def tangent_through(
    y: Floats,
    v: Floats,
    a: Floats,
    b: Floats,
    direct: float,
    begin: Any,
    with_constant: bool,
    wanted: Any,
    by_position: Floats,
    by_speed: Floats,
    inputs: Floats,
    outputs: Floats,
) -> Floats:
    """Return dy where forces pass a direct path, by own parameters and changes of v and of y.

    Changes ``outputs`` of y are those at given v; shape (n_wanted + n_inputs, n_rows).
    """
    columns, order = np.flatnonzero(wanted), a.shape[0]
    own = columns.shape[0]
    out = np.zeros((own + inputs.shape[0], y.shape[0]))
    z, dz, dv = y - direct * v, np.empty(y.shape[0]), np.empty(y.shape[0])
    for e in range(begin.shape[0] - 1):
        first, last = begin[e], begin[e + 1]
        for line in range(out.shape[0]):
            dz[first:last] = 0.0
            if line < own:
                _fill_own(dz, columns[line], order, with_constant, e, z, v, first, last)
            dy = out[line]
            for k in range(first, last):
                for i in range(1, min(order, k - first) + 1):
                    dz[k] += b[i - 1] * dv[k - i] - a[i - 1] * dz[k - i]
                given = moved = 0.0
                if line >= own:
                    given, moved = inputs[line - own, k], outputs[line - own, k]
                slope = by_position[k]
                if k > first:
                    slope += by_speed[k]
                    given -= by_speed[k] * dy[k - 1]
                dy[k] = (dz[k] + moved + direct * given) / (1.0 - direct * slope)
                dv[k] = given + slope * dy[k]
    return out
