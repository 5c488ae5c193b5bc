"""Thresholds of switches: where they are put in what the rows leave open, and how well they are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import sysid
from sysid.data import make_record
from sysid.diagnosis.diagnose import structure_of
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort
from sysid.diagnosis.structures.thresholds import threshold_error
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


def test_the_interval_of_a_threshold_holds_it_under_loud_noise():
    """A step in noise, its height known: the sum of squares wanders from row to row."""
    rng = np.random.default_rng(5)
    held = []
    for _ in range(300):
        u = np.sort(rng.uniform(0.0, 1.0, 200))
        y = (u > 0.5) + rng.standard_normal(200)
        costs = np.array([np.sum((y - (u > level)) ** 2) for level in 0.5 * (u[1:] + u[:-1])])
        value = 0.5 * (u[1:] + u[:-1])[np.argmin(costs)]
        error = threshold_error(u, value, lambda at, u=u, y=y, c=costs: np.sum((y - (u > at)) ** 2) - c.min())
        held.append(abs(value - 0.5) < 1.96 * error)
    # Three standard deviations of 300 draws are 4 %; a rise of 3.84 would hold it in 0.78.
    assert np.mean(held) > 0.91


@pytest.mark.parametrize("family", ["linear", "thermal-first-order"])
def test_a_dead_zone_before_a_jump_is_known_as_well_as_its_cells_are(family):
    """Within a cell of the inputs a wider zone and a higher jump do the same."""
    rng = np.random.default_rng(11)
    u = np.repeat(rng.uniform(-1.5, 1.5, 90), 10)
    x = np.sign(u) * np.where(np.abs(u) > 0.6, np.abs(u) - 0.6 + 0.35, 0.0)
    clean = lfilter([0.0, 1.0 - np.exp(-PERIOD)], [1.0, -np.exp(-PERIOD)], x)
    model = "linear" if family == "linear" else load_model(family)
    choices = [Choice(effect, effect.forms[0]) for effect in find_effects(["in_deadzone", "in_preload"])]
    levels = np.unique(np.abs(u))
    place = np.searchsorted(levels, 0.6)
    for _ in range(5):
        y = clean + 0.05 * np.std(clean) * rng.standard_normal(u.size)
        record = make_record(u, y, period=PERIOD)
        structure = structure_of(record, model, 1 if family == "linear" else None, "rest")
        rows = record.learning
        start = structure.baseline(rows)
        own = start.point.copy()
        if family == "linear":
            own[:] = -np.exp(-PERIOD), 1.0 - np.exp(-PERIOD)
        else:
            own[:] = 0.0  # logarithms
        begun = replace(start, choices=tuple(choices), point=np.r_[own, 0.6, 0.35], rows=record.estimation)
        found = structure.fit(choices, rows, WHITE, begun, effort=Effort.REFIT)
        fit = structure.finish(found, WHITE, closely=True)
        (width,), (jump,) = fit.parameters_of("in_deadzone"), fit.parameters_of("in_preload")
        assert width.value == pytest.approx(0.5 * (levels[place - 1] + levels[place]), abs=1e-9)
        assert 1.96 * width.std_error == pytest.approx(0.5 * (levels[place] - levels[place - 1]), rel=1e-4)
        assert width.std_error < jump.std_error < 2.0 * width.std_error
        assert abs(jump.value - 0.35) < 3.0 * jump.std_error
