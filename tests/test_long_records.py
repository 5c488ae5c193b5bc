"""Long records are searched on part of their rows and refitted on all."""

import numpy as np
import pytest

from sysid.data import make_record
from sysid.diagnosis import diagnose as module
from sysid.diagnosis.diagnose import diagnose
from sysid.diagnosis.long_records import shortened


def test_each_experiment_keeps_its_share_of_the_rows():
    n = 40_000
    split = np.array(["test"] * 1000 + ["train"] * 27_000 + ["train"] * 9000 + ["test_b"] * 3000)
    experiment = np.array(["a"] * 1000 + ["b"] * 27_000 + ["c"] * 12_000)
    u = np.random.default_rng(0).normal(size=n)
    record = make_record(u, 2 * u, period=1.0, split=split, experiment=experiment)
    short, rows = shortened(record)
    assert short.experiments == ("b", "c")
    assert [part.stop - part.start for part in short.slices] == [4500, 1500]
    assert np.array_equal(record.u[rows], short.u)
    # The last quarter of what is left, for the record's own is further on.
    assert [int(short.validation[part].sum()) for part in short.slices] == [1125, 375]
    assert not short.test_sets


def test_validation_rows_that_the_record_names_stay_so():
    split = np.array(["est"] * 20_000 + ["val"] * 10_000)
    record = make_record(
        np.arange(30_000.0), np.arange(30_000.0), period=1.0, split=split, experiment=split.copy()
    )
    short, _ = shortened(record)
    assert (int(short.estimation.sum()), int(short.validation.sum())) == (4000, 2000)
    assert set(short.y[short.validation, 0]) <= set(record.y[record.validation, 0])


@pytest.mark.parametrize("model", ["linear", "mass-spring-damper"])
def test_the_model_is_refitted_on_all_rows(model, monkeypatch):
    monkeypatch.setattr(module, "LONGEST", 1000)
    monkeypatch.setattr("sysid.diagnosis.long_records.SEARCHED", 900)
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(-2, 2, 480), 5)
    y, z = np.zeros(u.size), np.zeros(2)
    for k in range(u.size):  # semi-implicit Euler steps, ten in a sample
        y[k] = z[1]
        for _ in range(10):
            z[0] += 0.01 * (np.clip(u[k], -1.0, 1.0) - 0.8 * z[0] - 4.0 * z[1])
            z[1] += 0.01 * z[0]
    split = np.array(["train"] * 2000 + ["test"] * 400)
    record = make_record(u, y + 0.004 * rng.standard_normal(u.size), period=0.1, split=split)
    found = diagnose(
        record, model, 2 if model == "linear" else None, effects=["in_saturation", "in_deadzone", "coulomb"]
    )
    assert found.accepted == ("in_saturation",)
    assert found.searched is not None
    assert found.searched.record.n_samples == 900
    assert found.final.fitted.rows.sum() == 2000
    assert found.final.output.size == 2400
    # Noise of 0.004; one run of 400 rows.
    assert found.ladder[-1].scores["test"]["rmse"] == pytest.approx(0.004, rel=0.12)
    assert found.final.fitted.parameters_of("in_saturation")[0].value == pytest.approx(1.0, abs=0.01)
    assert found.to_json()["ranked"][0]["effect"] == "in_saturation"
