"""Read a record from a table in a file."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sysid.data.columns import Wanted
from sysid.data.empty_rows import without_empty_end
from sysid.data.formats import stored_table
from sysid.data.notes import known_period, read_notes
from sysid.data.record import Floats, Record, make_record, names_of
from sysid.data.registry import EXPERIMENT_COLUMN, SPLIT_COLUMN, registered_path
from sysid.data.resampling import checked_period, clock_of, resample_table
from sysid.data.text import detect, read_table
from sysid.data.times import period_from_times, remarks_on_times, restarts, seconds_of_dates
from sysid.data.units import in_seconds, named_units, time_unit
from sysid.errors import DataError, UsageError

if TYPE_CHECKING:
    import pandas as pd


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
    resample: float | None = None,
) -> Record:
    r"""Read a record from a CSV (plain or ``.gz``), Parquet, MATLAB or npz file.

    The suffix tells the format.  In a text table separator, decimal comma, byte order mark, comment lines
    and other lines above the header are detected; columns without a header are named by their place, ``1``
    first.  Rows at its end that lack an input or an output are left out, with a warning.  In ``.mat`` (any
    version) and ``.npz`` files each variable of n x 1 or 1 x n numbers is a column, fields of a MATLAB
    structure ``s`` are columns ``s.field``, and a scalar ``Ts``, ``dt``, ``period`` [s] or ``fs`` [Hz] gives
    the sampling period; nothing in them is ever executed.  A JSON file of the same name beside the table may
    give ``units``, ``Ts`` [s] and ``splits.<set>.skip``, which are used where nothing else is said.

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
        Column with the time [s], in the unit that its name tells (``t [ms]``, ``t_ms``), or as dates; it must
        be uniform, and starts a new experiment where it restarts.
    split, experiment : str, optional
        Columns with the split and the experiment.
    skip : int, optional
        Rows not scored at the beginning of each test set.
    separator, decimal : str, optional
        Overrule what is detected in a text table.
    resample : float, optional
        Period [s] to which the rows are brought (`sysid.data.resampling`); times need not be uniform then.

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
        wanted = Wanted(tuple(inputs), tuple(outputs), time, split, experiment)
        return _read(path, wanted, period, skip, separator, decimal, resample)
    except DataError as problem:
        # What is found in the numbers does not know the file they came from.
        text = str(problem)
        place = "" if path.name in text else f"{path.name}, " if text.startswith("row") else f"{path.name}: "
        raise DataError(place + text) from None


def _read(
    path: Path,
    wanted: Wanted,
    period: float | None,
    skip: int | None,
    separator: str | None,
    decimal: str | None,
    resample: float | None,
) -> Record:
    resample = None if resample is None else checked_period(resample)
    registered = registered_path(path)
    if registered is not None:
        path, wanted = registered, wanted.with_sets(SPLIT_COLUMN, EXPERIMENT_COLUMN)
    asked = wanted
    table, clock, period, wanted = _table(path, asked, period, separator, decimal)
    notes = read_notes(path)
    remarks = list(notes.warnings)
    n_rows = len(table)
    table = without_empty_end(table, wanted, remarks)
    left_out = n_rows - len(table) if resample is None else 0  # rows of another period are none of the file's
    labels = None if wanted.split is None else _text(table, wanted.split)
    times = _times(table, clock, path, wanted.time is not None, remarks)
    known = None if wanted.experiment is None else _text(table, wanted.experiment)
    groups = _experiments(known, times, strict=wanted.time is not None)
    told = named_units(wanted.names)
    units = {
        name: told[as_in_file]
        for name, as_in_file in zip(asked.names, wanted.names, strict=True)
        if as_in_file in told
    }
    units |= dict(notes.units)
    if asked.time is not None and wanted.time is not None and times is not None:
        unit = units.pop(asked.time, "") or time_unit(wanted.time)
        times = in_seconds(times, wanted.time, unit, remarks)
        if resample is None:
            period = period_from_times(times, groups, wanted.time, period)
    elif clock is not None and times is not None:
        remarks += remarks_on_times(times, groups, clock)
    u, y = (
        np.column_stack([_numbers(table, name, path) for name in names])
        for names in (wanted.inputs, wanted.outputs)
    )
    skips = notes.skips(labels) if skip is None else skip
    if resample is not None:
        if wanted.time is None or times is None:
            times = clock_of(known_period(period, notes, clock), groups, len(u))
        rows = resample_table(times, u, y, groups, labels, skips, resample)
        u, y, groups, labels, skips, period = rows.u, rows.y, rows.groups, rows.labels, rows.skip, resample
        remarks.append(rows.remark)
    record = make_record(
        u,
        y,
        known_period(period, notes, clock),
        name=path.name.removesuffix(".gz").rsplit(".", 1)[0],
        inputs=asked.inputs,
        outputs=asked.outputs,
        units=units,
        split=labels,
        experiment=groups,
        skip=skips,
        warnings=remarks,
        source=path,
    )
    return replace(record, left_out=left_out)


def _table(
    path: Path, wanted: Wanted, period: float | None, separator: str | None, decimal: str | None
) -> "tuple[pd.DataFrame, str | None, float | None, Wanted]":
    """Return the wanted columns, the time column, the period the file may tell, and the names it has."""
    stored = stored_table(path)
    if stored is None:
        dialect = detect(path, separator, decimal)
        wanted = wanted.spelt(dialect.columns)
        names, clock = wanted.found_in(path, dialect.columns)
        return read_table(path, dialect, names, wanted.texts), clock, period, wanted
    columns = stored.columns(wanted.names)
    wanted = wanted.spelt(columns)
    names, clock = wanted.found_in(path, columns)
    table = stored.read(names, wanted.texts)
    return table, clock, stored.period() if period is None and wanted.time is None else period, wanted


def _times(
    table: "pd.DataFrame", clock: str | None, path: Path, required: bool, remarks: list[str]
) -> Floats | None:
    """Return the times in the unit of their column; a column that is not required need not be numbers."""
    try:
        return None if clock is None else _numbers(table, clock, path)
    except DataError:
        dated = seconds_of_dates(table[clock])
        if dated is not None:
            return dated
        if required:
            raise
        remarks.append(
            f"Column {clock!r} does not hold numbers: restarts of the time are not looked for, experiments "
            "are told apart by the experiment column only."
        )
        return None


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
