"""Bai's two methods against SciPy, brute force, enumeration and exact correlations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.signal import lfilter

from sysid.errors import DataError, IdentifiabilityError, UsageError
from sysid.hammerstein import (
    CorrelationEstimate,
    correlation_equations,
    correlation_method,
    cross_correlation,
    equation_error_response,
    moment_ratio,
    search_method,
    two_sided_search_method,
)
from sysid.nonlinearities import NONLINEARITIES, AffinePieces, OneParameterMap, TwoSidedMap
from sysid.separable import LaggedRegression, project

ALPHA, BETA = [-0.8333, -0.1667], [1.0, 1.0]
ONE_PARAMETER = [name for name, entry in NONLINEARITIES.items() if isinstance(entry, OneParameterMap)]
TWO_SIDED = [name for name, entry in NONLINEARITIES.items() if isinstance(entry, TwoSidedMap)]
FLAT = ["relay", "hysteresis-relay", "hysteresis-relay-schmitt"]
SLOPING = [name for name in ONE_PARAMETER if name not in FLAT]


def experiment(name, seed, n=100, noise=0.2, parameters=(1.0,)):
    rng = np.random.default_rng(seed)
    u = rng.uniform(-4, 4, n)
    v = rng.uniform(-noise, noise, n)
    return u, equation_error_response(NONLINEARITIES[name](u, *parameters), ALPHA, BETA, v)


def dense_cost(name, u, y, *parameters):
    """Cost with the parameters given, by LAPACK's SVD on rows built here."""
    x = NONLINEARITIES[name](u, *parameters)
    rows = np.column_stack([y[1:-1], y[:-2], x[1:-1], x[:-2]])
    theta = np.linalg.lstsq(rows, y[2:])[0]
    return float(np.sum((y[2:] - rows @ theta) ** 2))


# Simulation ------------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 300), order=st.integers(1, 5))
def test_response_agrees_with_a_filter(seed, n, order):
    rng = np.random.default_rng(seed)
    x, v = rng.standard_normal((2, n))
    alpha, beta = rng.uniform(-0.9, 0.9, order) / order, rng.standard_normal(order)
    denominator = np.concatenate([[1.0], -alpha])
    expected = lfilter(np.concatenate([[0.0], beta]), denominator, x) + lfilter([1.0], denominator, v)
    # The poles lie inside 0.9, so rounding of either recursion is amplified by less than 10.
    np.testing.assert_allclose(equation_error_response(x, alpha, beta, v), expected, atol=1e-12, rtol=1e-12)


def test_response_leaves_its_arguments_alone():
    x, v = np.ones(5), np.ones(5)
    equation_error_response(x, [0.5], [1.0], v)
    assert x.tolist() == v.tolist() == [1.0] * 5


def test_response_refuses_different_lengths():
    with pytest.raises(DataError, match=r"signal of shape \(3,\) and noise of shape \(4,\) differ"):
        equation_error_response([1, 2, 3], [0.5], [1.0], [0, 0, 0, 0])


# Search method: recovery -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ONE_PARAMETER)
@pytest.mark.parametrize("seed", range(3))
def test_noise_free_data_give_the_truth_back(name, seed):
    u, y = experiment(name, seed, noise=0.0)
    fitted = search_method(u, y, NONLINEARITIES[name], 2, upper=3.5)
    low, high = fitted.cells[0]
    if name in FLAT:
        assert low <= 1.0 <= high
        assert fitted.eta[0] == (low + high) / 2
    else:
        # Conditioned like the regressors (condition number below 100): rounding is 1e-14.
        np.testing.assert_allclose(fitted.eta, 1.0, rtol=1e-10)
    np.testing.assert_allclose(fitted.theta, [*ALPHA, *BETA], rtol=1e-10)
    assert fitted.cost < 1e-20


@pytest.mark.parametrize("name", TWO_SIDED)
def test_noise_free_data_give_both_sides_back(name):
    u, y = experiment(name, 5, noise=0.0, parameters=(0.7, 1.6))
    fitted = two_sided_search_method(u, y, NONLINEARITIES[name], 2, upper=3.5)
    for found, true, (low, high) in zip(fitted.eta, (0.7, 1.6), fitted.cells, strict=True):
        # Alternation between the two sides ends when the cost no longer falls: half the digits.
        assert low <= true <= high or found == pytest.approx(true, abs=1e-6)
    np.testing.assert_allclose(fitted.theta, [*ALPHA, *BETA], rtol=1e-6)


