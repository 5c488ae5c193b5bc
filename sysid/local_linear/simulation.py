"""Free run of a composite local linear model over measured rows."""

import numpy as np
from numpy.typing import NDArray

from sysid.data.record import Mask
from sysid.local_linear.model import LocalLinearModel
from sysid.local_linear.passes import regressors
from sysid.local_linear.problem import START_RIDGE
from sysid.local_linear.structure import Experiment, course

Floats = NDArray[np.float64]


def free_run(
    model: LocalLinearModel, u: Floats, phi: Floats, y: Floats, used: Mask, weights: Floats, free_start: bool
) -> Floats:
    """Simulate an experiment, its initial state estimated on the rows ``used`` if it is free.

    Parameters
    ----------
    model : LocalLinearModel
    u, phi, y : ndarray, shapes (n_samples, n_inputs), (n_samples, n_scheduling), (n_samples, n_outputs)
    used : ndarray of bool, shape (n_samples,)
    weights : ndarray, shape (n_outputs,)
        Of the outputs, in the estimate of the initial state.
    free_start : bool

    Returns
    -------
    ndarray, shape (n_samples, n_outputs)
    """
    known = used & np.isfinite(y).all(axis=1)
    forced = model.simulate(u, phi)
    if not free_start or not known.any():
        return forced
    # A model that is not stable diverges over rows it was not fitted to: nothing there tells its start.
    known[~np.isfinite(forced).all(axis=1)] = False
    sizes = model.sizes
    last = int(np.flatnonzero(known)[-1]) + 1 if known.any() else 0
    with np.errstate(all="ignore"):
        one = course(sizes, model.eta, Experiment.of(u, phi))
        free = regressors(one, starts=True)[:, :, sizes.n_linear :]
    known[:last] &= np.isfinite(free[:last]).all(axis=(1, 2))
    if not known.any():
        return forced
    matrix = (free[known] * weights[:, np.newaxis]).reshape(-1, sizes.n_states)
    ridge = START_RIDGE * np.linalg.norm(matrix) * np.eye(sizes.n_states)
    target = np.concatenate([((y - forced)[known] * weights).ravel(), np.zeros(sizes.n_states)])
    start = np.linalg.lstsq(np.vstack([matrix, ridge]), target, rcond=None)[0]
    # Simulated again from the start that was found: forced and free responses that both grow do not add up.
    return model.simulate(u, phi, start)
