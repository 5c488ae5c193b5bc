"""The run of a fitted physical model for an input of one's choice, with its derivative."""

from dataclasses import replace

import numpy as np

from sysid.data import make_record
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.problem import COARSE_STEP, Problem
from sysid.diagnosis.physics.setting import Setting
from sysid.diagnosis.structures.structure import WHITE, StructureFit


def response(setting: Setting, fit: StructureFit, u: Floats) -> tuple[Floats, Floats]:
    """Return the free run from rest for a course of the first input, and its derivative by all parameters.

    Further inputs stay at the mean that they had.

    Parameters
    ----------
    setting : Setting
    fit : StructureFit
    u : ndarray, shape (n_samples,)

    Returns
    -------
    y : ndarray, shape (n_samples,)
        Infinite where the run diverges.
    tangent : ndarray, shape (n_samples, n_parameters)
        By the parameters of the model and of its effects; sensors that jump are left out of it.
    """
    measured = setting.record
    driven = np.tile(measured.u[measured.learning].mean(axis=0), (u.size, 1))
    driven[:, 0] = u
    # Nothing has been measured: a record asks for an output that moves, and none looks at it.
    chosen = replace(setting, record=make_record(driven, u, measured.period))
    rows = np.ones(u.size, dtype=bool)
    problem = Problem(chosen, fit.choices, rows, WHITE, COARSE_STEP, free_start=False)
    point = fit.point[: problem.size]
    points, steps = problem.shifted(point, range(problem.size))
    y = problem.outputs(point[np.newaxis])[0]
    outputs = problem.outputs(points, rounded=False)
    if not (np.isfinite(y).all() and np.isfinite(outputs).all()):
        return np.full(u.size, np.inf), np.zeros((u.size, problem.size))
    return y, np.asarray(((outputs[1:] - outputs[0]) / steps[:, np.newaxis]).T)
