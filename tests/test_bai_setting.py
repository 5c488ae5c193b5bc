"""The experiments of Bai's examples: their sizes, their true system, and that a seed fixes them."""

import math
import pickle

import numpy as np
import pytest
from scipy.signal import lfilter

from replications.bai import setting
from replications.bai.example_1 import Example1, asymptotic_std, cost_curve, one_parameter_map
from replications.bai.example_2 import LAGS, Example2, correlation_estimate, variants
from replications.bai.worked import WORKED, WorkedRun, static_map, true_parameters
from sysid.hammerstein import CorrelationEstimate
from sysid.nonlinearities import NONLINEARITIES

DENOMINATOR = [1.0, 0.8333, 0.1667]


def rng(seed=0):
    return np.random.default_rng(seed)


def disturbance(u, y, x):
    """Equation error of (2.1) by a filter that shares nothing with the simulation."""
    return lfilter(DENOMINATOR, [1.0], y) - lfilter([0.0, 1.0, 1.0], [1.0], x)


def test_the_linear_system_is_the_papers():
    impulse = lfilter([0.0, 1.0, 1.0], DENOMINATOR, np.eye(1, 31)[0])[1:]
    np.testing.assert_allclose(setting.impulse_response(30), impulse, atol=1e-14)
    assert np.all(np.abs(np.roots(DENOMINATOR)) < 1)
    assert list(setting.TRUE.values()) == [1.0, -0.8333, -0.1667, 1.0, 1.0]
    assert set(setting.CASES) <= set(NONLINEARITIES)
    assert set(setting.RELAYS) <= set(setting.CASES)


# Example 1 ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", setting.CASES)
def test_an_experiment_of_example_1(case):
    u, y = Example1(case).experiment(rng())
    assert u.shape == y.shape == (102,)  # 100 rows of the regression
    v = disturbance(u, y, one_parameter_map(case)(u, 1.0))
    assert np.abs(u).max() <= 4
    assert np.abs(v).max() <= 0.2 + 1e-12
    # The standard deviation of 102 uniform draws is known to 4.5 %; four of those.
    assert v.std() == pytest.approx(0.2 / math.sqrt(3), rel=0.2)
    assert Example1(case).identify(u, y).residual.size == 100


@pytest.mark.parametrize("case", setting.CASES)
def test_example_1_is_fixed_by_its_seed(case):
    task = Example1(case)
    first, second, other = task(rng(3)), task(rng(3)), task(rng(4))
    assert first == second
    assert first != other
    assert list(first)[:5] == list(setting.PARAMETERS)
    assert pickle.loads(pickle.dumps(task))(rng(3)) == first  # what a worker process gets


def test_inputs_of_all_cases_share_their_draws():
    inputs = {case: Example1(case).experiment(rng(9))[0] for case in setting.CASES}
    for u in inputs.values():
        np.testing.assert_array_equal(u, inputs["saturation"])


@pytest.mark.parametrize("case", setting.CASES)
def test_estimates_of_a_long_record_are_near_the_truth(case):
    values = Example1(case, 20_000)(rng(1))
    bound = asymptotic_std(case, 20_000)
    for name, std in bound.items():
        assert abs(values[name] - setting.TRUE[name]) < 5 * std, name
    if case in setting.RELAYS:
        # Between two of 20 000 samples: their mean distance is 4/20000, the error a few of those.
        assert "a" not in bound
        assert values["a"] == pytest.approx(1.0, abs=0.01)
        assert values["cell_width"] > 0
    else:
        assert values["cell_width"] == 0
    assert values["j"] == pytest.approx(0.2**2 / 3, rel=0.03)  # 0.9/sqrt(20000) = 0.6 % a standard error


def test_the_bound_falls_with_the_root_of_the_samples():
    few, many = asymptotic_std("saturation", 100), asymptotic_std("saturation", 400)
    assert list(few) == list(setting.PARAMETERS)
    for name, value in few.items():
        assert value / many[name] == pytest.approx(2.0, rel=1e-12)


