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

    All changes go from row to row together, in vector instructions.
    """
    columns = np.flatnonzero(wanted)
    n, order = columns.shape[0] + inputs.shape[0], a.shape[0]
    d, dv = np.zeros((z.shape[0], n)), np.zeros((z.shape[0], n))
    dv[:, columns.shape[0] :] = inputs.T
    for e in range(begin.shape[0] - 1):
        for k in range(begin[e], begin[e + 1]):
            age = k - begin[e]
            _fill_own(d[k], columns, order, with_constant, e, age, z, v, k)
            _add_lags(d, dv, a, b, k, min(order, age))
            slope = by_position[k] + (by_speed[k] if age > 0 else 0.0)
            for j in range(n):
                dv[k, j] += slope * d[k, j]
            if age > 0:
                for j in range(n):
                    dv[k, j] -= by_speed[k] * d[k - 1, j]
    return d.T.copy()


@compiled
def _fill_own(
    row: Floats, columns: Any, order: int, with_constant: bool, e: int, age: int, z: Floats, v: Floats, k: int
) -> None:
    """Fill in what own parameters stand beside in row k: a lag, a one or nothing."""
    first = 2 * order + int(with_constant)
    for j in range(columns.shape[0]):
        column = columns[j]
        if column < order:
            row[j] = -z[k - column - 1] if age > column else 0.0
        elif column < 2 * order:
            row[j] = v[k - column + order - 1] if age > column - order else 0.0
        else:
            row[j] = 1.0 if column < first or (age < order and column - first == e * order + age) else 0.0


@compiled
def _add_lags(dz: Floats, dv: Floats, a: Floats, b: Floats, k: int, lags: int) -> None:
    """Add to row k what the rows before it hand on."""
    for i in range(1, lags + 1):
        for j in range(dz.shape[1]):
            dz[k, j] += b[i - 1] * dv[k - i, j] - a[i - 1] * dz[k - i, j]


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
    columns = np.flatnonzero(wanted)
    own, order = columns.shape[0], a.shape[0]
    n = own + inputs.shape[0]
    z, moved, dy = y - direct * v, np.zeros(n), np.zeros((y.shape[0], n))
    dz, dv = np.zeros((y.shape[0], n)), np.zeros((y.shape[0], n))
    dv[:, own:] = inputs.T
    for e in range(begin.shape[0] - 1):
        for k in range(begin[e], begin[e + 1]):
            age = k - begin[e]
            _fill_own(dz[k], columns, order, with_constant, e, age, z, v, k)
            _add_lags(dz, dv, a, b, k, min(order, age))
            moved[own:] = outputs[:, k]
            slope = by_position[k] + (by_speed[k] if age > 0 else 0.0)
            if age > 0:
                for j in range(n):
                    dv[k, j] -= by_speed[k] * dy[k - 1, j]
            for j in range(n):
                dy[k, j] = (dz[k, j] + moved[j] + direct * dv[k, j]) / (1.0 - direct * slope)
                dv[k, j] += slope * dy[k, j]
    return dy.T.copy()
