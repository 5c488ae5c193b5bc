"""Levenberg-Marquardt for small nonlinear least-squares problems, with a reason for its stop."""

import enum
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack

from sysid.errors import UsageError
from sysid.separable.factor import folded_up

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Status(enum.Enum):
    """Why an optimisation stopped; the value is the sentence shown to the user."""

    GRADIENT = "converged: the residual is orthogonal to every column of the Jacobian"
    STEP = "converged: the step is smaller than the tolerance relative to the parameters"
    COST = "converged: the cost no longer falls by more than the tolerance"
    NEGLIGIBLE = "converged: a full step would lower the cost by a negligible amount"
    GLOBAL = "global minimum over the bounds: every cell was examined"
    GRID = "best of all starting points on the grid; a finer grid may find a lower minimum"
    MET = "stopped: it has come to where another search has been, and no lower"
    MAX_EVALUATIONS = (
        "stopped at the limit of evaluations before convergence: raise max_evaluations or start nearer"
    )
    STUCK = "stopped: no damped step lowers the cost; check the Jacobian or the scaling of the parameters"

    @property
    def converged(self) -> bool:
        """Whether the stop is a minimum rather than a limit."""
        return self not in (Status.MAX_EVALUATIONS, Status.STUCK)


class Point(Protocol):
    """A least-squares problem at one set of parameters; only what is asked for need be computed."""

    @property
    def cost(self) -> float:
        """Sum of squared residuals; infinite or NaN where the parameters are infeasible."""

    def linearise(self) -> tuple[Floats, Floats]:
        """Return the Jacobian and the residual, in any one orthonormal basis.

        What is orthogonal to the Jacobian may be left out, so that a triangular factor will do.
        """


@dataclass(frozen=True)
class Residual:
    """A point of the problem that a residual and its Jacobian define.

    Attributes
    ----------
    residual : ndarray, shape (n_residuals,)
    derivative : callable
        Returns the Jacobian, shape (n_residuals, n_parameters).
    """

    residual: Floats
    derivative: Callable[[], Floats]

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return float(self.residual @ self.residual)

    def linearise(self) -> tuple[Floats, Floats]:
        """Return the Jacobian and the residual."""
        return self.derivative(), self.residual


AnyPoint = TypeVar("AnyPoint", bound=Point)


@dataclass(frozen=True)
class Minimum(Generic[AnyPoint]):
    """Result of `descend` and `levenberg_marquardt`.

    Attributes
    ----------
    x : ndarray, shape (n_parameters,)
        Parameters.
    point : Point
        The problem at ``x``.
    status : Status
        Why the iteration stopped.
    costs : tuple of float
        Cost at the start and after every accepted step.
    n_evaluations : int
        Evaluations of the cost.
    """

    x: Floats
    point: AnyPoint
    status: Status
    costs: tuple[float, ...]
    n_evaluations: int

    @property
    def cost(self) -> float:
        """Sum of squared residuals at ``x``."""
        return self.point.cost


def levenberg_marquardt(
    residual: Callable[[Floats], Floats],
    jacobian: Callable[[Floats], Floats],
    start: ArrayLike,
    *,
    bounds: tuple[ArrayLike, ArrayLike] | None = None,
    tolerance: float = 1e-10,
    max_evaluations: int = 200,
) -> Minimum[Residual]:
    r"""Minimise :math:`\|r(x)\|^2` for a residual and its Jacobian given as functions.

    Parameters
    ----------
    residual, jacobian : callable
        Functions of the parameters; shapes (n_residuals,) and (n_residuals, n_parameters).
        A residual with a non-finite entry marks an infeasible point: the step is shortened.
    start, bounds, tolerance, max_evaluations
        See `descend`.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0, 1, 20)
    >>> fit = levenberg_marquardt(
    ...     lambda x: np.exp(-x[0] * t) - np.exp(-3 * t), lambda x: (-t * np.exp(-x[0] * t))[:, None], [1.0])
    >>> round(float(fit.x[0]), 8)
    3.0
    """
    return descend(
        lambda x: Residual(residual(x), partial(jacobian, x)),
        start,
        bounds=bounds,
        tolerance=tolerance,
        max_evaluations=max_evaluations,
    )