def test_a_cost_curve_lies_above_the_minimum_found():
    curve = cost_curve(Example1("saturation"), rng(2), points=101)
    assert curve["a"].shape == curve["j"].shape == (101,)
    assert curve["found_j"] <= curve["j"].min() * (1 + 1e-10)
    assert curve["minima_j"][0] == pytest.approx(curve["found_j"], rel=1e-9)
    assert curve["n_minima"] >= len(curve["minima"]) >= 1


# Example 2 ------------------------------------------------------------------------------------------


def test_the_experiments_of_example_2():
    records = Example2().experiments(rng())
    assert set(records) == {"independent", "shared"}
    saturation = NONLINEARITIES["saturation"]
    for pair in records.values():
        for (u, y), width in zip(pair, (2.0, 3.0), strict=True):
            assert u.size == 2000 + max(LAGS)
            assert width * 0.99 < np.abs(u).max() <= width
            assert np.abs(disturbance(u, y, saturation(u, 1.0))).max() <= 0.1 + 1e-12
    np.testing.assert_allclose(records["shared"][1][0], 1.5 * records["shared"][0][0], rtol=1e-15)
    assert abs(np.corrcoef(records["independent"][0][0], records["independent"][1][0])[0, 1]) < 0.1
    np.testing.assert_array_equal(records["shared"][0], records["independent"][0])


def test_example_2_reports_every_variant():
    values = Example2()(rng(5))
    assert values == Example2()(rng(5))
    assert len(variants()) == 12
    for name in (*variants(), "separable"):
        assert {f"{name}/{parameter}" for parameter in setting.PARAMETERS} <= set(values)
    for parameter, true in setting.TRUE.items():
        # Standard deviations at N = 4000 and noise 0.06: below 0.005.
        assert values[f"separable/{parameter}"] == pytest.approx(true, abs=0.03)


def test_exact_moments_give_example_2_back():
    u = [static_map("saturation").moment(f, 1.0) for f in WORKED["saturation"].inputs]
    linear = [CorrelationEstimate(np.array(setting.ALPHA), q * np.array(setting.BETA)) for q in u]
    for column in (None, 0):
        parameters, regular = correlation_estimate(linear, column)
        assert parameters == pytest.approx(setting.TRUE, rel=1e-12)
        assert regular


# Worked nonlinearities --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", WORKED)
def test_a_worked_run_is_fixed_by_its_seed(name):
    task = WorkedRun(name, n_samples=2000)
    first = task(rng(1))
    assert first == task(rng(1)) == pickle.loads(pickle.dumps(task))(rng(1))
    assert set(first) == {*true_parameters(name), "regular"}


@pytest.mark.parametrize("name", [name for name in WORKED if not name.endswith("as-printed")])
def test_exact_moments_solve_the_worked_nonlinearities(name):
    worked = WORKED[name]
    entry = static_map(worked.map_name)
    beta, alpha = np.array(setting.BETA), np.array(setting.ALPHA)
    moments = [entry.moment(f, *worked.parameters) for f in worked.inputs]
    linear = [CorrelationEstimate(alpha, q * beta) for q in moments]
    gain = beta.sum() / (1 - alpha.sum())
    means = [gain * entry.mean(f, *worked.parameters) for f in worked.inputs]
    solution = worked.solve(linear, means)
    assert solution.regular
    # The numerical solution of the even map stops at a gradient of 1e-14, the closed forms at rounding.
    np.testing.assert_allclose(solution.parameters, worked.parameters, rtol=1e-6)


@pytest.mark.parametrize("name", [name for name in WORKED if not name.endswith("as-printed")])
def test_a_long_record_solves_the_worked_nonlinearities(name):
    found = WorkedRun(name, n_samples=400_000)(rng(2))
    for parameter, true in true_parameters(name).items():
        # Correlations are known to 1/sqrt(400000) = 0.16 %; the ratio equations amplify that tenfold or so.
        assert found[parameter] == pytest.approx(true, rel=0.1)
