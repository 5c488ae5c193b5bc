"""Least-squares bounds against closed forms and against the spread of simulated estimates."""

import numpy as np
import pytest

from sysid.bounds import least_squares_bound
from sysid.errors import IdentifiabilityError
from sysid.hammerstein import equation_error_response, search_method
from sysid.nonlinearities import NONLINEARITIES


def test_a_static_regression():
    rows = np.random.default_rng(0).standard_normal((500, 4))
    expected = 0.3 * np.linalg.inv(rows.T @ rows)
    # Condition number of a Gaussian matrix of this shape: below 2.
    np.testing.assert_allclose(least_squares_bound([rows], 0.3, 500), expected, rtol=1e-12)
    np.testing.assert_allclose(least_squares_bound([rows], 0.3, 50), 10 * expected, rtol=1e-12)
    blocks = np.array_split(rows, 7)
    np.testing.assert_allclose(least_squares_bound(iter(blocks), 0.3, 500), expected, rtol=1e-12)


@pytest.mark.parametrize("pole", [-0.9, 0.0, 0.5, 0.95])
def test_an_autoregression_of_first_order(pole):
    # var(a) = (1 - a^2)/N, whatever the noise variance (Box and Jenkins).
    rng = np.random.default_rng(7)
    n = 200_000
    y = equation_error_response(np.zeros(n), [pole], [0.0], 0.4 * rng.standard_normal(n))
    bound = least_squares_bound([y[100:-1, None]], 0.16, 250)
    # The variance of y is known to sqrt(2 (1 + a^2)/(1 - a^2)/N): 1.4 % at a = 0.95; four of those.
    assert bound[0, 0] == pytest.approx((1 - pole**2) / 250, rel=0.06)


def test_the_units_of_the_parameters_do_not_matter():
    rows = np.random.default_rng(1).standard_normal((300, 3))
    scale = np.array([1e-9, 1.0, 1e9])
    scaled = least_squares_bound([rows * scale], 1.0, 300)
    np.testing.assert_allclose(
        scaled * np.outer(scale, scale), least_squares_bound([rows], 1.0, 300), rtol=1e-11
    )


def test_the_spread_of_estimates_attains_the_bound():
    saturation = NONLINEARITIES["saturation"]
    alpha, beta = [-0.8333, -0.1667], [1.0, 1.0]
    rng = np.random.default_rng(20)

    def record(n):
        u = rng.uniform(-4, 4, n)
        return u, equation_error_response(saturation(u, 1.0), alpha, beta, rng.uniform(-0.2, 0.2, n))

    u, y = record(100_000)
    x, moved = saturation(u, 1.0), saturation.slope(u, 1.0)
    rows = np.column_stack([moved[1:-1] + moved[:-2], y[1:-1], y[:-2], x[1:-1], x[:-2]])
    n, runs = 800, 500
    std = np.sqrt(np.diag(least_squares_bound([rows], 0.2**2 / 3, n)))
    fits = [search_method(*record(n), saturation, 2, upper=3.5) for _ in range(runs)]
    estimates = np.array([[*fitted.eta, *fitted.theta] for fitted in fits])
    # 500 runs: a standard deviation is known to 1/sqrt(1000) = 3.2 %; four of those, and O(1/N) above.
    np.testing.assert_allclose(estimates.std(axis=0, ddof=1), std, rtol=0.13)
    # The covariance each fit claims is the same bound, seen from one experiment.
    claimed = np.sqrt(np.mean([fitted.std_error**2 for fitted in fits], axis=0))
    np.testing.assert_allclose(claimed, std, rtol=0.05)


@pytest.mark.parametrize(
    "rows",
    [[], [np.ones((5, 2))], [np.eye(3)[:2]], [np.zeros((4, 1))], [np.array([[1.0], [np.nan], [1.0]])]],
    ids=["none", "dependent", "too few", "zero", "not finite"],
)
def test_rows_without_information_are_refused(rows):
    with pytest.raises(IdentifiabilityError, match="do not determine every parameter: use an input"):
        least_squares_bound(rows, 1.0, 10)
