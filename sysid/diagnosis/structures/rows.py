"""Some of the rows of a record."""

import numpy as np

from sysid.data.record import Mask


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
