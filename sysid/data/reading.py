"""Read a record from a table in a file."""

import csv
import gzip
import re
import warnings
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sysid.data.formats import stored_table
from sysid.data.notes import known_period, read_notes
from sysid.data.record import Floats, Record, make_record, names_of
from sysid.data.registry import EXPERIMENT_COLUMN, SPLIT_COLUMN, registered_path
from sysid.data.times import period_from_times, restarts
from sysid.errors import DataError, UsageError

if TYPE_CHECKING:
    import pandas as pd

SEPARATORS = (";", "\t", ",", "|")
COMMENT_SIGNS = ("#", "%", "//")
TIME_COLUMN = "t"
HEAD_BYTES = 65536
LISTED_COLUMNS = 20
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


def read_record(
    path: str | Path,
    *,
    inputs: Sequence[str] = ("u",),
    outputs: Sequence[str] = ("y",),
    period: float | None = None,
    time: str | None = None,
    split: str | None = None,
    experiment: str | None = None,
    skip: int | None = None,
    separator: str | None = None,
    decimal: str | None = None,
) -> Record:
    r"""Read a record from a CSV (plain or ``.gz``), Parquet, MATLAB or npz file.

    The suffix tells the format.  In a text table separator, decimal comma, byte order mark and
    comment lines are detected.  In ``.mat`` (any version) and ``.npz`` files each variable of
    n x 1 or 1 x n numbers is a column, fields of a MATLAB structure ``s`` are columns ``s.field``,
    and a scalar ``Ts``, ``dt``, ``period`` [s] or ``fs`` [Hz] gives the sampling period; nothing in
    them is ever executed.  A JSON file of the same name beside the table may give ``units``, ``Ts``
    [s] and ``splits.<set>.skip``, which are used where nothing else is said.

    Parameters
    ----------
    path : str or Path
        Where there is no such file, the name of a registered record that is at hand (`sysid.data.registry`);
        its split and experiment columns are then known.
    inputs, outputs : sequence of str
        Column names.
    period : float, optional
        Sampling period [s].
    time : str, optional
        Column with the time [s]; it must be uniform, and starts a new experiment where it restarts.
    split, experiment : str, optional
        Columns with the split and the experiment.
    skip : int, optional
        Rows not scored at the beginning of each test set.
    separator, decimal : str, optional
        Overrule what is detected in a text table.

    Returns
    -------
    Record

    Raises
    ------
    DataError
        If the file cannot be read or used; the message names row, column and value.
    UsageError
        If a column does not exist or neither period nor time is known.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> table = pathlib.Path(folder.name, "pump.csv")
    >>> _ = table.write_text("t;u;y\n" + "".join(f"{k};{k % 3};{k % 5},5\n" for k in range(40)))
    >>> read_record(table, time="t")
    Record('pump': 40 rows at 1 s, u -> y, 1 experiment, estimation 30, validation 10, test sets: none)
    >>> folder.cleanup()
    """
    path = Path(path)
    inputs, outputs = names_of(inputs), names_of(outputs)
    for what, names in (("input", inputs), ("output", outputs)):
        if not names:
            raise UsageError(f"no {what} column is named: name at least one")
    for what, sign in (("separator", separator), ("decimal", decimal)):
        if sign is not None and len(sign) != 1:
            raise UsageError(f"{what} is {sign!r}: give a single sign, or leave it out to have it detected")
    try:
        return _read(path, inputs, outputs, period, time, split, experiment, skip, separator, decimal)
    except DataError as problem:
        # What is found in the numbers does not know the file they came from.
        text = str(problem)
        place = "" if path.name in text else f"{path.name}, " if text.startswith("row") else f"{path.name}: "
        raise DataError(place + text) from None


