"""Variables of MATLAB files of version 7.3, which are HDF5 files."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.data.matlab import CELLS, DEEPEST, OBJECT, SPARSE, STRUCTS
from sysid.data.variables import Variable, by_type, refused

ELSEWHERE = "is a link to another place: save the values themselves"
PLAIN = frozenset(
    {
        "",
        "double",
        "single",
        "logical",
        *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
    }
)


def variables(path: Path) -> Sequence[tuple[str, Variable]]:
    """List the variables; the fields of a structure ``s`` are ``s.field``."""
    import h5py

    with h5py.File(path, "r") as file:
        return list(_members(path, file, ""))


def _members(path: Path, group: Any, before: str, depth: int = 0) -> Iterator[tuple[str, Variable]]:
    import h5py

    for name in group:
        if name.startswith("#"):  # what MATLAB stores for cells and objects
            continue
        full = before + name
        # Links could lead to other files or round in circles.
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            yield full, refused(ELSEWHERE)
            continue
        item = group[name]
        if isinstance(item, h5py.Dataset):
            yield full, _variable(path, item)
        elif not isinstance(item, h5py.Group) or "MATLAB_object_decode" in item.attrs:
            yield full, refused(OBJECT)
        elif "MATLAB_sparse" in item.attrs:
            yield full, refused(SPARSE)
        elif depth >= DEEPEST:
            yield full, refused(STRUCTS)
        else:
            yield from _members(path, item, f"{full}.", depth + 1)


def _variable(path: Path, item: Any) -> Variable:
    import h5py

    known = _matlab_class(item)
    if item.external or item.is_virtual:
        return refused(ELSEWHERE)
    if "MATLAB_object_decode" in item.attrs or known == "function_handle":
        return refused(OBJECT)
    if item.attrs.get("MATLAB_empty", 0) or item.shape is None:
        return Variable((0,), lambda: np.empty(0))
    if known == "char":
        # One column of letters for each text.
        return Variable(item.shape[1:], _loader(path, item.name, _letters))
    if h5py.check_ref_dtype(item.dtype) is not None:
        return refused(STRUCTS) if known != "cell" else _cells(path, item)
    if item.dtype.names == ("real", "imag"):
        return refused(by_type(np.dtype(complex)))
    if h5py.check_string_dtype(item.dtype) is not None:
        return Variable(item.shape, _loader(path, item.name, lambda data: data.asstr()[()]))
    if known not in PLAIN:
        return refused(OBJECT)
    return Variable(item.shape[::-1], _loader(path, item.name, lambda data: data[()]), by_type(item.dtype))


def _matlab_class(item: Any) -> str:
    value = item.attrs.get("MATLAB_class", b"")
    return value.decode("ascii", "replace") if isinstance(value, bytes) else str(value)


def _letters(data: Any) -> NDArray[Any]:
    """Return the texts that columns of character codes spell."""
    codes = np.asarray(data[()]).T
    return np.asarray(
        ["".join(map(chr, row)).strip() for row in codes.reshape(-1, codes.shape[-1])], dtype=str
    )


def _cells(path: Path, item: Any) -> Variable:
    """Return a cell array of texts as text."""
    first = item.file[item[()].reshape(-1)[0]] if item.size else None
    if first is None or _matlab_class(first) != "char":
        return refused(CELLS)

    def texts(data: Any) -> NDArray[Any]:
        return np.asarray([_text(data.file[place]) for place in data[()].reshape(-1)], dtype=str)

    return Variable(item.shape[::-1], _loader(path, item.name, texts))


def _text(cell: Any) -> str:
    if _matlab_class(cell) != "char":
        raise ValueError(CELLS)
    return "" if cell.attrs.get("MATLAB_empty", 0) else str(_letters(cell)[0])


def _loader(path: Path, name: str, read: Callable[[Any], NDArray[Any]]) -> Callable[[], NDArray[Any]]:
    def load() -> NDArray[Any]:
        import h5py

        with h5py.File(path, "r") as file:
            return np.asarray(read(file[name]))

    return load
