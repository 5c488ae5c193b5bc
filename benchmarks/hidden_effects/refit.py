"""The best that can be had: the true structure, simulated by its own simulator, fitted to the same rows."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from sysid.demonstration import Case, Hidden, Plant, simulate

Floats = NDArray[np.float64]

_NOT_FITTED = {"n", "start", "half", "bias", "swing", "share"}
_EVALUATIONS = 12


def true_structure(case: Case) -> Floats:
    """Return the free run of the true structure, its parameters fitted to est and val from the true values.

    The fit stops when it does not get better than the truth itself, so that what jumps in a parameter
    (a quantiser's step) does no harm.
    """
    rows = case.sets != "test"
    names, truth = _free(case)

    def output(values: Floats) -> Floats:
        return simulate(*_with(case, names, values), case.u)

    def residual(relative: Floats) -> Floats:
        error = (output(truth * relative) - case.y)[rows]
        return np.nan_to_num(error, nan=1e6, posinf=1e6, neginf=-1e6)

    start = np.ones(truth.size)
    fit = least_squares(residual, start, x_scale=0.1, diff_step=1e-5, max_nfev=_EVALUATIONS)
    better = 2.0 * fit.cost <= float(np.sum(residual(start) ** 2))
    return output(truth * (fit.x if better else start))


def _free(case: Case) -> tuple[list[tuple[int, str]], Floats]:
    """List what is fitted, (-1, name) of the plant and (i, name) of effect i, and the true values."""
    plant = [
        ((-1, name), value)
        for name, value in case.plant.parameters.items()
        if name not in case.known and value != 0.0 and name != "gain"
    ]
    effects = [
        ((i, name), value)
        for i, effect in enumerate(case.effects)
        for name, value in effect.parameters.items()
        if name not in _NOT_FITTED
        and value != 0.0
        and not (effect.name == "time_variation" and name == "step")
    ]
    # The level of a relay is one with the gain of the plant.
    effects = [entry for entry in effects if entry[0][1] != "level"]
    names, values = zip(*(plant + effects), strict=True)
    return list(names), np.array(values)


def _with(case: Case, names: list[tuple[int, str]], values: Floats) -> tuple[Plant, list[Hidden]]:
    parameters = dict(case.plant.parameters)
    effects = [dict(effect.parameters) for effect in case.effects]
    for (owner, name), value in zip(names, values, strict=True):
        (parameters if owner < 0 else effects[owner])[name] = float(value)
    hidden = [replace(old, parameters=new) for old, new in zip(case.effects, effects, strict=True)]
    return replace(case.plant, parameters=parameters), hidden


def rms(error: Floats) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(error**2)))