def descend(
    evaluate: Callable[[Floats], AnyPoint],
    start: ArrayLike,
    *,
    bounds: tuple[ArrayLike, ArrayLike] | None = None,
    tolerance: float = 1e-10,
    negligible: float = 0.0,
    zero: float = 0.0,
    max_evaluations: int = 200,
    met: Callable[[AnyPoint], bool] | None = None,
) -> Minimum[AnyPoint]:
    r"""Minimise a sum of squares by damped Gauss-Newton steps.

    The damping is scaled by the running column norms of the Jacobian (Moré 1978), so the iteration
    does not depend on the units of the parameters, and follows the gain ratio (Nielsen 1999).
    Every step solves the augmented least-squares problem by QR.

    Parameters
    ----------
    evaluate : callable
        Returns the `Point` at given parameters.  Its cost decides whether a step is taken; only
        where one was taken is the point linearised.
    start : array_like, shape (n_parameters,)
        Starting point, feasible.
    bounds : pair of array_like, optional
        Lower and upper bounds; parameters at a bound that the gradient pushes outwards are held.
    tolerance : float
        Relative tolerance on gradient angle, step and cost.
    negligible : float
        Share of the cost; a point is good enough when no step could lower the cost by more if the
        problem were linear.
    zero : float
        Cost, and decrease of the cost, that count as zero.
    max_evaluations : int
        Limit of evaluations.
    met : callable, optional
        Tells of a point whether another search has been there, so that this one need not go on.

    Returns
    -------
    Minimum
        Parameters, the point there and status.

    Raises
    ------
    UsageError
        If the start is infeasible or outside the bounds.
    """
    x = np.array(start, dtype=float)
    lower, upper = _bounds(bounds, x)
    point = evaluate(x)
    if not np.isfinite(point.cost):
        raise UsageError(f"the residual is not finite at the start {x.tolist()}: start elsewhere")
    costs = [point.cost]
    scale = np.zeros(x.size)
    damping, growth = 1e-3, 2.0
    n_evaluations = 1
    status = Status.MAX_EVALUATIONS
    jac, r = _compressed(point)
    while n_evaluations < max_evaluations:
        cost = point.cost
        norms = np.sqrt(np.einsum("ij,ij->j", jac, jac))
        scale = np.maximum(scale, norms)
        gradient = jac.T @ r
        if not np.isfinite([norms, gradient]).all():  # the cost has a value here, its derivative has none
            status = Status.STUCK
            break
        free = ~(((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0))) & (norms > 0)
        if not np.any(free & (np.abs(gradient) > tolerance * norms * np.sqrt(cost))):
            status = Status.GRADIENT
            break
        small = max(negligible * cost, zero)
        # One unknown alone may lower the cost by more than that, which is sooner seen.
        by_one = np.max((gradient[free] / norms[free]) ** 2)
        if cost <= zero or (
            small > max(0.0, by_one) and _possible_decrease(jac[:, free] / norms[free], r) <= small
        ):
            status = Status.NEGLIGIBLE
            break
        step = _bounded_step(jac, r, np.sqrt(damping) * scale, free, lower - x, upper - x)
        trial = np.clip(x + step, lower, upper)
        small_step = np.linalg.norm(scale * step) <= tolerance * (np.linalg.norm(scale * x) + tolerance)
        trial_point = evaluate(trial)
        n_evaluations += 1
        trial_cost = trial_point.cost if np.isfinite(trial_point.cost) else np.inf
        predicted = float(r @ r - np.sum((r + jac @ step) ** 2))
        gain = (cost - trial_cost) / predicted if predicted > 0 else -1.0
        if gain > 1e-4:
            flat = cost - trial_cost <= tolerance * cost and predicted <= tolerance * cost
            x, point = trial, trial_point
            costs.append(trial_cost)
            damping *= max(1 / 3, 1 - (2 * gain - 1) ** 3)
            growth = 2.0
            if small_step or flat:
                status = Status.STEP if small_step else Status.COST
                break
            if met is not None and met(point):
                status = Status.MET
                break
            if n_evaluations < max_evaluations:
                jac, r = _compressed(point)
        else:
            if small_step or abs(predicted) <= max(small, 1e-15 * cost):
                status = Status.STEP
                break
            if damping > 1e20:
                status = Status.STUCK
                break
            damping *= growth
            growth *= 2
    return Minimum(x, point, status, tuple(costs), n_evaluations)


def _compressed(point: Point) -> tuple[Floats, Floats]:
    """Return the triangular factor of the Jacobian and the part of the residual in its range."""
    jac, r = point.linearise()
    n = jac.shape[1]
    columns = np.empty((n + 1, r.size))
    columns[:n], columns[n] = jac.T, r
    factor = folded_up(columns.T)
    return factor[:n, :n], factor[:n, n]


def _possible_decrease(jac: Floats, r: Floats) -> float:
    """Return how much a full step would lower the cost if the problem were linear."""
    left, values, _ = np.linalg.svd(jac)
    seen = values > 1e-10 * values[0]
    return float(np.sum((left.T @ r)[: values.size][seen] ** 2))


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
    """Solve min ||J s + r||^2 + ||diag(weight) s||^2 by QR."""
    m, n = jac.shape
    matrix = np.zeros((m + n, n + 1), order="F")
    matrix[:m, :n], matrix[:m, n] = jac, r
    matrix[np.arange(m, m + n), np.arange(n)] = weight
    factor = folded_up(matrix)
    return np.asarray(-lapack.dtrtrs(factor[:n, :n], factor[:n, n])[0])
