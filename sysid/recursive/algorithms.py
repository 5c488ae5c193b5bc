"""Projected gradient, Kaczmarz's method and least squares with forgetting, sample by sample."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import UsageError
from sysid.recursive.base import Floats, Indices, Recursive, finite
from sysid.recursive.kernels import gradient_run, gradient_step, least_squares_run, least_squares_step


class ProjectionGradient(Recursive):
    r"""Normalised gradient with projection on a ball, eq. (4.1) of Giri, Rochdi and Chaoui.

    :math:`\theta' = \theta + s\,\Phi e / (c + \Phi^T\Phi)`, then :math:`\theta = \theta'` inside the
    ball of radius :math:`\rho^*` and the nearest point of the ball outside.  The paper has s = c = 1.

    Parameters
    ----------
    order, levels, start
        See `Recursive`.
    radius : float
        Upper bound of the norm of the true parameters; infinite for no projection.
    step : float
        s, between 0 and 2.
    offset : float
        c, not negative; it is not free of units: it is small or large against the signals' squares.

    Raises
    ------
    UsageError
        If a setting is out of its range.

    Examples
    --------
    >>> from sysid.excitation import impulse_levels
    >>> from sysid.linear.simulation import simulate_polynomial
    >>> u = impulse_levels([-2.0, -1.0, 1.0, 2.0], order=1, periods=200)
    >>> y = simulate_polynomial([0.0, 1.0], [1.0, -0.5], u)
    >>> estimator = ProjectionGradient(1, [-2.0, -1.0, 1.0, 2.0], radius=10.0)
    >>> for sample in zip(u, y):
    ...     error = estimator.update(*sample)
    >>> estimator.snapshot().a.round(6), estimator.snapshot().composite.round(6)
    (array([-0.5]), array([[1., 1., 1., 1.]]))
    """

    algorithm = "projection-gradient"

    def __init__(
        self,
        order: int,
        levels: ArrayLike,
        *,
        radius: float = math.inf,
        step: float = 1.0,
        offset: float = 1.0,
        start: ArrayLike | None = None,
    ) -> None:
        super().__init__(order, levels, start=start)
        if not radius > 0.0:
            raise UsageError(f"the radius is {radius}: give a positive bound of the parameters' norm")
        if not 0.0 < step < 2.0:
            raise UsageError(f"the step is {step}: outside (0, 2) the iteration cannot converge")
        if not (offset >= 0.0 and math.isfinite(offset)):
            raise UsageError(f"the offset is {offset}: give a finite number >= 0")
        self.radius, self.step, self.offset = float(radius), float(step), float(offset)

    def _settings(self) -> dict[str, Any]:
        radius = self.radius if math.isfinite(self.radius) else None
        return {"radius": radius, "step": self.step, "offset": self.offset}

    @classmethod
    def _restored(cls, state: Mapping[str, Any]) -> Recursive:
        settings = dict(state["settings"])
        if settings.get("radius", 0) is None:
            settings["radius"] = math.inf
        return cls(state["order"], state["levels"], **settings)

    def _step(self, number: int, value: float, y: float) -> float:
        return gradient_step(
            self._theta, self._phi, self.order, self.step, self.offset, self.radius, number, value, y
        )

    def _steps(self, numbers: Indices, y: Floats, errors: Floats, kept: Floats, every: int) -> None:
        settings = (self.order, self.step, self.offset, self.radius)
        gradient_run(self._theta, self._phi, *settings, self._levels.values, numbers, y, errors, kept, every)


class Kaczmarz(ProjectionGradient):
    r"""Normalised Kaczmarz: :math:`\theta + s\,\Phi e / \Phi^T\Phi`; nothing at a zero regressor.

    With s = 1 the new estimate explains the newest sample exactly.  It is the gradient algorithm
    without the 1 in its denominator, so it does not change when the signals change their unit.

    Parameters
    ----------
    order, levels, start
        See `Recursive`.
    step : float
        s, between 0 and 2.
    """

    algorithm = "kaczmarz"

    def __init__(
        self, order: int, levels: ArrayLike, *, step: float = 1.0, start: ArrayLike | None = None
    ) -> None:
        super().__init__(order, levels, step=step, offset=0.0, start=start)

    def _settings(self) -> dict[str, Any]:
        return {"step": self.step}


class RecursiveLeastSquares(Recursive):
    r"""Recursive least squares with exponential forgetting, in square-root (QR) form.

    Keeps the triangle R of :math:`\sum_t \lambda^{N-t}\Phi\Phi^T + \lambda^N P_0^{-1} = R^TR` and
    rotates each new row into it; no covariance is ever formed, so none can lose its symmetry or sign.

    Parameters
    ----------
    order, levels, start
        See `Recursive`.
    initial_covariance : float
        P0 = this times I, how far the start may be from the truth.
    forgetting : float
        lambda, in (0, 1]; 1 forgets nothing.

    Raises
    ------
    UsageError
        If a setting is out of its range.

    Examples
    --------
    >>> estimator = RecursiveLeastSquares(1, [-1.0, 1.0], initial_covariance=1e6)
    >>> inputs, outputs = [1.0, 0.0, 0.0, -1.0, 0.0], [0.0, 2.0, 1.0, 0.5, -1.75]
    >>> errors = [estimator.update(u, y) for u, y in zip(inputs, outputs)]
    >>> estimator.theta.round(4)
    array([-0.5,  2. ,  2. ])
    """

    algorithm = "recursive-least-squares"

    def __init__(
        self,
        order: int,
        levels: ArrayLike,
        *,
        initial_covariance: float = 1e6,
        forgetting: float = 1.0,
        start: ArrayLike | None = None,
    ) -> None:
        super().__init__(order, levels, start=start)
        if not (initial_covariance > 0.0 and math.isfinite(initial_covariance)):
            raise UsageError(f"the initial covariance is {initial_covariance}: give a positive number")
        if not 0.0 < forgetting <= 1.0:
            raise UsageError(f"the forgetting factor is {forgetting}: it must lie in (0, 1]")
        self.initial_covariance, self.forgetting = float(initial_covariance), float(forgetting)
        p = self._theta.size
        self._factor = np.zeros((p + 1, p + 1))
        self._factor[:p, :p] = np.eye(p) / math.sqrt(initial_covariance)
        self._factor[:p, p] = self._theta / math.sqrt(initial_covariance)

    @property
    def triangle(self) -> tuple[Floats, Floats]:
        """R and z (copies): the weighted sum of squares is ||R theta - z||^2 plus a constant."""
        p = self._theta.size
        return self._factor[:p, :p].copy(), self._factor[:p, p].copy()

    @property
    def covariance(self) -> Floats:
        """P = (R^T R)^-1; times the noise variance the covariance of the estimate, shape (p, p)."""
        from scipy.linalg import solve_triangular

        p = self._theta.size
        inverse = solve_triangular(self._factor[:p, :p], np.eye(p))
        return np.asarray(inverse @ inverse.T)

    def _settings(self) -> dict[str, Any]:
        return {
            "initial_covariance": self.initial_covariance,
            "forgetting": self.forgetting,
            "factor": self._factor.tolist(),
        }

    @classmethod
    def _restored(cls, state: Mapping[str, Any]) -> Recursive:
        settings = dict(state["settings"])
        factor = settings.pop("factor")
        made = cls(state["order"], state["levels"], **settings)
        made._factor[:] = finite(factor, made._factor.shape)
        return made

    def _step(self, number: int, value: float, y: float) -> float:
        root = math.sqrt(self.forgetting)
        return least_squares_step(self._theta, self._phi, self._factor, self.order, root, number, value, y)

    def _steps(self, numbers: Indices, y: Floats, errors: Floats, kept: Floats, every: int) -> None:
        arrays = (self._theta, self._phi, self._factor, self.order, math.sqrt(self.forgetting))
        least_squares_run(*arrays, self._levels.values, numbers, y, errors, kept, every)
