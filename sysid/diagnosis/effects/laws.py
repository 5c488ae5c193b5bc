"""Laws given as expressions: forces, gains and pointwise maps, compiled.

The source is made from the checked tree of the expression alone, as for the equations of a physical
model, and kept where numba can keep the compiled code beside it.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from sysid.diagnosis.effects.base import Effect, Floats, Form, Map

# A drive gives the input that acts, from the input, position (or output), speed and parameters.
Drive = Callable[[float, float, float, Floats], float]
# The same for each row of sequences; the last one takes what acts.
Rows = Callable[[Floats, Floats, Floats, Floats, Floats], None]
_LIBRARY = "import numpy as np\n\n# Divided by zero, a number is infinite.\n\n\n"


def drive_of(effect: Effect, form: Form) -> Drive:
    """Return the compiled drive of a force or gain: ``drive(u, x, v, parameters)``.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.diagnosis.effects import find_effects
    >>> (drag,) = find_effects(["quad_drag"])
    >>> drive_of(drag, drag.forms[0])(1.0, 0.0, -2.0, np.array([0.5]))
    3.0
    """
    names = tuple(parameter.name for parameter in form.parameters)
    return _drive(effect.port, form.expression, names)


@lru_cache(maxsize=256)
def pointer_of(law: Drive | Rows, kind: Any) -> Any:
    """Return a drive, or one for rows, as kernels take it: by its address, looked up once."""
    from numba.experimental import function_type

    from sysid._compile import pointer

    address_of: Any = function_type._get_wrapper_address
    return pointer(law, kind, int(address_of(law, kind)))


@lru_cache(maxsize=256)
def _drive(port: str, expression: str, names: tuple[str, ...]) -> Drive:
    source = f"{_LIBRARY}def law(u, x, v, p):\n    return {_change(port, expression, names)}\n"
    drive: Drive = _compiled(source, drive_signature())
    return drive


def _change(port: str, expression: str, names: Sequence[str]) -> str:
    text = _source(expression, {"x": "x", "y": "x", "v": "v"}, names)
    return f"u - {text}" if port == "force" else f"u * {text}"


def rows_of(effect: Effect, form: Form) -> Rows:
    """Return the drive of a force or gain for whole sequences: ``rows(u, x, v, parameters, acting)``.

    Where nothing is fed back within it the compiler takes several rows at a time.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.diagnosis.effects import find_effects
    >>> (drag,) = find_effects(["quad_drag"])
    >>> acting = np.empty(2)
    >>> rows_of(drag, drag.forms[0])(np.ones(2), np.zeros(2), np.array([-2.0, 1.0]), np.array([0.5]), acting)
    >>> acting
    array([3. , 0.5])
    """
    names = tuple(parameter.name for parameter in form.parameters)
    return _rows(effect.port, form.expression, names)


@lru_cache(maxsize=256)
def _rows(port: str, expression: str, names: tuple[str, ...]) -> Rows:
    return _looped(_change(port, expression, names))


def _looped(change: str) -> Rows:
    source = (
        f"{_LIBRARY}def law(inputs, positions, speeds, p, out):\n"
        "    for k in range(inputs.shape[0]):\n        u, x, v = inputs[k], positions[k], speeds[k]\n"
        f"        out[k] = {change}\n"
    )
    rows: Rows = _compiled(source, rows_signature())
    return rows


@lru_cache(maxsize=1)
def no_drive() -> Drive:
    """Return the drive that leaves the input as it is."""
    drive: Drive = _compiled(f"{_LIBRARY}def law(u, x, v, p):\n    return u\n", drive_signature())
    return drive


@lru_cache(maxsize=1)
def no_rows() -> Rows:
    """Return the same for rows."""
    return _looped("u")


@lru_cache(maxsize=1)
def drive_signature() -> Any:
    """Return numba's type of a drive."""
    from numba import types

    number = types.float64
    return number(number, number, number, types.Array(number, 1, "C"))


@lru_cache(maxsize=1)
def rows_signature() -> Any:
    """Return numba's type of a drive for rows."""
    from numba import types

    row = types.Array(types.float64, 1, "C")
    return types.void(row, row, row, row, row)


def pointwise(expression: str, variables: Sequence[str], names: Sequence[str]) -> Map:
    """Return a map that puts each sample through an expression in it and the parameters.

    Examples
    --------
    >>> import numpy as np
    >>> pointwise("s + c*s**3", ("s",), ("c",))(np.array([1.0, 2.0]), np.array([0.5]), 1.0)
    array([1.5, 6. ])
    """
    (variable,) = variables
    text = _source(expression, {variable: "s"}, tuple(names))
    source = (
        f"{_LIBRARY}def law(sequence, p):\n    out = np.empty_like(sequence)\n"
        "    for k in range(sequence.size):\n        s = sequence[k]\n"
        f"        out[k] = {text}\n    return out\n"
    )

    def apply(sequence: Floats, p: Floats, period: float) -> Floats:
        return np.asarray(_compiled(source, None)(sequence, p))

    return apply


def _source(expression: str, variables: dict[str, str], names: Sequence[str]) -> str:
    from sysid.physics.expressions import code
    from sysid.physics.grammar import parse

    inside = variables | {name: f"p[{i}]" for i, name in enumerate(names)}
    return code(parse(expression, set(inside)), inside)


@lru_cache(maxsize=256)
def _compiled(source: str, signature: Any) -> Any:
    import numba

    from sysid.physics.generator import functions_of

    (law,), kept = functions_of(source, __name__, "law")
    compiler: Any = numba.njit(signature, cache=kept, nogil=True, error_model="numpy")
    return compiler(law)
