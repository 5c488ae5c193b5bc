"""Nonlinear tests of a residual: nominal under independence, alarmed by what they look for."""

import numpy as np
import pytest
from scipy import signal

from sysid.data import make_record
from sysid.diagnosis.comparison.nonlinear_tests import cube, nonlinear_tests, square
from sysid.diagnosis.comparison.series import judged_series


def plant(u):
    return signal.lfilter([0.0, 0.1, 0.05], [1.0, -1.8, 0.85], u)


def series_of(u, model, error, **keywords):
    record = make_record(u, model + error, 0.1, **keywords)
    return judged_series(record, "test", np.ones(model.size, dtype=bool), model, 0)


@pytest.mark.parametrize("noise", [[1.0], [1.0, -0.9], [1.0, -1.8, 0.95]])
@pytest.mark.parametrize("laplace", [False, True])
def test_bands_hold_99_percent_of_independent_residuals(noise, laplace):
    """100 records of 600 rows: 1 % of 13 000 correlations lies outside, 0.2 % standard error."""
    rng = np.random.default_rng(1)
    outside, failed = [], 0
    for number in range(100):
        hold = (1, 8)[number % 2]
        u = np.repeat(rng.standard_normal(800 // hold), hold)
        draws = rng.laplace(size=800) if laplace else rng.standard_normal(800)
        error = signal.lfilter([1.0], noise, draws)
        tests = nonlinear_tests(series_of(u[200:], plant(u)[200:], error[200:]))
        outside.append(np.mean([test.outside / test.lags.size for test in tests.values()]))
        failed += sum(not test.passed for test in tests.values())
    assert 0.004 < np.mean(outside) < 0.017
    assert failed <= 14  # 1 % of 500 tests is 5 +- 2.2; those of one signal are dependent


def test_each_trace_is_found_by_its_test_and_not_by_the_others():
    rng = np.random.default_rng(2)
    u, e = rng.standard_normal((2, 2000))
    model = plant(u)
    late = np.concatenate([np.zeros(4), u[:-4]])
    traces = {
        "residual_squared_input": e + 0.3 * late**2,
        "residual_cubed_input": e + 0.1 * late**3,
        "squared_residual_squared_input": e * (1.0 + late**2),
        "residual_squared_output": e + 0.3 * (model / model.std()) ** 2,
    }
    for name, error in traces.items():
        tests = nonlinear_tests(series_of(u, model, error))
        assert tests[name].p_value < 1e-4
        if name.endswith("input"):
            worst = np.argmax(np.abs(tests[name].correlation))
            assert tests[name].lags[worst] == 4
    assert nonlinear_tests(series_of(u, model, e + late))["residual_cubed_input"].passed  # a linear trace


def test_powers_are_orthogonal_to_lower_ones():
    x = np.random.default_rng(3).exponential(size=500)
    for shaped, lower in ((square(x), (x**0, x)), (cube(x), (x**0, x, x**2))):
        for power in lower:
            assert abs(shaped @ power) < 1e-9 * np.linalg.norm(shaped) * np.linalg.norm(power)


def test_white_residual_gives_plain_correlations():
    """Without memory the whitening does nothing, and the test is the textbook correlation."""
    rng = np.random.default_rng(4)
    u, e = rng.standard_normal((2, 5000))
    test = nonlinear_tests(series_of(u, plant(u), e))["residual_squared_input"]
    shaped = square((u - u.mean()) / u.std())
    centred = e - e.mean()
    expected = [np.corrcoef(centred[lag:], shaped[: 5000 - lag])[0, 1] for lag in range(26)]
    # The whitening filter may have a small coefficient or two: correlations differ by their errors' share.
    np.testing.assert_allclose(test.correlation, expected, atol=0.004)


def test_two_level_input_has_no_squares_and_several_inputs_have_names():
    rng = np.random.default_rng(5)
    u = np.column_stack([rng.choice([-1.0, 1.0], 400), rng.standard_normal(400)])
    tests = nonlinear_tests(series_of(u, plant(u[:, 1]), rng.standard_normal(400), inputs=["a", "b"]))
    assert "residual_squared_input_b" in tests
    assert "residual_squared_input_a" not in tests


def test_few_rows_are_not_tested():
    rng = np.random.default_rng(6)
    assert nonlinear_tests(series_of(rng.standard_normal(40), np.zeros(40), rng.standard_normal(40))) == {}
