"""Comparison with local linear models, by name and number."""

import json

import numpy as np
import pytest

from sysid.data import make_record
from sysid.diagnosis.compare import compare
from sysid.diagnosis.models.resolution import resolve_model
from sysid.errors import UsageError


def bent(n=500):
    rng = np.random.default_rng(0)
    u, y = np.repeat(rng.uniform(-2, 2, n // 5), 5), np.zeros(n)
    for k in range(n - 1):
        y[k + 1] = 0.7 * y[k] + np.tanh(2.0 * u[k])
    y += 0.02 * rng.standard_normal(n)
    return make_record(u, y, 0.1, split=np.repeat(["train", "test"], [n - 150, 150]), units={"u": "V"})


def test_local_linear_models_are_compared():
    record = bent()
    comparison = compare(record, "local-linear-3", 1, ports=False)
    # A linear model of this order leaves 39 % of the signal.
    assert comparison.score_of("test").free_run.nrmse < 0.1
    assert comparison.sentences()[0].startswith("A mixture of 3 first-order local linear models explains ")
    content = json.loads(json.dumps(comparison.to_json(), allow_nan=False))
    assert content["model"]["order"] == 1
    assert content["model"]["local_models"] == 3
    assert content["model"]["parameters"]["c1"]["unit"] == "V"
    assert content["scores"]["validation"]["fitted_on"] == "estimation rows"
    assert "scheduled by u" in comparison.to_html()


def test_names_and_options():
    assert resolve_model("local-linear") == "local-linear"
    assert resolve_model("local-linear-12") == "local-linear-12"
    with pytest.raises(
        UsageError, match=r"'local-linear-0' is not known: choose one of linear, .*local-linear"
    ):
        resolve_model("local-linear-0")
    with pytest.raises(UsageError, match="delay and constant belong to the linear model"):
        compare(bent(300), "local-linear", delay=1)