def _read(
    path: Path,
    inputs: Sequence[str],
    outputs: Sequence[str],
    period: float | None,
    time: str | None,
    split: str | None,
    experiment: str | None,
    skip: int | None,
    separator: str | None,
    decimal: str | None,
) -> Record:
    registered = registered_path(path)
    if registered is not None:
        path, split, experiment = registered, split or SPLIT_COLUMN, experiment or EXPERIMENT_COLUMN
    wanted = [*inputs, *outputs, *(name for name in (time, split, experiment) if name is not None)]
    texts = [name for name in (split, experiment) if name is not None]
    stored = stored_table(path)
    if stored is None:
        dialect = _detect(path, separator, decimal)
        columns = dialect.columns
    else:
        columns = stored.columns(wanted)
    _check_columns(path, columns, wanted, inputs, outputs)
    clock = time if time is not None else _restart_column(columns, wanted)
    names = [*wanted, *([clock] if clock is not None else [])]
    if stored is None:
        table = _read_table(path, dialect, names, texts)
    else:
        table = stored.read(names, texts)
        period = stored.period() if period is None and time is None else period
    notes = read_notes(path)
    labels = None if split is None else _text(table, split)
    remarks = list(notes.warnings)
    try:
        times = None if clock is None else _numbers(table, clock, path)
    except DataError:
        if time is not None:
            raise
        times = None
        remarks.append(
            f"Column {clock!r} does not hold numbers: restarts of the time are not looked for, experiments "
            "are told apart by the experiment column only."
        )
    known = None if experiment is None else _text(table, experiment)
    groups = _experiments(known, times, strict=time is not None)
    if time is not None and times is not None:
        period = period_from_times(times, groups, time, period)
    return make_record(
        np.column_stack([_numbers(table, name, path) for name in inputs]),
        np.column_stack([_numbers(table, name, path) for name in outputs]),
        known_period(period, notes),
        name=path.name.removesuffix(".gz").rsplit(".", 1)[0],
        inputs=tuple(inputs),
        outputs=tuple(outputs),
        units=notes.units,
        split=labels,
        experiment=groups,
        skip=notes.skips(labels) if skip is None else skip,
        warnings=remarks,
        source=path,
    )


def _open(path: Path) -> bytes:
    """Return the first bytes of the file, decompressed."""
    try:
        if path.is_dir():
            raise DataError(f"{path} is a folder: give the file with the measurements")
        with path.open("rb") as raw:
            packed = raw.read(2) == b"\x1f\x8b"
        with gzip.open(path, "rb") if packed else path.open("rb") as stream:
            return stream.read(HEAD_BYTES)
    except FileNotFoundError:
        raise DataError(f"there is no file {path}: check the name and the folder") from None
    except (OSError, EOFError, ValueError, zlib.error) as problem:
        reason = getattr(problem, "strerror", None) or problem
        raise DataError(f"{path} cannot be read ({reason}): give a whole, readable file") from None


def _detect(path: Path, separator: str | None, decimal: str | None) -> Dialect:
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
    header = lines[before]
    if separator is None:
        separator = max(SEPARATORS, key=header.count)
        if header.count(separator) == 0:
            separator = r"\s+"
    columns = tuple(name.strip() for name in _header_cells(header, separator))
    if all(_is_number(name) for name in columns):
        raise DataError(
            f"{path}: the first row is {header.strip()[:60]!r}, all numbers: columns are chosen by name, "
            "so add a header row"
        )
    if decimal is None:
        decimal = _decimal(lines[before + 1 : before + 200], separator)
    return Dialect(encoding, separator, decimal, comment, columns, before)


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
    if separator == r"\s+":
        return [name.strip('"') for name in header.split()]
    return next(csv.reader([header], delimiter=separator, skipinitialspace=True))


def _cells(line: str, separator: str) -> list[str]:
    return line.split() if separator == r"\s+" else line.split(separator)


