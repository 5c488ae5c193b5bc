"""Thresholds of switches: where they are put in what the rows leave open."""

import numpy as np
import pytest
from scipy.signal import lfilter

import sysid
from sysid.data import make_record
from sysid.diagnosis.diagnose import structure_of
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort
from sysid.physics import load_model

PERIOD = 0.1


def switched(seed=3, n=900, threshold=0.6):
    """A first-order lag behind a switch, and the split; few of the inputs are near the threshold."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.5, 1.5, n // 10), 10)
    x = np.sign(u) * (np.abs(u) > threshold)
    y = lfilter([0.0, 1.0 - np.exp(-PERIOD)], [1.0, -np.exp(-PERIOD)], x)
    y = y + 0.02 * np.std(y) * rng.standard_normal(n)
    return u, y, np.repeat(["est", "val", "test"], [n // 3, n // 3, n // 3])


@pytest.mark.parametrize("family", ["linear", "thermal-first-order"])
def test_a_threshold_stands_between_the_inputs_of_all_rows_that_were_learnt_from(family):
    u, y, split = switched()
    record = make_record(u, y, period=PERIOD, split=split)
    model = "linear" if family == "linear" else load_model(family)
    structure = structure_of(record, model, 1 if family == "linear" else None, "rest")
    (relay,) = find_effects(["in_relay"])
    rows = record.estimation
    choices = [Choice(relay, relay.forms[0])]
    found = structure.fit(choices, rows, WHITE, structure.baseline(rows), effort=Effort.FINE)
    found = structure.fit(choices, record.learning, WHITE, found, effort=Effort.REFIT)
    (threshold,) = found.parameters_of("in_relay")
    levels = np.unique(np.abs(u[record.learning]))
    place = np.searchsorted(levels, 0.6)
    assert threshold.value == pytest.approx(0.5 * (levels[place - 1] + levels[place]), abs=1e-12)


def test_a_limit_below_all_inputs_is_a_relay():
    rng = np.random.default_rng(6)
    u = np.repeat(rng.choice([-1.0, -0.6, -0.2, 0.2, 0.6, 1.0], 240), 5)
    y = lfilter([0.0, 0.2], [1.0, -0.8], np.sign(u)) + 0.01 * rng.standard_normal(u.size)
    record = make_record(u, y, period=PERIOD, split=np.repeat(["est", "val", "test"], 400))
    candidates = ["in_saturation", "in_relay", "in_deadzone", "coloured_noise"]
    found = sysid.diagnose(record, order=1, initial_state="rest", effects=candidates)
    assert found.accepted == ("in_relay",)
    assert "in_saturation" in found.decision.tie  # the record cannot tell them, which is said
