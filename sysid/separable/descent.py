"""Levenberg-Marquardt for small nonlinear least-squares problems, with a reason for its stop."""

import enum
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from sysid.errors import UsageError
from sysid.separable.factor import triangle

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Status(enum.Enum):
    """Why an optimisation stopped; the value is the sentence shown to the user."""

    GRADIENT = "converged: the residual is orthogonal to every column of the Jacobian"
    STEP = "converged: the step is smaller than the tolerance relative to the parameters"
    COST = "converged: the cost no longer falls by more than the tolerance"
    GLOBAL = "global minimum over the bounds: every cell was examined"
    GRID = "best of all starting points on the grid; a finer grid may find a lower minimum"
    MAX_EVALUATIONS = (
        "stopped at the limit of evaluations before convergence: raise max_evaluations or start nearer"
    )
    STUCK = "stopped: no damped step lowers the cost; check the Jacobian or the scaling of the parameters"

    @property
    def converged(self) -> bool:
        """Whether the stop is a minimum rather than a limit."""
        return self in (Status.GRADIENT, Status.STEP, Status.COST, Status.GLOBAL, Status.GRID)


@dataclass(frozen=True)
class Minimum:
    """Result of `levenberg_marquardt`.

    Attributes
    ----------
    x : ndarray, shape (n_parameters,)
        Parameters.
    residual : ndarray, shape (n_residuals,)
        Residual at ``x``.
    jacobian : ndarray, shape (n_residuals, n_parameters)
        Its derivative at ``x``.
    cost : float
        Sum of squared residuals.
    status : Status
        Why the iteration stopped.
    costs : tuple of float
        Cost at the start and after every accepted step.
    n_evaluations : int
        Evaluations of the residual.
    """

    x: Floats
    residual: Floats
    jacobian: Floats
    cost: float
    status: Status
    costs: tuple[float, ...]
    n_evaluations: int


def levenberg_marquardt(
    residual: Callable[[Floats], Floats],
    jacobian: Callable[[Floats], Floats],
    start: ArrayLike,
    *,
    bounds: tuple[ArrayLike, ArrayLike] | None = None,
    damping: float = 1e-3,
    tolerance: float = 1e-10,
    max_evaluations: int = 200,
) -> Minimum:
    r"""Minimise :math:`\|r(x)\|^2` by damped Gauss-Newton steps.

    The damping is scaled by the running column norms of the Jacobian (Moré 1978), so the iteration
    does not depend on the units of the parameters, and follows the gain ratio (Nielsen 1999).
    Every step solves the augmented least-squares problem by QR.

    Parameters
    ----------
    residual, jacobian : callable
        Functions of the parameters; shapes (n_residuals,) and (n_residuals, n_parameters).
        A residual with a non-finite entry marks an infeasible point: the step is shortened.
    start : array_like, shape (n_parameters,)
        Starting point, feasible.
    bounds : pair of array_like, optional
        Lower and upper bounds; parameters at a bound that the gradient pushes outwards are held.
    damping : float
        Initial damping relative to the squared column norms.
    tolerance : float
        Relative tolerance on gradient angle, step and cost.
    max_evaluations : int
        Limit of residual evaluations.

    Returns
    -------
    Minimum
        Parameters, residual, Jacobian and status.

    Raises
    ------
    UsageError
        If the start is infeasible or outside the bounds.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0, 1, 20)
    >>> fit = levenberg_marquardt(
    ...     lambda x: np.exp(-x[0] * t) - np.exp(-3 * t), lambda x: (-t * np.exp(-x[0] * t))[:, None], [1.0])
    >>> round(float(fit.x[0]), 8)
    3.0
    """
    x = np.array(start, dtype=float)
    lower, upper = _bounds(bounds, x)
    r = residual(x)
    if not np.all(np.isfinite(r)):
        raise UsageError(f"the residual is not finite at the start {x.tolist()}: start elsewhere")
    cost = float(r @ r)
    costs = [cost]
    scale = np.zeros(x.size)
    growth = 2.0
    n_evaluations = 1
    status = Status.MAX_EVALUATIONS
    jac = jacobian(x)
    while n_evaluations < max_evaluations:
        norms = np.sqrt(np.einsum("ij,ij->j", jac, jac))
        scale = np.maximum(scale, norms)
        gradient = jac.T @ r
        free = ~(((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0))) & (norms > 0)
        if not np.any(free & (np.abs(gradient) > tolerance * norms * np.sqrt(cost))):
            status = Status.GRADIENT
            break
        step = _bounded_step(jac, r, np.sqrt(damping) * scale, free, lower - x, upper - x)
        trial = np.clip(x + step, lower, upper)
        small_step = np.linalg.norm(scale * step) <= tolerance * (np.linalg.norm(scale * x) + tolerance)
        trial_residual = residual(trial)
        n_evaluations += 1
        trial_cost = float(trial_residual @ trial_residual) if np.all(np.isfinite(trial_residual)) else np.inf
        predicted = cost - float(np.sum((r + jac @ step) ** 2))
        gain = (cost - trial_cost) / predicted if predicted > 0 else -1.0
        if gain > 1e-4:
            flat = cost - trial_cost <= tolerance * cost and predicted <= tolerance * cost
            x, r, cost = trial, trial_residual, trial_cost
            costs.append(cost)
            damping *= max(1 / 3, 1 - (2 * gain - 1) ** 3)
            growth = 2.0
            jac = jacobian(x)
            if small_step or flat:
                status = Status.STEP if small_step else Status.COST
                break
        else:
            if small_step or abs(predicted) <= 1e-15 * cost:
                status = Status.STEP
                break
            if damping > 1e20:
                status = Status.STUCK
                break
            damping *= growth
            growth *= 2
    return Minimum(x, r, jac, cost, status, tuple(costs), n_evaluations)


def _bounds(bounds: tuple[ArrayLike, ArrayLike] | None, x: Floats) -> tuple[Floats, Floats]:
    lower, upper = (-np.inf, np.inf) if bounds is None else bounds
    low = np.broadcast_to(np.asarray(lower, dtype=float), x.shape)
    high = np.broadcast_to(np.asarray(upper, dtype=float), x.shape)
    outside = np.flatnonzero((x < low) | (x > high) | ~np.isfinite(x))
    if outside.size:
        i = int(outside[0])
        raise UsageError(f"start value {i} is {x[i]:g}, outside its bounds [{low[i]:g}, {high[i]:g}]")
    return low, high


def _bounded_step(jac: Floats, r: Floats, weight: Floats, free: Bools, low: Floats, high: Floats) -> Floats:
    """Damped step between ``low`` and ``high``; the others re-optimise when a parameter meets its bound."""
    step = np.zeros(low.size)
    free = free.copy()
    while np.any(free):
        step[free] = _damped_step(jac[:, free], r + jac[:, ~free] @ step[~free], weight[free])
        outside = free & ((step < low) | (step > high))
        if not np.any(outside):
            break
        step[outside] = np.clip(step, low, high)[outside]
        free &= ~outside
    return step


def _damped_step(jac: Floats, r: Floats, weight: Floats) -> Floats:
    """Solve min ||J s + r||^2 + ||diag(weight) s||^2 by QR of the triangular factor of [J r]."""
    n = jac.shape[1]
    factor = triangle(np.column_stack([jac, r]))
    stacked = np.vstack([factor, np.column_stack([np.diag(weight), np.zeros(n)])])
    factor = triangle(stacked)
    return np.asarray(solve_triangular(factor[:n, :n], -factor[:n, n]))
