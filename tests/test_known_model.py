"""A saved model on another record: judged as it is, its initial states found, nothing else fitted."""

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import sysid
from sysid.cli import main
from sysid.data import make_record
from sysid.diagnosis.export.saved_effects import SavedEffect
from sysid.diagnosis.export.saved_linear import SavedModel
from sysid.diagnosis.export.saved_physics import SavedPhysicalModel
from sysid.errors import SysidError, UsageError
from sysid.physics import load_model
from sysid.physics.writing import model_text

PERIOD = 0.1
LIMIT = SavedEffect("in_saturation", "symmetric", {"level": 0.5})
DRAG = SavedEffect("quad_drag", "drag", {"c": 0.4})
MASS = {"m": 1.0, "c": 0.3, "k": 2.0}


def difference_equation(u, y_before, u_before, noise=0.0, seed=0):
    """Simulate y(k) = 1.2 y(k-1) - 0.5 y(k-2) + 0.3 x(k-1) + 0.1 x(k-2) + 0.2 sample by sample."""
    x = np.clip(np.concatenate([u_before, u]), -0.5, 0.5)
    y = np.concatenate([y_before, np.zeros(u.size)])
    for k in range(2, y.size):
        y[k] = 1.2 * y[k - 1] - 0.5 * y[k - 2] + 0.3 * x[k - 1] + 0.1 * x[k - 2] + 0.2
    return y[2:] + noise * np.random.default_rng(seed).standard_normal(u.size)


def saved_linear():
    return SavedModel((-1.2, 0.5), (0.3, 0.1), 0.2, PERIOD, (LIMIT,))


def saved_mass(period=PERIOD):
    model = load_model("mass-spring-damper").with_parameters(fixed=MASS)
    return SavedPhysicalModel(model_text(model), period, "zero", 4, (DRAG,))


def moving_mass(u, start, period):
    """Integrate m x'' = u - c x' - k x - s x' |x'| by another solver, the input held between samples."""
    state, y = np.array(start), []
    for value in u:
        y.append(state[0])
        acting = lambda t, z, value=value: [  # noqa: E731
            z[1],
            (value - MASS["c"] * z[1] - MASS["k"] * z[0] - 0.4 * z[1] * abs(z[1])) / MASS["m"],
        ]
        state = solve_ivp(acting, (0.0, period), state, rtol=1e-10, atol=1e-12).y[:, -1]
    return np.array(y)


def test_a_saved_linear_model_finds_the_state_of_each_experiment_and_nothing_else():
    rng = np.random.default_rng(3)
    u = rng.uniform(-1.0, 1.0, 300)
    parts = [
        difference_equation(u[:150], [2.0, 1.0], [0.3, -0.2]),
        difference_equation(u[150:], [-1.0, 3.0], [0.0, 0.4]),
    ]
    record = make_record(u, np.concatenate(parts), PERIOD, experiment=np.repeat(["a", "b"], 150))
    found = sysid.compare(record, saved_linear())
    # Two values before each experiment determine the state: what is left is the tolerance of the search.
    assert found.judged == "test"
    assert found.score_of("test").n_rows == 300
    assert found.score_of("test").free_run.rmse < 1e-6 * np.std(record.y)
    assert found.score_of("test").fitted_on == "no row of this record"
    assert found.model.parameters["in_saturation.level"].value == 0.5
    assert found.model.parameters["b1"].std_error is None
    assert "The parameters are those of in memory; of this record only initial" in found.sentences()[-1]


@pytest.mark.parametrize("period", [0.1, 0.25])
def test_a_saved_physical_model_runs_at_any_period_from_a_state_that_is_found(period):
    u = np.repeat(np.random.default_rng(1).uniform(-2.0, 2.0, 20), 6)
    y = moving_mass(u, [1.5, -2.0], period)
    found = sysid.compare(make_record(u, y, period), saved_mass())
    # The steps of the saved model: four of a tenth of a second or so, of fourth order.
    assert found.score_of("test").free_run.rmse < 1e-4 * np.std(y)
    rested = sysid.compare(make_record(u, y, period), saved_mass(), initial_state="rest")
    assert rested.score_of("test").free_run.rmse > 0.1 * np.std(y)


def test_tanks_that_begin_full_are_followed():
    """A full tank does not feel a small change of its level: the search begins at states that are passed."""
    names = ("limit_1", "limit_2", "caught")
    overflow = SavedEffect("overflow", "cascade", dict(zip(names, [3.0, 2.0, 0.4], strict=True)))
    tanks = SavedPhysicalModel(model_text(load_model("two-tanks")), 1.0, "zero", 2, (overflow,))
    u = np.repeat(np.abs(np.random.default_rng(2).uniform(0.0, 3.0, 30)), 10)
    y = tanks.simulate(u, [2.9, 1.9])
    found = sysid.compare(make_record(u, y, 1.0), tanks)
    assert found.score_of("test").free_run.rmse < 1e-5 * np.std(y)


