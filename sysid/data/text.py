"""Text tables: how they are written is found out, then they are read."""

import csv
import gzip
import re
import warnings
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.data.preamble import SEPARATORS, WHITE_SPACE, found_table, is_number
from sysid.data.units import named_units
from sysid.errors import DataError

if TYPE_CHECKING:
    import pandas as pd

COMMENT_SIGNS = ("#", "%", "//")
HEAD_BYTES = 65536
# Cells without a value.
MISSING = ["", "nan", "NaN", "NAN", "NA", "#N/A", "null", "NULL"]
LONGEST_UNIT = 12
# UTF-32 first: its little-endian mark begins with that of UTF-16.
BYTE_ORDER_MARKS = (
    ((b"\xff\xfe\0\0", b"\0\0\xfe\xff"), "utf-32"),
    ((b"\xff\xfe", b"\xfe\xff"), "utf-16"),
)
UNPRINTABLE = frozenset(range(32)) - frozenset(b"\t\n\v\f\r\x1a\x1b")


@dataclass(frozen=True)
class Dialect:
    """How a text table is written."""

    encoding: str
    separator: str
    decimal: str
    comment: str | None
    columns: tuple[str, ...]
    lines_before_header: int
    header_lines: int = 1


def _open(path: Path) -> bytes:
    """Return the first bytes of the file, decompressed."""
    if path.is_dir():
        raise DataError(f"{path} is a folder: give the file with the measurements")
    try:
        with path.open("rb") as raw:
            packed = raw.read(2) == b"\x1f\x8b"
        with gzip.open(path, "rb") if packed else path.open("rb") as stream:
            return stream.read(HEAD_BYTES)
    except FileNotFoundError:
        raise DataError(f"there is no file {path}: check the name and the folder") from None
    except (OSError, EOFError, ValueError, zlib.error) as problem:
        reason = getattr(problem, "strerror", None) or problem
        raise DataError(f"{path} cannot be read ({reason}): give a whole, readable file") from None


def detect(path: Path, separator: str | None, decimal: str | None) -> Dialect:
    """Find out how the table is written from its first lines."""
    head = _open(path)
    encoding = _encoding(head, path)
    text = head.decode(encoding, errors="ignore")
    lines = text.splitlines()
    before = 0
    while before < len(lines) and (not lines[before].strip() or lines[before].startswith(COMMENT_SIGNS)):
        before += 1
    if before == len(lines):
        raise DataError(f"{path} is empty: it needs a header row with column names and rows of numbers")
    comment = next((line[0] for line in lines[:before] if line.startswith(COMMENT_SIGNS)), None)
    whole = lines if len(head) < HEAD_BYTES else lines[:-1]
    table = found_table(whole, before, [separator] if separator else SEPARATORS, decimal)
    if table is not None:
        before, separator = table.first, table.separator
    header = lines[before]
    if separator is None:
        separator = max(SEPARATORS, key=header.count)
        if header.count(separator) == 0:
            separator = WHITE_SPACE
    columns = tuple(name.strip() for name in _header_cells(header, separator))
    if decimal is None:
        decimal = _decimal(lines[before + 1 : before + 200], separator)
    if all(is_number(name.replace(decimal, ".")) for name in columns) and not _counts(columns):
        numbers = tuple(str(1 + place) for place in range(len(columns)))
        return Dialect(encoding, separator, decimal, comment, numbers, before, header_lines=0)
    units = _units(lines[before + 1 : before + 3], separator, decimal)
    if len(units) != len(columns):
        return Dialect(encoding, separator, decimal, comment, columns, before)
    columns = tuple(_with_unit(name, unit) for name, unit in zip(columns, units, strict=True))
    return Dialect(encoding, separator, decimal, comment, columns, before, header_lines=2)


def _counts(columns: Sequence[str]) -> bool:
    """Tell whether a row of numbers counts the columns, as a header without names does."""
    return list(columns) in ([str(i + first) for i in range(len(columns))] for first in (0, 1))


def _units(lines: Sequence[str], separator: str, decimal: str) -> list[str]:
    """Return the row of units below the header; empty where there is none.

    It holds short words and no number; below it numbers stand, and none of the words again, as in a column
    that tells the rows of the fit from those of the test.
    """
    if len(lines) < 2:
        return []
    units, below = ([cell.strip() for cell in _header_cells(line, separator)] for line in lines)
    measured = [is_number(cell.replace(decimal, ".")) for cell in below]
    told = [unit for unit, number in zip(units, measured, strict=False) if unit and number]
    again = any(unit and unit == cell for unit, cell in zip(units, below, strict=False))
    if not told or again or any(is_number(u.replace(decimal, ".")) or len(u) > LONGEST_UNIT for u in units):
        return []
    return [unit.strip("[]()") for unit in units]


