"""Laws that a first look hides: behind the colour of what is missing, or by sides that are uneven."""

import numpy as np
import pytest
from scipy.signal import lfilter

from sysid.data import Record, make_record
from sysid.diagnosis.diagnose import diagnose, structure_of
from sysid.diagnosis.effects.catalogue import find_effects
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort
from sysid.physics import load_model
from sysid.physics.forced import ForcedPlant, law

PERIOD = 0.09
STAIRCASE = np.r_[np.linspace(-1.0, 1.0, 9), np.linspace(1.0, -1.0, 9)[1:-1]]


def coloured(n: int, memory: float, rng: np.random.Generator) -> np.ndarray:
    """Return noise of variance one."""
    noise = lfilter([1.0], [1.0, -memory], rng.standard_normal(n))
    return noise / noise.std()


def sticking(seed: int, n: int = 500) -> Record:
    """Return the record of a body that sticks and slips."""
    rng = np.random.default_rng(seed)
    u = 3.0 * STAIRCASE[(np.arange(n) // 30 + seed) % STAIRCASE.size] + 0.25 * rng.standard_normal(n)
    friction = law(friction_forward=0.7, friction_back=0.7, breakaway=0.7, stribeck_speed=0.013)
    plant = ForcedPlant(load_model("mass-spring-damper"), PERIOD)
    y = plant.run(np.array([[3.4, 3.7, 51.0]]), friction[np.newaxis], u)[0]
    return make_record(u, y + 0.008 * coloured(n, 0.7, rng), period=PERIOD)


@pytest.mark.parametrize("seed", [1, 5, 29])
def test_friction_is_found_under_the_colour_of_what_is_missing(seed):
    record = sticking(seed)
    structure = structure_of(record, "mass-spring-damper", None, "rest", {"c": 4.0, "k": 50.0}, {"m": 3.4})
    rows, colour = record.learning, np.array([1.0, -0.9])
    base = structure.baseline(rows)
    (stribeck,) = find_effects(["stribeck"])
    choices = (Choice(stribeck, stribeck.forms[0]),)
    plain = structure.fit(choices, rows, WHITE, base, effort=Effort.FINE)
    from_there = structure.fit(choices, rows, colour, plain, effort=Effort.REFIT)
    found = structure.fit(choices, rows, colour, base, effort=Effort.FINE)
    assert found.cost <= 1.002 * from_there.cost


def test_a_limit_that_is_reached_on_one_side_only_is_tried():
    """One that is the same on both sides explains nothing of it, and other laws would be named."""
    rng = np.random.default_rng(1)
    low, high = rng.random(240) < 0.6, 0.3
    u = np.repeat(np.where(low, rng.uniform(-3.0, 0.0, 240), rng.uniform(0.0, 0.9, 240)), 5)
    y = lfilter([0.0, 0.4], [1.0, -0.8], np.clip(u, -5.0, high)) + 0.3 * coloured(u.size, 0.7, rng)
    found = diagnose(make_record(u, y, period=1.0), order=1, initial_state="rest")
    assert found.accepted == ("in_saturation", "coloured_noise")
    assert found.decision.trials[0].name == "in_saturation"


@pytest.fixture(scope="module")
def relayed() -> Record:
    """Return the record of two tanks that are filled through a switch."""
    rng = np.random.default_rng(1)
    n, u = 600, np.abs(np.repeat(np.random.default_rng(2).uniform(-1.0, 2.0, 150), 4))
    plant = ForcedPlant(load_model("two-tanks"), 2.0)
    level = plant.run(np.array([[0.06, 0.05, 0.02]]), law()[np.newaxis], np.where(u > 0.8, 1.0, 0.0))[0]
    return make_record(u, level + 0.004 * rng.standard_normal(n), period=2.0)


def test_a_level_that_is_one_with_the_gain_is_no_freedom(relayed):
    structure = structure_of(relayed, "two-tanks", None, "rest", {"a1": 0.055, "a2": 0.055, "b": 0.018})
    rows = relayed.learning
    (relay,) = structure.offered(find_effects(["in_relay"]))
    base = structure.baseline(rows)
    fit = structure.fit((Choice(relay, relay.forms[0]),), rows, WHITE, base, effort=Effort.FINE)
    assert fit.point.size == base.n_parameters + 2  # threshold and level
    assert fit.n_parameters == base.n_parameters + 1
    told = {p.name: p for p in structure.finish(fit, WHITE).parameters}
    assert not np.isfinite([told[name].std_error for name in ("b", "level")]).any()
    threshold = told["threshold"]
    assert abs(threshold.value - 0.8) < 1.96 * threshold.std_error < 0.1


def test_a_known_mass_leaves_the_level_free():
    rng = np.random.default_rng(4)
    u = rng.uniform(-1.0, 1.0, 600)
    plant = ForcedPlant(load_model("mass-spring-damper"), PERIOD)
    driven = 2.0 * np.where(np.abs(u) > 0.3, np.sign(u), 0.0)
    y = plant.run(np.array([[1.0, 2.0, 30.0]]), law()[np.newaxis], driven)[0]
    record = make_record(u, y + 0.05 * y.std() * rng.standard_normal(u.size), period=PERIOD)
    structure = structure_of(record, "mass-spring-damper", None, "rest", {"c": 2.2, "k": 28.0}, {"m": 1.0})
    (relay,) = structure.offered(find_effects(["in_relay"]))
    base = structure.baseline(record.learning)
    choices = (Choice(relay, relay.forms[0]),)
    fit = structure.fit(choices, record.learning, WHITE, base, effort=Effort.FINE)
    assert fit.n_parameters == base.n_parameters + 2
    told = {p.name: p for p in structure.finish(fit, WHITE).parameters}
    assert abs(told["level"].value - 2.0) < 2.6 * told["level"].std_error < 0.1
    assert abs(told["threshold"].value - 0.3) < 1.96 * told["threshold"].std_error < 0.02


@pytest.mark.parametrize("seed", range(3))
def test_a_quantiser_is_found_far_from_zero(seed):
    """Of many counts a step that is off by some per cent makes nearly every reading the one beside it."""
    rng = np.random.default_rng(seed)
    u = 1.5 + np.repeat(rng.uniform(-1.0, 1.0, 200), 3)
    plant = ForcedPlant(load_model("two-tanks"), 6.0)
    x = plant.run(np.array([[0.08, 0.035, 0.07]]), law()[np.newaxis], u)[0]
    step = 0.8 * x.std()
    y = step * np.round(x / step) + 0.45 * step * coloured(u.size, 0.7, rng)
    record = make_record(u, y, period=6.0)
    structure = structure_of(record, "two-tanks", None, "rest", {"a1": 0.09, "a2": 0.039, "b": 0.078})
    base = structure.baseline(record.learning)
    (quantiser,) = find_effects(["out_quantisation"])
    choices = (Choice(quantiser, quantiser.forms[0]),)
    fit = structure.fit(choices, record.learning, WHITE, base, effort=Effort.COARSE)
    assert abs(fit.parameters_of("out_quantisation")[0].value / step - 1.0) < 0.02
