"""A finished record of an experiment at a few input levels, identified in one call."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import IdentifiabilityError
from sysid.recursive.algorithms import RecursiveLeastSquares
from sysid.recursive.base import checked_pair, regressors
from sysid.recursive.persistence import excitation_of
from sysid.recursive.recovery import HammersteinParameters, Normalisation, Structure, recover
from sysid.recursive.structured import structured

WEAK_PRIOR = 1e8
"""Initial covariance: the zero start must leave no trace in the estimate."""


def identify_levels(
    u: ArrayLike,
    y: ArrayLike,
    order: int,
    *,
    levels: Sequence[float] | None = None,
    structure: Structure = "general",
    normalisation: Normalisation = "first",
) -> HammersteinParameters:
    """Identify a Hammerstein system from a record whose input takes a few values.

    Recursive least squares over the record, then least squares with the structure mu_ij = b_i d_j, then
    the segments of the nonlinearity.

    Parameters
    ----------
    u, y : array_like, shape (n_samples,)
        Input and output; the record begins at rest.
    order : int
        Order n of the linear system.
    levels : sequence of float, optional
        Values the input takes beside zero; by default those it takes in the record.
    structure, normalisation
        See `recover`.

    Returns
    -------
    HammersteinParameters

    Raises
    ------
    DataError
        If the lengths differ, a value is not finite or an input is no level.
    IdentifiabilityError
        If there are too few samples, the input does not excite every direction, or a side of zero has
        fewer than two levels.
    UsageError
        If the order, the levels or the structure are wrong.

    Examples
    --------
    >>> from sysid.excitation import impulse_levels
    >>> from sysid.linear.simulation import simulate_polynomial
    >>> from sysid.nonlinearities import Segments
    >>> u = impulse_levels([-6.0, -3.0, 3.0, 6.0], order=2, periods=3)
    >>> x = Segments(K1=1.0, K2=2.0, D1=1.0, D2=-2.0)(u)
    >>> y = simulate_polynomial([0.0, 1.0, -2.0], [1.0, -1.5, 0.56], x)
    >>> found = identify_levels(u, y, order=2, structure="dead-zone")
    >>> round(found.D1, 4), round(found.D2, 4), found.a.round(4)
    (1.0, -2.0, array([-1.5 ,  0.56]))
    """
    signal, output = checked_pair(u, y)
    heights = np.unique(signal[signal != 0.0]) if levels is None else np.asarray(levels, dtype=np.float64)
    estimator = RecursiveLeastSquares(order, heights, initial_covariance=WEAK_PRIOR)
    n_parameters = estimator.regressor.size
    if signal.size < n_parameters + order:
        raise IdentifiabilityError(
            f"{signal.size} samples cannot determine {n_parameters} parameters of order {order} with "
            f"{heights.size} levels: record a period of {order * (heights.size + 3)} samples or more"
        )
    excitation_of(regressors(signal, output, order, heights)).require()
    estimator.run(signal, output, every=signal.size)
    return recover(structured(estimator), structure, normalisation)
