"""Standard errors of a linear model when its residual is coloured."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.linear.forms import LARGEST_START, Floats, denominator
from sysid.linear.kernels import polynomial_filter
from sysid.linear.reduction import BLOCK_ROWS, Segment, Structure, solve
from sysid.linear.responses import fitted_output
from sysid.linear.search import Search
from sysid.separable.factor import fold

LARGEST_NOISE_ORDER = 20


@dataclass(frozen=True)
class Uncertainty:
    """Standard errors, and the autoregressive model of the residual they rest on.

    Attributes
    ----------
    standard_errors : ndarray, shape (n_parameters,)
        Of a1.., b.., constant; NaN when not asked for.
    noise : ndarray, shape (order + 1,)
        D(q), leading 1: the residual is white noise through 1/D.
    noise_std : float
        Standard deviation of that white noise.
    """

    standard_errors: Floats
    noise: Floats
    noise_std: float


def parameter_uncertainty(
    segments: tuple[Segment, ...],
    structure: Structure,
    search: Search,
    *,
    skip: bool = False,
    extra: Sequence[Floats] = (),
) -> Uncertainty:
    """Return standard errors of the coefficients, and of further parameters behind them.

    With Jacobian J and residual covariance V the estimate has the covariance
    (J'J)^-1 J'VJ (J'J)^-1; V is that of an autoregressive model of the residual, so that
    J'VJ = sigma^2 |F'J|^2, where F' runs 1/D backwards in time.  Initial states count as parameters.
    ``extra`` holds for each segment the derivatives of its output by the further ones, one a row.
    """
    n_parameters = structure.n_parameters(segments[0].u.shape[1])
    if skip:
        return Uncertainty(np.full(n_parameters, np.nan), np.ones(1), float("nan"))
    jacobians, residuals = zip(
        *(_jacobian(segment, structure, search, number) for number, segment in enumerate(segments)),
        strict=True,
    )
    if extra:
        jacobians = tuple(np.vstack([J, more]) for J, more in zip(jacobians, extra, strict=True))
        n_parameters += extra[0].shape[0]
    noise, noise_std = autoregression([r[s.used] for r, s in zip(residuals, segments, strict=True)])
    n_rows = sum(int(segment.used.sum()) for segment in segments)
    n_starts = structure.order * len(segments) if structure.free_start else 0
    bread, meat = None, None
    for segment, jacobian in zip(segments, jacobians, strict=True):
        jacobian[:, ~segment.used] = 0.0
        rows = jacobian[structure.order :] if structure.free_start else jacobian
        if structure.free_start:
            rows = _without(jacobian[: structure.order], rows)
        bread = fold(bread, rows.copy())
        meat = fold(meat, backwards(rows, noise))
    assert bread is not None
    assert meat is not None
    scale = np.linalg.norm(bread, axis=0)
    scale[scale == 0.0] = 1.0
    # The covariance is X'X with X = M (R'R)^-1 for J'J = R'R and J'VJ = M'M.
    inverse = np.linalg.pinv(bread / scale, rcond=1e-12)
    X = ((meat / scale) @ inverse @ inverse.T) / scale
    spread = noise_std * np.sqrt(n_rows / max(n_rows - n_parameters - n_starts, 1))
    return Uncertainty(np.asarray(spread * np.linalg.norm(X, axis=0)), noise, noise_std)


def autoregression(runs: list[Floats]) -> tuple[Floats, float]:
    """Return D(q) and the innovation's standard deviation, the order chosen by BIC.

    Parameters
    ----------
    runs : list of ndarray
        Stretches of a stationary signal.
    """
    total = sum(run.size for run in runs)
    largest = int(min(LARGEST_NOISE_ORDER, total // 20))
    triangle = None
    for run in runs:
        for first in range(largest, run.size, BLOCK_ROWS):
            k = np.arange(first, min(first + BLOCK_ROWS, run.size))
            triangle = fold(triangle, np.vstack([run[k - lag] for lag in range(1, largest + 1)] + [run[k]]))
    if triangle is None or not triangle[:, -1].any():
        return np.ones(1), float(np.sqrt(sum(run @ run for run in runs) / max(total, 1)))
    # The rows below the first n of the factor hold what an equation of order n leaves over.
    left_over = np.cumsum(triangle[::-1, -1] ** 2)[::-1]
    left_over = np.maximum(left_over, 1e-24 * left_over[0])
    order = int(np.argmin(total * np.log(left_over) + np.arange(largest + 1) * np.log(total)))
    d = np.concatenate([[1.0], -solve(triangle[:order, :order], triangle[:order, -1])])
    radius = float(np.abs(np.roots(d)).max(initial=0.0))
    if radius > LARGEST_START:  # least squares does not keep the model stationary
        d = d * (LARGEST_START / radius) ** np.arange(order + 1)
    return d, float(np.sqrt(left_over[order] / total))


def _jacobian(segment: Segment, structure: Structure, search: Search, number: int) -> tuple[Floats, Floats]:
    """Return the derivatives by initial state, a, b, constant, one a row, and the residual."""
    n_rows, n_inputs = segment.u.shape
    order, delay = structure.order, structure.delay
    a = denominator(search.reflections)
    output, start = fitted_output(segment, structure, search.reflections, search.projection, number)
    by_output = _all_pole(output, a)
    columns = [*start] if structure.free_start else []
    columns += [-_delayed(by_output, i, 0.0) for i in range(1, order + 1)]
    for channel in range(n_inputs):
        u = segment.u[:, channel]
        before = u[0] if structure.free_start else 0.0
        shift = max(delay, 1)
        base = _all_pole(_delayed(u, shift, before), a)
        if structure.direct:
            columns.append(_all_pole(u, a))
        columns += [_delayed(base, i, 0.0) for i in range(order)]
    if structure.constant:
        columns.append(_all_pole(np.ones(n_rows), a))
    return np.vstack(columns), segment.y - output


def _without(starts: Floats, rows: Floats) -> Floats:
    """Return the rows less their part in the span of the responses to the initial state."""
    scale = np.linalg.norm(starts, axis=1, keepdims=True)
    _, values, right = np.linalg.svd(starts / np.where(scale > 0.0, scale, 1.0), full_matrices=False)
    basis = right[values > 1e-10 * values.max(initial=1e-300)]
    return np.asarray(rows - (rows @ basis.T) @ basis)


def _delayed(signal: Floats, lag: int, before: float) -> Floats:
    if lag == 0:
        return signal
    return np.concatenate([np.full(min(lag, signal.size), before), signal[:-lag]])


def _all_pole(signal: Floats, a: Floats) -> Floats:
    b = np.zeros_like(a)
    b[0] = 1.0
    out = np.empty_like(signal)
    polynomial_filter(b, a, np.ascontiguousarray(signal), np.zeros(a.size - 1), out)
    return out


def backwards(rows: Floats, noise: Floats) -> Floats:
    """Filter each row by 1/D in reversed time."""
    filtered = np.empty(rows.shape)
    for place, row in enumerate(rows):
        filtered[place] = _all_pole(np.ascontiguousarray(row[::-1]), noise)[::-1]
    return filtered
