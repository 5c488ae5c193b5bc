"""Maximum likelihood for a Wiener system behind a known nonlinearity, started from the preimage estimate."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import DataError, IdentifiabilityError
from sysid.linear import simulate_polynomial
from sysid.nonlinearities.base import Floats
from sysid.nonlinearities.preimages import KnownMap, Preimage
from sysid.wiener.estimate import WienerFit
from sysid.wiener.identifiability import initial_state
from sysid.wiener.likelihood import log_likelihood, maximise, simulate

_REASONS = (
    "converged: the score vanishes",
    "the data are separated: the model explains every datum with probability one, the noise is not "
    "determined",
    "the noise went down to its floor: the model passes through the data",
    "stopped at the limit of iterations: raise max_iterations",
    "stopped: no damped step raises the likelihood",
    "the start diverges",
)
_FLOOR = 1e-6
"""Smallest noise relative to the size of y."""
_LARGEST_MODULUS = 0.999


@dataclass(frozen=True, eq=False)
class LikelihoodFit:
    """A Wiener system by maximum likelihood.

    Attributes
    ----------
    theta : ndarray, shape (2 order + 1,)
        [a1 ... an b0 ... bn]; where the gain is not identifiable, in units of the noise.
    order : int
    nonlinearity : KnownMap
    state : ndarray, shape (order,)
        Initial state of the transposed direct form.
    noise : float
        Standard deviation of w.
    log_likelihood : float
    covariance : ndarray or None, shape (2 order + 1, 2 order + 1)
        Of theta, from the inverse observed information; None where that is singular.
    y : ndarray, shape (n_samples,)
        Free run of the linear system.
    status : str
    converged : bool
    """

    theta: Floats
    order: int
    nonlinearity: KnownMap
    state: Floats
    noise: float
    log_likelihood: float
    covariance: Floats | None
    y: Floats
    status: str
    converged: bool

    @property
    def a(self) -> Floats:
        """Denominator [1, a1, ... an] by rising powers of q^-1."""
        return np.concatenate([[1.0], self.theta[: self.order]])

    @property
    def b(self) -> Floats:
        """Numerator [b0, ... bn] by rising powers of q^-1."""
        return self.theta[self.order :]

    def simulate(self, u: ArrayLike) -> Floats:
        """Return the output of the model for an input, from rest."""
        return self.nonlinearity(simulate_polynomial(self.b, self.a, u))


def maximum_likelihood(
    u: ArrayLike,
    z: ArrayLike,
    nonlinearity: KnownMap,
    start: WienerFit | Sequence[ArrayLike],
    *,
    order: int | None = None,
    max_iterations: int = 200,
    tolerance: float = 1e-9,
) -> LikelihoodFit:
    r"""Fit :math:`z = \mathcal N(y + w)`, :math:`y = G u`, with free initial state and noise level.

    A datum says that y + w lies in its preimage: a point contributes a density (several points their sum),
    an interval a probability. Where the preimage fixes no scale (sign) the noise has standard deviation one.

    Parameters
    ----------
    u, z : array_like, shape (n_samples,)
    nonlinearity : KnownMap
    start : WienerFit or sequence of array_like
        The preimage estimate, all candidates of which are tried, or values of theta.
    order : int, optional
        Needed when ``start`` is not a fit.
    max_iterations : int
        Of one start.
    tolerance : float
        Half the rise of the log-likelihood that a Newton step must promise.

    Returns
    -------
    LikelihoodFit

    Raises
    ------
    DataError
        If the data do not match.
    IdentifiabilityError
        If no start gives a finite likelihood.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.nonlinearities import Quantiser
    >>> from sysid.wiener import identify_wiener
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(500)
    >>> y = simulate_polynomial([0.0, 0.445, 0.4299], [1.0, -1.03, 0.9048], u)
    >>> z = Quantiser(1.0)(y + 0.2 * rng.standard_normal(500))
    >>> fit = maximum_likelihood(u, z, Quantiser(1.0), [[-0.9, 0.8, 0.0, 0.4, 0.4]], order=2)
    >>> (fit.theta[:2].round(2) + 0.0).tolist(), round(fit.noise, 1)
    ([-1.03, 0.91], 0.2)
    """
    inputs, outputs = np.array(u, dtype=np.float64), np.array(z, dtype=np.float64)
    if inputs.ndim != 1 or inputs.shape != outputs.shape or not np.all(np.isfinite(inputs)):
        raise DataError(
            f"input of shape {inputs.shape} and output of shape {outputs.shape} do not match or are not "
            "finite: give two finite sequences of one length"
        )
    preimage = nonlinearity.preimage(outputs)
    if isinstance(start, WienerFit):
        n = start.order
        starts: list[tuple[Floats, Floats | None]] = [(one.theta, one.y) for one in start.candidates]
    else:
        given = [np.asarray(one, dtype=np.float64) for one in start]
        n = order if order is not None else (given[0].size - 1) // 2
        starts = [(one, None) for one in given]
    if preimage.n_samples < 3 * n + 2:
        raise IdentifiabilityError(
            f"{preimage.n_samples} samples cannot determine {3 * n + 2} unknowns: give more samples"
        )
    scale_free = preimage.has_no_scale
    best: tuple[Floats, float, int] | None = None
    for theta, y in starts:
        first, floor = _start(inputs, theta, y, n, preimage, scale_free)
        point, value, _, reason = maximise(
            inputs, preimage.first, preimage.lower, preimage.upper, preimage.weight, first, n, scale_free,
            floor, max_iterations, tolerance,
        )  # fmt: skip
        if np.isfinite(value) and (best is None or value > best[1]):
            best = point, value, reason
    if best is None:
        raise IdentifiabilityError(
            "the likelihood is zero at every start: the data contradict the nonlinearity, or the starts "
            "diverge"
        )
    point, value, reason = best
    theta, state = point[: 2 * n + 1], point[2 * n + 1 : 3 * n + 1]
    return LikelihoodFit(
        theta=theta,
        order=n,
        nonlinearity=nonlinearity,
        state=state,
        noise=float(np.exp(point[-1])),
        log_likelihood=value,
        covariance=_covariance(inputs, preimage, point, n, scale_free),
        y=simulate(inputs, theta, state, n)[0],
        status=_REASONS[reason],
        converged=reason in (0, 1, 2),
    )


def _start(
    u: Floats, theta: Floats, y: Floats | None, order: int, preimage: Preimage, scale_free: bool
) -> tuple[Floats, float]:
    """Return a full start from a linear system, made stable, and the floor of log sigma."""
    stable = stabilised(theta, order)
    target = preimage.nearest(simulate(u, stable, np.zeros(order), order)[0]) if y is None else y
    state = initial_state(u, target, stable, order)
    free_run = simulate(u, stable, state, order)[0]
    size = max(float(np.sqrt(np.mean(target**2))), 1e-300)
    # Where the free run lies inside the preimage it needs no noise; a third of its distance or some
    # percent of its size is a start from which the Newton steps go either way.
    error = float(np.sqrt(np.mean((preimage.nearest(free_run) - free_run) ** 2)))
    sigma = max(error, 0.05 * size)
    if scale_free:
        stable[order:] /= sigma
        return np.concatenate([stable, state / sigma, [0.0]]), 0.0
    return np.concatenate([stable, state, [np.log(sigma)]]), float(np.log(_FLOOR * size))


def stabilised(theta: Floats, order: int) -> Floats:
    """Return theta with poles outside the unit circle mirrored into it, the gain on the circle kept.

    Examples
    --------
    >>> stabilised(np.array([-2.0, 0.0, 1.0]), 1) + 0.0
    array([-0.5,  0. , -0.5])
    """
    found = np.array(theta, dtype=np.float64)
    poles = np.roots(np.concatenate([[1.0], found[:order]]))
    modulus = np.abs(poles)
    if np.all(modulus < _LARGEST_MODULUS):
        return found
    outside = modulus > 1.0
    mirrored = np.where(outside, poles / np.where(outside, modulus**2, 1.0), poles)
    modulus = np.abs(mirrored)
    inner = np.where(
        modulus > _LARGEST_MODULUS, mirrored * _LARGEST_MODULUS / np.maximum(modulus, 1e-300), mirrored
    )
    found[:order] = np.real(np.poly(inner))[1:]
    # 1 / (1 - p/z) = -(1/p)/(...) on the circle up to an all-pass factor; the signs of real poles count.
    found[order:] /= np.real(np.prod(np.where(outside, -poles, 1.0)))
    return found


def _covariance(u: Floats, preimage: Preimage, point: Floats, order: int, scale_free: bool) -> Floats | None:
    _, _, information, scale = log_likelihood(
        u, preimage.first, preimage.lower, preimage.upper, preimage.weight, point, order
    )
    used = point.size - 1 if scale_free else point.size
    matrix, size = information[:used, :used], np.sqrt(np.maximum(scale[:used], 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    if values[0] <= 1e-12 * max(values[-1], 0.0):
        return None
    whole = (vectors / values) @ vectors.T / np.outer(size, size)
    return np.asarray(whole[: 2 * order + 1, : 2 * order + 1])
