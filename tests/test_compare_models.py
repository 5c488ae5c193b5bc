"""Comparison of physical models: fitted on estimation rows, judged on held-out ones."""

import json
from pathlib import Path

import numpy as np
import pytest

from sysid.cli import main
from sysid.data import make_record
from sysid.diagnosis.compare import compare
from sysid.diagnosis.models.resolution import resolve_model
from sysid.errors import ModelError, UsageError
from sysid.physics import Simulator, load_model

TRUTH = {"m": 2.0, "c": 0.6, "k": 9.0}


def spring(n=600, noise=0.002, seed=0):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(n // 5), 5)
    y = Simulator(load_model("mass-spring-damper"), 0.1).run(TRUTH, u)[:, 0]
    split = np.repeat(["train", "test"], [2 * n // 3, n - 2 * n // 3])
    units = {"u": "N", "y": "m"}
    return make_record(u, y + noise * rng.standard_normal(n), 0.1, name="spring", split=split, units=units)


@pytest.fixture(scope="module")
def comparison():
    return compare(spring(), "mass-spring-damper", fixed={"m": 2.0}, start={"c": 0.5}, initial_state="rest")


def test_physical_model_is_fitted_and_judged(comparison):
    """The parameters come back within four standard errors, and the error is the noise."""
    content = json.loads(json.dumps(comparison.to_json(), allow_nan=False))
    parameters = content["model"]["parameters"]
    for name in "ck":
        assert abs(parameters[name]["value"] - TRUTH[name]) < 4.0 * parameters[name]["std_error"]
    assert parameters["m"] == {"value": 2.0, "std_error": None, "unit": "kg"}
    assert content["model"]["name"] == "mass-spring-damper"
    assert content["model"]["order"] == 2
    assert content["model"]["restarts_agree"]
    assert content["scores"]["test"]["rmse"] == pytest.approx(0.002, rel=0.15)
    assert content["scores"]["validation"]["fitted_on"] == "estimation rows"


def test_sentences_and_page_speak_of_the_physical_model(comparison):
    assert comparison.sentences()[0].startswith("The model mass-spring-damper explains 99.")
    assert any("m is fixed" in sentence for sentence in comparison.sentences())
    page = comparison.to_html()
    assert "m v&#39; = u - c*v - k*x" in page
    assert "N s/m" in page
    assert '<th scope="col">pole</th>' not in page


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"model": "duffing"}, UsageError, "'duffing' is not known: choose one of linear, dc-motor, "),
        ({"model": 3}, UsageError, "model is of type int"),
        ({"model": "two-tanks", "order": 3}, UsageError, "order is 3 and model 'two-tanks' has 2 states"),
        (
            {"model": "two-tanks", "start": {"k": 1.0}},
            ModelError,
            "no parameter 'k': choose one of a1, a2, b",
        ),
        ({"model": "two-tanks", "fixed": {"a1": -1.0}}, ModelError, "start is -1: give a number from 0"),
        ({"model": "linear", "fixed": {"a1": 1.0}}, UsageError, "the linear model has no parameter 'a1'"),
    ],
)
def test_wrong_models_and_parameters_are_told(arguments, error, message):
    with pytest.raises(error, match=message):
        resolve_model(**arguments)


def test_linear_options_do_not_belong_to_a_physical_model():
    with pytest.raises(UsageError, match="delay belongs to the linear model"):
        compare(spring(100), "mass-spring-damper", delay=2)


def test_one_output_is_compared_at_a_time():
    u = np.random.default_rng(0).standard_normal(100)
    with pytest.raises(UsageError, match=r"2 outputs \(y1, y2\) and one is compared at a time"):
        compare(make_record(u, np.column_stack([u, u**2]), 1.0))


def test_command_takes_physical_models(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    record = spring(300)
    rows = [
        f"{u:.8f},{y:.8f},{s}" for u, y, s in zip(record.u[:, 0], record.y[:, 0], record.split, strict=True)
    ]
    Path("spring.csv").write_text("u,y,set\n" + "\n".join(rows) + "\n")
    common = ["compare", "spring.csv", "--period", "0.1", "--split-column", "set", "--initial-state", "rest"]
    model = ["--model", "mass-spring-damper", "--param", "c=0.5", "--param", "k=8", "--fix", "m=2"]
    assert main([*common, *model, "--json", "s.json"]) == 0
    assert capsys.readouterr().out.startswith("The model mass-spring-damper explains ")
    assert json.loads(Path("s.json").read_text())["model"]["parameters"]["k"]["value"] == pytest.approx(
        9, rel=0.05
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--param", "c"], "--param 'c' has no value: write --param NAME=VALUE"),
        (["--fix", "c=much"], "--fix 'c=much': 'much' is no number"),
        (["--fix", "c=inf"], "--fix 'c=inf': 'inf' is not finite"),
        (["--fix", "c=1", "--fix", "c=2"], "--fix gives 'c' twice"),
        (["--fix", "z=1"], "no parameter 'z': choose one of m, c, k"),
        (["--fix", "c=1", "--param", "c=1"], "'c' has a start and a fixed value"),
    ],
)
def test_wrong_assignments_end_in_one_sentence(options, message, capsys):
    assert main(["compare", "none.csv", "--model", "mass-spring-damper", *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_a_nonlinear_physical_model_has_no_curves_and_the_page_says_why(tmp_path):
    path = tmp_path / "bent.toml"
    path.write_text(
        'name = "bent"\ntitle = "Bent drain"\n[states]\nx = { unit = "m" }\n[inputs]\nu = { unit = "N" }\n'
        "[outputs.y]\n"
        'unit = "m"\nterms = { "level" = "x" }\n[[equations]]\nstate = "x"\nunit = "m/s"\n'
        'terms = { "push" = "u", "drain" = "-a*x - b*x**3" }\n[parameters]\n'
        'a = { unit = "1/s", start = 1.0 }\nb = { unit = "1/(m^2 s)", start = 0.1 }\n'
    )
    rng = np.random.default_rng(0)
    u, y = rng.standard_normal(300), np.zeros(300)
    for k in range(1, 300):
        y[k] = y[k - 1] + 0.1 * (u[k - 1] - y[k - 1] - 0.2 * y[k - 1] ** 3)
    y += 0.01 * rng.standard_normal(300)
    comparison = compare(make_record(u, y, 0.1, split=np.repeat(["train", "test"], 150)), path)
    assert comparison.ports == ()
    (note,) = (warning for warning in comparison.warnings if "Free-form curves" in warning)
    assert "not linear in state and input" in note
    assert note in comparison.to_json()["warnings"]
