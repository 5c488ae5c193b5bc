"""Some of the rows of a record."""

from collections.abc import Iterable

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats

# A search runs on so many rows, or as many as it takes to see the ends of the ranges of input and output, but
# for this share; its end is polished on all of them.
SEARCH_ROWS, NEAR_THE_END = 1_500, 0.2


def runs_of(rows: Mask) -> list[slice]:
    """Return where runs of chosen rows that follow one another stand among the chosen rows.

    Examples
    --------
    >>> runs_of(np.array([True, True, False, True]))
    [slice(0, 2, None), slice(2, 3, None)]
    """
    index = np.flatnonzero(rows)
    begins = np.flatnonzero(np.diff(index, prepend=index[:1] - 2) != 1).tolist()
    return [slice(begin, end) for begin, end in zip(begins, [*begins[1:], index.size], strict=False)]


def end_of_search(signals: Iterable[Floats], rows: Mask, count: int = SEARCH_ROWS) -> int:
    """Return the row before which a search has what it needs of the chosen rows of signals.

    That are so many, and more until each signal has come near both ends of its range: what happens there
    only, such as a limit, must be among them.

    Parameters
    ----------
    signals : iterable of ndarray, shape (n_samples,)
    rows : ndarray of bool, shape (n_samples,)
    count : int

    Examples
    --------
    >>> rows = np.array([False, True, True, True, True, True])
    >>> [end_of_search([np.array([9.0, 0.0, 1.0, 0.2, 0.99, 0.5])], rows, count) for count in (1, 4, 9)]
    [3, 5, 6]
    """
    index = np.flatnonzero(rows)
    if index.size <= count:
        return rows.size
    ends = [int(index[count - 1])]
    for signal in signals:
        values = signal[index]
        low, high = float(values.min()), float(values.max())
        near = NEAR_THE_END * (high - low)
        ends += [int(index[np.argmax(values <= low + near)]), int(index[np.argmax(values >= high - near)])]
    return max(ends) + 1


def rows_of_search(signals: Iterable[Floats], rows: Mask) -> Mask:
    """Return the chosen rows on which a search runs."""
    return rows & (np.arange(rows.size) < end_of_search(signals, rows))


def first_rows_of(rows: Mask, count: int) -> Mask:
    """Return the first of some rows, so many.

    Examples
    --------
    >>> first_rows_of(np.array([True, False, True, True]), 2)
    array([ True, False,  True, False])
    """
    chosen = rows.copy()
    chosen[np.flatnonzero(rows)[count:]] = False
    return chosen
