"""Hammerstein systems with a hard input nonlinearity of known structure: Bai's search method."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid._compile import compiled
from sysid.errors import DataError, UsageError
from sysid.nonlinearities import AffinePieces, OneParameterMap, TwoSidedMap
from sysid.separable import (
    LaggedRegression,
    SeparableFit,
    experiment_starts,
    project,
    search_pieces,
    search_two_pieces,
)

Floats = NDArray[np.float64]


@compiled
def _autoregression(alpha: Floats, forced: Floats) -> Floats:
    y = np.empty(forced.size)
    for k in range(forced.size):
        value = forced[k]
        for i in range(min(alpha.size, k)):
            value += alpha[i] * y[k - 1 - i]
        y[k] = value
    return y


def equation_error_response(x: ArrayLike, alpha: ArrayLike, beta: ArrayLike, noise: ArrayLike) -> Floats:
    r"""Response of :math:`y_k = \sum_i \alpha_i y_{k-i} + \sum_i \beta_i x_{k-i} + v_k` from rest.

    Bai (2002), eq. (2.1).  Note the sign of alpha: it is minus the coefficient of
    :math:`A(q) = 1 + a_1 q^{-1} + \dots`.

    Parameters
    ----------
    x : array_like, shape (n_samples,)
        Output of the nonlinearity; zero before the first sample.
    alpha, beta : array_like, shape (order,)
        Coefficients.
    noise : array_like, shape (n_samples,)
        Equation error v.

    Returns
    -------
    ndarray, shape (n_samples,)

    Raises
    ------
    DataError
        If signal and noise differ in length.

    Examples
    --------
    >>> equation_error_response([1.0, 0.0, 0.0, 0.0], [0.5], [2.0], [0.0] * 4).tolist()
    [0.0, 2.0, 1.0, 0.5]
    """
    signal = np.asarray(x, dtype=float)
    forced = np.array(noise, dtype=float)
    if signal.shape != forced.shape or signal.ndim != 1:
        raise DataError(
            f"signal of shape {signal.shape} and noise of shape {forced.shape} differ: "
            "give one channel each, of equal length"
        )
    for i, coefficient in enumerate(np.asarray(beta, dtype=float), start=1):
        forced[i:] += coefficient * signal[:-i]
    return _autoregression(np.asarray(alpha, dtype=float), forced)


def search_method(
    u: ArrayLike,
    y: ArrayLike,
    nonlinearity: OneParameterMap,
    order: int,
    *,
    upper: float,
    lower: float = 0.0,
    starts: ArrayLike = (0,),
) -> SeparableFit:
    r"""Identify a Hammerstein system by Bai's deterministic approach.

    Minimises :math:`J(a) = \frac1N \|(I - A(A^TA)^{-1}A^T)Y\|^2`, eq. (2.9) of Bai (2002), exactly:
    the cells between the knots of the map are enumerated, so the minimum is global over
    ``[lower, upper]`` without a plot to be looked at.

    Parameters
    ----------
    u, y : array_like, shape (n_samples,)
        Input and output, experiments one after another.
    nonlinearity : OneParameterMap
        The map, such as ``NONLINEARITIES["saturation"]``.
    order : int
        Order of the linear system.
    upper, lower : float
        Range of the parameter, in the unit of ``u``.
    starts : array_like of int
        First sample of each experiment; a map with memory starts anew there.

    Returns
    -------
    SeparableFit
        ``eta`` is the parameter of the map and ``theta`` holds alpha then beta.

    Raises
    ------
    DataError
        If a value is not finite or the lengths differ.
    IdentifiabilityError
        If there are too few samples.
    UsageError
        If the range or the starts are not in order.

    Examples
    --------
    >>> from sysid.nonlinearities import NONLINEARITIES
    >>> saturation = NONLINEARITIES["saturation"]
    >>> u = np.random.default_rng(0).uniform(-4, 4, 100)
    >>> y = equation_error_response(saturation(u, 1.0), [-0.8333, -0.1667], [1, 1], np.zeros(100))
    >>> search_method(u, y, saturation, 2, upper=3.5).eta.round(9).tolist()
    [1.0]
    """
    if not isinstance(nonlinearity, OneParameterMap):
        raise UsageError(
            f"the search method takes a map with one parameter, not {nonlinearity!r}: "
            "for different sides use two_sided_search_method"
        )
    signal, output = _pair(u, y)
    regression = LaggedRegression.arx(output, order, starts=starts)
    # Each experiment has its own pieces: a map with memory starts anew.
    first = experiment_starts(starts, signal.size)
    edges = [*first[1:], signal.size]
    parts = [nonlinearity.pieces(signal[a:b], lower, upper) for a, b in zip(first, edges, strict=True)]
    return search_pieces(regression, AffinePieces.joined(parts))


def two_sided_search_method(
    u: ArrayLike,
    y: ArrayLike,
    nonlinearity: TwoSidedMap,
    order: int,
    *,
    upper: float,
    lower: float = 0.0,
    starts: ArrayLike = (0,),
) -> SeparableFit:
    """Identify a Hammerstein system whose map has different parameters on its two sides.

    Parameters and errors are those of `search_method`; ``eta`` holds the parameter of the negative
    side, then that of the positive side.
    """
    signal, output = _pair(u, y)
    regression = LaggedRegression.arx(output, order, starts=starts)
    return search_two_pieces(regression, *nonlinearity.sided_pieces(signal, lower, upper))


def _pair(u: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    try:
        signal, output = np.asarray(u, dtype=float), np.asarray(y, dtype=float)
    except (TypeError, ValueError) as problem:
        raise DataError(f"input and output must be sequences of numbers ({problem})") from None
    if signal.shape != output.shape or signal.ndim != 1:
        raise DataError(
            f"input of shape {signal.shape} and output of shape {output.shape} differ: "
            "give one channel each, of equal length"
        )
    if not np.all(np.isfinite(signal)):
        row = int(np.flatnonzero(~np.isfinite(signal))[0])
        raise DataError(f"input value {row} is {signal[row]}: remove the row or fill it before the fit")
    return signal, output


@dataclass(frozen=True)
class CorrelationEstimate:
    r"""Linear part seen through one input distribution.

    Attributes
    ----------
    alpha : ndarray, shape (order,)
        Autoregressive coefficients.
    scaled_beta : ndarray, shape (order,)
        :math:`q(f, a)\,\beta_j`.
    """

    alpha: Floats
    scaled_beta: Floats


def cross_correlation(u: ArrayLike, y: ArrayLike, n_lags: int) -> Floats:
    r"""Return :math:`w(i) = \frac1N\sum_k y(k)u(k-i)`, i = 1 .. n_lags; Bai (2002), eq. (3.17).

    Only the N samples k whose every lag was recorded enter the sum.

    Examples
    --------
    >>> cross_correlation([1.0, 2.0, 0.0, 1.0], [0.0, 1.0, 2.0, 0.0], 2).tolist()
    [2.0, 1.0]
    """
    signal, output = _pair(u, y)
    n = output.size - n_lags
    if n_lags < 1 or n < 1:
        raise DataError(
            f"{output.size} samples are too few for {n_lags} lags: give more samples or fewer lags"
        )
    return np.array(
        [output[n_lags:] @ signal[n_lags - i : output.size - i] / n for i in range(1, n_lags + 1)]
    )


def correlation_equations(w: ArrayLike, order: int) -> Floats:
    r"""Return the matrix :math:`\Sigma` of Bai's eq. (3.3), shape (n_lags, 2 order).

    Examples
    --------
    >>> correlation_equations([1.0, 2.0, 3.0, 4.0], 2).tolist()
    [[0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 1.0], [2.0, 1.0, 0.0, 0.0], [3.0, 2.0, 0.0, 0.0]]
    """
    correlation = np.asarray(w, dtype=float)
    if correlation.size < 2 * order:
        raise DataError(f"{correlation.size} lags cannot determine order {order}: use at least {2 * order}")
    sigma = np.zeros((correlation.size, 2 * order))
    for i in range(1, order + 1):
        sigma[i:, i - 1] = correlation[: correlation.size - i]
        sigma[i - 1, order + i - 1] = 1.0
    return sigma


def correlation_method(
    u: ArrayLike, y: ArrayLike, order: int, n_lags: int, *, centred: bool = False
) -> CorrelationEstimate:
    r"""Solve (3.3) for the linear part from one experiment with an i.i.d. input (Bai 2002, section 3).

    Parameters
    ----------
    u, y : array_like, shape (n_samples,)
        Input and output.
    order : int
        Order n of the linear system.
    n_lags : int
        Number m >= 2n of correlations used.
    centred : bool
        Subtract the means first.  Needed for an input of nonzero mean, for which the printed (3.2)
        does not hold; ``scaled_beta`` then is the covariance of x and u times beta.

    Returns
    -------
    CorrelationEstimate
    """
    signal, output = _pair(u, y)
    if centred:
        signal, output = signal - signal.mean(), output - output.mean()
    w = cross_correlation(signal, output, n_lags)
    solution = project(correlation_equations(w, order), w).theta
    return CorrelationEstimate(solution[:order], solution[order:])


def moment_ratio(first: CorrelationEstimate, second: CorrelationEstimate, column: int | None = None) -> float:
    """Return c = q(f1, a) / q(f2, a), eq. (3.18): from one beta, or averaged over all (``None``).

    Examples
    --------
    >>> one = CorrelationEstimate(np.array([0.5]), np.array([2.0]))
    >>> moment_ratio(one, CorrelationEstimate(np.array([0.5]), np.array([4.0])))
    0.5
    """
    ratios = first.scaled_beta / second.scaled_beta
    return float(ratios.mean() if column is None else ratios[column])
