"""Fits of physical models: the truth recovered with honest standard errors, and the contract's cases."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from physics_cases import VALUES, duffing, free_model

from sysid.data import make_record, read_record
from sysid.errors import IdentifiabilityError, ModelError, UsageError
from sysid.physics import Term, fit_physics, load_model, model_names
from sysid.physics.grammar import parse
from sysid.physics.problem import Problem
from sysid.physics.restarts import descend
from sysid.physics.simulation import Simulator

FIXED = {"dc-motor": ("L", "R"), "positioning-stage": ("gain",)}
PERIOD = 0.1


def excitation(rng, n):
    return np.repeat(rng.uniform(-1.0, 1.5, n // 5), 5)


def simulated(name, seed=0, n=600, noise=0.03, start=None):
    rng = np.random.default_rng(seed)
    u = excitation(rng, n)
    y = Simulator(free_model(name), PERIOD).run(VALUES[name], u, start)[:, 0]
    return make_record(u, y + noise * y.std() * rng.standard_normal(n), PERIOD)


def options(name, rng):
    """Known values, and starts some 15 % off."""
    fixed = {key: VALUES[name][key] for key in FIXED.get(name, ())}
    start = {k: v * rng.uniform(0.85, 1.15) for k, v in VALUES[name].items() if k not in fixed}
    return {"start": start, "fixed": fixed}


def scaled_errors(fit, truth):
    if fit.model.name.startswith("two-tanks") and fit.values["a1"] < fit.values["a2"]:  # the tanks can swap
        truth = truth | {"a1": truth["a2"], "a2": truth["a1"], "b": truth["b"] * truth["a1"] / truth["a2"]}
    pairs = zip(fit.names, fit.uncertainty.standard_errors, strict=True)
    return np.array([(fit.values[name] - truth[name]) / error for name, error in pairs])


@pytest.mark.parametrize("initial_state", ["rest", "estimate"])
@pytest.mark.parametrize("name", model_names())
def test_the_truth_is_recovered_from_starts_that_are_some_way_off(name, initial_state):
    rng = np.random.default_rng(5)
    order = load_model(name).order
    start = None if initial_state == "rest" else rng.uniform(-0.5, 0.5, order)
    record = simulated(name, start=start)
    fit = fit_physics(record, name, initial_state=initial_state, **options(name, rng))
    assert fit.converged
    assert fit.restarts_agree
    # Within four standard errors: a chance of 6e-5 for each of some sixty.
    assert np.abs(scaled_errors(fit, VALUES[name])).max() < 4.0
    assert fit.rms == pytest.approx(0.03 * record.y.std(), rel=0.15)
    if start is not None:
        np.testing.assert_allclose(fit.states[0], start, atol=0.6)


@pytest.mark.parametrize("name", ["dc-motor", "mass-spring-damper", "two-tanks", "positioning-stage"])
def test_the_truth_is_recovered_without_a_start(name):
    fixed = {key: VALUES[name][key] for key in FIXED.get(name, ())}
    record = simulated(name, seed=3)
    fit = fit_physics(record, name, fixed=fixed, initial_state="estimate")
    assert fit.restarts_agree
    assert np.abs(scaled_errors(fit, VALUES[name])).max() < 4.0


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_standard_errors_are_calibrated_in_white_and_coloured_noise(colour):
    scores = []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        u = excitation(rng, 400)
        y = Simulator(free_model("dc-motor"), PERIOD).run(VALUES["dc-motor"], u)[:, 0]
        noise = 0.02 * rng.standard_normal(400)
        for k in range(1, 400):
            noise[k] += colour * noise[k - 1]
        record = make_record(u, y + noise, PERIOD)
        fit = fit_physics(record, "dc-motor", initial_state="rest", **options("dc-motor", rng))
        scores.append(scaled_errors(fit, VALUES["dc-motor"]))
    # The mean square of 25 standard normal triples, strongly correlated: 1 with a deviation of at most 0.28.
    assert 0.3 < np.mean(np.square(scores)) < 1.85


def test_a_nonlinear_oscillator_is_recovered():
    rng = np.random.default_rng(2)
    model = duffing()
    truth = {p.name: p.start for p in model.parameters}
    u = 3.0 * excitation(rng, 800)
    y = Simulator(model, PERIOD, substeps=40).run({}, u, [0.2, -0.3])[:, 0]
    record = make_record(u, y + 0.02 * y.std() * rng.standard_normal(800), PERIOD)
    start = {"w0": 3.3, "zeta": 0.12, "gain": 0.6, "cubic": 17.0}
    fit = fit_physics(record, "oscillator", start=start)
    assert fit.restarts_agree
    assert np.abs(scaled_errors(fit, truth)).max() < 4.0
    assert fit.substeps is not None


def test_positive_parameters_are_searched_by_their_logarithm():
    record = simulated("mass-spring-damper")
    from sysid.linear.output_error import make_segments

    model = load_model("mass-spring-damper").with_parameters(start=VALUES["mass-spring-damper"])
    problem = Problem(model, make_segments(record, record.learning), PERIOD, True)
    point = np.concatenate([problem.coordinates(problem.simulator.values()), [0.1, -0.2]])
    step = 1e-6 * np.eye(point.size)
    differences = [(problem.residual(point + s) - problem.residual(point - s)) / 2e-6 for s in step]
    np.testing.assert_allclose(problem.jacobian(point), np.array(differences).T, rtol=1e-5, atol=1e-7)
    assert descend(problem, point, 50).status.converged


def test_each_experiment_has_its_own_initial_state():
    name, rng = "mass-spring-damper", np.random.default_rng(1)
    u = excitation(rng, 900)
    starts = [[0.5, 0.0], [-0.4, 1.0], [0.3, -0.8]]
    simulator = Simulator(free_model(name), PERIOD)
    y = np.concatenate(
        [simulator.run(VALUES[name], u[300 * i : 300 * i + 300], s)[:, 0] for i, s in enumerate(starts)]
    )
    measured = y + 0.01 * y.std() * rng.standard_normal(900)
    experiment, split = np.repeat(["a", "b", "c"], 300), np.repeat(["train", "train", "test"], 300)
    record = make_record(u, measured, PERIOD, split=split, experiment=experiment, skip=40)
    fit = fit_physics(record, name, **options(name, rng))
    assert fit.states.shape == (2, 2)
    np.testing.assert_allclose(fit.states, starts[:2], atol=0.05)
    prediction = fit.predict(record)
    assert prediction.starts[2] == "estimated on the first 40 rows"
    error = prediction.free_run - y
    assert np.sqrt(np.mean(error**2)) < 0.01 * y.std()
    rest = fit_physics(record, name, initial_state="rest", **options(name, rng)).predict(record)
    assert rest.starts == ("at rest",) * 3
    assert rest.free_run[600] == 0.0


def test_test_rows_do_not_touch_the_fit():
    record = simulated("two-tanks")
    split = np.repeat(["est", "val", "test"], 200)
    y = record.y.copy()
    fits = []
    for change in (0.0, np.nan):
        y[400:] += change
        changed = make_record(record.u, y, PERIOD, split=split)
        fits.append(fit_physics(changed, "two-tanks", start=VALUES["two-tanks"]))
    assert fits[0].values == fits[1].values
    assert np.isfinite(fits[1].predict(changed).free_run).all()


def test_what_the_record_cannot_determine_is_said():
    fit = fit_physics(simulated("dc-motor"), "dc-motor", start=VALUES["dc-motor"], initial_state="rest")
    assert len(fit.uncertainty.undetermined) >= 2
    assert "only combinations of" in fit.status
    assert np.isinf(fit.uncertainty.standard_errors).any()


def test_wrong_use_is_named():
    record = simulated("two-tanks")
    with pytest.raises(UsageError, match="initial state is 'free'"):
        fit_physics(record, "two-tanks", initial_state="free")
    with pytest.raises(UsageError, match="every parameter"):
        fit_physics(record, "two-tanks", fixed=VALUES["two-tanks"])
    with pytest.raises(ModelError, match="has no parameter 'c'"):
        fit_physics(record, "two-tanks", start={"c": 1.0})
    with pytest.raises(IdentifiabilityError, match="4 rows cannot determine 5 unknowns"):
        fit_physics(record, "two-tanks", rows=np.arange(600) < 4)
    two = make_record(np.column_stack([record.u, record.u[::-1]]), record.y, PERIOD)
    with pytest.raises(UsageError, match="has 1 inputs and 1 outputs, the record 2 and 1"):
        fit_physics(two, "two-tanks")


@pytest.mark.skipif("SYSID_DATA" not in os.environ, reason="real records: set SYSID_DATA to their folder")
def test_a_positioning_stage_runs_free_in_spite_of_its_closed_loop():
    record = read_record(
        Path(os.environ["SYSID_DATA"]) / "emps" / "emps.csv.gz",
        split="split",
        experiment="experiment",
        inputs=("u",),
        outputs=("y",),
    )
    fit = fit_physics(record, "positioning-stage", fixed={"gain": 35.15})
    rows = record.scored_rows("test")
    error = record.y[rows, 0] - fit.predict(record).free_run[rows]
    # A linear model of order 2 reaches 20 mm; this one has no dry friction either.
    assert np.sqrt(np.mean(error**2)) < 0.03


@pytest.mark.skipif("SYSID_DATA" not in os.environ, reason="real records: set SYSID_DATA to their folder")
def test_a_sensor_with_its_own_zero_halves_the_error_of_two_tanks():
    record = read_record(
        Path(os.environ["SYSID_DATA"]) / "cascaded_tanks" / "cascaded_tanks.csv",
        split="split",
        experiment="experiment",
    )
    rows = record.scored_rows("test")
    errors = []
    for name in ("two-tanks", "two-tanks-offset"):
        free_run = fit_physics(record, name).predict(record).free_run
        errors.append(np.sqrt(np.mean((record.y[rows, 0] - free_run[rows]) ** 2)))
    # A linear output-error model with a constant reaches 0.61 V.
    assert errors[1] < 0.63 < errors[0]


def test_a_model_with_several_outputs_is_fitted_to_the_one_of_the_same_name():
    spring = load_model("mass-spring-damper")
    speed = replace(spring.outputs[0], name="speed", unit="m/s", terms=(Term("speed", parse("v", {"v"})),))
    both = replace(spring, outputs=(*spring.outputs, speed))
    rng = np.random.default_rng(3)
    u = excitation(rng, 400)
    truth = {"m": 1.5, "c": 0.7, "k": 6.0}
    y = Simulator(both, PERIOD).run(truth, u)
    for place, name in enumerate(("y", "speed")):
        record = make_record(u, y[:, place], PERIOD, outputs=(name,))
        fit = fit_physics(record, both, start=truth, initial_state="rest")
        assert fit.values == pytest.approx(truth, rel=1e-5)
        assert fit.outputs == (name,)
    with pytest.raises(UsageError, match="has the outputs y, speed and is fitted to them by their names"):
        fit_physics(make_record(u, y[:, 0], PERIOD, outputs=("z",)), both)
