"""Some of the rows of a record."""

import numpy as np

from sysid.data.record import Mask


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
