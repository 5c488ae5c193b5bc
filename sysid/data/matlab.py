"""Variables of MATLAB files up to version 7, read by SciPy."""

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.data.variables import Variable, by_type, refused

OBJECT = "is a MATLAB object or function, which is not read: save its numbers as plain variables"
STRUCTS = "is an array of structures: save each column under a name of its own"
CELLS = "is a cell array of other things than texts: save it as plain numbers"
SPARSE = "is a sparse matrix: save it with full()"
DEEPEST = 4


def variables(path: Path) -> Sequence[tuple[str, Variable]]:
    """List the variables; the fields of a structure ``s`` are ``s.field``."""
    from scipy.io import loadmat

    with warnings.catch_warnings():
        # Variables SciPy cannot represent are refused by name when they are asked for.
        warnings.simplefilter("ignore")
        content = loadmat(path, struct_as_record=True, chars_as_strings=True, squeeze_me=False)
    return [
        found for name, value in content.items() if not name.startswith("__") for found in _flat(name, value)
    ]


def _flat(name: str, value: Any, depth: int = 0) -> Iterator[tuple[str, Variable]]:
    from scipy.io.matlab import MatlabFunction, MatlabObject, MatlabOpaque
    from scipy.sparse import issparse

    if issparse(value):
        yield name, refused(SPARSE)
    elif isinstance(value, MatlabFunction | MatlabObject | MatlabOpaque) or not isinstance(value, np.ndarray):
        yield name, refused(OBJECT)
    elif value.dtype.names is not None:
        if value.size != 1 or depth >= DEEPEST:
            yield name, refused(STRUCTS)
            return
        for field in value.dtype.names:
            yield from _flat(f"{name}.{field}", value.reshape(-1)[0][field], depth + 1)
    elif value.dtype.kind == "O":
        yield name, _cells(value)
    else:
        yield name, _plain(value)


def _plain(value: NDArray[Any]) -> Variable:
    return Variable(
        value.shape, lambda: np.char.strip(value) if value.dtype.kind == "U" else value, by_type(value.dtype)
    )


def _cells(value: NDArray[Any]) -> Variable:
    """Return a cell array of texts as text."""
    cells = value.reshape(-1)
    if not all(isinstance(cell, np.ndarray) and cell.dtype.kind == "U" and cell.size <= 1 for cell in cells):
        return refused(CELLS)
    texts = np.asarray([str(cell.reshape(-1)[0]) if cell.size else "" for cell in cells], dtype=str)
    return Variable(value.shape, lambda: texts)