@pytest.mark.parametrize("name", ONE_PARAMETER)
def test_experiments_start_anew(name):
    parts = [experiment(name, seed, n, noise=0.0) for seed, n in ((1, 40), (2, 70), (3, 55))]
    u, y = (np.concatenate(signals) for signals in zip(*parts, strict=True))
    fitted = search_method(u, y, NONLINEARITIES[name], 2, upper=3.5, starts=[0, 40, 110])
    assert fitted.residual.size == 165 - 3 * 2
    # A row across a start, or a memory carried over it, would leave a cost of order one.
    assert fitted.cost < 1e-20
    np.testing.assert_allclose(fitted.theta, [*ALPHA, *BETA], rtol=1e-9)


@pytest.mark.parametrize("name", ONE_PARAMETER)
def test_joined_pieces_are_the_signals_one_after_another(name):
    entry = NONLINEARITIES[name]
    signals = [np.random.default_rng(seed).integers(-4, 5, 30).astype(float) for seed in range(3)]
    joined = AffinePieces.joined([entry.pieces(u, 0.1, 3.5) for u in signals])
    assert np.all(np.diff(joined.knot) >= 0)
    for a in (0.2, 1.5, 2.7):
        expected = np.concatenate([entry(u, a) for u in signals])
        np.testing.assert_allclose(joined.at(a), expected, atol=1e-14)


# Search method: the minimum is global ---------------------------------------------------------------


@pytest.mark.parametrize("name", FLAT)
@pytest.mark.parametrize("seed", range(4))
def test_relays_agree_with_enumeration(name, seed):
    u, y = experiment(name, seed, n=40, noise=1.0)
    fitted = search_method(u, y, NONLINEARITIES[name], 2, upper=3.5)
    knots = np.unique(np.abs(u))
    edges = np.concatenate([[0.0], knots[knots < 3.5], [3.5]])
    middles = (edges[1:] + edges[:-1]) / 2
    costs = np.array([dense_cost(name, u, y, a) for a in middles])
    # Both are least-squares costs by orthogonal factors: they differ by rounding.
    np.testing.assert_allclose(fitted.cost, costs.min(), rtol=1e-10)
    low, high = fitted.cells[0]
    best = middles[costs <= costs.min() * (1 + 1e-10)]
    assert np.all((best > low) & (best < high))  # the cell joins all that cannot be told apart
    assert fitted.eta[0] == (low + high) / 2


@pytest.mark.parametrize("name", ONE_PARAMETER)
@pytest.mark.parametrize("seed", range(2))
def test_never_above_a_dense_grid(name, seed):
    u, y = experiment(name, seed, n=30, noise=2.0)
    fitted = search_method(u, y, NONLINEARITIES[name], 2, upper=3.5)
    costs = [dense_cost(name, u, y, a) for a in np.linspace(0, 3.5, 1201)]
    assert fitted.cost <= min(costs) * (1 + 1e-10)
    # At the point returned the dense cost is the cost returned.
    a = float(fitted.eta[0])
    np.testing.assert_allclose(fitted.cost, dense_cost(name, u, y, a), rtol=1e-9)


