"""Compiled recursions of small changes along a run of `sysid.diagnosis.linear.kernels`."""

from typing import Any

import numpy as np

from sysid._compile import compiled
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.kernels import add_delayed, all_pole

# What a parameter of the equation stands beside: outputs and inputs before, one, or the first rows.
OUTPUT, INPUT, CONSTANT, START = 0, 1, 2, 3


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

    The derivatives by a1, a2, ... are one filtered signal, shifted; those by b and by starts, too.

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
    order, n_experiments, n_wanted = a.shape[0], begin.shape[0] - 1, _count(wanted)
    shared = 2 * order + int(with_constant)
    out, response = np.empty((n_wanted + inputs.shape[0], z.shape[0])), np.empty(z.shape[0])
    line, known = 0, -1
    for column in range(wanted.shape[0]):
        if not wanted[column]:
            continue
        kind = column // order if column < shared else START
        if kind != known:
            _fill_response(kind, z, v, a, begin, response)
            known = kind
        place = column - shared if kind == START else column
        lag, own = place % order, place // order
        for e in range(n_experiments):
            first, last = begin[e], begin[e + 1]
            felt = min(first + lag, last) if kind != START or e == own else last
            for k in range(first, felt):
                out[line, k] = 0.0
            for k in range(felt, last):
                out[line, k] = response[k - lag]
        line += 1
    for i in range(inputs.shape[0]):
        for e in range(n_experiments):
            for k in range(begin[e], begin[e + 1]):
                out[line, k] = 0.0
            add_delayed(inputs[i], b, begin[e], begin[e + 1], out[line])
            all_pole(out[line], a, begin[e], begin[e + 1])
        line += 1
    return out


@compiled
def _count(wanted: Any) -> int:
    count = 0
    for asked in wanted:
        count += int(asked)
    return count


@compiled
def _fill_response(kind: int, z: Floats, v: Floats, a: Floats, begin: Any, out: Floats) -> None:
    """Fill ``out`` with what the first parameter of a kind stands beside, through 1/A."""
    for e in range(begin.shape[0] - 1):
        first, last = begin[e], begin[e + 1]
        if first == last:
            continue
        out[first] = 0.0 if kind in (OUTPUT, INPUT) else 1.0
        for k in range(first + 1, last):
            if kind == OUTPUT:
                out[k] = -z[k - 1]
            elif kind == INPUT:
                out[k] = v[k - 1]
            else:
                out[k] = 1.0 if kind == CONSTANT else 0.0
        all_pole(out, a, first, last)


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

    With v put in, each change is a filter of what it stands beside, with weights that move with time; row by
    row all lines go through it at a time.
    """
    columns, order = np.flatnonzero(wanted), a.shape[0]
    own, n_rows = columns.shape[0], z.shape[0]
    n_lines = own + inputs.shape[0]
    out, d = np.zeros((n_lines, n_rows)), np.empty((n_rows, n_lines))
    W = _moving_weights(a, b, begin, by_position, by_speed)
    for e in range(begin.shape[0] - 1):
        first, last = begin[e], begin[e + 1]
        for line in range(n_lines):
            if line < own:
                _fill_own(out[line], columns[line], order, with_constant, e, z, v, first, last)
            else:
                add_delayed(inputs[line - own], b, first, last, out[line])
        for k in range(first, last):
            for line in range(n_lines):
                d[k, line] = out[line, k]
            for i in range(min(order + 1, k - first), 0, -1):
                weight = W[k, i - 1]
                for line in range(n_lines):
                    d[k, line] += weight * d[k - i, line]
    for line in range(n_lines):
        for k in range(n_rows):
            out[line, k] = d[k, line]
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
) -> Floats:
    """Return dy where forces pass a direct path, by own parameters, by changes of v, and by the path's gain.

    Shape (n_wanted + n_inputs + 1, n_rows).
    """
    columns, order = np.flatnonzero(wanted), a.shape[0]
    own = columns.shape[0]
    by_gain = own + inputs.shape[0]
    out = np.zeros((by_gain + 1, y.shape[0]))
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
                given = inputs[line - own, k] if own <= line < by_gain else 0.0
                moved = v[k] if line == by_gain else 0.0
                slope = by_position[k]
                if k > first:
                    slope += by_speed[k]
                    given -= by_speed[k] * dy[k - 1]
                dy[k] = (dz[k] + moved + direct * given) / (1.0 - direct * slope)
                dv[k] = given + slope * dy[k]
    return out
