"""The time column: where it restarts, whether it is uniform, which period it has."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sysid.data.labels import Floats
from sysid.errors import DataError

if TYPE_CHECKING:
    import pandas as pd

# Largest deviation of one step from the period.  Times are often printed with few digits.
STEP_TOLERANCE = 0.05
PERIOD_TOLERANCE = 0.01
# A step longer than this many periods lacks rows, unless more steps than this share are odd.
GAP = 1.5
ODD_SHARE = 0.005
# How dates may be written, as pandas takes them.
_CLOCKS = ("%H:%M:%S.%f", "%H:%M:%S", "%H:%M")
_DAYS = ("%d.%m.%Y", "%d/%m/%Y", "%m/%d/%Y", "%d-%m-%Y", "%Y/%m/%d")
DATE_FORMATS: tuple[str, ...] = (
    "ISO8601",
    *_CLOCKS,
    *(f"{day} {clock}" for day in _DAYS for clock in _CLOCKS),
)


def restarts(times: Floats, known: NDArray[np.str_] | None, *, strict: bool) -> NDArray[np.bool_]:
    """Mark the rows at which the time goes back to its first value.

    Parameters
    ----------
    times : ndarray, shape (n_samples,)
    known : ndarray of str, shape (n_samples,), optional
        Experiments that are already known; the time may jump where they change.
    strict : bool
        Whether any other step back is an error.

    Raises
    ------
    DataError
        If ``strict`` and a time is not above the one before it and no restart.
    """
    back = np.zeros(times.size, dtype=bool)
    back[1:] = ~(np.diff(times) > 0.0)
    if known is not None:
        back[1:] &= known[1:] == known[:-1]
    typical = float(np.median(np.abs(np.diff(times)))) if times.size > 1 else 0.0
    restart = back & (np.abs(times - times[0]) <= 0.5 * typical)
    restart[1:] &= np.diff(times) < 0.0
    if strict and (wrong := (back & ~restart) | ~np.isfinite(times)).any():
        row = int(np.argmax(wrong))
        if not np.isfinite(times[row]):
            raise DataError(f"row {row + 1}: the time is missing: repair or remove the row")
        raise DataError(
            f"row {row + 1}: the time {times[row]:g} does not come after {times[row - 1]:g}: times must "
            f"increase, or restart at {times[0]:g} for a new experiment; sort the rows or repair the time"
        )
    return np.asarray(restart)


def seconds_of_dates(texts: "pd.Series") -> Floats | None:
    """Return the seconds since the first of dates or times of the day; None where one is none.

    Dates as ISO 8601 writes them, with the day or the month first, or with the time of the day alone; where
    it is not clear which comes first, the one that gives the more uniform steps.

    Examples
    --------
    >>> import pandas as pd
    >>> seconds_of_dates(pd.Series(["2024-02-29 23:59:59.5", "2024-03-01T00:00:00"])).tolist()
    [0.0, 0.5]
    >>> seconds_of_dates(pd.Series(["31.01.2024 23:59", "01.02.2024 00:00", "01.02.2024 00:01"])).tolist()
    [0.0, 60.0, 120.0]
    """
    import pandas as pd

    found = []
    for form in DATE_FORMATS:
        try:
            dates = pd.to_datetime(texts, utc=True, format=form)
        except (ValueError, TypeError):
            continue
        if not dates.isna().any():
            found.append(np.asarray((dates - dates.iloc[0]).dt.total_seconds(), dtype=np.float64))
    return min(
        found, key=lambda times: float(np.ptp(np.diff(times))) if times.size > 1 else 0.0, default=None
    )


def period_from_times(
    times: Floats, groups: NDArray[np.str_] | None, name: str, stated: float | None
) -> float:
    """Return the sampling period [s] of uniform times.

    Raises
    ------
    DataError
        If the times are not uniform, or not those of the stated period.
    """
    if not np.isfinite(times).all():
        row = int(np.argmax(~np.isfinite(times)))
        raise DataError(f"row {row + 1}, column {name!r}: the time is missing: repair or remove the row")
    if times.size < 2:
        raise DataError(f"column {name!r} has {times.size} times: at least two are needed to know the period")
    inside = np.ones(times.size - 1, dtype=bool) if groups is None else groups[1:] == groups[:-1]
    steps = np.diff(times)
    if not inside.any():
        raise DataError(f"column {name!r}: every experiment has one row only: a period needs at least two")
    typical = float(np.median(steps[inside]))
    wrong = inside & ~(np.abs(steps - typical) <= STEP_TOLERANCE * abs(typical))
    if wrong.any():
        row = int(np.argmax(wrong)) + 1
        raise DataError(
            f"row {row + 1}: the time step in {name!r} is {steps[row - 1]:g} s where the others are "
            f"{typical:g} s: sampling must be uniform; resample (--resample {typical:.6g}), or mark "
            "a gap as a new experiment"
        )
    period = float(np.mean(steps[inside]))
    if stated is not None and abs(stated - period) > PERIOD_TOLERANCE * period:
        raise DataError(
            f"the stated period is {stated:g} s and the steps in {name!r} are {period:g} s: "
            "leave one of the two out, or repair the time's unit (seconds)"
        )
    return period if stated is None else stated


def remarks_on_times(times: Floats, groups: NDArray[np.str_] | None, name: str) -> list[str]:
    """Return what is odd in times that only tell experiments apart, since the period was given.

    Examples
    --------
    >>> times = np.r_[np.arange(300.0), np.arange(320.0, 600.0)]
    >>> remarks_on_times(times, None, "t")[0][:72]
    "The time in 't' jumps by 21 at row 301 where the other steps are 1: rows"
    """
    inside = np.ones(max(times.size - 1, 0), dtype=bool) if groups is None else groups[1:] == groups[:-1]
    steps = np.diff(times)
    if not inside.any() or not np.isfinite(times).all():
        return []
    typical = float(np.median(steps[inside]))
    odd = inside & ~(np.abs(steps - typical) <= STEP_TOLERANCE * abs(typical))
    if typical <= 0.0 or not 0 < odd.sum() <= max(ODD_SHARE * inside.sum(), 1.0):
        return []  # no clock, or one that is coarse or irregular throughout
    wrong = odd & ((steps > GAP * typical) | (steps <= 0.0))
    if not wrong.any():
        return []
    row, others = int(np.argmax(wrong)), int(wrong.sum()) - 1
    more = f" (and at {others} more row{'s' * (others > 1)})" if others else ""
    where, normal = f"at row {row + 2}{more}", f"where the other steps are {typical:.6g}"
    if steps[row] > 0.0:
        return [
            f"The time in {name!r} jumps by {steps[row]:.6g} {where} {normal}: rows seem to be missing, and "
            "the given period takes all rows as evenly spaced; resample by this column, or begin a new "
            "experiment after the gap."
        ]
    return [
        f"The time in {name!r} goes from {times[row]:g} to {times[row + 1]:g} {where} {normal}: rows seem "
        "to be doubled or out of order; sort the rows or repair the time."
    ]