def _with_unit(name: str, unit: str) -> str:
    """Return a name with its unit in brackets, if the unit is a word and the name has none yet."""
    full = f"{name} [{unit}]"
    return full if named_units([full]) and not named_units([name]) else name


def _encoding(head: bytes, path: Path) -> str:
    for marks, encoding in BYTE_ORDER_MARKS:
        if head.startswith(marks):
            return encoding
    if not UNPRINTABLE.isdisjoint(head):
        raise DataError(f"{path} is not a text table: export it as CSV")
    try:
        # Four bytes less, so that a character cut by the end of the head does not count.
        head[:-4].decode("utf-8") if len(head) == HEAD_BYTES else head.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _header_cells(header: str, separator: str) -> list[str]:
    """Cut the header, in which a quoted name may hold the separator."""
    if separator == WHITE_SPACE:
        return [name.strip('"') for name in header.split()]
    return next(csv.reader([header], delimiter=separator, skipinitialspace=True))


def _cells(line: str, separator: str) -> list[str]:
    return line.split() if separator == WHITE_SPACE else line.split(separator)


def _decimal(lines: Sequence[str], separator: str) -> str:
    """Return the decimal sign: a comma if cells hold commas and no points."""
    if separator == ",":
        return "."
    cells = [cell.strip() for line in lines for cell in _cells(line, separator)]
    commas = sum(is_number(cell.replace(",", ".")) for cell in cells if cell.count(",") == 1)
    points = sum(is_number(cell) for cell in cells if "." in cell)
    return "," if commas > points else "."


def read_table(path: Path, dialect: Dialect, wanted: Sequence[str], texts: Sequence[str]) -> "pd.DataFrame":
    """Read columns of a text table; those in `texts` as text."""
    import pandas as pd

    names = list(dict.fromkeys(wanted))
    places = {dialect.columns.index(name): name for name in names}
    beyond = len(dialect.columns)  # one cell after the last column, to see rows that are too long
    with path.open("rb") as raw:
        compression = "gzip" if raw.read(2) == b"\x1f\x8b" else None
    options: dict[str, Any] = {
        "sep": dialect.separator,
        "decimal": dialect.decimal,
        "encoding": dialect.encoding,
        "skiprows": dialect.lines_before_header + dialect.header_lines,
        "header": None,
        "names": range(beyond + 1),  # places: names of columns that are not read may be double
        "dtype": {**{place: "str" for place, name in places.items() if name in texts}, beyond: "str"},
        "keep_default_na": False,
        "na_values": {place: MISSING for place, name in places.items() if name not in texts},
        "skipinitialspace": True,
        "comment": dialect.comment,
        "index_col": False,
        "compression": compression,
        "low_memory": False,
    }
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # cells of long rows would be lost
            table: pd.DataFrame = pd.read_csv(path, **options)
    except pd.errors.ParserWarning:
        raise _too_long(path, "row 1", dialect) from None
    except (pd.errors.ParserError, UnicodeError, EOFError, OSError, zlib.error) as problem:
        if place := re.search(r"Expected \d+ fields in (line \d+), saw", str(problem)):
            raise _too_long(path, place[1], dialect) from None
        reason = " ".join(str(problem).split())
        raise DataError(
            f"{path} cannot be read as a table ({reason}): repair the file or export it again"
        ) from None
    if len(table) == 0:
        raise DataError(f"{path} has a header and no rows: it needs rows of numbers")
    longer = (table[beyond].fillna("").str.strip() != "").to_numpy(dtype=bool)
    if longer.any():
        raise _too_long(path, f"row {int(np.argmax(longer)) + 1}", dialect)
    return table.rename(columns=places)


def _too_long(path: Path, place: str, dialect: Dialect) -> DataError:
    """Return the error for a row whose values would stand in wrong columns."""
    return DataError(
        f"{path.name}, {place}: there are more cells than the {len(dialect.columns)} columns of the header: "
        f"quote cells that hold {dialect.separator!r}, such as numbers with a decimal comma or thousands "
        "separators, or give every column a name"
    )
