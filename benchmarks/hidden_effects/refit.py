"""The best that can be had: the true structure, simulated by its own simulator, fitted to the same rows."""

from collections.abc import Callable
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

    Behind a quantiser the error has no useful derivative and a fit would stay where it starts, at the
    truth; there one Gauss-Newton step with the slopes of the unquantised output is taken, which has the
    scatter that an estimate from this noise has.
    """
    names, truth = _free(case)

    def output(relative: Floats, *, sensor: bool = True) -> Floats:
        plant, effects = _with(case, names, truth * relative)
        if not sensor:
            effects = [effect for effect in effects if effect.name != "out_quantisation"]
        return simulate(plant, effects, case.u)

    if "out_quantisation" in case.names:
        return output(_one_step(case, output, truth.size))
    return output(_fitted(case, output, truth.size))


def _fitted(case: Case, output: Callable[[Floats], Floats], n: int) -> Floats:
    """Return the parameters, relative to the truth, of least squared free-run error."""
    rows = case.sets != "test"

    def residual(relative: Floats) -> Floats:
        error = (output(relative) - case.y)[rows]
        return np.nan_to_num(error, nan=1e6, posinf=1e6, neginf=-1e6)

    start = np.ones(n)
    fit = least_squares(residual, start, x_scale=0.1, diff_step=1e-5, max_nfev=_EVALUATIONS)
    better = 2.0 * fit.cost <= float(np.sum(residual(start) ** 2))
    return np.asarray(fit.x) if better else start


def _one_step(case: Case, output: Callable[..., Floats], n: int) -> Floats:
    rows = case.sets != "test"
    start, nearby = np.ones(n), 1e-5
    smooth = output(start, sensor=False)
    slopes = [(output(start + nearby * unit, sensor=False) - smooth)[rows] / nearby for unit in np.eye(n)]
    # The step of the quantiser itself has no slope here: it is known far better than the rest.
    step = np.linalg.lstsq(np.column_stack(slopes), (case.y - output(start))[rows], rcond=1e-9)[0]
    return start + step


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
