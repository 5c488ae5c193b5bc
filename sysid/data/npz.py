"""Variables of npz files; pickled objects are never loaded."""

import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from sysid.data.variables import Variable, by_type, refused
from sysid.errors import DataError

MEMBER = ".npy"


def variables(path: Path) -> Sequence[tuple[str, Variable]]:
    """List the arrays of an npz file from their headers.

    Raises
    ------
    DataError
        If it is no npz file.
    """
    found = []
    if not zipfile.is_zipfile(path):
        raise DataError(f"{path} is not an npz file, or cut short: save it with numpy.savez")
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            if member.filename.endswith(MEMBER):
                found.append((member.filename.removesuffix(MEMBER), _variable(path, archive, member)))
    return found


def _variable(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> Variable:
    with archive.open(member) as stream:
        version = npy.read_magic(stream)
        if version == (1, 0):
            shape, _, dtype = npy.read_array_header_1_0(stream)
        elif version == (2, 0):
            shape, _, dtype = npy.read_array_header_2_0(stream)
        else:
            return refused("is an array with named fields: save each field under a name of its own")
        place = stream.tell()
    objection = by_type(dtype)
    if not objection and int(np.prod(shape, dtype=object)) * dtype.itemsize != member.file_size - place:
        raise DataError(
            f"{path}: the array {member.filename.removesuffix(MEMBER)!r} does not hold the values its header "
            "tells: the file is damaged; save it again"
        )
    return Variable(tuple(shape), _loader(path, member.filename), objection)


def _loader(path: Path, member: str) -> Callable[[], NDArray[Any]]:
    def load() -> NDArray[Any]:
        with zipfile.ZipFile(path) as archive, archive.open(member) as stream:
            values: NDArray[Any] = npy.read_array(stream, allow_pickle=False)
        return np.char.decode(values, "utf-8") if values.dtype.kind == "S" else values

    return load
