"""What share of an output no linear model explains: the size of a hidden effect."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import lfilter

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_EXTRA_ORDER = 3
_TAPS = 6
_ITERATIONS = 6


def nonlinear_share(u: Floats, y: Floats, poles: Complexes) -> float:
    """Return the mean square that linear models of ample order leave, over the variance of y.

    Two sets of poles are tried, twice those of the plant and those that Steiglitz-McBride iterations
    find for four more than the plant has; direct terms and a constant are always among the regressors.

    Parameters
    ----------
    u, y : ndarray, shape (n_samples,)
        Input and noise-free output.
    poles : ndarray of complex, shape (order,)
        Poles of the plant without the effect.

    Returns
    -------
    float
        Infinite if y is, or stands still behind an effect that hides all.
    """
    if _shows_nothing(y):
        return float("inf")
    repeated = np.real(np.poly(np.r_[poles, poles]))
    found = steiglitz_mcbride(u, y, poles.size + _EXTRA_ORDER)
    return min(_left(u, y, repeated), _left(u, y, found))


def baseline_share(u: Floats, y: Floats, poles: Complexes) -> float:
    """Return the mean square that the best strictly proper model of the plant's order leaves.

    As `nonlinear_share`, for effects that are linear themselves: B/A u, without direct term, delay or
    constant, fitted to the free run.
    """
    if _shows_nothing(y):
        return float("inf")
    order = poles.size
    starts = (np.real(np.poly(poles)), steiglitz_mcbride(u, y, order))
    return min(_output_error(u, y, start) for start in starts)


def added_share(y: Floats, before: Floats, u: Floats, *, constant: bool) -> float:
    """Return the share of y that a few taps of an output without the effect, and of the input, leave.

    For the second of two effects: how much is missing without it, whatever the first one does.
    """
    if _shows_nothing(y):
        return float("inf")
    columns = [_shifted(signal, i) for signal in (before, u) for i in range(1, _TAPS)] + [before]
    columns += [np.ones_like(y)] if constant else []
    matrix = np.column_stack(columns)
    return float(np.mean((y - matrix @ _solve(matrix, y)) ** 2) / np.var(y))


def _shows_nothing(y: Floats) -> bool:
    return not np.all(np.isfinite(y)) or np.abs(y).max() > 1e9 or np.ptp(y) == 0.0


def steiglitz_mcbride(u: Floats, y: Floats, order: int) -> Floats:
    """Return a stable denominator [1, a1, ...] by Steiglitz-McBride iterations."""
    a = np.r_[1.0, np.zeros(order)]
    for _ in range(_ITERATIONS):
        filtered_y, filtered_u = lfilter([1.0], a, y), lfilter([1.0], a, u)
        columns = [-_shifted(filtered_y, i) for i in range(1, order + 1)]
        columns += [_shifted(filtered_u, i) for i in range(order + 1)]
        a = np.r_[1.0, _solve(np.column_stack(columns), filtered_y)[:order]]
        a = _stabilised(a)
    return np.asarray(a)


def _stabilised(a: Floats) -> Floats:
    roots = np.roots(a)
    outside = np.abs(roots) > 1.0
    roots[outside] = 1.0 / np.conj(roots[outside])
    return np.asarray(np.real(np.poly(roots)))


def _shifted(signal: Floats, samples: int) -> Floats:
    return np.asarray(np.concatenate([np.zeros(samples), signal[: signal.size - samples]]))


def _solve(columns: Floats, target: Floats) -> Floats:
    """Return a least-squares solution; directions below a millionth of the largest are left out.

    The share is wanted to three digits and a hundred times a record, so the small Gram matrix will do.
    """
    sizes = np.linalg.norm(columns, axis=0)
    sizes[sizes == 0.0] = 1.0
    scaled = columns / sizes
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    kept = values > 1e-12 * values[-1]
    basis = vectors[:, kept]
    solution = basis @ ((basis.T @ (scaled.T @ target)) / values[kept])
    return np.asarray(solution / sizes)


def _left(u: Floats, y: Floats, a: Floats) -> float:
    filtered = lfilter([1.0], a, u)
    columns = [_shifted(filtered, i) for i in range(a.size)]
    columns += [_shifted(u, i) for i in range(_TAPS)] + [np.ones_like(u)]
    matrix = np.column_stack(columns)
    if not np.all(np.isfinite(matrix)):
        return float("inf")
    error = y - matrix @ _solve(matrix, y)
    return float(np.mean(error**2) / np.var(y))


def _output_error(u: Floats, y: Floats, a: Floats) -> float:
    order = a.size - 1
    delayed = _shifted(u, 1)
    filtered = lfilter([1.0], a, delayed)
    b = _solve(np.column_stack([_shifted(filtered, i) for i in range(order)]), y)
    scale = float(np.sqrt(y.size * np.var(y)))

    def residual(theta: Floats) -> Floats:
        model = lfilter(theta[order:], np.r_[1.0, theta[:order]], delayed)
        return np.clip(np.nan_to_num((model - y) / scale, nan=1e3, posinf=1e3, neginf=-1e3), -1e3, 1e3)

    def jacobian(theta: Floats) -> Floats:
        denominator = np.r_[1.0, theta[:order]]
        model = lfilter(theta[order:], denominator, delayed)
        by_y, by_u = lfilter([1.0], denominator, -model), lfilter([1.0], denominator, delayed)
        columns = [_shifted(by_y, i) for i in range(1, order + 1)]
        columns += [_shifted(by_u, i) for i in range(order)]
        return np.clip(np.nan_to_num(np.column_stack(columns) / scale), -1e6, 1e6)

    with np.errstate(over="ignore", invalid="ignore"):
        fit = least_squares(residual, np.r_[a[1:], b], jacobian, method="lm", max_nfev=25)
    return float(2.0 * fit.cost)
