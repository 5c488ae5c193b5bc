"""Files that a command writes: where they may stand, and how they are written."""

import json
import os
from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

from sysid.errors import UsageError

DEFAULT_FOLDER = Path("sysid-out")


def stem_of(data: Path) -> str:
    """Return the name of a record without the ending of its file."""
    return data.name.removesuffix(".gz").rsplit(".", 1)[0]


def finite(value: float) -> float | None:
    """Return the value, or None if it is not finite: JSON has no NaN."""
    return float(value) if isfinite(value) else None


def to_json_text(content: dict[str, Any]) -> str:
    """Return strict JSON: no NaN."""
    return json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def to_csv_text(columns: Mapping[str, Sequence[float]], empty: int = 0) -> str:
    """Return a CSV with one row for each row of a measurement file, k from 0; what is not finite is empty.

    Parameters
    ----------
    columns : mapping of str to sequence of float
        Values of the rows of the record.
    empty : int
        Rows without values behind them.

    Examples
    --------
    >>> print(to_csv_text({"y": [0.5, float("nan")]}, empty=1), end="")
    k,y
    0,0.5
    1,
    2,
    """
    lines = [",".join(["k", *columns])]
    for k, values in enumerate(zip(*columns.values(), strict=True)):
        lines.append(",".join([str(k), *(repr(value) if isfinite(value) else "" for value in values)]))
    lines += [f"{len(lines) - 1 + k}{',' * len(columns)}" for k in range(empty)]
    return "\n".join(lines) + "\n"


def write_text(path: Path, text: str) -> None:
    """Write a text, with its folder if need be."""
    write_result(path, text.encode("utf-8", errors="backslashreplace"))  # a name may be no Unicode


def write_result(path: Path, content: bytes) -> None:
    """Write a result, with its folder if need be."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    except OSError as problem:
        raise _unwritable(path, problem.strerror) from None


def check_results(results: Sequence[Path], data: Path) -> None:
    """Refuse to write over the measurements, their notes or another result, or where nothing can be."""
    for index, path in enumerate(results):
        try:
            if path.resolve() == data.resolve():
                raise UsageError(f"{path} is the measurement file: write the result to another place")
            if path.is_dir():
                raise UsageError(f"{path} is a folder: give the name of a file in it")
            if _is_notes(path, data):
                raise UsageError(f"{path} holds notes on the measurements: write the result to another place")
            if path.resolve() in [other.resolve() for other in results[:index]]:
                raise UsageError(f"{path} is named for two results: give each a file of its own")
            folder = next(place for place in path.absolute().parents if place.exists())
        except OSError as problem:
            raise _unwritable(path, problem.strerror) from None
        if not (folder.is_dir() and os.access(folder, os.W_OK)):
            raise _unwritable(path, f"{folder} is {'a file' if folder.is_file() else 'not to be written in'}")


def _unwritable(path: Path, reason: str | None) -> UsageError:
    return UsageError(f"{path} cannot be written ({reason}): choose another place")


def _is_notes(path: Path, data: Path) -> bool:
    """Tell whether a file stands where notes are read and is not an earlier result."""
    from sysid.data.notes import notes_path

    if path.resolve() != notes_path(data).resolve() or not path.exists():
        return False
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError):
        return True
    return not (isinstance(content, dict) and {"schema", "model", "scores"} <= content.keys())
