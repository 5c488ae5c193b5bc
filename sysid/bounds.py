"""Bounds on the precision of least-squares estimates."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from sysid.errors import IdentifiabilityError
from sysid.separable import BlockedQR

Floats = NDArray[np.float64]


def least_squares_bound(jacobian: Iterable[ArrayLike], noise_variance: float, n_samples: int) -> Floats:
    r"""Asymptotic covariance of a least-squares estimate from ``n_samples`` samples.

    :math:`\frac{\sigma^2}{N}\,\bar M^{-1}` with the average information per sample
    :math:`\bar M = \mathrm E\,\psi\psi^T` taken over the rows given.  It is the Cramér-Rao bound for
    Gaussian noise; for other noise of the same variance it is what least squares attains.

    Parameters
    ----------
    jacobian : iterable of array_like, each of shape (n_rows, n_parameters)
        Blocks of derivatives of the one-step prediction, from a long record.
    noise_variance : float
        Variance of the equation error.
    n_samples : int
        Samples of the experiment the bound is for.

    Returns
    -------
    ndarray, shape (n_parameters, n_parameters)

    Raises
    ------
    IdentifiabilityError
        If the rows do not determine all parameters.

    Examples
    --------
    >>> rows = np.tile([[1.0, 0.0], [0.0, 2.0]], (50, 1))
    >>> least_squares_bound([rows], 1.0, 10).round(12).tolist()
    [[0.2, 0.0], [0.0, 0.05]]
    """
    factor: BlockedQR | None = None
    for block in jacobian:
        rows = np.asarray(block, dtype=float)
        factor = factor or BlockedQR(rows.shape[1])
        factor.update(rows)
    # Relative to each column, so that the units of the parameters do not matter; NaN determines nothing.
    if factor is None or not np.all(np.abs(np.diag(factor.r)) > 1e-10 * np.linalg.norm(factor.r, axis=0)):
        raise IdentifiabilityError(
            "the rows do not determine every parameter: use an input that excites them all"
        )
    inverse = solve_triangular(factor.r, np.eye(factor.n_columns))
    return np.asarray(noise_variance * factor.n_rows / n_samples * inverse @ inverse.T)
