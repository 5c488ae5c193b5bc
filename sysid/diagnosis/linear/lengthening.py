"""A search of a chain on longer and longer openings of its rows."""

from dataclasses import replace

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.levenberg import Minimum, minimise
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.structures.lengthening import ITERATIONS, TOLERANCE, openings

# How many times as many rows the next opening has: the less, the surer it is followed.
FACTOR = 1.1


def lengthened(chain: Chain, data: Data, start: Floats, noise: Floats, iterations: int) -> Minimum | None:
    """Search from a point on longer and longer openings of the rows, at last on all; None if that diverges.

    Parameters
    ----------
    chain : Chain
    data : Data
    start : ndarray
    noise : ndarray
        D(q) of the noise.
    iterations : int
        Most Jacobians of the last search.
    """
    point, free = start, chain.smooth(data)
    for opening in openings(data.used, data.begin, FACTOR):
        end = minimise(
            chain, _opening_of(data, opening), point, noise,
            free=free, iterations=ITERATIONS, tolerance=TOLERANCE,
        )  # fmt: skip
        point = point if end is None else end.point
    return minimise(chain, data, point, noise, free=free, iterations=iterations)


def _opening_of(data: Data, opening: Mask) -> Data:
    """Return each experiment up to the last row of an opening."""
    parts = [
        first + np.arange(int(np.flatnonzero(opening[first:last])[-1]) + 1)
        for first, last in zip(data.begin[:-1], data.begin[1:], strict=True)
    ]
    index, begin = np.concatenate(parts), np.cumsum([0, *(part.size for part in parts)])
    return replace(data, u=data.u[index], y=data.y[index], used=opening[index], begin=begin)
