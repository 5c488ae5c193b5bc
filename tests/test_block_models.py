"""Block-structured models as models to compare: each finds the system it is made for."""

import numpy as np
import pytest
from scipy import signal

from sysid.data import make_record
from sysid.diagnosis.compare import compare
from sysid.diagnosis.models.block_models import BLOCK_MODELS
from sysid.diagnosis.models.resolution import resolve_model
from sysid.errors import UsageError

NOISE = 0.02


def record(name, n=700, seed=1):
    rng = np.random.default_rng(seed)
    u = signal.lfilter([1.0], [1.0, -0.5], rng.standard_normal(n))
    slow = ([0.0, 0.3], [1.0, -0.7])
    if name == "piecewise-affine":
        y = np.zeros(n)
        for k in range(1, n):
            y[k] = (0.8 if y[k - 1] > 0.0 else 0.3) * y[k - 1] + u[k - 1]
    elif name == "lft":
        y = np.zeros(n)
        for k in range(2, n):
            y[k] = 0.6 * y[k - 1] - 0.3 * y[k - 2] + np.tanh(u[k - 1])
    else:
        y = np.tanh(1.5 * u) if name == "hammerstein" else np.tanh(1.5 * signal.lfilter(*slow, u))
        y = y if name == "wiener" else signal.lfilter([0.0, 0.4], [1.0, -0.6], y)
    y = y + NOISE * y.std() * rng.standard_normal(n)
    return make_record(u, y, 0.1, split=np.repeat(["train", "test"], [500, n - 500]))


# Wiener-Hammerstein models have tests of their own.
@pytest.mark.parametrize(
    "model", [m for m in BLOCK_MODELS if m.name != "wiener-hammerstein"], ids=lambda model: model.name
)
def test_each_model_finds_the_system_it_is_made_for(model):
    order = 2 if model.name == "lft" else 1
    found = compare(record(model.name), model.name, order, ports=False)
    straight = compare(record(model.name), "linear", ports=False)
    error = found.score_of("test").free_run.nrmse
    assert error < 2.5 * NOISE  # noise is amplified a little where a one-step fit is run free
    assert error < 0.5 * straight.score_of("test").free_run.nrmse
    assert found.model.name == model.name
    assert found.to_json()["model"]["name"] == model.name
    if model.name != "lft":  # which is said to be what it has become: here of the Hammerstein kind
        assert model.name.split("-")[0] in found.model.title.lower()


def test_orders_are_chosen_where_none_is_given():
    found = compare(record("wiener"), "wiener", ports=False)
    assert found.model.fit.orders[1] == 0
    assert found.score_of("test").free_run.nrmse < 2.0 * NOISE


def test_options_that_do_not_belong_are_refused():
    made = record("lft")
    with pytest.raises(UsageError, match="constant belongs to the linear model"):
        compare(made, "lft", constant=True)
    with pytest.raises(UsageError, match="the piecewise-affine model chooses its own delay"):
        compare(made, "piecewise-affine", delay=2)
    with pytest.raises(UsageError, match="hammerstein, wiener, wiener-hammerstein, lft, piecewise-affine"):
        resolve_model("lftt")
