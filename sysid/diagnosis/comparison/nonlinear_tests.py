"""Tests of a residual for nonlinear traces of input and output."""

from collections.abc import Callable

import numpy as np

from sysid.diagnosis.comparison.series import Series
from sysid.diagnosis.comparison.surrogates import normal_scores
from sysid.diagnosis.residuals import BAND, LARGEST_LAG, CorrelationTest, corrected
from sysid.linear.forms import Floats
from sysid.linear.uncertainty import autoregression

FEWEST_ROWS = 60


def nonlinear_tests(series: Series) -> dict[str, CorrelationTest]:
    """Test whether the residual follows squares or cubes of input and output, in mean or in size.

    The residual is whitened by its own autoregression first.  Then, if it is independent of a signal,
    its correlation with any function of that signal has the standard deviation 1/sqrt(N) at every
    lag, however coloured the signal is (Billings and Voon, 1986, Correlation based model validity
    tests for nonlinear models, International Journal of Control 44, use the same functions).  Squares
    and cubes are made orthogonal to the lower powers at the same lag, so that a linear misfit is not
    taken for a nonlinear one.

    Parameters
    ----------
    series : Series

    Returns
    -------
    dict of str to CorrelationTest
        ``squared_residual_squared_input``, ``residual_squared_input``, ``residual_cubed_input``,
        ``residual_squared_output``, ``residual_cubed_output``; with several inputs, their names follow.
    """
    if series.places.size < FEWEST_ROWS:
        return {}
    white = _Whitened(series)
    found: dict[str, CorrelationTest] = {}
    names = series.record.inputs
    for index, name in enumerate(names):
        suffix = "" if len(names) == 1 else f"_{name}"
        u = series.u[:, index]
        if np.unique(u[:: max(u.size // 1000, 1)]).size > 2:  # squares of a two-level signal are constant
            found[f"squared_residual_squared_input{suffix}"] = white.test(white.size, u, square)
            found[f"residual_squared_input{suffix}"] = white.test(white.residual, u, square)
            found[f"residual_cubed_input{suffix}"] = white.test(white.residual, u, cube)
    found["residual_squared_output"] = white.test(white.residual, series.output, square)
    found["residual_cubed_output"] = white.test(white.residual, series.output, cube)
    return found


def square(x: Floats) -> Floats:
    """Return the part of x^2 that is orthogonal to 1 and x."""
    return _without(x**2, [x])


def cube(x: Floats) -> Floats:
    """Return the part of x^3 that is orthogonal to 1, x and x^2."""
    return _without(x**3, [x, x**2])


def _without(target: Floats, lower: list[Floats]) -> Floats:
    basis, _ = np.linalg.qr(np.column_stack([np.ones(target.size), *lower]))
    return np.asarray(target - basis @ (basis.T @ target))


class _Whitened:
    """The whitened residual of all runs, its size, and the lags at which a signal can precede it."""

    def __init__(self, series: Series) -> None:
        residuals = [series.residual[run] for run in series.runs]
        noise, _ = autoregression(residuals)
        self.skipped = noise.size - 1
        self.runs = [run for run in series.runs if run.stop - run.start > self.skipped + 2 * LARGEST_LAG]
        if not self.runs:
            self.runs = [max(series.runs, key=lambda part: part.stop - part.start)]
        parts = [np.convolve(series.residual[run], noise, mode="valid") for run in self.runs]
        white = np.concatenate(parts)
        self.residual = white - white.mean()
        self.size = normal_scores(np.abs(self.residual))

    def test(self, target: Floats, signal: Floats, shape: Callable[[Floats], Floats]) -> CorrelationTest:
        """Correlate with a function of a signal so many samples before."""
        centred = signal - signal.mean()
        spread = float(centred.std())
        shaped = shape(centred / spread) if spread > 0.0 else np.zeros_like(centred)
        lags = np.arange(min(LARGEST_LAG, target.size // 4) + 1)
        correlation = np.array([self._correlation(target, shaped, int(lag)) for lag in lags])
        count = max(target.size, 1)
        return corrected(lags, correlation, np.full(lags.size, BAND / np.sqrt(count)))

    def _correlation(self, target: Floats, shaped: Floats, lag: int) -> float:
        """Correlate over all rows whose signal so many rows before belongs to the same run."""
        place, products, left, right = 0, 0.0, 0.0, 0.0
        for run in self.runs:
            n = run.stop - run.start - self.skipped
            part = target[place : place + n]
            place += n
            first = max(lag - self.skipped, 0)
            x = shaped[run.start + self.skipped + first - lag : run.stop - lag]
            t = part[first:]
            products += float(t @ x)
            left += float(t @ t)
            right += float(x @ x)
        return products / float(np.sqrt(left * right)) if left * right > 0.0 else 0.0
