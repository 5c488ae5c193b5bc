"""Exact global search when the regressors are lags of a signal that is affine between knots."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import IdentifiabilityError, UsageError
from sysid.separable import cells
from sysid.separable.descent import Status
from sysid.separable.estimate import SeparableFit
from sysid.separable.factor import finite, project, triangle
from sysid.separable.pieces import AffinePieces
from sysid.separable.polish import polish

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

SMOOTH_PARTS = 48
"""A smooth cell is examined in steps of this share of the whole range."""

_CELLS_IN_FULL = 2000  # outer cells of a two-parameter search up to which each is examined
_OUTER_POINTS = 65  # outer values examined otherwise
_TIE = 1e-9  # minima whose screened costs differ by less, relative to |y|^2, are compared by QR


@dataclass(frozen=True)
class LaggedRegression:
    r"""Rows :math:`y_k = f_k^T\theta_f + \sum_j \theta_j\, x(k - l_j)`.

    Attributes
    ----------
    fixed : ndarray, shape (n_rows, n_fixed)
        Regressors without nonlinear parameters.
    y : ndarray, shape (n_rows,)
        Data.
    times : ndarray of int, shape (n_rows,)
        Sample index k of each row.
    lags : ndarray of int, shape (n_lags,)
        Lags of the signal; different from each other.
    n_samples : int
        Length of the signal.
    """

    fixed: Floats
    y: Floats
    times: Indices
    lags: Indices
    n_samples: int

    @classmethod
    def arx(cls, y: ArrayLike, order: int, *, starts: ArrayLike = (0,)) -> "LaggedRegression":
        r"""Rows of :math:`y_k = \sum_i \alpha_i y_{k-i} + \sum_i \beta_i x_{k-i}`, Bai's eq. (2.1).

        Parameters
        ----------
        y : array_like, shape (n_samples,)
            Output, experiments one after another.
        order : int
            Number of lags of output and signal.
        starts : array_like of int
            First sample of each experiment; no row reaches across a start.

        Examples
        --------
        >>> rows = LaggedRegression.arx([1.0, 2.0, 3.0, 4.0], 1)
        >>> rows.fixed.tolist(), rows.y.tolist()
        ([[1.0], [2.0], [3.0]], [2.0, 3.0, 4.0])
        """
        output = finite(y)
        if not isinstance(order, int | np.integer) or order < 1:
            raise UsageError(f"order is {order!r}: give a whole number of at least 1")
        first = experiment_starts(starts, output.size)
        edges = [*first, output.size]
        shortest = min(b - a for a, b in pairwise(edges))
        if shortest <= order:
            raise IdentifiabilityError(
                f"an experiment of {shortest} samples is too short for order {order}: "
                f"give more than {order} samples in each"
            )
        parts = [np.arange(a + order, b, dtype=np.int64) for a, b in pairwise(edges)]
        times = parts[0] if len(parts) == 1 else np.concatenate(parts)
        if times.size < 2 * order + 1:
            raise IdentifiabilityError(
                f"{times.size} rows cannot determine {2 * order + 1} parameters: give more samples"
            )
        lags = np.arange(1, order + 1, dtype=np.int64)
        fixed = output[times[:, None] - lags]
        return cls(fixed, output[times], times, lags, output.size)

    @property
    def row_of_time(self) -> Indices:
        """Row of each sample, -1 where there is none; shape (n_samples,)."""
        rows = np.full(self.n_samples, -1, dtype=np.int64)
        rows[self.times] = np.arange(self.times.size)
        return rows

    def regressors(self, signal: Floats) -> Floats:
        """Return the regressors for a given signal, shape (n_rows, n_fixed + n_lags)."""
        return np.column_stack([self.fixed, *(signal[self.times - lag] for lag in self.lags)])


def experiment_starts(starts: ArrayLike, n_samples: int) -> list[int]:
    """Return the first samples of the experiments as integers.

    Raises
    ------
    UsageError
        If they are not 0 and then ascending sample numbers.
    """
    first = [int(start) for start in np.atleast_1d(np.asarray(starts)).tolist()]
    if not first or first[0] != 0 or any(a >= b for a, b in pairwise([*first, n_samples])):
        raise UsageError(
            f"starts of experiments {first} do not begin with 0 and ascend below the {n_samples} samples: "
            "give the first sample of each experiment in order"
        )
    return first


def search_pieces(regression: LaggedRegression, pieces: AffinePieces) -> SeparableFit:
    r"""Find the global minimum over the parameter of a piecewise affine signal.

    Every cell between knots is examined, so the result does not depend on a grid: constant cells
    (relays) return the midpoint of the best cell and the cell; kinks and smooth minima are found to
    rounding.  Where the cost falls towards a knot at which a regressor vanishes, its infimum is not
    attained, and a point of that cell is returned.  Time and memory are linear in the number of samples.

    Parameters
    ----------
    regression : LaggedRegression
        Rows.
    pieces : AffinePieces
        Signal as a function of the parameter.

    Returns
    -------
    SeparableFit
        Estimate; ``minima`` holds the lowest local minima and ``n_minima`` counts all.

    Raises
    ------
    UsageError
        If the signal and the rows have different lengths.

    Examples
    --------
    >>> import numpy as np
    >>> u = np.random.default_rng(1).uniform(-4, 4, 60)
    >>> x = np.clip(u, -1, 1)
    >>> y = np.zeros(60)
    >>> for k in range(1, 60):
    ...     y[k] = 0.5 * y[k - 1] + 2 * x[k - 1]
    >>> order = np.argsort(abs(u))
    >>> above = np.zeros(60), np.sign(u)
    >>> saturation = AffinePieces(0.0, 4.0, *above, abs(u)[order], order, u[order], np.zeros(60))
    >>> search_pieces(LaggedRegression.arx(y, 1), saturation).theta.round(9).tolist()
    [0.5, 2.0]
    """
    _check(regression, pieces)
    minima, n_minima = _sweep(regression, pieces)
    return _best(regression, pieces, minima, n_minima)


def _check(regression: LaggedRegression, pieces: AffinePieces) -> None:
    if pieces.offset.size != regression.n_samples:
        raise UsageError(
            f"the signal has {pieces.offset.size} samples and the output {regression.n_samples}: "
            "give both of one length"
        )


def _sweep(regression: LaggedRegression, pieces: AffinePieces) -> tuple[Floats, int]:
    return cells.sweep(
        regression.fixed, regression.y, regression.times, regression.row_of_time, regression.lags,
        pieces.lower, pieces.upper, pieces.offset, pieces.slope,
        pieces.knot, pieces.sample, pieces.new_offset, pieces.new_slope,
        (pieces.upper - pieces.lower) / SMOOTH_PARTS,
    )  # fmt: skip


def _best(regression: LaggedRegression, pieces: AffinePieces, minima: Floats, n_minima: int) -> SeparableFit:
    """Polish the minima that screening cannot tell apart and return the lowest."""
    minima = minima[: min(n_minima, cells.MAX_MINIMA)]
    kept = np.empty((len(minima), 2))
    kept[:, 0] = 0.5 * (minima[:, 0] + minima[:, 1])
    kept[:, 1] = minima[:, 2]
    tie = kept[0, 1] + _TIE * float(regression.y @ regression.y)
    best = _polished(regression, pieces, minima[0], kept, n_minima)
    for row in minima[1:]:
        if row[2] > tie:
            break
        fitted = _polished(regression, pieces, row, kept, n_minima)
        if fitted.cost < best.cost:
            best = fitted
    return best


def _polished(
    regression: LaggedRegression, pieces: AffinePieces, minimum: Floats, kept: Floats, n_minima: int
) -> SeparableFit:
    regular, a, theta, residual, r, signal = polish(
        regression.fixed, regression.y, regression.times, regression.lags,
        pieces.offset, pieces.slope, pieces.sample, pieces.new_offset, pieces.new_slope, minimum,
    )  # fmt: skip
    flat = bool(minimum[6])
    if not regular:
        projection = project(regression.regressors(signal), regression.y)
        theta, residual = projection.theta, projection.residual
    return SeparableFit(
        eta=np.array([a]),
        theta=theta,
        residual=residual,
        jacobian_factor=_factor(r, theta, regression, flat),
        status=Status.GLOBAL,
        cells=((float(minimum[0]), float(minimum[1])) if flat else (a, a),),
        minima=kept,
        n_minima=n_minima,
    )


def _factor(r: Floats, theta: Floats, regression: LaggedRegression, flat: bool) -> Floats:
    """Factor of the Jacobian [dx/da beta, fixed, x] from R of [fixed, x, dx/da, y]."""
    n_lags = regression.lags.size
    n = theta.size
    factor = np.zeros((n + n_lags, n + 1))
    if not flat:
        factor[:, 0] = r[:-1, n:-1] @ theta[n - n_lags :]
    factor[:, 1:] = r[:-1, :n]
    return factor


def search_two_pieces(
    regression: LaggedRegression, first: AffinePieces, second: AffinePieces
) -> SeparableFit:
    """Find the minimum over the two parameters of a signal x = x1(a1) + x2(a2).

    For every cell of the first parameter the second is searched exactly; the lowest local minima of
    that profile are refined by exact searches in turn.  With constant cells this examines every
    rectangle, so the result is the global minimum; with affine cells, and beyond
    2000 cells, the outer grid decides whether a narrow minimum is seen.

    Parameters
    ----------
    regression : LaggedRegression
        Rows.
    first, second : AffinePieces
        The two parts of the signal.

    Returns
    -------
    SeparableFit
        Estimate of both parameters.
    """
    _check(regression, first)
    _check(regression, second)
    edges = np.unique(np.concatenate([[first.lower], first.knot, [first.upper]]))
    constant = not (np.any(first.slope) or np.any(first.new_slope))
    in_full = edges.size - 1 <= _CELLS_IN_FULL
    if in_full and constant:
        outer = (edges[1:] + edges[:-1]) / 2
    else:
        outer = np.linspace(first.lower, first.upper, _OUTER_POINTS)
    profile = np.array([_sweep(regression, _shifted(second, first.at(a)))[0][0, 2] for a in outer])
    padded = np.concatenate([[np.inf], profile, [np.inf]])
    starts = np.flatnonzero((profile < padded[:-2]) & (profile <= padded[2:]))
    starts = starts[np.argsort(profile[starts])][:4]
    refined = [_alternate(regression, first, second, float(outer[i])) for i in starts]
    a1, inner, outer_fit = min(refined, key=lambda item: item[1].cost)
    return _joined(regression, first, second, a1, inner, outer_fit, np.array([
        [a, fitted.eta[0], fitted.cost] for a, fitted, _ in refined]), in_full and constant)  # fmt: skip


def _shifted(pieces: AffinePieces, signal: Floats) -> AffinePieces:
    """Add a signal that does not depend on the parameter."""
    return replace(
        pieces, offset=pieces.offset + signal, new_offset=pieces.new_offset + signal[pieces.sample]
    )


def _alternate(
    regression: LaggedRegression, first: AffinePieces, second: AffinePieces, a1: float
) -> tuple[float, SeparableFit, SeparableFit]:
    """Search exactly in each parameter in turn; kinks lie along the axes, so this ends in a minimum."""
    inner = search_pieces(regression, _shifted(second, first.at(a1)))
    for _ in range(100):
        outer = search_pieces(regression, _shifted(first, second.at(float(inner.eta[0]))))
        improved = search_pieces(regression, _shifted(second, first.at(float(outer.eta[0]))))
        gained = inner.cost - improved.cost
        a1, inner = float(outer.eta[0]), improved
        if gained <= 1e-14 * regression.y.size * float(np.var(regression.y)):
            break
    return a1, inner, outer


def _joined(
    regression: LaggedRegression,
    first: AffinePieces,
    second: AffinePieces,
    a1: float,
    inner: SeparableFit,
    outer: SeparableFit,
    minima: Floats,
    exact: bool,
) -> SeparableFit:
    """Combine the two one-parameter results into one estimate of both parameters."""
    a2 = float(inner.eta[0])
    slopes = [_slope_at(first, a1), _slope_at(second, a2)]
    beta = inner.theta[-regression.lags.size :]
    moved = [regression.regressors(slope)[:, regression.fixed.shape[1] :] @ beta for slope in slopes]
    jacobian = np.column_stack([*moved, regression.regressors(first.at(a1) + second.at(a2))])
    return SeparableFit(
        eta=np.array([a1, a2]),
        theta=inner.theta,
        residual=inner.residual,
        jacobian_factor=triangle(jacobian),
        status=Status.GLOBAL if exact else Status.GRID,
        cells=(outer.cells[0], inner.cells[0]),
        minima=minima[np.argsort(minima[:, -1])],
        n_minima=len(minima),
    )


def _slope_at(pieces: AffinePieces, a: float) -> Floats:
    slope = pieces.slope.copy()
    applied = slice(0, int(np.searchsorted(pieces.knot, a, side="right")))
    for sample, value in zip(pieces.sample[applied], pieces.new_slope[applied], strict=True):
        slope[sample] = value
    return slope
