"""A zero of the sensor in the comparison of a physical model: told by the rows, asked for, or left out."""

import numpy as np
import pytest
from test_compare_models import TRUTH

from sysid.cli import main
from sysid.data import make_record
from sysid.diagnosis.compare import compare
from sysid.diagnosis.models.sensor_zero import has_constant, with_sensor_zero
from sysid.physics import Simulator, load_model

NOISE = 0.002


def spring(zero, n=600, seed=0):
    """Return a record of a spring whose sensor reads ``zero`` at rest."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(n // 5), 5)
    y = zero + Simulator(load_model("mass-spring-damper"), 0.1).run(TRUTH, u)[:, 0]
    split = np.repeat(["train", "test"], [2 * n // 3, n - 2 * n // 3])
    units = {"u": "N", "y": "m"}
    return make_record(u, y + NOISE * rng.standard_normal(n), 0.1, name="spring", split=split, units=units)


def judged(record, **options):
    return compare(record, "mass-spring-damper", fixed={"m": 2.0}, ports=False, **options)


def test_zero_of_the_sensor_is_found():
    """The zero and the stiffness hold the truth within four standard errors, and the error is the noise."""
    comparison = judged(spring(0.05))
    found = comparison.model.parameters
    assert abs(found["sensor_zero"].value - 0.05) < 4.0 * found["sensor_zero"].std_error
    assert abs(found["k"].value - TRUTH["k"]) < 4.0 * found["k"].std_error
    assert found["sensor_zero"].unit == "m"
    assert comparison.score_of("test").free_run.rmse == pytest.approx(NOISE, rel=0.15)
    assert any(
        "The sensor reads" in sentence and "--constant no" in sentence for sentence in comparison.sentences()
    )
    assert "y = x + sensor_zero" in comparison.model.equations


@pytest.mark.parametrize("options", [{"constant": False}, {"initial_state": "rest"}])
def test_zero_is_left_out_where_it_is_refused(options):
    comparison = judged(spring(0.05), **options)
    assert "sensor_zero" not in comparison.model.parameters
    assert comparison.score_of("test").free_run.rmse > 5.0 * NOISE


def test_zero_that_is_asked_for_is_there():
    found = judged(spring(0.0), constant=True).model.parameters["sensor_zero"]
    assert abs(found.value) < 4.0 * found.std_error


def test_model_stays_as_it_is_where_the_sensor_reads_right():
    """Four standard errors: none of five records has a zero."""
    names = [judged(spring(0.0, seed=seed)).model.parameters for seed in range(5)]
    assert not any("sensor_zero" in found for found in names)


def test_models_with_a_constant_get_no_second_one():
    assert has_constant(load_model("two-tanks-offset"))
    assert not has_constant(load_model("two-tanks"))
    assert has_constant(with_sensor_zero(load_model("two-tanks")))
    assert not has_constant(load_model("two-tanks-offset").with_parameters(fixed={"offset": 0.0}))
    known = load_model("two-tanks").with_parameters(start={"a1": 0.1, "a2": 0.1, "b": 0.1})
    assert with_sensor_zero(known).parameter("sensor_zero").status == "uncertain"


def test_command_leaves_the_zero_out(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    record = spring(0.05, n=300)
    rows = [f"{u},{y},{s}" for u, y, s in zip(record.u[:, 0], record.y[:, 0], record.split, strict=True)]
    (tmp_path / "spring.csv").write_text("\n".join(["u [N],y [m],set", *rows]))
    call = ["compare", "spring.csv", "--period", "0.1", "--split-column", "set"]
    call += ["--model", "mass-spring-damper", "--fix", "m=2"]
    assert main([*call, "--constant", "no"]) == 0
    assert "sensor_zero" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "model", "linear"), [("cascaded_tanks", "two-tanks", 0.61), ("silverbox", "oscillator", 7.0e-3)]
)
def test_grey_boxes_fit_real_records_as_the_linear_model_does(records, name, model, linear):
    """The linear model's free-run error on the test rows, measured elsewhere: grey boxes come as near."""
    from sysid.data import read_record

    path = next(path for path in (records / name).iterdir() if ".csv" in path.name)
    record = read_record(path, split="split", experiment="experiment")
    comparison = compare(record, model, ports=False)
    scored = {"cascaded_tanks": "test", "silverbox": "test_multisine"}[name]
    assert comparison.score_of(scored).free_run.rmse < 1.01 * linear
