"""Hammerstein models fitted by their free run: every map recovered, errors honest, misuse told."""

import numpy as np
import pytest

import sysid
from sysid.data import make_record
from sysid.errors import UsageError
from sysid.linear import fit_hammerstein, fit_output_error, simulate_polynomial
from sysid.nonlinearities import NONLINEARITIES, PLAY, RELAY, SATURATION

A, B = [1.0, -1.5, 0.7], [0.0, 0.5, 0.3]
THRESHOLDS = {1: (0.8,), 2: (0.6, 1.1)}


def simulated(kind, seed=0, n=400, noise=0.02, thresholds=None, hold=1):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-2.0, 2.0, n // hold), hold)
    x = kind(u, *(thresholds or THRESHOLDS[len(kind.parameters)]))
    y = simulate_polynomial(B, A, x)
    return u, y, noise * y.std() * rng.standard_normal(n)


@pytest.mark.parametrize("name", NONLINEARITIES)
def test_every_map_is_found_with_its_linear_part(name):
    kind = NONLINEARITIES[name]
    u, y, e = simulated(kind)
    fit = fit_hammerstein(make_record(u, y + e, 1.0), kind, 2, initial_state="rest")
    # 2 % noise on 400 rows: the error of the rms is 4 %, thresholds are known to a percent or a cell.
    assert fit.rms == pytest.approx(e.std(), rel=0.14)
    np.testing.assert_allclose(fit.thresholds, THRESHOLDS[len(fit.thresholds)], rtol=0.03)
    np.testing.assert_allclose(fit.linear.a, A, atol=0.01)
    assert fit.converged
    assert fit.name == f"hammerstein-{name}"


def test_standard_errors_of_threshold_and_coefficients_are_calibrated():
    scores = []
    for seed in range(20):
        u, y, e = simulated(SATURATION, seed=seed, n=400, noise=0.1)
        fit = fit_hammerstein(make_record(u, y + e, 1.0), "saturation", 2, initial_state="rest")
        truth = [0.8, *A[1:], *B[1:]]
        scores.append([(v - t) / s for (v, s), t in zip(fit.parameters().values(), truth, strict=True)])
    # Mean squares of 20 standard normal variables for each of five: 1 with a deviation of 0.32.
    assert np.all(np.mean(np.square(scores), axis=0) < 1.0 + 4.0 * 0.32)
    assert np.all(np.mean(np.square(scores), axis=0) > 0.3)


def test_a_threshold_that_acts_in_steps_has_no_standard_error():
    u, y, e = simulated(RELAY)
    fit = fit_hammerstein(make_record(u, y + e, 1.0), "relay", 2)
    values = fit.parameters()
    assert np.isnan(values["threshold"][1])
    assert np.isfinite(values["b1"][1])
    assert "HammersteinFit with a" in repr(fit)


def test_what_is_linear_is_left_linear():
    u, y, e = simulated(SATURATION, thresholds=(5.0,))
    record = make_record(u, y + e, 1.0)
    fit = fit_hammerstein(record, "saturation", 2)
    linear = fit_output_error(record, 2)
    assert linear.rms * 0.98 < fit.rms <= linear.rms * (1.0 + 1e-6)


def test_prediction_goes_on_over_all_rows_and_memory_starts_anew_in_each_experiment():
    u, y, e = simulated(PLAY, n=900, hold=3)
    experiment = np.repeat(["a", "b"], [600, 300])
    split = np.repeat(["train", "test"], [600, 300])
    y[600:] = simulate_polynomial(B, A, PLAY(u[600:], 0.8))
    record = make_record(u, y + e, 1.0, experiment=experiment, split=split, skip=20)
    fit = fit_hammerstein(record, PLAY, 2)
    prediction = fit.predict(record)
    assert np.std((prediction.free_run - y)[620:]) < 0.01 * y.std()


@pytest.mark.parametrize("model", ["hammerstein-saturation", "state-space"])
def test_it_is_compared_by_its_name(model):
    u, y, e = simulated(SATURATION, n=900)
    record = make_record(u, y + e, 1.0, split=np.repeat(["train", "test"], 450), units={"u": "V"})
    comparison = sysid.compare(record, model)
    content = comparison.to_json()
    assert content["model"]["name"] == model
    assert content["model"]["order"] >= 1
    nrmse = comparison.score_of("test").free_run.nrmse
    if model == "state-space":
        assert nrmse > 0.1  # a linear model, whatever its form
    else:
        assert nrmse < 0.03
        threshold = content["model"]["parameters"]["threshold"]
        assert threshold["value"] == pytest.approx(0.8, rel=0.03)
        assert threshold["unit"] == "V"
    assert comparison.sentences()
    assert "<html" in comparison.to_html()


def test_bad_requests_are_refused():
    u, y, _ = simulated(SATURATION)
    record = make_record(u, y, 1.0)
    with pytest.raises(UsageError, match="There is no nonlinearity 'sponge'"):
        fit_hammerstein(record, "sponge", 2)
    with pytest.raises(UsageError, match="kind is 3"):
        fit_hammerstein(record, 3, 2)
    with pytest.raises(UsageError, match="record is of type ndarray"):
        fit_hammerstein(u, "saturation", 2)
    wide = make_record(np.column_stack([u, u]), y, 1.0)
    with pytest.raises(UsageError, match="2 inputs"):
        fit_hammerstein(wide, "saturation", 2)
    with pytest.raises(UsageError, match="order is 'x'"):
        fit_hammerstein(record, "saturation", "x")
    with pytest.raises(UsageError, match="has no parameter 'm'"):
        sysid.compare(record, "state-space", start={"m": 1.0})
    with pytest.raises(UsageError, match="hammerstein-saturation"):
        sysid.compare(record, "hammerstein-sponge")
