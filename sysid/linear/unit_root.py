"""Residuals that wander: noise with a unit root, where a record cannot tell it from a stationary one."""

import numpy as np

from sysid.linear.forms import Floats

# Dickey and Fuller's statistic of a residual from which a constant and a trend were fitted is below this
# with a probability of 1 % if it wanders (-3.96; Fuller 1976, table 8.5.2).
WANDERS = -3.96


def with_unit_root(runs: list[Floats], noise: Floats) -> Floats:
    """Return D(q) of a residual, with a factor 1 - q^-1 unless the residual proves that it does not wander.

    What disturbs a drive's force moves its position for ever.  Of such a residual, from which a fit has taken
    what looks like its parameters, least squares finds a memory of some tenth of the record, and a slow
    parameter would seem known by far too many independent rows.

    Parameters
    ----------
    runs : list of ndarray
        Stretches of a residual.
    noise : ndarray, shape (order + 1,)
        D(q) of a stationary model of it, leading 1 included.

    Returns
    -------
    ndarray, shape (order + 1,)

    References
    ----------
    Dickey and Fuller (1979), Distribution of the estimators for autoregressive time series with a unit root,
    JASA 74.

    Examples
    --------
    >>> steps = np.random.default_rng(0).standard_normal(1000)
    >>> with_unit_root([np.cumsum(steps)], np.array([1.0, -0.99]))
    array([ 1., -1.])
    >>> with_unit_root([steps], np.array([1.0, -0.2]))
    array([ 1. , -0.2])
    """
    order = noise.size - 1
    if order == 0:
        return noise
    level, past, change = [], [], []
    for run in runs:
        steps = np.diff(run)
        k = np.arange(order - 1, steps.size)
        level.append(run[k])
        past.append(np.column_stack([steps[k - lag] for lag in range(1, order)] or [np.empty((k.size, 0))]))
        change.append(steps[k])
    x, lags, target = np.concatenate(level), np.vstack(past), np.concatenate(change)
    if target.size <= 2 * order or not x.any():
        return noise
    # R of [lags, level, change]: its last two columns hold the level's weight and what is left over.
    R: Floats = np.asarray(np.linalg.qr(np.column_stack([lags, x, target]), mode="r"))
    pull = R[order - 1, order - 1]
    spread = abs(R[order, order]) / np.sqrt(target.size - order)
    if spread == 0.0 or np.sign(pull) * R[order - 1, order] / spread < WANDERS:
        return noise
    weights = np.linalg.lstsq(lags, target, rcond=None)[0] if order > 1 else np.empty(0)
    return np.asarray(np.convolve([1.0, -1.0], np.concatenate([[1.0], -weights])))
