"""What the point of a physical problem says to a reader: named parameters and their standard errors."""

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.cells import read_cells
from sysid.diagnosis.physics.evaluation import finite
from sysid.diagnosis.physics.problem import Problem
from sysid.diagnosis.structures.structure import FittedParameter

# Singular values below this share of the largest belong to directions that the output does not show,
# unknowns with more than this share in such a direction have no standard error.
UNSEEN, LOOSE = 1e-9, 1e-2


def named_parameters(problem: Problem, x: Floats, errors: Floats) -> tuple[FittedParameter, ...]:
    """Return the parameters for a reader; errors are those of the coordinates."""
    setting = problem.setting
    values = setting.to_values(x[: problem.n_model])
    slopes = np.where(setting.positive, values, 1.0)
    found = [
        FittedParameter(p.name, float(value), float(error * slope), p.unit)
        for p, value, error, slope in zip(setting.searched, values, errors, slopes, strict=False)
    ]
    for choice, place in zip(problem.choices, problem.effect_places, strict=True):
        for parameter, value, error in zip(choice.form.parameters, x[place], errors[place], strict=True):
            unit = parameter.unit_with(setting.units)
            found.append(FittedParameter(parameter.name, float(value), float(error), unit, choice.name))
    return tuple(found)


def standard_errors(problem: Problem, point: Floats) -> Floats:
    """Return the standard error of each unknown; infinite where the output does not tell.

    Parameters
    ----------
    problem : Problem
    point : ndarray, shape (n_unknowns,)

    Returns
    -------
    ndarray, shape (n_unknowns,)
    """
    with np.errstate(all="ignore"):
        J = finite(problem.jacobian(point))
    error = problem.residual(point)
    scale = np.linalg.norm(J, axis=0)
    lost = scale == 0.0
    scale[lost] = 1.0
    _, sizes, right = np.linalg.svd(J / scale, full_matrices=False)
    seen = sizes > UNSEEN * sizes.max(initial=0.0)
    spread = np.sqrt(float(error @ error) / max(error.size - problem.size, 1))
    errors = spread * np.linalg.norm(right[seen].T / sizes[seen], axis=1) / scale
    errors[lost | (np.abs(right[~seen]).max(axis=0, initial=0.0) > LOOSE)] = np.inf
    cells = read_cells(problem, point)
    if cells is not None:
        errors *= cells.widening(problem.size)
        errors[problem.effect_places[-1].start] = cells.step_error
    return np.asarray(errors)
