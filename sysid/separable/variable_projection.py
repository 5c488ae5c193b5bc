"""Variable projection: descent in the nonlinear parameters with the linear ones eliminated."""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from sysid.separable.descent import Residual, descend
from sysid.separable.estimate import SeparableFit
from sysid.separable.factor import Projection, finite, project, triangle

Floats = NDArray[np.float64]


class Derivative(Protocol):
    """dPhi/deta as its two products, for regressors whose derivative need not be formed."""

    def along(self, theta: Floats) -> Floats:
        """Return (dPhi/deta_j) theta, shape (n_rows, n_eta)."""

    def correlated(self, residual: Floats) -> Floats:
        """Return (dPhi/deta_j)^T residual, shape (n_linear, n_eta)."""


class Regression(Protocol):
    """Regressors that depend on a few nonlinear parameters."""

    def regressors(self, eta: Floats) -> Floats:
        """Return Phi(eta), shape (n_rows, n_linear)."""

    def derivative(self, eta: Floats) -> Floats | Derivative:
        """Return dPhi/deta, shape (n_eta, n_rows, n_linear), or its products."""


def kaufman_jacobian(projection: Projection, derivative: Floats | Derivative) -> Floats:
    r"""Jacobian of the projected residual in Kaufman's approximation.

    Keeps :math:`-(I - QQ^T)\,(\partial\Phi/\partial\eta_j)\,\theta`, the first of the two terms of
    Golub and Pereyra; the gradient of the cost it gives is exact.

    Parameters
    ----------
    projection : Projection
        Result of `project` at the same point.
    derivative : ndarray, shape (n_eta, n_rows, n_linear), or Derivative
        Derivative of the regressors.

    Returns
    -------
    ndarray, shape (n_rows, n_eta)
    """
    moved = _along(derivative, projection.theta)
    return projection.q @ (projection.q.T @ moved) - moved


def golub_pereyra_jacobian(projection: Projection, derivative: Floats | Derivative) -> Floats:
    r"""Exact Jacobian of the projected residual (Golub and Pereyra 1973).

    Adds to Kaufman's term :math:`-Q R^{-T} (\partial\Phi/\partial\eta_j)^T r`.

    Parameters
    ----------
    projection : Projection
        Result of `project` at the same point.
    derivative : ndarray, shape (n_eta, n_rows, n_linear), or Derivative
        Derivative of the regressors.

    Returns
    -------
    ndarray, shape (n_rows, n_eta)
    """
    if isinstance(derivative, np.ndarray):
        correlated = np.einsum("jki,k->ij", derivative[:, :, projection.columns], projection.residual)
    else:
        correlated = derivative.correlated(projection.residual)[projection.columns]
    turned = projection.q @ solve_triangular(projection.r, correlated, trans="T")
    return kaufman_jacobian(projection, derivative) - turned


def _along(derivative: Floats | Derivative, theta: Floats) -> Floats:
    """Return (dPhi/deta_j) theta, shape (n_rows, n_eta)."""
    if isinstance(derivative, np.ndarray):
        return (derivative @ theta).T
    return derivative.along(theta)


@dataclass(frozen=True)
class _Point(Residual):
    """The projected residual at one eta."""

    projection: Projection


def fit(
    regression: Regression,
    y: ArrayLike,
    start: ArrayLike,
    *,
    bounds: tuple[ArrayLike, ArrayLike] | None = None,
    jacobian: Literal["golub-pereyra", "kaufman"] = "kaufman",
    tolerance: float = 1e-10,
    max_evaluations: int = 200,
) -> SeparableFit:
    r"""Descend to a minimum of the projected cost by Levenberg-Marquardt.

    Parameters
    ----------
    regression : Regression
        Regressors and their derivative.
    y : array_like, shape (n_rows,)
        Data.
    start : array_like, shape (n_eta,)
        Starting point of the nonlinear parameters.
    bounds : pair of array_like, optional
        Lower and upper bounds.
    jacobian : {"kaufman", "golub-pereyra"}
        Approximate or exact Jacobian of the projected residual.
    tolerance, max_evaluations : float, int
        See `descend`.

    Returns
    -------
    SeparableFit
        Estimate with its status.

    Raises
    ------
    DataError
        If ``y`` is not finite.
    IdentifiabilityError
        If there are fewer rows than parameters.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0, 2, 50)
    >>> class Decay:
    ...     def regressors(self, eta):
    ...         return np.exp(-eta[0] * t)[:, None]
    ...     def derivative(self, eta):
    ...         return (-t * np.exp(-eta[0] * t))[None, :, None]
    >>> fit(Decay(), 5 * np.exp(-1.5 * t), [1.0])
    SeparableFit(eta=[1.5], theta=[5], cost=...: converged: ...)
    """
    data = finite(y)
    build = golub_pereyra_jacobian if jacobian == "golub-pereyra" else kaufman_jacobian

    def evaluate(eta: Floats) -> _Point:
        phi = regression.regressors(eta)
        feasible = bool(np.all(np.isfinite(phi)))
        found = project(phi if feasible else np.zeros_like(phi), data)
        residual = found.residual if feasible else np.full(data.size, np.inf)
        return _Point(residual, lambda: build(found, regression.derivative(eta)), found)

    minimum = descend(evaluate, start, bounds=bounds, tolerance=tolerance, max_evaluations=max_evaluations)
    final = minimum.point.projection
    return SeparableFit(
        eta=minimum.x,
        theta=final.theta,
        residual=final.residual,
        jacobian_factor=_jacobian_factor(regression, minimum.x, final),
        status=minimum.status,
        cells=tuple((float(value), float(value)) for value in minimum.x),
        minima=np.empty((0, minimum.x.size + 1)),
        n_minima=0,
        costs=minimum.costs,
    )


def _jacobian_factor(regression: Regression, eta: Floats, projection: Projection) -> Floats:
    """R of the model's Jacobian in (eta, theta)."""
    moved = _along(regression.derivative(eta), projection.theta)
    return triangle(np.column_stack([moved, regression.regressors(eta)]))