@pytest.mark.parametrize("name", SLOPING)
@pytest.mark.parametrize("seed", range(3))
def test_a_joint_fit_from_the_minimum_stays_there(name, seed):
    entry = NONLINEARITIES[name]
    u, y = experiment(name, seed)
    fitted = search_method(u, y, entry, 2, upper=3.5)

    def model(p):
        x = entry(u, p[0])
        return y[2:] - (p[1] * y[1:-1] + p[2] * y[:-2] + p[3] * x[1:-1] + p[4] * x[:-2])

    start = np.array([*fitted.eta, *fitted.theta])
    joint = least_squares(
        model, start, bounds=([0, *[-9] * 4], [3.5, *[9] * 4]), xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    # A kink in the cost may hold the joint fit elsewhere, but never below the global minimum.
    assert 2 * joint.cost >= fitted.cost * (1 - 1e-10)
    np.testing.assert_allclose(model(start), fitted.residual, atol=1e-10)


@pytest.mark.parametrize("name", TWO_SIDED)
def test_two_sides_are_never_above_a_grid(name):
    u, y = experiment(name, 3, n=40, noise=0.3, parameters=(0.7, 1.6))
    fitted = two_sided_search_method(u, y, NONLINEARITIES[name], 2, upper=3.5)
    costs = [dense_cost(name, u, y, a, b) for a in np.linspace(0, 3.5, 36) for b in np.linspace(0, 3.5, 36)]
    assert fitted.cost <= min(costs) * (1 + 1e-10)
    np.testing.assert_allclose(fitted.cost, dense_cost(name, u, y, *map(float, fitted.eta)), rtol=1e-9)


# Search method: units, degenerate inputs, sizes --------------------------------------------------------


@pytest.mark.parametrize("name", ONE_PARAMETER)
@pytest.mark.parametrize("scale", [1e-150, 1e-8, 1e8, 1e150])
def test_the_unit_of_the_input_does_not_matter(name, scale):
    u, y = experiment(name, 11)
    reference = search_method(u, y, NONLINEARITIES[name], 2, upper=3.5)
    scaled = search_method(u * scale, y, NONLINEARITIES[name], 2, upper=3.5 * scale)
    gain = 1.0 if name in FLAT else scale
    np.testing.assert_allclose(scaled.eta / scale, reference.eta, rtol=1e-11)
    np.testing.assert_allclose(scaled.theta * [1, 1, gain, gain], reference.theta, rtol=1e-11)
    np.testing.assert_allclose(scaled.cost, reference.cost, rtol=1e-12)
    assert scaled.n_minima == reference.n_minima


@pytest.mark.parametrize("name", ONE_PARAMETER)
@pytest.mark.parametrize("scale", [1e-8, 1e8])
def test_the_unit_of_the_output_does_not_matter(name, scale):
    u, y = experiment(name, 12)
    reference = search_method(u, y, NONLINEARITIES[name], 2, upper=3.5)
    scaled = search_method(u, y * scale, NONLINEARITIES[name], 2, upper=3.5)
    np.testing.assert_allclose(scaled.eta, reference.eta, rtol=1e-11)
    np.testing.assert_allclose(scaled.theta / [1, 1, scale, scale], reference.theta, rtol=1e-11)
    assert scaled.n_minima == reference.n_minima


DEGENERATE = {
    "zero": np.zeros(50),
    "constant": np.full(50, 2.0),
    "repeated": np.random.default_rng(0).integers(-4, 5, 120).astype(float),
    "below every threshold": np.random.default_rng(0).uniform(-0.4, 0.4, 60),
    "monotone": np.linspace(0.1, 4, 60),
    "with zeros": np.where(np.arange(80) % 3 == 0, 0.0, np.random.default_rng(1).uniform(-4, 4, 80)),
}


@pytest.mark.parametrize("name", ONE_PARAMETER)
@pytest.mark.parametrize("kind", DEGENERATE)
def test_degenerate_inputs_still_give_the_lowest_cost(name, kind):
    u = DEGENERATE[kind]
    v = np.random.default_rng(4).uniform(-0.2, 0.2, u.size)
    y = equation_error_response(NONLINEARITIES[name](u, 1.0), ALPHA, BETA, v)
    fitted = search_method(u, y, NONLINEARITIES[name], 2, upper=3.5)
    costs = [dense_cost(name, u, y, a) for a in np.linspace(0, 3.5, 401)]
    # The dense cost of dependent regressors is a minimum-norm one: the residual is the same.
    assert fitted.cost <= min(costs) * (1 + 1e-9)
    assert np.all(np.isfinite(fitted.theta))
    assert 0 <= fitted.eta[0] <= 3.5
    assert fitted.covariance.shape == (5, 5)


def test_data_without_information_on_a_say_so():
    fitted = search_method(np.zeros(50), np.arange(50.0) ** 0.5, NONLINEARITIES["saturation"], 2, upper=3.5)
    assert fitted.cells == ((0.0, 3.5),)
    assert np.isnan(fitted.std_error[[0, 3, 4]]).all()


def test_a_truth_at_a_bound_is_found():
    u, y = experiment("saturation", 8, noise=0.0, parameters=(3.5,))
    assert search_method(u, y, NONLINEARITIES["saturation"], 2, upper=3.5).eta[0] == pytest.approx(3.5)
    u, y = experiment("dead-zone", 8, noise=0.0, parameters=(0.0,))
    assert search_method(u, y, NONLINEARITIES["dead-zone"], 2, upper=3.5).eta[0] == pytest.approx(
        0, abs=1e-12
    )


def test_a_truth_outside_the_range_ends_at_its_nearer_end():
    u, y = experiment("saturation", 9, noise=0.0)
    fitted = search_method(u, y, NONLINEARITIES["saturation"], 2, lower=1.2, upper=3.5)
    assert fitted.eta[0] == pytest.approx(1.2, rel=1e-12)
    below = search_method(u, y, NONLINEARITIES["saturation"], 2, upper=0.5 * np.abs(u).min())
    assert np.isfinite(below.cost)


def test_as_few_rows_as_parameters_are_fitted_exactly():
    u, y = experiment("saturation", 2, n=7)
    fitted = search_method(u, y, NONLINEARITIES["saturation"], 2, upper=3.5)
    assert fitted.residual.size == 5
    assert np.isnan(fitted.noise_variance)
    with pytest.raises(IdentifiabilityError, match="4 rows cannot determine 5 parameters"):
        search_method(u[:6], y[:6], NONLINEARITIES["saturation"], 2, upper=3.5)


@pytest.mark.parametrize("name", ["saturation", "relay", "hysteresis-play"])
def test_a_long_record(name):
    u, y = experiment(name, 21, n=100_000)
    fitted = search_method(u, y, NONLINEARITIES[name], 2, upper=3.5)
    # 100 000 samples: the standard deviation of a is about 1e-3 (saturation) or less.
    assert fitted.eta[0] == pytest.approx(1.0, abs=6e-3)
    np.testing.assert_allclose(fitted.cost, dense_cost(name, u, y, float(fitted.eta[0])), rtol=1e-9)
    # The change of the Gram matrix from cell to cell must not drift away from the factorisation.
    np.testing.assert_allclose(fitted.minima[0, 1], fitted.cost, rtol=1e-7)


def test_the_data_are_not_changed():
    u, y = experiment("saturation", 0)
    before = u.copy(), y.copy()
    u.setflags(write=False)
    y.setflags(write=False)
    search_method(u, y, NONLINEARITIES["saturation"], 2, upper=3.5)
    search_method(u[::2], y[::2], NONLINEARITIES["saturation"], 2, upper=3.5)  # strided views, too
    np.testing.assert_array_equal((u, y), before)


def test_bad_data_end_in_one_sentence():
    u, y = experiment("saturation", 0)
    saturation = NONLINEARITIES["saturation"]
    with pytest.raises(DataError, match=r"shape \(100,\) and output of shape \(99,\) differ"):
        search_method(u, y[:-1], saturation, 2, upper=3.5)
    with pytest.raises(DataError, match="must be sequences of numbers"):
        search_method(["low"] * 100, y, saturation, 2, upper=3.5)
    with pytest.raises(DataError, match="input value 7 is nan: remove the row"):
        search_method(np.where(np.arange(100) == 7, np.nan, u), y, saturation, 2, upper=3.5)
    with pytest.raises(DataError, match="data value 8 is inf: remove the row"):
        search_method(u, np.where(np.arange(100) == 8, np.inf, y), saturation, 2, upper=3.5)
    with pytest.raises(UsageError, match="order is 0: give a whole number of at least 1"):
        search_method(u, y, saturation, 0, upper=3.5)
    for lower, upper in ((0, np.inf), (2, 1), (-1, 1), (1, 1), (0, np.nan)):
        with pytest.raises(UsageError, match="saturation: the range"):
            search_method(u, y, saturation, 2, lower=lower, upper=upper)
    with pytest.raises(IdentifiabilityError, match="an experiment of 2 samples is too short for order 2"):
        search_method(u, y, saturation, 2, upper=3.5, starts=[0, 98])
    for starts in ([5], [0, 50, 20], [0, 100], []):
        with pytest.raises(UsageError, match="do not begin with 0 and ascend below the 100 samples"):
            search_method(u, y, saturation, 2, upper=3.5, starts=starts)


def test_rows_of_several_experiments_are_those_of_each():
    y = np.arange(12.0) ** 2
    rows = LaggedRegression.arx(y, 2, starts=[0, 5])
    assert rows.times.tolist() == [2, 3, 4, 7, 8, 9, 10, 11]
    np.testing.assert_array_equal(rows.fixed, np.column_stack([y[rows.times - 1], y[rows.times - 2]]))
    assert rows.row_of_time.tolist() == [-1, -1, 0, 1, 2, -1, -1, 3, 4, 5, 6, 7]


# Correlation method ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("n", "n_lags"), [(3, 2), (50, 4), (400, 20)])
def test_correlations_agree_with_numpy(n, n_lags):
    rng = np.random.default_rng(n)
    u, y = rng.standard_normal((2, n))
    tail = y.copy()
    tail[:n_lags] = 0.0  # only samples whose every lag was recorded count
    full = np.correlate(tail, u, mode="full")[n - 1 :]
    # Sums of at most 400 products of order one.
    np.testing.assert_allclose(
        cross_correlation(u, y, n_lags), full[1 : n_lags + 1] / (n - n_lags), atol=1e-13
    )


def test_too_few_samples_for_the_lags():
    with pytest.raises(DataError, match="4 samples are too few for 4 lags"):
        cross_correlation(np.ones(4), np.ones(4), 4)
    with pytest.raises(DataError, match="3 lags cannot determine order 2: use at least 4"):
        correlation_equations([1.0, 2.0, 3.0], 2)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_the_equations_are_their_definition(order):
    w = np.random.default_rng(order).standard_normal(2 * order + 5)
    sigma = correlation_equations(w, order)
    theta = np.random.default_rng(1).standard_normal(2 * order)
    for i in range(1, w.size + 1):  # (3.2): w(i) = sum_j alpha_j w(i - j) + q beta_i, w(i) = 0 for i < 1
        expected = sum(theta[j - 1] * w[i - j - 1] for j in range(1, order + 1) if i - j >= 1)
        expected += theta[order + i - 1] if i <= order else 0.0
        assert sigma[i - 1] @ theta == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize("n_lags", range(4, 21))
@pytest.mark.parametrize("q", [0.9, -1e-6, 1e6])
def test_exact_correlations_give_the_linear_part(n_lags, q):
    impulse = lfilter([0.0, *BETA], [1.0, *(-a for a in ALPHA)], np.eye(1, n_lags + 1)[0])[1:]
    w = q * impulse
    theta = project(correlation_equations(w, 2), w).theta
    # The unit of the correlations scales two of the four columns: QR does not feel it.
    np.testing.assert_allclose(theta[:2], ALPHA, rtol=1e-9)
    np.testing.assert_allclose(theta[2:] / q, BETA, rtol=1e-9)


@pytest.mark.parametrize("n_lags", [4, 8, 20])
def test_white_correlations_pass_through_the_method(n_lags):
    # One unit impulse as input: w(i) = h_i / N exactly, as long as all lags are recorded.
    n = 3 * n_lags
    u = np.zeros(n)
    u[n_lags] = 1.0
    y = equation_error_response(u, ALPHA, BETA, np.zeros(n))
    found = correlation_method(u, y, 2, n_lags)
    np.testing.assert_allclose(found.alpha, ALPHA, rtol=1e-10)
    np.testing.assert_allclose(found.scaled_beta * (n - n_lags), BETA, rtol=1e-10)


def test_centring_removes_the_means():
    rng = np.random.default_rng(3)
    u = rng.uniform(0, 2, 40_000)
    y = equation_error_response(u, ALPHA, BETA, np.zeros(u.size))
    centred = correlation_method(u, y, 2, 4, centred=True)
    # Standard error of a correlation: 1/sqrt(40000) = 0.005; six of them, doubled by the poles.
    np.testing.assert_allclose(centred.alpha, ALPHA, atol=0.06)
    np.testing.assert_allclose(centred.scaled_beta / (4 / 12), BETA, atol=0.06)
    plain = correlation_method(u, y, 2, 4)
    assert np.abs(plain.alpha - ALPHA).max() > 0.1  # (3.2) fails for an input of nonzero mean


def test_ratios_of_moments():
    one = CorrelationEstimate(np.zeros(2), np.array([2.0, 6.0]))
    two = CorrelationEstimate(np.zeros(2), np.array([4.0, 3.0]))
    assert moment_ratio(one, two) == 1.25
    assert moment_ratio(one, two, 0) == 0.5
    assert moment_ratio(one, two, 1) == 2.0


def test_a_map_with_two_parameters_and_a_broken_order_are_refused():
    u, y = np.linspace(-3, 3, 40), np.cos(np.arange(40.0))
    with pytest.raises(UsageError, match="use two_sided_search_method"):
        search_method(u, y, NONLINEARITIES["two-sided-relay"], 2, upper=2.0)
    with pytest.raises(UsageError, match=r"order is 1\.5: give a whole number"):
        search_method(u, y, NONLINEARITIES["relay"], 1.5, upper=2.0)
