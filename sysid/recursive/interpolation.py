"""The polynomial that equals a static map at the input levels and at zero."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from sysid.recursive.base import Floats, Levels


def interpolation_coefficients(levels: ArrayLike, function: Callable[[Floats], ArrayLike]) -> Floats:
    """Return d_j = F(V_j) / V_j, eq. (3.5) of Giri, Rochdi and Chaoui.

    Parameters
    ----------
    levels : array_like, shape (n_levels,)
        Distinct, none zero.
    function : callable
        The map F.

    Examples
    --------
    >>> interpolation_coefficients([-2.0, 2.0], np.abs).tolist()
    [-1.0, 1.0]
    """
    values = Levels(levels).values
    return np.asarray(function(values), dtype=np.float64) / values


def interpolation_polynomial(v: ArrayLike, levels: ArrayLike, d: ArrayLike) -> Floats:
    """Return P(v) = v sum_j d_j P_j(v) with Lagrange's polynomials P_j, eq. (3.3).

    Parameters
    ----------
    v : array_like
        Where to evaluate it.
    levels, d : array_like, shape (n_levels,)

    Returns
    -------
    ndarray, in the shape of ``v``

    Examples
    --------
    >>> interpolation_polynomial([-2.0, 0.0, 1.0, 2.0], [-2.0, 2.0], [-1.0, 1.0]).tolist()
    [2.0, 0.0, 0.5, 2.0]
    """
    places = np.asarray(v, dtype=np.float64)
    values = Levels(levels).values
    total = np.zeros_like(places)
    for j, coefficient in enumerate(np.asarray(d, dtype=np.float64)):
        others = np.delete(values, j)
        basis = np.prod((places[..., np.newaxis] - others) / (values[j] - others), axis=-1)
        total += coefficient * basis
    return places * total
