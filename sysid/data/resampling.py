"""Bring measurements to another, uniform sampling period."""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.data.checks import find_warnings
from sysid.data.labels import Floats
from sysid.data.record import Record, check_record, make_record
from sysid.errors import DataError, UsageError

# A gap of more steps than this is not bridged: what happened in it is not known.
LONGEST_GAP = 10
# Anti-alias filter: a sinc in a Kaiser window over so many new samples to each side, its half-amplitude at
# this share of the new Nyquist frequency; the window's shape gives 60 dB beyond it.
FILTER_REACH = 8
FILTER_EDGE = 0.85
KAISER_SHAPE = 5.65
MOST_ROWS = 20_000_000


@dataclass(frozen=True)
class Resampled:
    """Rows at a uniform period.

    Attributes
    ----------
    u, y : ndarray, shapes (n_rows, n_inputs), (n_rows, n_outputs)
    source : ndarray of int, shape (n_rows,)
        Row of the measurement at each new row or the last before it.
    filtered : bool
        Whether the signals were low-passed against aliasing.
    """

    u: Floats
    y: Floats
    source: NDArray[np.intp]
    filtered: bool


def resample(record: Record, period: float) -> Record:
    """Return a record at another sampling period.

    Parameters
    ----------
    record : Record
    period : float
        New sampling period [s].

    Returns
    -------
    Record
        Each experiment resampled by itself; splits follow their rows, and a warning says what was done.

    Raises
    ------
    UsageError
        If the period is not a positive number, or would give far too many rows.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> t = 0.01 * np.arange(1000.0)
    >>> record = make_record(np.sign(np.sin(t)), np.sin(t - 1.0), period=0.01)
    >>> coarse = resample(record, 0.05)
    >>> coarse.n_samples, round(coarse.period, 12)
    (200, 0.05)
    >>> bool(np.abs(coarse.y[5:-5, 0] - np.sin(0.05 * np.arange(200) - 1.0)[5:-5]).max() < 1e-4)
    True
    """
    check_record(record)
    period = checked_period(period)
    groups = np.repeat(record.experiments, [part.stop - part.start for part in record.slices])
    clock = clock_of(record.period, groups, record.n_samples)
    rows = resample_table(clock, record.u, record.y, groups, record.split, record.skip, period)
    seen = find_warnings(
        record.u, record.y, record.inputs, record.outputs, record.split, record.starts, record.units
    )
    return make_record(
        rows.u,
        rows.y,
        period,
        name=record.name,
        inputs=record.inputs,
        outputs=record.outputs,
        units=record.units,
        split=rows.labels,
        experiment=rows.groups,
        skip=rows.skip,
        warnings=[*(warning for warning in record.warnings if warning not in seen), rows.remark],
        source=record.source,
    )


@dataclass(frozen=True)
class ResampledTable:
    """The rows of all experiments at a uniform period, and what was done to them."""

    u: Floats
    y: Floats
    groups: NDArray[np.str_] | None
    labels: NDArray[np.str_] | None
    skip: dict[str, int] | int
    remark: str


def clock_of(period: float, groups: NDArray[np.str_] | None, n_rows: int) -> Floats:
    """Return the times [s] of uniform rows, from zero in each experiment."""
    row = np.arange(n_rows, dtype=np.float64)
    if groups is None or n_rows == 0:
        return period * row
    new = np.concatenate([[True], groups[1:] != groups[:-1]])
    return np.asarray(period * (row - np.maximum.accumulate(np.where(new, row, 0))))


def resample_table(
    times: Floats,
    u: Floats,
    y: Floats,
    groups: NDArray[np.str_] | None,
    labels: NDArray[np.str_] | None,
    skip: Mapping[str, int] | int,
    period: float,
) -> ResampledTable:
    """Resample each experiment of a table by itself; labels go with their rows.

    Parameters
    ----------
    times : ndarray, shape (n_samples,)
        Increasing within each experiment [s].
    u, y : ndarray, shapes (n_samples, n_inputs), (n_samples, n_outputs)
    groups, labels : ndarray of str, shape (n_samples,), optional
        Experiment and split of each row.
    skip : mapping of str to int, or int
        Rows not scored at the start of test sets; they cover the same time afterwards.
    period : float
        New period [s].
    """
    breaks = [] if groups is None else (np.flatnonzero(groups[1:] != groups[:-1]) + 1).tolist()
    edges = [0, *breaks, times.size]
    parts = []
    for first, last in itertools.pairwise(edges):
        parts.append(resample_rows(times[first:last], u[first:last], y[first:last], period, first))
    rows = np.concatenate([first + part.source for first, part in zip(edges[:-1], parts, strict=True)])
    before = float(np.median(np.concatenate([np.diff(times[a:b]) for a, b in itertools.pairwise(edges)])))
    return ResampledTable(
        np.concatenate([part.u for part in parts]),
        np.concatenate([part.y for part in parts]),
        None if groups is None else groups[rows],
        None if labels is None else labels[rows],
        _skips(skip, before / period),
        statement(before, period, any(part.filtered for part in parts)),
    )


def _skips(skip: Mapping[str, int] | int, share: float) -> dict[str, int] | int:
    if isinstance(skip, Mapping):
        return {name: math.ceil(rows * share - 1e-9) for name, rows in skip.items()}
    return math.ceil(skip * share - 1e-9)


