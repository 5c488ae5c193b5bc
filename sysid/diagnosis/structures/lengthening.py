"""A search on longer and longer openings of a record: where a free run has many minima, short ones have few.

A body that falls to one side or the other, or sticks at one place or the next, does so at other times for the
slightest change of its parameters, and the longer the run the more of these there are.  The first rows tell
the parameters well enough to follow some more of them, those well enough for the next.

References
----------
Ribeiro et al. (2020), On the smoothness of nonlinear system identification, Automatica 121.
"""

import numpy as np

from sysid.data.record import Mask

# Rows of an experiment to begin with.
FIRST = 40
# Of the search on each opening: it only has to stay near.
ITERATIONS, TOLERANCE = 15, 1e-5


def openings(used: Mask, begin: np.ndarray, factor: float) -> list[Mask]:
    """Return longer and longer openings of some rows, all of them left out.

    Parameters
    ----------
    used : ndarray of bool, shape (n_rows,)
    begin : ndarray of int, shape (n_experiments + 1,)
        First row of each experiment and, last, the number of rows.
    factor : float
        How many times as many rows the next opening has.

    Returns
    -------
    list of ndarray of bool, shape (n_rows,)
        With rows of each experiment that has some.

    Examples
    --------
    >>> used = np.ones(200, dtype=bool)
    >>> [int(opening.sum()) for opening in openings(used, np.array([0, 50, 200]), 1.25)]
    [80, 100, 112, 127, 146, 170]
    """
    counted = np.cumsum(used)
    before = np.repeat(np.concatenate([[0], counted])[begin[:-1]], np.diff(begin))
    place = counted - before
    found, count = [], FIRST
    while count < place.max(initial=0):
        found.append(used & (place <= count))
        count = int(factor * count)
    return found
