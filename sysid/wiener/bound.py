"""The Cramér-Rao bound of a Wiener system with Gaussian noise before a known nonlinearity."""

import numpy as np
from numpy.typing import ArrayLike

from sysid._compile import compiled
from sysid.errors import IdentifiabilityError, UsageError
from sysid.nonlinearities.base import Floats
from sysid.nonlinearities.preimages import Indices, KnownMap
from sysid.wiener.likelihood import simulate
from sysid.wiener.truncated import union_moments

_REACH = 5.0
_SINGULAR = 1e-12


def information_bound(
    u: ArrayLike,
    theta: ArrayLike,
    noise: float,
    nonlinearity: KnownMap,
    order: int,
    *,
    state: ArrayLike | None = None,
    points: int = 200,
) -> Floats:
    """Return the Cramér-Rao bound on the covariance of theta, shape (2 order + 1, 2 order + 1).

    The initial state and the noise level are unknown, too. Where the nonlinearity fixes no scale the bound
    is for the noise level known, as gain and noise cannot be told apart.

    Parameters
    ----------
    u : array_like, shape (n_samples,)
    theta : array_like, shape (2 order + 1,)
        True [a1 ... an b0 ... bn].
    noise : float
        Standard deviation of w in z = N(y + w).
    nonlinearity : KnownMap
    order : int
    state : array_like, shape (order,), optional
        True initial state; rest by default.
    points : int
        Of the midpoint rule for the expectation over w of each sample.

    Raises
    ------
    UsageError
        If the noise is not positive.
    IdentifiabilityError
        If the information is singular.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.nonlinearities import MonotonePieces
    >>> u = np.random.default_rng(0).standard_normal(200)
    >>> linear = MonotonePieces("identity", lambda y: y, [-np.inf, np.inf])
    >>> bound = information_bound(u, [-0.5, 0.0, 1.0], 0.1, linear, 1)
    >>> bool(0.05 < np.sqrt(bound[2, 2]) / (0.1 / np.sqrt(200)) < 2)
    True
    """
    if not noise > 0:
        raise UsageError(f"the noise is {noise:g}: give a standard deviation > 0")
    inputs = np.ascontiguousarray(u, dtype=np.float64)
    true = np.ascontiguousarray(theta, dtype=np.float64)
    begin = np.zeros(order) if state is None else np.array(state, dtype=np.float64)
    y, sensitivity = simulate(inputs, true, begin, order)
    width = 2 * _REACH / points
    t = -_REACH + width * (np.arange(points) + 0.5)
    probability = np.exp(-0.5 * t**2)
    probability /= probability.sum()
    preimage = nonlinearity.preimage(nonlinearity((y[:, np.newaxis] + noise * t).ravel()))
    per_sample = expected_information(
        preimage.first, preimage.lower, preimage.upper, preimage.weight, y, noise, probability
    )
    n = sensitivity.shape[0]
    information = np.zeros((n + 1, n + 1))
    information[:n, :n] = (sensitivity * per_sample[:, 0]) @ sensitivity.T
    information[:n, n] = information[n, :n] = sensitivity @ per_sample[:, 1]
    information[n, n] = np.sum(per_sample[:, 2])
    if preimage.has_no_scale:
        information = information[:n, :n]
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    if values[0] <= _SINGULAR * values[-1]:
        raise IdentifiabilityError(
            "the Fisher information is singular: the experiment does not determine every parameter; use "
            "more samples or an input that excites more"
        )
    covariance = (vectors / values) @ vectors.T / np.outer(size, size)
    return np.asarray(covariance[: 2 * order + 1, : 2 * order + 1])


@compiled
def expected_information(
    first: Indices, lower: Floats, upper: Floats, weight: Floats, y: Floats, noise: float, probability: Floats
) -> Floats:
    """Return E[score score^T] in (y, log sigma) of every sample as columns yy, ys, ss, shape (n_samples, 3).

    The preimages are those of all samples at all points of the quadrature, sample by sample.
    """
    found = np.zeros((y.shape[0], 3))
    moments, work = np.empty(4), np.empty(4)
    points = probability.shape[0]
    for k in range(y.shape[0]):
        for q in range(points):
            row = k * points + q
            part = slice(first[row], first[row + 1])
            union_moments(lower[part], upper[part], weight[part], y[k], noise, moments, work)
            score_y, score_s = moments[0] / noise, moments[1] - 1.0
            found[k, 0] += probability[q] * score_y * score_y
            found[k, 1] += probability[q] * score_y * score_s
            found[k, 2] += probability[q] * score_s * score_s
    return found
