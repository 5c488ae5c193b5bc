"""One measured record: inputs, outputs, splits, experiments."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import index
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.data.checks import check_arrays, find_warnings
from sysid.data.labels import ESTIMATION_LABELS, TEST_PREFIX, VALIDATION_LABEL, Floats, Mask
from sysid.errors import DataError, UsageError

__all__ = [
    "ESTIMATION_LABELS",
    "TEST_PREFIX",
    "VALIDATION_LABEL",
    "Floats",
    "Mask",
    "Record",
    "check_record",
    "make_record",
    "names_of",
]

Array = TypeVar("Array", bound=NDArray[Any])

HELD_OUT_SHARE = 0.25


@dataclass(frozen=True, eq=False)
class Record:
    """A sampled measurement with its splits and experiments.

    Made by `make_record` (arrays) or `read_record` (a file), which check what they are given.

    Attributes
    ----------
    name : str
    u : ndarray, shape (n_samples, n_inputs)
    y : ndarray, shape (n_samples, n_outputs)
        NaN where nothing was measured, which is allowed on test rows only.
    period : float
        Sampling period [s].
    inputs, outputs : tuple of str
        Column names.
    units : mapping of str to str
        Unit of each column for which one is known.
    split : ndarray of str, shape (n_samples,)
        ``"train"`` or ``"est"`` (estimation), ``"val"`` (validation), or a name that begins
        with ``"test"``.
    held_out : ndarray of bool, shape (n_samples,)
        The validation rows: those marked ``"val"`` or, without any, the last quarter of the
        estimation rows of each experiment.
    starts : tuple of int
        First row of each experiment.
    experiments : tuple of str
        Name of each experiment.
    skip : mapping of str to int
        Rows not scored at the beginning of each test set.
    warnings : tuple of str
        What looked odd and was let through.
    source : Path or None
        The file it came from.
    left_out : int
        Rows without values at the end of that file, which are no part of the record.

    All arrays are read-only.
    """

    name: str
    u: Floats
    y: Floats
    period: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: Mapping[str, str]
    split: NDArray[np.str_]
    held_out: Mask
    starts: tuple[int, ...]
    experiments: tuple[str, ...]
    skip: Mapping[str, int]
    warnings: tuple[str, ...] = ()
    source: Path | None = None
    left_out: int = 0

    @property
    def n_samples(self) -> int:
        """Number of rows."""
        return int(self.u.shape[0])

    @property
    def slices(self) -> tuple[slice, ...]:
        """Rows of each experiment."""
        ends = (*self.starts[1:], self.n_samples)
        return tuple(slice(start, end) for start, end in zip(self.starts, ends, strict=True))

    @property
    def longest(self) -> float:
        """Duration of the longest experiment [s]."""
        return float(self.period * max(part.stop - part.start for part in self.slices))

    @cached_property
    def estimation(self) -> Mask:
        """Rows on which a model is estimated, validation rows left out."""
        return _frozen(np.isin(self.split, ESTIMATION_LABELS) & ~self.held_out)

    @property
    def validation(self) -> Mask:
        """Rows on which a model is chosen."""
        return self.held_out

    @cached_property
    def learning(self) -> Mask:
        """Estimation and validation rows together."""
        return _frozen(self.estimation | self.validation)

    @cached_property
    def test_sets(self) -> tuple[str, ...]:
        """Names of the test sets, in the order of the rows."""
        names, first = np.unique(self.split, return_index=True)
        ordered = names[np.argsort(first)]
        return tuple(str(name) for name in ordered if str(name).startswith(TEST_PREFIX))

    @cached_property
    def estimation_label(self) -> str:
        """The name the file gives its estimation rows, ``"train"`` or ``"est"``."""
        return str(self.split[np.argmax(self.estimation)])

    def scored_rows(self, test_set: str) -> Mask:
        """Rows of a test set that are scored: measured, and after the skipped ones."""
        rows = np.flatnonzero(self.split == test_set)
        chosen = np.zeros(self.n_samples, dtype=bool)
        chosen[rows[self.skip.get(test_set, 0) :]] = True
        return _frozen(chosen & np.isfinite(self.y).all(axis=1))

    def of_output(self, name: str) -> "Record":
        """Return the same record with one of its outputs."""
        if name not in self.outputs:
            raise UsageError(f"the record has no output {name!r}: it has {', '.join(self.outputs)}")
        if len(self.outputs) == 1:
            return self
        place = self.outputs.index(name)
        return replace(self, y=_frozen(self.y[:, place : place + 1].copy()), outputs=(name,))

    def as_test_set(self) -> "Record":
        """Return the same record with all rows in one test set, for a model that is fitted to none."""
        held_out = np.zeros(self.n_samples, dtype=bool)
        return replace(self, split=_frozen(np.full(self.n_samples, TEST_PREFIX)), held_out=_frozen(held_out))

    def unit(self, column: str) -> str:
        """Return the unit of a column, or an empty string."""
        return self.units.get(column, "")

    def with_units(self, units: Mapping[str, str]) -> "Record":
        """Return the same record with units for the columns that have none."""
        given = {column: unit for column, unit in self.units.items() if unit}
        return replace(self, units=MappingProxyType({**units, **given}))

    @cached_property
    def sha256(self) -> str:
        """Hash of the content: arrays, period, splits, experiments; not of the file's form."""
        digest = hashlib.sha256()
        for part in (self.u, self.y, np.float64(self.period), np.asarray(self.starts, dtype=np.int64)):
            digest.update(np.ascontiguousarray(part).tobytes())
        digest.update("\n".join(self.split.tolist()).encode())
        digest.update(self.held_out.tobytes())
        return digest.hexdigest()

    def __getstate__(self) -> dict[str, Any]:
        """Return what is sent to a worker process; a mapping proxy cannot be."""
        return {**self.__dict__, "units": dict(self.units), "skip": dict(self.skip)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Make the record read-only again."""
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        views = {name: MappingProxyType(state[name]) for name in ("units", "skip")}
        self.__dict__.update({**state, **views})

    def __repr__(self) -> str:
        tests = ", ".join(self.test_sets) or "none"
        return (
            f"Record({self.name!r}: {self.n_samples} rows at {self.period:.6g} s, "
            f"{', '.join(self.inputs)} -> {', '.join(self.outputs)}, "
            f"{len(self.starts)} experiment{'s' * (len(self.starts) > 1)}, "
            f"estimation {int(self.estimation.sum())}, validation {int(self.validation.sum())}, "
            f"test sets: {tests})"
        )


def make_record(
    u: ArrayLike,
    y: ArrayLike,
    period: float,
    *,
    name: str = "record",
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    units: Mapping[str, str] | None = None,
    split: ArrayLike | None = None,
    experiment: ArrayLike | None = None,
    skip: Mapping[str, int] | int = 0,
    warnings: Sequence[str] = (),
    source: Path | None = None,
) -> Record:
    """Make a checked record from arrays.

    Parameters
    ----------
    u : array_like, shape (n_samples,) or (n_samples, n_inputs)
    y : array_like, shape (n_samples,) or (n_samples, n_outputs)
        NaN on test rows where nothing was measured.
    period : float
        Sampling period [s], positive.
    name : str
    inputs, outputs : sequence of str
        Column names; ``u``, ``y`` (numbered when there are several) by default.
    units : mapping of str to str, optional
    split : array_like of str, shape (n_samples,), optional
        ``train`` or ``est``, ``val``, or a name that begins with ``test``; all ``train`` by default.
    experiment : array_like, shape (n_samples,), optional
        A new value starts a new experiment.
    skip : mapping of str to int, or int
        Rows not scored at the beginning of each test set.
    warnings, source
        Kept with the record.

    Returns
    -------
    Record

    Raises
    ------
    DataError
        If the record cannot be used; the message names row, column and value.

    Examples
    --------
    >>> import numpy as np
    >>> record = make_record(np.sin(np.arange(40.0)), np.cos(np.arange(40.0)), period=0.1)
    >>> record
    Record('record': 40 rows at 0.1 s, u -> y, 1 experiment, estimation 30, validation 10, test sets: none)
    """
    u_array, y_array = _columns(u, "u"), _columns(y, "y")
    units = _checked_units(units)
    input_names = names_of(inputs) or _default_names("u", u_array.shape[1])
    output_names = names_of(outputs) or _default_names("y", y_array.shape[1])
    n_samples = u_array.shape[0]
    labels = np.full(n_samples, "train") if split is None else np.char.strip(np.asarray(split, dtype=str))
    period = _seconds(period)
    check_arrays(u_array, y_array, period, input_names, output_names, labels)
    starts, names = _experiments(experiment, n_samples)
    held_out = _held_out(labels, starts)
    test_sets = {label for label in np.unique(labels).tolist() if label.startswith(TEST_PREFIX)}
    skips = dict(skip) if isinstance(skip, Mapping) else dict.fromkeys(sorted(test_sets), skip)
    skips = {name: _row_count(rows) for name, rows in skips.items()}
    _check_skips(skips, labels)
    found = find_warnings(u_array, y_array, input_names, output_names, labels, starts, units)
    return Record(
        name=name,
        u=_frozen(u_array),
        y=_frozen(y_array),
        period=period,
        inputs=input_names,
        outputs=output_names,
        units=MappingProxyType(units),
        split=_frozen(labels),
        held_out=_frozen(held_out),
        starts=starts,
        experiments=names,
        skip=MappingProxyType(skips),
        warnings=(*warnings, *found),
        source=source,
    )


def check_record(record: object) -> Record:
    """Return what was given if it is a record.

    Raises
    ------
    UsageError
        If it is something else, such as an array.
    """
    if isinstance(record, Record):
        return record
    raise UsageError(
        f"record is of type {type(record).__name__}: make one with sysid.data.make_record(u, y, period)"
    )


def names_of(names: Sequence[str]) -> tuple[str, ...]:
    """Return column names as a tuple; a single name may stand alone."""
    found = (names,) if isinstance(names, str) else tuple(names)
    for name in found:
        if not isinstance(name, str) or not name.strip():
            raise UsageError(f"a column is named {name!r}: give each column a name, as a text")
    return found


def _checked_units(units: Mapping[str, str] | None) -> dict[str, str]:
    known = {} if units is None else units
    if not isinstance(known, Mapping) or not all(isinstance(unit, str) for unit in known.values()):
        raise UsageError(f"units is {units!r}: give a mapping from column to unit, such as {{'u': 'V'}}")
    return dict(known)


def _columns(values: ArrayLike, name: str) -> Floats:
    """Return a copy of shape (n_samples, n_channels); masked values are missing ones."""
    try:
        if np.iscomplexobj(values):
            raise TypeError("complex numbers")
        array = np.array(values, dtype=np.float64)
        if isinstance(values, np.ma.MaskedArray):
            array[np.ma.getmaskarray(values)] = np.nan
    except (TypeError, ValueError) as error:
        raise DataError(f"{name} is no array of real numbers ({error}): give one number a sample") from None
    if array.ndim == 0 or 0 in array.shape[1:]:
        raise DataError(f"{name} has shape {array.shape}: give (n_samples,) or (n_samples, n_channels)")
    return array[:, np.newaxis] if array.ndim == 1 else array


def _default_names(letter: str, count: int) -> tuple[str, ...]:
    return (letter,) if count == 1 else tuple(f"{letter}{index + 1}" for index in range(count))


def _experiments(experiment: ArrayLike | None, n_samples: int) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Find where each experiment starts; a name may not come back after another one."""
    if experiment is None:
        return (0,), ("1",)
    labels = np.asarray(experiment).astype(str)
    if labels.shape != (n_samples,):
        raise DataError(f"experiment has shape {labels.shape}: give one value for each of {n_samples} rows")
    starts = np.concatenate([[0], np.flatnonzero(labels[1:] != labels[:-1]) + 1])
    names = [str(labels[start]) for start in starts]
    seen: set[str] = set()
    for start, name in zip(starts.tolist(), names, strict=True):
        if name in seen:
            raise DataError(
                f"experiment {name!r} comes back at row {start + 1} after another one: the rows of one "
                "experiment must follow one another, so sort the rows or give the second part its own name"
            )
        seen.add(name)
    return tuple(starts.tolist()), tuple(names)


def _seconds(period: float) -> float:
    try:
        return float(period)
    except (TypeError, ValueError):
        raise DataError(f"the sampling period is {period!r}: give a positive number of seconds") from None


def _row_count(rows: int) -> int:
    try:
        return index(rows)
    except TypeError:
        raise DataError(f"skip is {rows!r}: give a whole number of rows") from None


def _held_out(labels: NDArray[np.str_], starts: tuple[int, ...]) -> Mask:
    """Mark the validation rows: ``val`` or the last quarter of each experiment's estimation rows."""
    held_out: Mask = labels == VALIDATION_LABEL
    if held_out.any():
        return held_out
    estimation = np.isin(labels, ESTIMATION_LABELS)
    for start, end in zip(starts, (*starts[1:], labels.size), strict=True):
        rows = start + np.flatnonzero(estimation[start:end])
        held_out[rows[rows.size - int(rows.size * HELD_OUT_SHARE) :]] = True
    return held_out


def _check_skips(skips: Mapping[str, int], labels: NDArray[np.str_]) -> None:
    for test_set, rows in skips.items():
        available = int((labels == test_set).sum())
        if rows < 0 or rows >= available:
            raise DataError(
                f"skip is {rows} for the set {test_set!r}, which has {available} rows: "
                f"give a number from 0 to {max(available - 1, 0)}"
            )


def _frozen(array: Array) -> Array:
    array.setflags(write=False)
    return array
