"""Several outputs of one physical model, fitted together and compared one by one."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares

from sysid.cli import main
from sysid.data import make_record
from sysid.diagnosis.compare import compare_outputs
from sysid.errors import UsageError
from sysid.physics import Simulator, fit_physics, load_model
from sysid.physics.grammar import parse
from sysid.physics.joint import segments_of
from sysid.physics.model import Output, Term
from sysid.physics.problem import Problem
from sysid.physics.writing import model_text

PERIOD = 0.1
TRUTH = {"m": 2.0, "c": 0.6, "k": 9.0}
NOISE = np.array([0.02, 0.005])


def both():
    """Return the spring with position and speed measured."""
    spring = load_model("mass-spring-damper")
    speed = Output("speed", "m/s", (Term("speed", parse("v", {"v"})),))
    return replace(spring, name="both", outputs=(*spring.outputs, speed))


def measured(seed=0, n=500):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(n // 5), 5)
    y = Simulator(both(), PERIOD).run(TRUTH, u) + NOISE * rng.standard_normal((n, 2))
    split = np.repeat(["train", "test"], [4 * n // 5, n - 4 * n // 5])
    units = {"u": "N", "y": "m", "speed": "m/s"}
    return make_record(u, y, PERIOD, name="both", outputs=("y", "speed"), split=split, units=units)


def independent_fit(record):
    """Return weighted least squares with the true noise, the recursion written out by hand."""
    u, y = record.u[record.learning, 0], record.y[record.learning]

    def errors(p):
        m, c, k = p
        whole = expm(PERIOD * np.array([[0, 1, 0], [-k / m, -c / m, 1 / m], [0, 0, 0]]))
        x, found = np.zeros(2), np.empty_like(y)
        for i, force in enumerate(u):
            found[i] = x
            x = whole[:2, :2] @ x + whole[:2, 2] * force
        return ((found - y) / NOISE).ravel()

    return least_squares(errors, list(TRUTH.values()), x_scale=list(TRUTH.values())).x


def test_joint_fit_is_that_of_known_noise():
    """Weights are estimated from 400 rows each, to 4 %: that moves the estimate by little."""
    record = measured()
    fit = fit_physics(record, both(), start=TRUTH, initial_state="rest")
    expected = independent_fit(record)
    for (value, error), other in zip(fit.parameters().values(), expected, strict=True):
        assert abs(value - other) < 0.2 * error
    assert fit.rms_of == pytest.approx(NOISE, rel=0.15)
    assert fit.converged
    assert fit.restarts_agree


def test_standard_errors_are_those_of_repetitions():
    """30 records: the mean square of three z-scores each lies in the 99.9 % band of a chi-square with 90."""
    z = []
    for seed in range(30):
        fit = fit_physics(measured(seed, 250), both(), start=TRUTH, initial_state="rest")
        z += [(value - TRUTH[name]) / error for name, (value, error) in fit.parameters().items()]
    assert 0.55 < np.mean(np.square(z)) < 1.6


def test_two_outputs_tell_more_than_one():
    record = measured()
    options = {"start": TRUTH, "initial_state": "rest"}
    together = fit_physics(record, both(), **options).uncertainty.standard_errors
    for name in record.outputs:
        alone = fit_physics(record.of_output(name), both(), **options).uncertainty.standard_errors
        assert np.all(together < alone)


def test_derivatives_agree_with_differences():
    """Central differences of step 1e-6: truncation and rounding stay below 1e-7 of the largest derivative."""
    record = measured(n=100)
    problem = Problem(both(), segments_of(record, None), PERIOD, True, weights=1.0 / NOISE)
    point = problem.point(problem.coordinates(TRUTH))
    J, step = problem.jacobian(point), 1e-6
    for i in range(point.size):
        away = np.zeros(point.size)
        away[i] = step
        slope = (problem.residual(point + away) - problem.residual(point - away)) / (2.0 * step)
        np.testing.assert_allclose(J[:, i], slope, atol=1e-6 * np.abs(J[:, i]).max())


def test_initial_states_come_from_all_outputs():
    """Free starts: the prediction has a column for each output, at the level of its noise."""
    record = measured()
    prediction = fit_physics(record, both(), start=TRUTH).predict(record)
    error = (prediction.free_run - record.y)[record.scored_rows("test")]
    assert prediction.one_step.shape == record.y.shape
    assert np.sqrt(np.mean(error**2, axis=0)) == pytest.approx(NOISE, rel=0.25)


def test_exact_outputs_are_fitted_too():
    """Without noise the weights end at their bound and the truth comes back."""
    u = np.random.default_rng(1).standard_normal(200)
    record = make_record(u, Simulator(both(), PERIOD).run(TRUTH, u), PERIOD, outputs=("y", "speed"))
    fit = fit_physics(record, both(), start={"m": 2.2, "c": 0.5, "k": 8.0}, initial_state="rest")
    assert fit.values == pytest.approx(TRUTH, rel=1e-5)


def test_names_of_outputs_tell_which_they_are():
    swapped = measured()
    record = replace(swapped, y=swapped.y[:, ::-1].copy(), outputs=("speed", "y"))
    fit = fit_physics(record, both(), start=TRUTH, initial_state="rest")
    assert fit.rms_of == pytest.approx(NOISE[::-1], rel=0.15)
    with pytest.raises(UsageError, match=r"has the outputs y, speed and is fitted to them by their names"):
        fit_physics(replace(record, outputs=("speed", "z")), both())
    with pytest.raises(UsageError, match="the record has no output 'z': it has speed, y"):
        record.of_output("z")


def test_each_output_is_compared_with_the_joint_model():
    record = measured()
    found = compare_outputs(record, both(), start=TRUTH, initial_state="rest", ports=False)
    assert [one.record.outputs for one in found] == [("y",), ("speed",)]
    assert found[0].model.parameters == found[1].model.parameters
    for one, noise in zip(found, NOISE, strict=True):
        assert one.score_of("test").free_run.rmse == pytest.approx(noise, rel=0.25)
        assert one.where == ()
        assert any("fitted together" in sentence for sentence in one.sentences())


def test_command_fits_the_outputs_together(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    record = measured(n=300)
    (tmp_path / "both.toml").write_text(model_text(both()))
    columns = zip(record.u[:, 0], *record.y.T, record.split, strict=True)
    rows = [",".join(map(str, row)) for row in columns]
    (tmp_path / "both.csv").write_text("\n".join(["u,y,speed,set", *rows]))
    call = ["compare", "both.csv", "--output", "y", "--output", "speed", "--period", "0.1"]
    call += ["--split-column", "set", "--model", "both.toml", "--param", "m=2", "--param", "c=0.5"]
    assert main([*call, "--param", "k=9", "--json", "both.json"]) == 0
    assert "Side by side" in capsys.readouterr().out
    contents = [json.loads((tmp_path / f"both.{name}.json").read_text()) for name in record.outputs]
    assert contents[0]["model"]["parameters"] == contents[1]["model"]["parameters"]
    assert contents[0]["model"]["fitted_outputs"] == ["y", "speed"]
    assert {path.name for path in (tmp_path / "sysid-out").iterdir()} == {
        "both.compare.y.html",
        "both.compare.speed.html",
    }
