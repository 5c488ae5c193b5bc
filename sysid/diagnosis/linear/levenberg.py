"""Levenberg-Marquardt over some of the parameters of a chain.

`sysid.separable.descend` does the same for any problem, with more to say about its end.  Here thousands of
descents of a few steps each are taken for one answer, most of them of a thousand rows and ten unknowns: what
is left besides runs and slopes must be small beside them, so that steps are compiled and a run that diverges
is no error.
"""

from dataclasses import dataclass

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.linear.triangles import damped_step, scaled_triangle, stepped

FIRST_DAMPING, LARGEST_DAMPING = 1e-4, 1e8
# A step that would lower the cost by less than this share of the tolerance, were all linear, is not taken.
NEGLIGIBLE = 1e-2


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a search ended: point, sum of squares there, and whether it had come to rest."""

    point: Floats
    cost: float
    converged: bool


def minimise(
    chain: Chain,
    data: Data,
    start: Floats,
    noise: Floats,
    *,
    free: Mask | None = None,
    iterations: int = 30,
    tolerance: float = 1e-7,
) -> Minimum | None:
    """Minimise the sum of squares of the filtered free-run error; None if the start diverges.

    Parameters
    ----------
    chain : Chain
    data : Data
    start : ndarray
        Point to start from.
    noise : ndarray
        D(q) of the noise.
    free : ndarray of bool, optional
        Which parameters may move; all by default.
    iterations : int
        Most Jacobians.
    tolerance : float
        The search ends when two steps running lower the cost by less than this share.
    """
    lower, upper = chain.bounds(data)
    point = np.minimum(np.maximum(start, lower), upper)
    run = chain.run(data, point)
    if run is None:
        return None
    places = np.arange(point.size) if free is None else np.flatnonzero(free)
    low, high = lower[places], upper[places]
    error = chain.error(data, run, noise)
    cost, damping, small = float(error @ error), FIRST_DAMPING, 0
    for _ in range(iterations):
        lines, here = chain.slopes(data, point, run, noise, free), point[places]
        R, c, lengths = scaled_triangle(lines, error, here <= low, here >= high)
        if not float(c @ c) + float(R.sum()) < np.inf:
            return Minimum(point, cost, False)
        before = cost
        while damping < LARGEST_DAMPING:
            step, lowered = damped_step(R, c, damping)
            if lowered <= NEGLIGIBLE * tolerance * cost:
                return Minimum(point, cost, True)
            trial = stepped(point, places, step, lengths, lower, upper)
            tried = chain.run(data, trial)
            if tried is not None:
                new_error = chain.error(data, tried, noise)
                new_cost = float(new_error @ new_error)
                if new_cost < cost:
                    point, run, error, cost = trial, tried, new_error, new_cost
                    damping = max(0.1 * damping, 1e-12)
                    break
            damping = max(10.0 * damping, 1e-6)
        else:
            return Minimum(point, cost, True)
        small = small + 1 if before - cost <= tolerance * before else 0
        if small == 2 or cost == 0.0:
            return Minimum(point, cost, True)
    return Minimum(point, cost, False)