def statement(before: float, period: float, filtered: bool) -> str:
    """Say what resampling did."""
    alias = (
        f"both were low-passed below {0.5 / period:.4g} Hz, without phase, against aliasing"
        if filtered
        else "no anti-alias filter was needed, as the step did not grow"
    )
    return (
        f"Resampled from steps of {before:.6g} s to {period:.6g} s: the input, held between its samples, was "
        f"averaged over each new step, the output interpolated by monotone cubics; {alias}."
    )


def resample_rows(times: Floats, u: Floats, y: Floats, period: float, first: int = 0) -> Resampled:
    """Bring the rows of one experiment to a uniform period.

    The input is held between samples, so its mean over each new step is exact.  The output runs
    through monotone cubics (PCHIP).  Where the new step is longer than the old one, both are low-passed
    first by the same symmetric filter: it shifts nothing, and a linear relation between them stays.

    Parameters
    ----------
    times : ndarray, shape (n_samples,)
        Increasing [s].
    u, y : ndarray, shapes (n_samples, n_inputs), (n_samples, n_outputs)
        NaN in y where nothing was measured.
    period : float
        New sampling period [s].
    first : int
        Row of the first of them in the table, for messages.

    Returns
    -------
    Resampled

    Raises
    ------
    DataError
        If there is a gap too long to be bridged.
    UsageError
        If the period makes no sense.
    """
    typical = _checked_steps(times, period, first)
    n_rows = int(np.floor((times[-1] - times[0]) / period * (1.0 + 1e-12) + 1e-6)) + 1
    filtered = period > 1.01 * typical
    fine = math.ceil(period / typical * (1.0 - 1e-9)) if filtered else 1
    clock = times[0] + (period / fine) * np.arange(n_rows * fine + 1)
    held = _means_of_held(times, u, clock)
    known = np.column_stack([_interpolated(times, column, clock[:-1]) for column in y.T])
    if filtered:
        held, known = _low_passed(held, fine), _low_passed(known, fine)
    nearest = np.clip(np.searchsorted(times, clock[:-1:fine] + 0.5 * typical, "right") - 1, 0, times.size - 1)
    source = np.clip(np.searchsorted(times, clock[:-1:fine] + 1e-6 * typical, "right") - 1, 0, None)
    outputs = np.where(np.isfinite(y[nearest]), known[::fine], np.nan)
    means = held.reshape(n_rows, fine, u.shape[1]).mean(axis=1)
    return Resampled(means, outputs, source, filtered)


def checked_period(period: float) -> float:
    """Return a positive number of seconds; UsageError if it is none."""
    try:
        seconds = float(period)
    except (TypeError, ValueError):
        seconds = math.nan
    if not (math.isfinite(seconds) and seconds > 0.0):
        raise UsageError(f"the period to resample to is {period!r}: give a positive number of seconds")
    return seconds


def _checked_steps(times: Floats, period: float, first: int) -> float:
    """Return the typical step of the times."""
    if times.size < 2:
        raise DataError(f"{times.size} rows cannot be resampled: an experiment needs at least two")
    steps = np.diff(times)
    typical = float(np.median(steps))
    if period > times[-1] - times[0]:
        raise UsageError(
            f"resampling to {period:g} s leaves one row of {times[-1] - times[0]:g} s: give a shorter period"
        )
    if (times[-1] - times[0]) / period > MOST_ROWS:
        raise UsageError(
            f"resampling to {period:g} s would give more than {MOST_ROWS} rows: give a longer period"
        )
    longest = int(np.argmax(steps))
    if steps[longest] > LONGEST_GAP * max(typical, period):
        raise DataError(
            f"row {first + longest + 2}: nothing was measured for {steps[longest]:g} s, more than "
            f"{LONGEST_GAP} steps: such a gap cannot be bridged; mark it as the start of a new experiment"
        )
    return typical


def _means_of_held(times: Floats, u: Floats, clock: Floats) -> Floats:
    """Return the mean of each input, held between its samples, over each cell of the clock."""
    ends = np.append(times, max(times[-1] + 1.0, clock[-1] + 1.0))
    integral = np.vstack([np.zeros(u.shape[1]), np.cumsum(u * np.diff(ends)[:, np.newaxis], axis=0)])
    at = np.column_stack([np.interp(clock, ends, column) for column in integral.T])
    return np.asarray(np.diff(at, axis=0) / np.diff(clock)[:, np.newaxis])


def _interpolated(times: Floats, values: Floats, clock: Floats) -> Floats:
    from scipy.interpolate import PchipInterpolator

    known = np.isfinite(values)
    if known.sum() < 2:
        return np.full(clock.size, values[known][0] if known.any() else 0.0)
    curve = PchipInterpolator(times[known], values[known], extrapolate=False)
    return np.asarray(curve(np.clip(clock, times[known][0], times[known][-1])))


def _low_passed(values: Floats, fine: int) -> Floats:
    """Filter each column without phase; beyond its ends a signal goes on point-symmetrically."""
    from scipy.signal import fftconvolve

    reach = min(FILTER_REACH * fine, values.shape[0] - 1)
    place = np.arange(-reach, reach + 1)
    kernel = np.sinc(FILTER_EDGE * place / fine) * np.kaiser(place.size, KAISER_SHAPE)
    kernel /= kernel.sum()
    before = 2.0 * values[0] - values[reach:0:-1]
    after = 2.0 * values[-1] - values[-2 : -reach - 2 : -1]
    extended = np.vstack([before, values, after])
    return np.asarray(fftconvolve(extended, kernel[:, np.newaxis], mode="valid", axes=0))
