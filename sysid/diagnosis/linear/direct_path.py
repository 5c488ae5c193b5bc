"""Compiled recursions of a difference equation whose forces pass a direct path, too.

y(k) = z(k) + direct v(k), with z as in `kernels`, and v(k) is the input x(k) after drives that see
y(k) and y(k) - y(k-1): so each y(k) is the root of an equation.
"""

from typing import Any

from numba import types

from sysid._compile import compiled_for
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.effects.laws import Drive, drive_signature
from sysid.diagnosis.linear.kernels import LARGEST, drive_at

# Steps of the secant method, and the error it ends with, beside the size of what is added up: rounding.
ROOT_STEPS, ROOT_ERROR = 50, 1e-14

_number, _row, _index = types.float64, types.Array(types.float64, 1, "C"), types.Array(types.int64, 1, "C")
_matrix = types.Array(types.float64, 2, "C")
_drive = types.FunctionType(drive_signature())


@compiled_for(
    types.boolean(
        _row,
        _row,
        _row,
        _number,
        _number,
        _matrix,
        _index,
        types.int64,
        _drive,
        _row,
        _drive,
        _row,
        _row,
        _row,
    )
)
def simulate_through(
    x: Floats,
    a: Floats,
    b: Floats,
    direct: float,
    constant: float,
    start: Floats,
    begin: Any,
    n_drives: int,
    first: Drive,
    p: Floats,
    second: Drive,
    q: Floats,
    y: Floats,
    v: Floats,
) -> bool:
    """Fill ``y`` and ``v``; return False if the run diverges, or an equation has no root near its terms."""
    order = a.shape[0]
    for e in range(begin.shape[0] - 1):
        for k in range(begin[e], begin[e + 1]):
            age = k - begin[e]
            value = constant
            for i in range(1, min(order, age) + 1):
                value += b[i - 1] * v[k - i] - a[i - 1] * (y[k - i] - direct * v[k - i])
            if age < order:
                value += start[e, age]
            if not abs(value) < LARGEST:
                return False
            # Without a speed in the first row, whatever its position.
            here = value + direct * x[k]
            size = abs(value) + abs(direct * x[k])
            before = y[k - 1] if age > 0 else here
            acting = drive_at(x[k], here, here - before, n_drives, first, p, second, q)
            error = value + direct * acting - here
            change = error
            for _ in range(ROOT_STEPS):
                if not abs(error) > ROOT_ERROR * size:
                    break
                here += change
                if age == 0:
                    before = here
                acting = drive_at(x[k], here, here - before, n_drives, first, p, second, q)
                error_before, error = error, value + direct * acting - here
                if error == error_before:
                    break
                change *= error / (error_before - error)
            if not abs(error) <= 1e3 * ROOT_ERROR * (size + abs(here)):
                return False
            y[k], v[k] = here, acting
    return True
