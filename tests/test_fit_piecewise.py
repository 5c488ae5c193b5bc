"""`sysid fit --structure piecewise-affine`: what it finds, says, saves and refuses."""

import json
from pathlib import Path

import numpy as np
import pytest

from sysid.cli import main
from sysid.data import make_record
from sysid.diagnosis.models.piecewise import fit_piecewise_structure
from sysid.errors import DataError, ModelError, UsageError
from sysid.lft import PiecewiseLft, PiecewiseStructure, load
from sysid.nonlinearities.piecewise_affine import PiecewiseAffineMap

ROWS = 700
Z = (("y", 2), ("u", 2))
GIVEN = {"z_lags": Z, "n_a": 1, "n_g": 1, "b_lags": (("u", 1),)}


def plant():
    map_ = PiecewiseAffineMap([[0.5, 1.0, -0.25], [-0.7, 1.5, 0.0]], [[0.0, 0.0, 0.0], [1.5, -0.5, 1.0]])
    return PiecewiseLft.of(PiecewiseStructure(1, (1,), 1, Z), [-0.4, 1.2, -0.5], map_)


def signals(seed=0, noise=0.1):
    rng = np.random.default_rng(seed)
    u = rng.uniform(-1, 1, ROWS)
    return u, plant().simulate(u, rng.uniform(-noise, noise, ROWS))


def record(**changes):
    u, y = signals()
    split = np.where(np.arange(ROWS) < 550, "train", "test")
    return make_record(u, y, period=0.1, split=split, **changes)


def test_the_plant_is_found_from_python():
    found = fit_piecewise_structure(record(), GIVEN)
    errors = found.fit.std_errors
    for name, true in plant().values.items():
        assert abs(found.model.values[name] - true) < 4.5 * errors[name]
    assert found.model.map.modes == 2
    assert "chosen by the one-step error on validation rows" in found.reason
    assert found.converged
    assert any("appears" not in note for note in found.notes)


def test_one_step_predictions_use_the_measured_past_and_free_runs_do_not():
    u, y = signals()
    measured = record()
    found = fit_piecewise_structure(measured, {**GIVEN, "modes": 2})
    prediction = found.predict(measured)
    first = found.model.structure.first
    assert np.allclose(prediction.one_step[first:], found.model.one_step(u, y)[first:], atol=1e-12)
    assert np.allclose(prediction.free_run, found.model.simulate(u, initial=y[:first]), atol=1e-12)
    rest = fit_piecewise_structure(measured, {**GIVEN, "modes": 2}, initial_state="rest")
    assert np.allclose(rest.predict(measured).free_run, rest.model.simulate(u), atol=1e-12)
    assert rest.predict(measured).starts == ("at rest",)


def test_rows_that_are_not_measured_are_predicted():
    u, y = signals()
    y = y.copy()
    y[600:650] = np.nan
    split = np.where(np.arange(ROWS) < 550, "train", "test")
    gap = make_record(u, y, period=0.1, split=split)
    prediction = fit_piecewise_structure(gap, {**GIVEN, "modes": 2}).predict(gap)
    assert np.isfinite(prediction.one_step).all()
    assert np.isfinite(prediction.free_run).all()


def test_a_bound_on_the_error_finds_the_number_of_modes():
    found = fit_piecewise_structure(record(), {**GIVEN, "stage": "bounded-error", "delta": 0.4})
    assert found.model.map.modes >= 2
    assert "bound on the error" in found.reason
    with pytest.raises(UsageError, match="give --delta"):
        fit_piecewise_structure(record(), {**GIVEN, "stage": "bounded-error"})


def test_wrong_options_are_refused():
    with pytest.raises(UsageError, match="name them by --z"):
        fit_piecewise_structure(record(), {})
    with pytest.raises(ModelError, match="'v' is no signal"):
        fit_piecewise_structure(record(), {"z_lags": (("v", 1),)})
    with pytest.raises(ModelError, match="names the output"):
        fit_piecewise_structure(record(), {**GIVEN, "b_lags": (("y", 1),)})
    rng = np.random.default_rng(1)
    two = make_record(rng.standard_normal((50, 2)), rng.standard_normal(50), period=1.0, split=["train"] * 50)
    with pytest.raises(DataError, match="2 inputs"):
        fit_piecewise_structure(two, GIVEN)


def test_the_command_fits_saves_and_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch):
    monkeypatch.chdir(tmp_path)
    u, y = signals()
    lines = [
        f"{a},{b},{'train' if k < 550 else 'test'}"
        for k, (a, b) in enumerate(zip(u.tolist(), y.tolist(), strict=True))
    ]
    Path("data.csv").write_text("\n".join(["u,y,set", *lines]) + "\n")
    call = ["fit", "data.csv", "--period", "0.1", "--split-column", "set", "--structure", "piecewise-affine"]
    given = ["--z", "y:2,u:2", "--b-lags", "1", "--g-order", "1", "--modes", "2"]
    assert main([*call, *given, "--save", "model.json", "--json", "fit.json"]) == 0
    said = capsys.readouterr().out
    assert "A linear model around a piecewise affine map of y(k-2), u(k-2) explains" in said
    content = json.loads(Path("fit.json").read_text())
    model = load("model.json")
    assert isinstance(model, PiecewiseLft)
    assert content["model"]["model"]["linear"] == model.linear.tolist()
    assert "w(k) = theta1_1 y(k-2)" in Path("sysid-out/data.fit.html").read_text()
    assert main([*call, "--z", "y:1"]) == 2
    assert "y(k-1) appears in both A(q) y (a1) and w(k)" in capsys.readouterr().err
    assert main([*call, "--z", "y:2", "--delta", "-1"]) == 2
    assert "give a positive number" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"schema": 9}, "another kind or version"),
        ({"linear": [1.0]}, "3 finite values"),
        ({"map": {}}, "theta"),
    ],
)
def test_a_file_that_is_no_model_is_refused(tmp_path: Path, change, words):
    from sysid.lft.piecewise_files import to_json

    path = tmp_path / "model.json"
    path.write_text(json.dumps({**to_json(plant()), **change}))
    with pytest.raises(DataError, match=words):
        load(path)