def _decimal(lines: Sequence[str], separator: str) -> str:
    """Return the decimal sign: a comma if cells hold commas and no points."""
    if separator == ",":
        return "."
    cells = [cell.strip() for line in lines for cell in _cells(line, separator)]
    commas = sum(_is_number(cell.replace(",", ".")) for cell in cells if cell.count(",") == 1)
    points = sum(_is_number(cell) for cell in cells if "." in cell)
    return "," if commas > points else "."


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _check_columns(
    path: Path,
    columns: Sequence[str],
    wanted: Sequence[str],
    inputs: Sequence[str],
    outputs: Sequence[str],
) -> None:
    for name in wanted:
        if name not in columns:
            near = _nearest(name, columns)
            guess = f"; did you mean {near!r}?" if near else ":"
            more = len(columns) - LISTED_COLUMNS
            listed = ", ".join(columns[:LISTED_COLUMNS]) + (f" and {more} more" if more > 0 else "")
            raise UsageError(f"{path.name} has no column {name!r}{guess} it has {listed}")
        if columns.count(name) > 1:
            raise DataError(f"{path.name} has {columns.count(name)} columns named {name!r}: rename one")
    both = set(inputs) & set(outputs)
    if both:
        raise UsageError(f"column {both.pop()!r} is both input and output: choose one of the two")
    for name in inputs:
        if (times := list(inputs).count(name)) > 1:
            raise UsageError(f"column {name!r} is given {times} times as input: give it once")


def _nearest(name: str, columns: Sequence[str]) -> str | None:
    """Return the column that was perhaps meant; upper and lower case count as equal."""
    folded = {column.casefold(): column for column in reversed(columns)}
    near = get_close_matches(name.casefold(), list(folded), n=1, cutoff=0.5)
    return folded[near[0]] if near else None


def _restart_column(columns: Sequence[str], wanted: Sequence[str]) -> str | None:
    """Return the time column that only tells where experiments restart."""
    return TIME_COLUMN if TIME_COLUMN in columns and TIME_COLUMN not in wanted else None


def _read_table(path: Path, dialect: Dialect, wanted: Sequence[str], texts: Sequence[str]) -> "pd.DataFrame":
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
        "skiprows": dialect.lines_before_header + 1,
        "header": None,
        "names": range(beyond + 1),  # places: names of columns that are not read may be double
        "dtype": {**{place: "str" for place, name in places.items() if name in texts}, beyond: "str"},
        "keep_default_na": False,
        "na_values": {place: [""] for place, name in places.items() if name not in texts},
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


def _numbers(table: "pd.DataFrame", name: str, path: Path) -> Floats:
    """Return a column as floats; a cell that is no number is an error."""
    import pandas as pd

    column = table[name]
    if not pd.api.types.is_numeric_dtype(column):
        values = pd.to_numeric(column, errors="coerce").to_numpy(dtype=np.float64)
        texts = column.fillna("").astype(str).str.strip()
        wrong = np.isnan(values) & ~texts.str.lower().isin(["", "nan"]).to_numpy(dtype=bool)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise DataError(
                f"{path.name}, row {row + 1}, column {name!r}: {texts.iloc[row]!r} is not a number: "
                "repair the cell or leave out the row"
            )
        return np.asarray(values)
    return column.to_numpy(dtype=np.float64)


def _text(table: "pd.DataFrame", name: str) -> NDArray[np.str_]:
    return np.asarray(table[name].to_numpy(dtype=str))


def _experiments(
    known: NDArray[np.str_] | None, times: Floats | None, *, strict: bool
) -> NDArray[np.str_] | None:
    """Join the experiment column with the places where the time restarts."""
    if times is None:
        return known
    new = restarts(times, known, strict=strict)
    if not new.any():
        return known
    if known is None:
        return np.asarray((1 + np.cumsum(new)).astype(str))
    part = np.zeros(times.size, dtype=np.int64)
    for name in np.unique(known):
        rows = known == name
        part[rows] = np.cumsum(new[rows])
    return np.where(part > 0, np.char.add(np.char.add(known, " part "), (part + 1).astype(str)), known)
