"""Example 1: six hard nonlinearities, 100 samples, separable least squares."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from replications.bai import setting
from sysid.bounds import least_squares_bound
from sysid.hammerstein import equation_error_response, search_method
from sysid.nonlinearities import NONLINEARITIES, OneParameterMap
from sysid.separable import LaggedRegression, SeparableFit

_LONG_RECORD = 20_000
_LONG_RECORDS = 10


def one_parameter_map(name: str) -> OneParameterMap:
    """Return a map of the table."""
    found = NONLINEARITIES[name]
    assert isinstance(found, OneParameterMap)
    return found


@dataclass(frozen=True)
class Example1:
    """One run of Example 1: draw an experiment, identify it.

    Attributes
    ----------
    case : str
        The nonlinearity.
    n_samples : int
        Rows of the regression, N of the paper; the experiment starts at rest two samples earlier, so that
        every row of (2.5) is measured.
    """

    case: str
    n_samples: int = setting.EXAMPLE_1_SAMPLES

    def experiment(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return input and output."""
        total = self.n_samples + setting.ORDER
        u = rng.uniform(-setting.EXAMPLE_1_INPUT, setting.EXAMPLE_1_INPUT, total)
        noise = rng.uniform(-setting.EXAMPLE_1_NOISE, setting.EXAMPLE_1_NOISE, total)
        x = one_parameter_map(self.case)(u, setting.THRESHOLD)
        return u, equation_error_response(x, setting.ALPHA, setting.BETA, noise)

    def identify(self, u: np.ndarray, y: np.ndarray) -> SeparableFit:
        """Identify by (2.9)."""
        return search_method(u, y, one_parameter_map(self.case), setting.ORDER, upper=setting.SEARCH_UPPER)

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return the estimates, J, and what the search saw."""
        fitted = self.identify(*self.experiment(rng))
        low, high = fitted.cells[0]
        return {
            **dict(zip(setting.PARAMETERS, [*fitted.eta, *fitted.theta], strict=True)),
            "j": fitted.mean_square,
            "n_minima": float(fitted.n_minima),
            "cell_width": high - low,
        }


def cost_curve(task: Example1, rng: np.random.Generator, points: int = 701) -> dict[str, object]:
    """Return J(a) of one experiment over the range searched, its minimum and its local minima (figure 3)."""
    u, y = task.experiment(rng)
    fitted = task.identify(u, y)
    regression = LaggedRegression.arx(y, setting.ORDER)
    nonlinearity = one_parameter_map(task.case)
    grid = np.linspace(0.0, setting.SEARCH_UPPER, points)
    n = regression.y.size
    costs = [_cost(regression, nonlinearity(u, float(a))) / n for a in grid]
    return {
        "a": grid,
        "j": np.array(costs),
        "found": float(fitted.eta[0]),
        "found_j": fitted.mean_square,
        "cell": fitted.cells[0],
        "minima": fitted.minima[:, 0],
        "minima_j": fitted.minima[:, 1] / n,
        "n_minima": fitted.n_minima,
    }


def _cost(regression: LaggedRegression, x: np.ndarray) -> float:
    """Sum of squares with x given, from an independent least-squares routine."""
    regressors = regression.regressors(x)
    theta = np.linalg.lstsq(regressors, regression.y, rcond=None)[0]
    return float(np.sum((regression.y - regressors @ theta) ** 2))


def asymptotic_std(case: str, n_samples: int) -> dict[str, float]:
    """Return the standard deviations at the asymptotic least-squares bound.

    For the relays a has no bound (the estimate converges faster than 1/sqrt(N)) and theta is bounded
    as if a were known.
    """
    rng = np.random.default_rng(20020721)
    nonlinearity = one_parameter_map(case)
    task = Example1(case, _LONG_RECORD)

    def blocks() -> list[np.ndarray]:
        found = []
        for _ in range(_LONG_RECORDS):
            u, y = task.experiment(rng)
            regression = LaggedRegression.arx(y, setting.ORDER)
            rows = regression.regressors(nonlinearity(u, setting.THRESHOLD))
            if case not in setting.RELAYS:
                slope = nonlinearity.slope(u, setting.THRESHOLD)
                moved = sum(
                    b * slope[regression.times - lag]
                    for b, lag in zip(setting.BETA, regression.lags, strict=True)
                )
                rows = np.column_stack([moved, rows])
            found.append(rows)
        return found

    variance = setting.EXAMPLE_1_NOISE**2 / 3
    std = np.sqrt(np.diag(least_squares_bound(blocks(), variance, n_samples)))
    names = setting.PARAMETERS if case not in setting.RELAYS else setting.PARAMETERS[1:]
    return dict(zip(names, std.tolist(), strict=True))
