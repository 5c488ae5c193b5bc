"""How fast the gradient algorithm converges under a periodic input, without simulating it."""

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import DataError, ModelError
from sysid.recursive.base import Floats, Levels
from sysid.recursive.kernels import regressor_rows


def stationary_period(
    a: ArrayLike, composite: ArrayLike, u: ArrayLike, levels: ArrayLike
) -> tuple[Floats, Floats]:
    """Return regressors and output of one period of the steady state, without noise.

    The periodic solution of A y = sum mu_ij v_j is found by one linear system, not by a long run.

    Parameters
    ----------
    a : array_like, shape (order,)
        Coefficients a_1 .. a_n, a stable polynomial.
    composite : array_like, shape (order, n_levels)
        mu_ij = b_i d_j.
    u : array_like, shape (n_period,)
        One period of the input.
    levels : array_like, shape (n_levels,)

    Returns
    -------
    rows : ndarray, shape (n_period, order * (1 + n_levels))
        Regressors (3.8b).
    y : ndarray, shape (n_period,)
        Output.

    Raises
    ------
    DataError
        If the period is shorter than the order.
    ModelError
        If A is not stable: there is no steady state.
    """
    poles = np.asarray(a, dtype=np.float64)
    mu = np.asarray(composite, dtype=np.float64)
    order = poles.size
    largest = float(np.max(np.abs(np.roots(np.concatenate([[1.0], poles]))), initial=0.0))
    if not largest < 1.0:
        raise ModelError(f"the largest pole has modulus {largest:.4g}: a steady state needs one below 1")
    known = Levels(levels)
    numbers = known.numbers(np.ascontiguousarray(u, dtype=np.float64))
    period = numbers.size
    if period < order:
        raise DataError(f"a period of {period} samples is shorter than the order {order}: use a longer one")
    forced = np.zeros(period)
    system = np.eye(period)
    for i in range(order):
        heights = np.where(numbers >= 0, (mu[i] * known.values)[numbers], 0.0)
        forced += np.roll(heights, i + 1)
        system += poles[i] * np.roll(np.eye(period), i + 1, axis=0)
    y: Floats = np.asarray(np.linalg.solve(system, forced), dtype=np.float64)
    # The regressors of the second of two periods hold no sample from before the first.
    rows = np.empty((2 * period, order * (1 + known.values.size)))
    regressor_rows(order, known.values, np.tile(numbers, 2), np.tile(y, 2), rows)
    return rows[period:], y


def transition_matrix(rows: ArrayLike, step: float = 1.0, offset: float = 1.0) -> Floats:
    r"""Return the map of the parameter error over one period of the gradient algorithm.

    :math:`\prod_t \left(I - s\,\Phi\Phi^T / (c + \Phi^T\Phi)\right)`, the latest factor on the left.

    Parameters
    ----------
    rows : array_like, shape (n_period, n_parameters)
        Regressors of one period in their order.
    step, offset : float
        s and c.

    Examples
    --------
    >>> transition_matrix([[1.0, 0.0]], offset=1.0).tolist()
    [[0.5, 0.0], [0.0, 1.0]]
    """
    phi = np.asarray(rows, dtype=np.float64)
    found = np.eye(phi.shape[1])
    for row in phi:
        size = offset + row @ row
        if size > 0.0:
            found -= np.outer(step * row / size, row @ found)
    return found


def convergence_rate(rows: ArrayLike, step: float = 1.0, offset: float = 1.0) -> float:
    """Return the factor by which the parameter error shrinks in a period, in the long run.

    The largest modulus of an eigenvalue of `transition_matrix`; 1 when a direction is not excited.

    Examples
    --------
    >>> convergence_rate([[1.0, 0.0], [0.0, 2.0]])
    0.5
    """
    return float(np.max(np.abs(np.linalg.eigvals(transition_matrix(rows, step, offset)))))


def averaged_rate(rows: ArrayLike, step: float = 1.0, offset: float = 1.0) -> float:
    r"""Return what the averaged information matrix promises in place of `convergence_rate`.

    :math:`(1 - s\,\lambda_{\min}(\bar R))^T` with
    :math:`\bar R = \frac1T\sum_t \Phi\Phi^T/(c + \Phi^T\Phi)`.  Averaging holds for small steps only.

    Examples
    --------
    >>> averaged_rate([[1.0, 0.0], [0.0, 2.0]])
    0.5625
    """
    phi = np.asarray(rows, dtype=np.float64)
    size = offset + np.einsum("ij,ij->i", phi, phi)
    weights = np.divide(step, size, out=np.zeros_like(size), where=size > 0.0)
    mean = (phi * weights[:, np.newaxis]).T @ phi / phi.shape[0]
    return float((1.0 - np.linalg.eigvalsh(mean)[0]) ** phi.shape[0])