def test_rows_that_are_marked_keep_their_sets_and_the_noise_its_size(tmp_path):
    rng = np.random.default_rng(5)
    u = rng.uniform(-1.0, 1.0, 2000)
    y = difference_equation(u, [0.0, 0.0], [0.0, 0.0], noise=0.05)
    record = make_record(u, y, PERIOD, split=np.repeat(["train", "test"], [1500, 500]))
    sysid.save(saved_linear(), tmp_path / "model.json")
    found = sysid.compare(record, tmp_path / "model.json")
    assert [score.name for score in found.scores] == ["train", "validation", "test"]
    # Of 500 rows the root mean square of white noise has a relative deviation of 3 %.
    assert found.score_of("test").free_run.rmse == pytest.approx(0.05, rel=0.12)
    assert "model.json" in found.to_html()
    assert found.to_json()["model"]["effects"][0]["name"] == "in_saturation"


def test_a_saved_model_that_does_not_fit_the_record_is_refused(tmp_path):
    u = np.random.default_rng(0).uniform(-1.0, 1.0, 200)
    with pytest.raises(UsageError, match=r"sampled at 0\.2 s and the saved difference equation at 0\.1 s"):
        sysid.compare(make_record(u, u, 0.2), saved_linear())
    with pytest.raises(UsageError, match="2 inputs"):
        sysid.compare(make_record(np.column_stack([u, u]), u, PERIOD), saved_linear())


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--order", "2"], "leave 'order' out"),
        (["--fix", "m=1"], "leave 'm' out"),
        (["--constant", "yes"], "neither a delay nor a constant"),
    ],
)
def test_options_of_a_fit_are_refused_beside_a_saved_model(tmp_path, capsys, monkeypatch, extra, message):
    monkeypatch.chdir(tmp_path)
    u = np.random.default_rng(0).uniform(-1.0, 1.0, 200)
    rows = "\n".join(f"{a},{b}" for a, b in zip(u, u, strict=True))
    (tmp_path / "case.csv").write_text(f"u,y\n{rows}\n")
    sysid.save(saved_linear(), tmp_path / "model.toml")
    assert main(["compare", "case.csv", "--period", "0.1", "--model", "model.toml", *extra]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_a_diagnosis_goes_on_from_a_saved_model():
    """A limit is in the saved model, an offset of the sensor came after: only that is found missing."""
    rng = np.random.default_rng(7)
    u = rng.uniform(-1.0, 1.0, 1200)
    y = difference_equation(u, [0.0, 0.0], [0.0, 0.0], noise=0.02)
    y += 0.3 * (y - np.mean(y)) ** 2
    record = make_record(u, y, PERIOD)
    found = sysid.diagnose(record, saved_linear(), effects=["in_deadzone", "out_quadratic", "in_delay"])
    assert found.accepted == ("in_saturation", "out_quadratic")
    assert found.sentences()[0] == "Missing in the model with in_saturation: out_quadratic."
    assert found.advice.startswith("out_quadratic was added. The model is kept with --save")
    limit = found.final.fitted.parameters_of("in_saturation")[0]
    assert abs(limit.value - 0.5) < 4 * limit.std_error


def test_a_diagnosis_goes_on_from_a_saved_physical_model(tmp_path):
    u = np.repeat(np.random.default_rng(1).uniform(-2.0, 2.0, 100), 6)
    y = moving_mass(u, [0.0, 0.0], PERIOD)
    y += 0.01 * np.std(y) * np.random.default_rng(2).standard_normal(y.size)
    sysid.save(saved_mass(), tmp_path / "mass.toml")
    found = sysid.diagnose(
        make_record(u, y, PERIOD), tmp_path / "mass.toml", effects=["coulomb", "out_offset"]
    )
    assert found.accepted == ("quad_drag",)
    assert found.sentences()[0] == "With quad_drag, which was given, nothing further is missing."
    (drag,) = found.final.fitted.parameters_of("quad_drag")
    assert abs(drag.value - 0.4) < 4 * drag.std_error


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"a": []}, "0 coefficients a and 2 b"),
        ({"period": -1.0}, "period: -1 is no positive number"),
        ({"constant": float("nan")}, "coefficients: nan is no finite number"),
        ({"effects": [{"name": "in_saturation", "form": "symmetric", "parameters": {}}]}, "'level'"),
        (
            {"effects": [LIMIT.to_json() | {"parameters": {"level": -0.5}}]},
            "in_saturation.level is -0.5, and must be between 0 and inf",
        ),
        (
            {"effects": [{"name": "nothing", "form": "x", "parameters": {}}]},
            "effect 'nothing' that is not installed here",
        ),
        ({"kind": "sysid-lft-model"}, "it holds 'sysid-lft-model'"),
    ],
)
def test_a_saved_model_that_was_changed_by_hand_is_one_sentence(tmp_path, changed, message):
    file = tmp_path / "model.json"
    file.write_text(json.dumps(saved_linear().to_json() | changed))
    with pytest.raises(SysidError) as caught:
        sysid.load(file)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"substeps": 0}, "substeps: 0 is no positive number"),
        ({"hold": "odd"}, "hold is 'odd', choose one of zero, smooth"),
        ({"model": "x"}, "is not TOML"),
    ],
)
def test_a_saved_physical_model_that_was_changed_by_hand_is_one_sentence(tmp_path, changed, message):
    file = tmp_path / "model.json"
    file.write_text(json.dumps(saved_mass().to_json() | changed))
    with pytest.raises(SysidError) as caught:
        sysid.load(file)
    assert message in str(caught.value)
