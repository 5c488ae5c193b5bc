"""LFT models refined by their free run: exact derivatives, consistency, honest intervals."""

from dataclasses import replace

import numpy as np
import pytest
from lft_cases import STRUCTURES, simulated
from numpy.typing import NDArray
from scipy.stats import binom

from sysid.data import make_record
from sysid.errors import DataError, IdentifiabilityError, ModelError, UsageError
from sysid.lft import LftStructure, fit_lft, lags, refine_free_run
from sysid.lft.free_run import _Problem

Floats = NDArray[np.float64]


@pytest.mark.parametrize("initial_state", ["measured", "rest"])
@pytest.mark.parametrize("case", list(STRUCTURES))
def test_derivatives_are_those_of_differences(case: str, initial_state: str) -> None:
    data = simulated(case, 120)
    problem = _Problem.of(data, fit_lft(data, STRUCTURES[case]), None, initial_state)
    x = problem.start + 0.01 * np.random.default_rng(0).standard_normal(problem.start.size)
    exact, h = problem.derivative(x)[problem.times], 1e-6
    for j in range(x.size):
        step = h * np.eye(x.size)[j]
        up, down = (problem.at(x + sign * step).residual for sign in (1, -1))
        # Central differences: h^2 times third derivatives of order 1e3, and rounding 1e-16 / h.
        np.testing.assert_allclose(exact[:, j], -(up - down) / (2.0 * h), atol=1e-6)


def with_sensor_noise(seed: int, n: int = 400) -> tuple[Floats, Floats]:
    """A cubic map inside dynamics, measured with coloured noise."""
    rng = np.random.default_rng(seed)
    u, x, w = rng.uniform(-1.5, 1.5, n), np.zeros(n), np.zeros(n)
    for k in range(2, n):
        z = 0.6 * u[k - 1] + 0.8 * u[k - 2]
        w[k] = z - 0.2 * z**3
        x[k] = 0.8 * x[k - 1] + w[k] + 0.4 * w[k - 1]
    noise = np.zeros(n)
    for k in range(1, n):
        noise[k] = 0.7 * noise[k - 1] + 0.1 * rng.standard_normal()
    noise[:2] = 0.0  # the run begins with these
    return u, x + noise


def test_intervals_cover_the_truth_when_the_noise_is_coloured() -> None:
    structure = LftStructure(n_a=1, n_g=1, z_lags=lags("u", 1, 2), knots=3)
    truth = {"a1": -0.8, "g1": 0.4, "d1": 0.6, "d2": 0.8}
    runs, places = 120, np.array([-1.0, 0.5])
    inside, band = dict.fromkeys(truth, 0), np.zeros(places.size)
    for seed in range(runs):
        data = with_sensor_noise(seed)
        fit = refine_free_run(data, fit_lft(data, structure))
        for name, (value, error) in fit.parameters().items():
            inside[name] += abs(value - truth[name]) <= 1.96 * error
        low, high = fit.map_band(places)
        band += (low <= places - 0.2 * places**3) & (places - 0.2 * places**3 <= high)
    # The noise model is estimated, too: coverage between 90 and 98 %, each within its binomial range.
    least, most = binom.ppf(5e-5, runs, 0.90), binom.ppf(1.0 - 5e-5, runs, 0.98)
    assert all(least <= count <= most for count in [*inside.values(), *band]), (inside, band)


def test_free_run_error_falls_and_the_bias_of_the_prediction_error_goes() -> None:
    structure = LftStructure(n_a=1, n_g=1, z_lags=lags("u", 1, 2), knots=3)
    u, y = with_sensor_noise(1, 3000)
    rng = np.random.default_rng(5)
    y = y + 0.5 * rng.standard_normal(3000)
    predicted = fit_lft((u, y), structure)
    refined = refine_free_run((u, y), predicted)
    errors = [float(np.mean((y - model.simulate((u, y)))[2:] ** 2)) for model in (predicted, refined)]
    assert errors[1] < errors[0]
    assert refined.cost / refined.n_rows == pytest.approx(
        float(np.mean((y - refined.simulate((u, y)))[refined.times] ** 2)), rel=1e-12
    )
    assert abs(refined.a[1] + 0.8) < 0.02 < abs(predicted.a[1] + 0.8)
    assert list(refined.costs) == sorted(refined.costs, reverse=True)
    assert refined.criterion == "free-run"
    assert "free-run rms" in repr(refined)


def test_rows_that_are_not_fitted_do_not_matter() -> None:
    structure = STRUCTURES["both in the map"]
    first, second = simulated("both in the map", 300), simulated("both in the map", 200, seed=1)
    u, y = (np.concatenate(pair) for pair in zip(first, second, strict=True))
    split, experiment = np.repeat(["est", "test"], [300, 200]), np.repeat(["one", "two"], [300, 200])
    fits = []
    for outputs in (y, np.where(np.arange(500) < 300, y, 5.0 * y)):
        record = make_record(u, outputs, 1.0, split=split, experiment=experiment)
        fits.append(refine_free_run(record, fit_lft(record, structure)))
    alone = refine_free_run(first, fit_lft(first, structure))
    np.testing.assert_array_equal(fits[0].covariance, fits[1].covariance)
    np.testing.assert_allclose(fits[0].a, alone.a, rtol=1e-12)
    np.testing.assert_array_equal(fits[0].times, alone.times)


def test_refined_model_keeps_what_an_lft_fit_can_do() -> None:
    data = simulated("wiener-hammerstein", 400)
    fit = refine_free_run(data, fit_lft(data, STRUCTURES["wiener-hammerstein"]))
    mirrored = fit.oriented(-fit.d)
    np.testing.assert_allclose(mirrored.map_band([0.5]), fit.map_band([-0.5]), atol=1e-12)
    assert np.linalg.norm(fit.d) == pytest.approx(1.0)
    assert fit.straight_line_test() < 1e-4


def test_bad_use_is_one_sentence() -> None:
    data = simulated("wiener-hammerstein", 300)
    fit = fit_lft(data, STRUCTURES["wiener-hammerstein"])
    with pytest.raises(ModelError, match="the free run that was to be refined diverges"):
        refine_free_run(data, replace(fit, a=np.array([1.0, -2.0])))
    with pytest.raises(IdentifiabilityError, match="rows cannot determine"):
        refine_free_run((data[0][:12], data[1][:12]), fit)
    with pytest.raises(IdentifiabilityError, match="no row is left"):
        refine_free_run(data, fit, rows=np.zeros(300, dtype=bool))
    with pytest.raises(UsageError, match="choose measured, rest or available"):
        refine_free_run(data, fit, initial_state="zero")
    data[1][0] = np.nan
    with pytest.raises(DataError, match="start it from rest"):
        refine_free_run(data, fit)
