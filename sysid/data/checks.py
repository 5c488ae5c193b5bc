"""What makes a record unusable (an error) or odd (a warning)."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sysid.data.drift import drift_warnings
from sysid.data.labels import ESTIMATION_LABELS, MINIMUM_ROWS, TEST_PREFIX, VALIDATION_LABEL, Floats
from sysid.data.quantisation import quantisation_warnings
from sysid.errors import DataError

# Squares and their sums must neither overflow nor vanish: no unit of measurement needs values beyond these.
LARGEST_VALUE = 1e100
SMALLEST_MOVE = 1e-100
# Fewer validation rows cannot choose a structure.
MINIMUM_VALIDATION_ROWS = 5
# A level counts as clipped when the signal rests there in runs, far more often than at the level beside it.
CLIPPED_RUN = 3
CLIPPED_SHARE = 0.005
CLIPPED_RATIO = 4.0
# A single sample counts as an outlier when it leaves the line through its neighbours by this many robust
# standard deviations: with Gaussian noise about 1e-15 a sample.
OUTLIER_DEVIATIONS = 8.0


def check_arrays(
    u: Floats,
    y: Floats,
    period: float,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    labels: NDArray[np.str_],
) -> None:
    """Raise `DataError` if the record cannot be used."""
    _check_shapes(u, y, inputs, outputs, labels)
    if not (np.isfinite(period) and period > 0.0):
        raise DataError(f"the sampling period is {period:g} s: give a positive number of seconds")
    _check_labels(labels)
    is_test = np.char.startswith(labels, TEST_PREFIX)
    for values, names, may_be_empty in ((u, inputs, False), (y, outputs, True)):
        for column, name in enumerate(names):
            _check_finite(values[:, column], name, is_test, may_be_empty)
            _check_size(values[:, column], name)
    estimation = np.isin(labels, ESTIMATION_LABELS)
    if estimation.sum() < MINIMUM_ROWS:
        raise DataError(
            f"{int(estimation.sum())} rows are marked for estimation (train or est), at least {MINIMUM_ROWS} "
            "are needed: mark more rows or take a longer record"
        )
    validation = int((labels == VALIDATION_LABEL).sum())
    if 0 < validation < MINIMUM_VALIDATION_ROWS:
        raise DataError(
            f"{validation} row{'s are' if validation > 1 else ' is'} marked val, at least "
            f"{MINIMUM_VALIDATION_ROWS} are needed to choose a structure: mark more rows, or none (the last "
            "quarter of the estimation rows is then held out)"
        )
    for values, names, word in ((u, inputs, "input"), (y, outputs, "output")):
        for column, name in enumerate(names):
            used = values[estimation, column]
            if 0.0 < np.ptp(used) < SMALLEST_MOVE:
                raise DataError(
                    f"{word} {name!r} moves by {np.ptp(used):g} only, less than {SMALLEST_MOVE:g}: "
                    "give it in another unit"
                )
            if np.ptp(used) == 0.0:
                raise DataError(
                    f"{word} {name!r} is constant ({used[0]:g}) on all {used.size} estimation rows: "
                    "nothing can be learned from it; choose another column or rows where it moves"
                )


def find_warnings(
    u: Floats,
    y: Floats,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    labels: NDArray[np.str_],
    starts: tuple[int, ...],
    units: Mapping[str, str],
) -> tuple[str, ...]:
    """Return one sentence for each odd thing that does not stop the work; test rows are not looked at."""
    is_test = np.char.startswith(labels, TEST_PREFIX)
    found: list[str] = []
    for values, names in ((u, inputs), (y, outputs)):
        for column, name in enumerate(names):
            signal = values[~is_test, column]
            found.extend(_clipping(signal, name))
            found.extend(quantisation_warnings(signal, name, units.get(name, ""), is_input=values is u))
    seen = np.where(is_test[:, np.newaxis], np.nan, y)
    ends = (*starts[1:], labels.size)
    for column, name in enumerate(outputs):
        found.extend(_outliers(seen[:, column], name, starts))
        for first, last in zip(starts, ends, strict=True):
            level = seen[first:last, column]
            found.extend(drift_warnings(u[first:last], level, name, units.get(name, ""), first + 1))
    return tuple(found)


def _check_shapes(
    u: Floats, y: Floats, inputs: tuple[str, ...], outputs: tuple[str, ...], labels: NDArray[np.str_]
) -> None:
    if u.ndim != 2 or y.ndim != 2:
        raise DataError(
            f"u has {u.ndim} and y has {y.ndim} dimensions: give arrays of shape (n_samples,) "
            "or (n_samples, n_channels)"
        )
    if not (u.shape[0] == y.shape[0] == labels.size):
        raise DataError(
            f"u has {u.shape[0]} rows, y has {y.shape[0]} and split has {labels.size}: "
            "they must have the same number of rows"
        )
    if labels.ndim != 1:
        raise DataError(f"split has {labels.ndim} dimensions: give one label for each row")
    names = (*inputs, *outputs)
    if len(set(names)) < len(names):
        raise DataError(f"the names {', '.join(names)} are not all different: give each column its own")
    if u.shape[1] != len(inputs) or y.shape[1] != len(outputs):
        raise DataError(
            f"{len(inputs)} input and {len(outputs)} output names are given for {u.shape[1]} input "
            f"and {y.shape[1]} output columns: give one name for each column"
        )


def _check_labels(labels: NDArray[np.str_]) -> None:
    known = (*ESTIMATION_LABELS, VALIDATION_LABEL)
    wrong = ~(np.isin(labels, known) | np.char.startswith(labels, TEST_PREFIX))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise DataError(
            f"row {row + 1}: split value {str(labels[row])!r} is not known: use train or est (estimation), "
            "val (validation) or a name that begins with test"
        )


def _check_finite(values: Floats, name: str, is_test: NDArray[np.bool_], may_be_empty: bool) -> None:
    wrong = ~np.isfinite(values)
    if may_be_empty:
        wrong &= ~(is_test & np.isnan(values))
    if wrong.any():
        row = int(np.argmax(wrong))
        value = "missing (NaN)" if np.isnan(values[row]) else f"{values[row]:g}"
        count = int(wrong.sum())
        more = f" (and {count - 1} more)" if count > 1 else ""
        excuse = "; only the output of test rows may be empty" if may_be_empty else ""
        raise DataError(
            f"row {row + 1}, column {name!r}{more}: the value is {value}: fill it in, or leave the row out "
            f"and begin a new experiment there, since the rows are evenly spaced in time{excuse}"
        )


def _check_size(values: Floats, name: str) -> None:
    wrong = np.abs(values) > LARGEST_VALUE
    if wrong.any():
        row = int(np.argmax(wrong))
        raise DataError(
            f"row {row + 1}, column {name!r}: the value is {values[row]:g}, beyond {LARGEST_VALUE:g}: "
            "repair it or give the column in another unit"
        )


def _clipping(values: Floats, name: str) -> list[str]:
    """Say where a signal rests at one of its extremes as if the range ended there."""
    measured = values[np.isfinite(values)]
    # A signal held at levels most of the time (steps, a binary sequence) rests at its extremes by design.
    if measured.size < 100 or np.mean(measured[1:] == measured[:-1]) > 0.5:
        return []
    found = []
    for extreme, word, sign in ((measured.max(), "maximum", -1), (measured.min(), "minimum", 1)):
        at_extreme = measured == extreme
        count = int(at_extreme.sum())
        if count < max(10, CLIPPED_SHARE * measured.size) or _longest_run(at_extreme) < CLIPPED_RUN:
            continue
        others = measured[~at_extreme]
        neighbour = others.max() if sign < 0 else others.min()
        if count > CLIPPED_RATIO * int((measured == neighbour).sum()):
            found.append(
                f"{name!r} rests at its {word} {extreme:g} for {count} samples, {_longest_run(at_extreme)} "
                "of them in a row: the sensor or actuator may be clipped there"
            )
    return found


def _longest_run(flags: NDArray[np.bool_]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _outliers(values: Floats, name: str, starts: tuple[int, ...]) -> list[str]:
    """Say where single samples leave the line through their neighbours.

    A spike of height h at sample k gives (-h/2, h, -h/2) in the deviation from the mean of the two
    neighbours; a step or a kink gives another pattern, so that sharp true signals are no outliers.
    """
    measured = np.isfinite(values)
    if measured.sum() < 100:
        return []
    deviation = np.zeros(values.size)
    deviation[1:-1] = values[1:-1] - 0.5 * (values[:-2] + values[2:])
    for start in starts[1:]:
        deviation[start - 1 : start + 1] = 0.0
    deviation[~np.isfinite(deviation)] = 0.0
    size = np.abs(deviation)
    spread = 1.4826 * float(np.median(size[measured]))
    before, after = np.roll(deviation, 1), np.roll(deviation, -1)
    tolerance = 0.1 * size + 2.0 * spread
    spike = size > OUTLIER_DEVIATIONS * spread
    spike &= (np.abs(before + 0.5 * deviation) < tolerance) & (np.abs(after + 0.5 * deviation) < tolerance)
    spike[1:-1] &= (values[1:-1] - values[:-2]) * (values[1:-1] - values[2:]) > 0.0
    rows = np.flatnonzero(spike)
    if spread == 0.0 or rows.size == 0 or rows.size > 0.01 * values.size:
        return []
    worst = int(rows[np.argmax(size[rows])])
    return [
        f"{rows.size} outlier{'s' * (rows.size > 1)} in {name!r}, the largest at row {worst + 1} "
        f"({values[worst]:g} between {values[worst - 1]:g} and {values[worst + 1]:g}): single samples that "
        "leave the line through their neighbours weigh on the fit; repair them if they are not real"
    ]
