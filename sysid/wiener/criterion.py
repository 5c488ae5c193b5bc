"""The decomposition of least squares behind the preimage method: J_y, its gradient and its Hessian."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from sysid.errors import IdentifiabilityError, UsageError
from sysid.nonlinearities.base import Floats
from sysid.wiener import kernels

Normalisation = Literal["free", "dc-gain", "sum-b"]
MODES: dict[str, int] = {"free": kernels.FREE, "dc-gain": kernels.DC_GAIN, "sum-b": kernels.SUM_B}


@dataclass(frozen=True, eq=False)
class Criterion:
    r"""The least-squares criterion of a linear system as a function of its output sequence.

    :math:`J_y^2(u, y) = \min_\theta \|Qy - \Phi(u, y)\theta\|^2`, eq. (13) of Lacy, Erwin and Bernstein
    (2001).  Its gradient is :math:`2A(\theta)^Tr` with the equation-error filter A and the residual r, as
    theta is at its minimum; the Hessian is :math:`2(A^TA - WW^T)` with W of 2n + 1 columns.  No projector
    is formed.

    Parameters
    ----------
    u : array_like, shape (n_samples,)
        Input.
    order : int
        Order n of the linear system.
    normalisation : {"free", "dc-gain", "sum-b"}
        Nothing, G(1) = 1 by eq. (28), or sum(b) = 1; the last two eliminate b0.

    Examples
    --------
    >>> import numpy as np
    >>> u = np.array([1.0, -1.0, 0.5, 2.0, -0.3, 0.7, 0.1])
    >>> y = 0.5 * u
    >>> bool(Criterion(u, 1).value(y) < 1e-20)
    True
    """

    u: Floats
    order: int
    normalisation: Normalisation = "free"

    def __post_init__(self) -> None:
        if self.normalisation not in MODES:
            raise UsageError(
                f"there is no normalisation {self.normalisation!r}; choose one of {', '.join(MODES)}"
            )
        u = np.array(self.u, dtype=np.float64)
        object.__setattr__(self, "u", u)
        check_lengths(u, self.order, self.normalisation)

    @property
    def mode(self) -> int:
        """The normalisation as the kernels know it."""
        return MODES[self.normalisation]

    @property
    def n_linear(self) -> int:
        """Number of parameters that are eliminated."""
        return 2 * self.order + (1 if self.normalisation == "free" else 0)

    def eliminate(self, y: ArrayLike) -> tuple[Floats, Floats, Floats, Floats, float]:
        """Return the orthonormal columns (n_linear, p), their triangular factor, theta, r and J_y^2."""
        sequence = np.ascontiguousarray(y, dtype=np.float64)
        p = self.u.size - self.order
        columns, residual = np.empty((self.n_linear, p)), np.empty(p)
        factor, theta = np.empty((self.n_linear, self.n_linear)), np.zeros(self.n_linear)
        kernels.fill_regression(self.u, sequence, self.order, self.mode, columns, residual)
        cost = kernels.eliminate(columns, residual, factor, theta)
        return columns, factor, theta, residual, cost

    def value(self, y: ArrayLike) -> float:
        """Return J_y^2."""
        return self.eliminate(y)[-1]

    def relative(self, y: ArrayLike) -> float:
        """Return J_y^2 / ||Q y||^2, which does not depend on the scale of y; infinite for y = 0."""
        energy = float(np.sum(np.asarray(y)[self.order :] ** 2))
        return self.value(y) / energy if energy > 0 else np.inf

    def parameters(self, y: ArrayLike) -> Floats:
        r"""Return :math:`\hat\theta(u, y)` of eq. (16), [a1 ... an b0 ... bn].

        Raises
        ------
        IdentifiabilityError
            If u and y do not determine every parameter (no persistent excitation).
        """
        _, factor, theta, _, _ = self.eliminate(y)
        missing = np.flatnonzero(np.diag(factor) == 0.0)
        if missing.size:
            raise IdentifiabilityError(
                f"{self.n_linear - missing.size} of {self.n_linear} regressors are independent: the "
                "parameters are not determined; use an input that excites more, or a lower order"
            )
        return self.complete(theta)

    def complete(self, theta: Floats) -> Floats:
        """Return theta with the b0 that the normalisation removed."""
        if self.normalisation == "free":
            return theta
        n = self.order
        a, b = theta[:n], theta[n:]
        b0 = 1.0 - np.sum(b) + (np.sum(a) if self.normalisation == "dc-gain" else 0.0)
        return np.concatenate([a, [b0], b])

    def gradient(self, y: ArrayLike) -> Floats:
        """Return the gradient of J_y^2, shape (n_samples,): eq. (22), corrected and fast."""
        _, _, theta, residual, _ = self.eliminate(y)
        found = np.empty(self.u.size)
        kernels.equation_error_gradient(theta, residual, self.order, found)
        return found

    def hessian(self, y: ArrayLike) -> Floats:
        """Return the Hessian of J_y^2, shape (n_samples, n_samples): eq. (23), corrected and fast."""
        columns, factor, theta, residual, _ = self.eliminate(y)
        filtered = equation_error_matrix(theta[: self.order], self.u.size)
        shifted = np.zeros((self.u.size, self.n_linear))
        for i in range(self.order):
            start = self.order - 1 - i
            shifted[start : start + residual.size, i] = residual
        w = solve_triangular(factor, shifted.T, trans="T").T - filtered.T @ columns.T
        return np.asarray(2 * (filtered.T @ filtered - w @ w.T))


def equation_error_matrix(a: ArrayLike, n_samples: int) -> Floats:
    """Return the banded matrix A of the equation-error filter, shape (n_samples - n, n_samples).

    Row k of A y is y(k) + a1 y(k-1) + ... + an y(k-n).

    Examples
    --------
    >>> equation_error_matrix([-0.5], 3)
    array([[-0.5,  1. ,  0. ],
           [ 0. , -0.5,  1. ]])
    """
    coefficients = np.concatenate([[1.0], np.asarray(a, dtype=np.float64)])
    n = coefficients.size - 1
    matrix = np.zeros((n_samples - n, n_samples))
    for lag, coefficient in enumerate(coefficients):
        matrix[:, n - lag : n_samples - lag] += coefficient * np.eye(n_samples - n)
    return matrix


def check_lengths(u: Floats, order: int, normalisation: str = "free") -> None:
    """Require a finite input, an order from 1 and at least as many equations as parameters."""
    if order < 1:
        raise UsageError(f"the order is {order}: give at least 1")
    if u.ndim != 1:
        raise UsageError(f"the input has shape {u.shape}: give one sequence (n_samples,)")
    bad = np.flatnonzero(~np.isfinite(u))
    if bad.size:
        raise UsageError(f"the input of sample {int(bad[0])} is {u[bad[0]]}: remove or fill it")
    n_linear = 2 * order + (1 if normalisation == "free" else 0)
    if u.size - order < n_linear:
        raise IdentifiabilityError(
            f"{u.size} samples give {max(u.size - order, 0)} equations for {n_linear} parameters: order "
            f"{order} needs at least {n_linear + order} samples"
        )


def check_excitation(u: Floats, order: int) -> None:
    """Require that the lagged inputs u(k) ... u(k-n) are independent.

    Raises
    ------
    IdentifiabilityError
        If they are not: no output can then determine b.
    """
    lagged = np.column_stack([u[order - i : u.size - i] for i in range(order + 1)])
    values = np.linalg.svd(lagged, compute_uv=False)
    rank = int(np.sum(values > 1e-10 * max(values[0], 1e-300)))
    if rank < order + 1:
        raise IdentifiabilityError(
            f"the input does not excite: {rank} of the {order + 1} lagged inputs u(k) ... u(k-{order}) "
            "are independent; use an input with more frequencies, e.g. white noise"
        )
