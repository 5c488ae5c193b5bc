"""Which rows a port is fitted to and judged on: all of a short record, windows of a long one."""

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.ports.loop import Stretch
from sysid.diagnosis.ports.plants import Plant
from sysid.errors import DataError, UsageError
from sysid.linear.simulation import first_rows

# Rows of all stretches together: the more states, the more a row costs.
LARGEST_COST = 32_000
LEAST_ROWS, MOST_ROWS = 3_000, 8_000
FITTED_WINDOWS, JUDGED_WINDOWS = 2, 2
JUDGED_SHARE = 0.3
# A judged window gives its own initial state from so much of its beginning.
OPENING_SHARE = 0.2


def make_stretches(record: Record, plant: Plant, judged: Mask) -> tuple[Stretch, ...]:
    """Return the stretches of a record.

    Parameters
    ----------
    record : Record
    plant : Plant
    judged : ndarray of bool, shape (n_samples,)
        Rows on which ports are judged; the fit takes the other estimation and validation rows.

    Raises
    ------
    UsageError
        If the rows do not belong to the record.
    DataError
        If no row is left for the fit or for the judgement.
    """
    measured = np.isfinite(record.y[:, 0])
    if judged.shape != (record.n_samples,):
        raise UsageError(
            f"rows has shape {judged.shape}: give one truth value for each of {record.n_samples} rows"
        )
    judged = judged & measured
    fitted = record.learning & ~judged & measured
    if not judged.any() or not fitted.any():
        raise DataError(
            f"{int(fitted.sum())} rows are left for the fit of a port and {int(judged.sum())} to judge it: "
            "mark rows as train and val"
        )
    used = fitted | judged
    lengths = [int(np.flatnonzero(used[part])[-1]) + 1 for part in record.slices if used[part].any()]
    limit = int(np.clip(LARGEST_COST / (plant.order + 2), LEAST_ROWS, MOST_ROWS))
    if sum(lengths) <= 1.5 * limit:
        parts = [part for part in record.slices if used[part].any()]
        spans = [
            (part.start, part.start + length, False) for part, length in zip(parts, lengths, strict=True)
        ]
    else:
        spans = _windows(record, fitted, int(limit * (1.0 - JUDGED_SHARE)), FITTED_WINDOWS)
        spans += _windows(record, judged, int(limit * JUDGED_SHARE), JUDGED_WINDOWS)
        return tuple(
            _window(record, plant, span, fitted if number < FITTED_WINDOWS else judged, fitted)
            for number, span in enumerate(spans)
        )
    return tuple(_whole(record, plant, span, fitted, judged) for span in spans)


def _whole(record: Record, plant: Plant, span: tuple[int, int, bool], fitted: Mask, judged: Mask) -> Stretch:
    first, end, _ = span
    rows = slice(first, end)
    y = record.y[rows, 0]
    skip = record.skip.get(str(record.split[first]), 0)
    opening, _ = first_rows(y, skip, plant.order)
    return _stretch(record, plant, rows, fitted[rows], judged[rows], opening, plant.free_start)


def _window(record: Record, plant: Plant, span: tuple[int, int, bool], chosen: Mask, fitted: Mask) -> Stretch:
    first, end, begins = span
    rows = slice(first, end)
    nothing = np.zeros(end - first, dtype=bool)
    free = plant.free_start or not begins
    if chosen is fitted:
        return _stretch(record, plant, rows, chosen[rows], nothing, nothing, free)
    opening = np.isfinite(record.y[rows, 0]) & (np.arange(end - first) < OPENING_SHARE * (end - first))
    return _stretch(record, plant, rows, nothing, chosen[rows] & ~(opening & free), opening, free)


def _stretch(
    record: Record, plant: Plant, rows: slice, fitted: Mask, judged: Mask, opening: Mask, free: bool
) -> Stretch:
    u, y = np.ascontiguousarray(record.u[rows]), record.y[rows, 0]
    known = np.isfinite(y)
    places = np.arange(y.size)
    filled = np.interp(places, places[known], y[known])
    return Stretch(rows.start, u, filled, plant.channels(u), fitted, judged, opening, free)


def _windows(record: Record, chosen: Mask, rows: int, count: int) -> list[tuple[int, int, bool]]:
    """Return windows spread evenly over the chosen rows, each inside one experiment."""
    length = max(rows // count, 1)
    places = np.flatnonzero(chosen)
    spans = []
    for number in range(count):
        # The middle of each equal part of the chosen rows.
        middle = int(places[int((number + 0.5) * places.size / count)])
        part = next(part for part in record.slices if part.start <= middle < part.stop)
        inside = places[(places >= part.start) & (places < part.stop)]
        low, high = int(inside[0]), int(inside[-1]) + 1
        first = max(low, min(middle - length // 2, high - length))
        spans.append((first, min(first + length, high), first == part.start))
    return sorted(set(spans))
