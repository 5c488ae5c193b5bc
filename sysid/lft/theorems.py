"""Theorems 4.1 and 4.2 of Pepona (2009) by numbers: the separated problem beside the joint one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.data.record import Mask
from sysid.lft.estimate import Start, first_start, given_start
from sysid.lft.problem import LftProblem
from sysid.lft.signals import Data, signals_of, usable_rows
from sysid.lft.structure import LftStructure
from sysid.lft.threads import on_one_thread
from sysid.nonlinearities.spline import absolute_power_basis, equal_knots, spline_basis
from sysid.separable import (
    Minimum,
    Residual,
    fit,
    golub_pereyra_jacobian,
    kaufman_jacobian,
    levenberg_marquardt,
    project,
)

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ProblemComparison:
    """Both problems searched from one start, and what each theorem speaks of.

    Attributes
    ----------
    separated, joint : ndarray
        Minimisers, nonlinear parameters (tangent coordinates of d around the separated minimum,
        then g) and then linear ones.
    separated_cost, joint_cost : float
        Sums of squared residuals.
    separated_gradient, joint_gradient : float
        Largest cosine between the residual and a column of the Jacobian, both at the separated
        minimum: zero where it is a critical point of the problem.
    separated_steps, joint_steps : int
        Steps that lowered the cost in each search.
    condition_separated, condition_kaufman, condition_joint : float
        Condition numbers at the minimum of the exact separated Jacobian, that of eq. (4.31), and
        the joint one (Definition 4.1).
    """

    separated: Floats
    joint: Floats
    separated_cost: float
    joint_cost: float
    separated_gradient: float
    joint_gradient: float
    separated_steps: int
    joint_steps: int
    condition_separated: float
    condition_kaufman: float
    condition_joint: float


@on_one_thread
def compare_problems(
    data: Data,
    structure: LftStructure,
    *,
    rows: Mask | None = None,
    start: Start | tuple[ArrayLike, ArrayLike] | None = None,
    max_evaluations: int = 500,
) -> ProblemComparison:
    """Search the separated and the joint problem from the same start.

    Parameters
    ----------
    data, structure, rows, start
        As for `fit_lft`; at least one nonlinear parameter is needed.
    max_evaluations : int
        Limit of each search.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> u = rng.uniform(-1, 1, 400)
    >>> y = np.zeros(400)
    >>> y[2:] = np.tanh(0.6 * u[1:-1] + 0.8 * u[:-2]) + 0.1 * rng.standard_normal(398)
    >>> found = compare_problems((u, y), LftStructure(z_lags=(("u", 1), ("u", 2)), knots=5))
    >>> found.joint_gradient < 1e-6, found.condition_kaufman <= found.condition_joint
    (True, True)
    """
    signals = signals_of(data)
    problem = LftProblem.of(signals, structure, usable_rows(signals, structure, rows))
    d, g = first_start(problem) if start is None else given_start(problem, start)
    eta = np.concatenate([np.zeros(d.size - 1), g[1:]])
    centred, eta, theta, n_steps = _searched(problem.around(d), eta, max_evaluations)
    # The joint search begins where the separated one did, told in the coordinates of its end.
    begin = _coordinates(centred, d, g)
    linear = project(centred.regressors(begin), centred.y).theta
    joint = joint_search(centred, np.concatenate([begin, linear]), max_evaluations)
    projection = project(centred.regressors(eta), centred.y)
    derivative = centred.derivative(eta)
    exact = golub_pereyra_jacobian(projection, derivative)
    jacobian = joint_jacobian(centred, np.concatenate([eta, theta]))
    return ProblemComparison(
        separated=np.concatenate([eta, theta]),
        joint=joint.x,
        separated_cost=projection.cost,
        joint_cost=joint.cost,
        separated_gradient=_cosine(exact, projection.residual),
        joint_gradient=_cosine(jacobian, projection.residual),
        separated_steps=n_steps,
        joint_steps=len(joint.costs) - 1,
        condition_separated=float(np.linalg.cond(exact)),
        condition_kaufman=float(np.linalg.cond(kaufman_jacobian(projection, derivative))),
        condition_joint=float(np.linalg.cond(jacobian)),
    )


def joint_search(problem: LftProblem, start: Floats, max_evaluations: int) -> Minimum[Residual]:
    """Minimise over nonlinear and linear parameters together."""
    n_eta = problem.n_tangents + problem.structure.n_g

    def residual(x: Floats) -> Floats:
        return problem.y - problem.regressors(x[:n_eta]) @ x[n_eta:]

    return levenberg_marquardt(
        residual,
        lambda x: joint_jacobian(problem, x),
        start,
        tolerance=1e-12,
        max_evaluations=max_evaluations,
    )


def joint_jacobian(problem: LftProblem, x: Floats) -> Floats:
    """Return the derivative of the residual by (eta, theta), shape (n_rows, n_eta + n_linear)."""
    n_eta = problem.n_tangents + problem.structure.n_g
    eta, theta = x[:n_eta], x[n_eta:]
    return -np.column_stack([problem.derivative(eta).along(theta), problem.regressors(eta)])


def basis_conditions(z: ArrayLike, knots: int, degree: int = 3) -> dict[str, float]:
    """Return the condition numbers of both bases of the map at some points.

    Parameters
    ----------
    z : array_like, shape (n_points,)
    knots : int
        Equally spaced over the range of z.
    degree : int
        3, for which both span the same maps.

    Returns
    -------
    dict
        ``thesis`` and ``bspline`` as they are, ``thesis scaled`` and ``bspline scaled`` with columns
        of length 1.

    Examples
    --------
    >>> import numpy as np
    >>> found = basis_conditions(np.linspace(-3, 3, 500), 12)
    >>> found["bspline"] < 10 < 1e4 < found["thesis scaled"] < found["thesis"]
    True
    """
    points = np.asarray(z, dtype=float)
    places = equal_knots(points, knots - 1)
    bases = {
        "thesis": absolute_power_basis(points, places, degree=degree),
        "bspline": spline_basis(points, places, degree=degree),
    }
    found = {name: float(np.linalg.cond(matrix)) for name, matrix in bases.items()}
    for name, matrix in bases.items():
        found[f"{name} scaled"] = float(np.linalg.cond(matrix / np.linalg.norm(matrix, axis=0)))
    return found


def _searched(problem: LftProblem, eta: Floats, limit: int) -> tuple[LftProblem, Floats, Floats, int]:
    """Search the separated problem; return it centred at the end."""
    n_steps = 0
    for _ in range(4):
        search = fit(
            problem, problem.y, eta, jacobian="golub-pereyra", tolerance=1e-12, max_evaluations=limit
        )
        n_steps += len(search.costs) - 1
        d, g = problem.direction(search.eta), problem.numerator(search.eta)
        problem = problem.around(d)
        eta = np.concatenate([np.zeros(problem.n_tangents), g[1:]])
        if np.linalg.norm(search.eta[: problem.n_tangents]) <= 1e-6:
            break
    theta = project(problem.regressors(eta), problem.y).theta
    return problem, eta, theta, n_steps


def _coordinates(problem: LftProblem, d: Floats, g: Floats) -> Floats:
    """Return the point (d, g) in the tangent coordinates of a problem."""
    along = float(problem.centre @ d)
    return np.concatenate([problem.tangents.T @ d / along, g[1:]])


def _cosine(jacobian: Floats, residual: Floats) -> float:
    lengths = np.linalg.norm(jacobian, axis=0) * np.linalg.norm(residual)
    return float(np.max(np.abs(jacobian.T @ residual) / lengths))
