"""The result that every separable estimator returns."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from sysid.separable.descent import Status
from sysid.separable.factor import triangle

Floats = NDArray[np.float64]

_DEPENDENT = 1e-11  # a column whose part outside those before it is this small relative to its norm


@dataclass(frozen=True)
class SeparableFit:
    r"""A separable least-squares estimate.

    Attributes
    ----------
    eta : ndarray, shape (n_eta,)
        Nonlinear parameters; where the cost is flat, the midpoint of the flat cell.
    theta : ndarray, shape (n_linear,)
        Linear parameters.
    residual : ndarray, shape (n_rows,)
        :math:`y - \Phi\theta`.
    jacobian_factor : ndarray, shape (any, n_eta + n_linear)
        A matrix F with :math:`F^TF = J^TJ`, J the Jacobian of the model output in (eta, theta); the
        column of a parameter without a derivative (in a flat cell) is zero.
    status : Status
        Why the search ended.
    cells : tuple of (float, float)
        For each nonlinear parameter the interval around it on which the cost does not change; empty
        width for parameters with a proper minimum.
    minima : ndarray, shape (n_kept, n_eta + 1)
        The lowest local minima found: parameters, then cost; empty for a local descent.
    n_minima : int
        Number of local minima found, those at the bounds included.
    costs : tuple of float
        Cost after each accepted step of a local descent.
    """

    eta: Floats
    theta: Floats
    residual: Floats
    jacobian_factor: Floats
    status: Status
    cells: tuple[tuple[float, float], ...]
    minima: Floats
    n_minima: int
    costs: tuple[float, ...] = ()

    @cached_property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return float(self.residual @ self.residual)

    @property
    def mean_square(self) -> float:
        """Cost over the number of rows: Bai's J."""
        return self.cost / self.residual.size

    @property
    def flat(self) -> bool:
        """Whether the cost does not change around the estimate."""
        return any(high > low for low, high in self.cells)

    @cached_property
    def noise_variance(self) -> float:
        """Unbiased estimate of the residual variance."""
        free = self.residual.size - self.theta.size - sum(low == high for low, high in self.cells)
        return self.cost / free if free > 0 else float("nan")

    @cached_property
    def covariance(self) -> Floats:
        """Covariance of (eta, theta) for white residuals; NaN where the data do not determine one."""
        size = self.jacobian_factor.shape[1]
        factor = triangle(self.jacobian_factor)
        norms = np.sqrt(np.einsum("ij,ij->j", factor, factor))
        diagonal = np.zeros(size)
        diagonal[: factor.shape[0]] = np.abs(np.diag(factor))
        known = np.flatnonzero(diagonal > _DEPENDENT * norms)
        covariance = np.full((size, size), np.nan)
        inverse = solve_triangular(factor[np.ix_(known, known)], np.eye(known.size))
        covariance[np.ix_(known, known)] = self.noise_variance * inverse @ inverse.T
        return covariance

    @property
    def std_error(self) -> Floats:
        """Standard errors of (eta, theta)."""
        return np.sqrt(np.diag(self.covariance))

    def __repr__(self) -> str:
        """Show parameters, cost and the reason for the stop."""
        eta = ", ".join(f"{value:.6g}" for value in self.eta)
        theta = ", ".join(f"{value:.6g}" for value in self.theta)
        return f"SeparableFit(eta=[{eta}], theta=[{theta}], cost={self.cost:.6g}: {self.status.value})"
