"""Levenberg-Marquardt over some of the parameters of a chain."""

from dataclasses import dataclass

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.chain import Chain, Data, Run

FIRST_DAMPING, LARGEST_DAMPING = 1e-4, 1e8


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a search ended: point, run there, sum of squares, and whether it had come to rest."""

    point: Floats
    run: Run
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
    point = np.clip(start, lower, upper)
    run = chain.run(data, point)
    if run is None:
        return None
    free = np.ones(point.size, dtype=bool) if free is None else free
    identity = np.eye(int(free.sum()))
    error = chain.error(data, run, noise)
    cost, damping, small = float(error @ error), FIRST_DAMPING, 0
    for _ in range(iterations):
        J = chain.slopes(data, point, run, noise, free)
        with np.errstate(all="ignore"):  # what is not finite ends the search below
            H, g = J @ J.T, J @ error
            scale = np.sqrt(np.diag(H))
            scale[scale == 0.0] = 1.0
            H, g = H / np.outer(scale, scale), g / scale
        if not (np.isfinite(H).all() and np.isfinite(g).all()):
            return Minimum(point, run, cost, False)
        before = cost
        while damping < LARGEST_DAMPING:
            trial = point.copy()
            trial[free] += np.linalg.solve(H + damping * identity, g) / scale
            trial = np.clip(trial, lower, upper)
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
            return Minimum(point, run, cost, True)
        small = small + 1 if before - cost <= tolerance * before else 0
        if small == 2 or cost == 0.0:
            return Minimum(point, run, cost, True)
    return Minimum(point, run, cost, False)
