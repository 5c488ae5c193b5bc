"""Records that look as if an effect were missing, or as if it were another one."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from sysid.data import make_record
from sysid.diagnosis import advice
from sysid.diagnosis.decide.alignment import chance_at_other_times
from sysid.diagnosis.decide.decision import Trial
from sysid.diagnosis.decide.noise_colour import WHITE_NOISE
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.decide.revision import exchanged, still_tied, without_idle
from sysid.diagnosis.decide.trials import Trials, may_hold
from sysid.diagnosis.diagnose import diagnose
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort
from sysid.progress import Progress

PERIOD = 0.05


def levels(rng, n, low, high, shortest, longest):
    held = []
    while len(held) < n:
        held += [rng.uniform(low, high)] * int(rng.integers(shortest, longest + 1))
    return np.array(held[:n])


def second_order(u):
    """A damped second-order plant at PERIOD: poles 0.85 exp(+-0.3 i), unit gain."""
    a1, a2 = -2 * 0.85 * np.cos(0.3), 0.85**2
    return lfilter([0.0, 1.0 + a1 + a2], [1.0, a1, a2], u)


def record_of(u, y, n_test=0):
    split = np.array(["train"] * (u.size - n_test) + ["test"] * n_test)
    return make_record(u, y, period=PERIOD, split=split)


@pytest.fixture
def ambient_steps():
    """An ambient temperature that steps three times, whatever the input does."""
    rng = np.random.default_rng(4)
    u, ambient = levels(rng, 1000, -2, 2, 4, 30), np.zeros(1000)
    ambient[180:420], ambient[640:] = 0.8, -0.6
    y = second_order(u) + lfilter([0.05], [1, -0.95], ambient) + 0.02 * rng.standard_normal(1000)
    return record_of(u, y)


def closed_loop(rng, n, level=0.0):
    """A PI loop around a first-order plant: the controller hands coloured noise on to the input."""
    target, x, integral = levels(rng, n, -2, 2, 20, 60), 0.0, 0.0
    noise = lfilter([0.08], [1, -0.8], rng.standard_normal(n))
    u, y = np.empty(n), np.empty(n)
    for k in range(n):
        y[k] = level + x + noise[k]
        error = target[k] - y[k] + level
        integral += PERIOD * error
        u[k] = 0.6 * error + 0.9 * integral
        x = 0.85 * x + 0.3 * u[k]
    return u, y


def test_steps_of_a_disturbance_are_not_named_after_an_effect_of_the_input(ambient_steps):
    found = diagnose(ambient_steps, order=2)
    assert found.verdict == "coloured-noise"
    assert found.accepted == ("coloured_noise",)


def test_what_follows_the_motion_explains_less_at_other_times():
    rng = np.random.default_rng(0)
    motion = lfilter([1], [1, -0.97], rng.standard_normal((40, 800)))
    slow = lfilter([1], [1, -0.97], rng.standard_normal((40, 800)))
    constant = np.ones((800, 1))
    seen = [
        chance_at_other_times(0.5 * m + s, constant, m, m[:, None]) for m, s in zip(motion, slow, strict=True)
    ]
    chance = [chance_at_other_times(s, constant, m, m[:, None]) for m, s in zip(motion, slow, strict=True)]
    # The rank is about uniform without an effect, though both signals are slow: of 40, some 20 below a half.
    assert 10 <= np.sum(np.array(chance) < 0.5) <= 30
    assert np.median(seen) < 0.1


def test_a_motion_that_repeats_itself_has_no_other_times():
    period = np.random.default_rng(0).standard_normal(10)
    motion = np.tile(period, 80)
    # Nine shifts of ten are other motions, but a constant is none at any time.
    assert chance_at_other_times(np.ones(800), np.empty((800, 0)), np.ones(800), np.ones((800, 1))) == 0.0
    assert chance_at_other_times(motion, np.ones((800, 1)), motion, motion[:, None]) < 0.02


@pytest.mark.parametrize("order", [1, 2])
def test_noise_that_a_controller_hands_on_is_not_an_effect(order):
    u, y = closed_loop(np.random.default_rng(11), 1200)
    found = diagnose(record_of(u, y), order=order)
    assert found.decision.fed_back
    assert found.verdict == "coloured-noise"
    assert "as under a controller" in found.advice


def test_an_effect_in_an_open_loop_is_not_put_down_to_a_controller():
    rng = np.random.default_rng(5)
    u = levels(rng, 900, -2, 2, 4, 30)
    structure = LinearStructure(record_of(u, second_order(np.tanh(u)) + 0.01 * rng.standard_normal(900)), 2)
    record = structure.record
    evidence = Evidence(structure, record.estimation, record.validation, 0.01)
    assert not evidence.only_at_once(structure.baseline(record.estimation))


def test_names_that_one_curve_outdoes_are_left_out():
    rng = np.random.default_rng(6)
    u = levels(rng, 1000, 5, 95, 8, 30)
    y = second_order(100.0 * 50.0 ** (u / 100.0 - 1.0)) + 0.3 * rng.standard_normal(1000)
    found = diagnose(record_of(u, y), order=2)
    assert found.verdict == "unexplained"
    assert found.accepted == ()
    assert found.ports[0].port == "input"
    assert found.ports[0].explains_at_most > 0.95
    assert "free-form curve" in found.advice


def test_laws_about_zero_are_not_offered_far_from_it():
    rng = np.random.default_rng(7)
    u = levels(rng, 400, -1, 1, 4, 30)
    asked = find_effects(["gravity_sine", "cubic_stiffness", "quad_drag"])
    near, far = (LinearStructure(record_of(u, second_order(u) + at), 2) for at in (0.5, 320.0))
    assert [effect.name for effect in near.offered(asked)] == ["gravity_sine", "cubic_stiffness", "quad_drag"]
    assert [effect.name for effect in far.offered(asked)] == ["quad_drag"]


def test_a_slow_path_is_said_to_be_a_matter_of_the_order():
    rng = np.random.default_rng(8)
    u = levels(rng, 1200, 0, 10, 5, 30)
    fast, slow = np.exp(-1 / 6.0), np.exp(-1 / 60.0)
    y = lfilter([0, 3 * (1 - fast)], [1, -fast], u) + lfilter([0, 4 * (1 - slow)], [1, -slow], u)
    found = diagnose(record_of(u, y + 0.1 * rng.standard_normal(1200)), order=1)
    text = " ".join(found.sentences())
    assert "lightly damped" not in text
    assert "order is too low" in text


def test_the_order_is_one_whose_restarts_agree():
    rng = np.random.default_rng(9)
    u = levels(rng, 700, 0, 8, 15, 40)
    late = np.concatenate([np.zeros(3), u])[:700]
    y = 20 + lfilter([0, 0.45], [1, -0.95], late) + 0.15 * rng.standard_normal(700)
    structure = LinearStructure(record_of(u, y))
    assert structure.baseline(structure.record.estimation).restarts_agree


def test_a_wide_tie_is_said_in_few_names():
    assert advice._tie(("a", "b")) == "The record cannot tell a from b."
    assert advice._tie(tuple("abcdefg")).endswith("a from b or c or d, nor from 3 more that explain less.")


def test_a_tie_ends_with_the_effect_it_began_with():
    u = np.random.default_rng(1).uniform(-1, 1, 300)
    structure = LinearStructure(record_of(u, second_order(np.clip(u, -0.5, 0.5))), 2)
    rows = structure.record.estimation
    saturation, offset = (Choice(e, e.forms[0]) for e in find_effects(["in_saturation", "out_quadratic"]))
    baseline = structure.baseline(rows)
    one = structure.fit((saturation,), rows, WHITE, baseline, effort=Effort.COARSE)
    two = structure.fit((saturation, offset), rows, WHITE, one, effort=Effort.COARSE)
    record = structure.record
    trials = Trials(Evidence(structure, rows, record.validation, 0.01), (), 0, 1, Progress())
    names = ("in_saturation", "in_relay", "in_preload")
    first, second, third = (Trial(name, one, WHITE_NOISE, 0.0) for name in names)
    assert still_tied(trials, one, (first, second)) == (first, second)
    assert still_tied(trials, two, (second, third)) == ()


def test_an_effect_chosen_beside_one_that_was_exchanged_is_looked_at_again():
    rng = np.random.default_rng(8)
    u = levels(rng, 1200, -2, 2, 3, 12)
    y = second_order(np.clip(u, -1.0, 1.0)) + 1.5
    record = record_of(u, y + 0.02 * rng.standard_normal(u.size))
    structure, rows = LinearStructure(record, 2, initial_state="rest"), record.estimation
    effects = find_effects(["out_drift", "in_backlash", "out_offset", "in_saturation"])
    drift, play = (Choice(effect, effect.forms[0]) for effect in effects[:2])
    wrong = structure.fit((drift, play), rows, WHITE, structure.baseline(rows), effort=Effort.COARSE)
    trials = Trials(Evidence(structure, rows, record.validation, 0.01), tuple(effects), 0, 1, Progress())
    assert set(exchanged(trials, wrong, 0).names) == {"in_saturation", "out_offset"}


def test_only_forces_that_could_hold_a_body_are_searched_where_the_plant_is_lost():
    asked = find_effects(["gravity_sine", "coulomb", "hysteresis_force", "cubic_stiffness", "in_deadzone"])
    assert [effect.name for effect in asked if may_hold(effect)] == ["gravity_sine", "cubic_stiffness"]


def test_a_furnace_lags_behind_drifts_and_is_measured_from_another_zero():
    """Alone the zero is lost in the drift, and a slow path explains more: yet all else builds on the zero."""
    rng = np.random.default_rng(3)
    period, delay, n = 2.0, 3.5, 800
    u = levels(rng, n, 0.0, 8.0, 15, 40)
    k = np.arange(n)
    late = np.interp(k - delay, k, u)
    heat = lfilter([0.0, 9.0 * (1.0 - np.exp(-period / 40.0))], [1.0, -np.exp(-period / 40.0)], late)
    y = 20.0 + heat + 0.01 * k + 0.3 * rng.standard_normal(n)
    found = diagnose(
        make_record(u, y, period=period),
        "thermal-first-order",
        start={"C": 4.2, "G": 0.12},
        effects=["in_delay", "out_offset", "out_drift", "extra_mode"],
    )
    assert found.verdict == "missing-effect"
    assert set(found.accepted) == {"in_delay", "out_offset", "out_drift"}
    (offset,) = found.final.fitted.parameters_of("out_offset")
    assert offset.value == pytest.approx(20.0, abs=4 * offset.std_error)


@pytest.mark.parametrize(("far", "lost"), [(6.0, True), (0.5, False)])
def test_rows_on_which_a_plant_is_slowly_lost_show_something_else(far, lost):
    """Its innovations hardly tell: the run leaves the record slowly, beside noise that is slow as well."""
    rng = np.random.default_rng(8)
    u = levels(rng, 1200, -2, 2, 4, 30)
    y = second_order(u)
    split = np.array(["train"] * 800 + ["val"] * 400)
    structure = LinearStructure(make_record(u, y, period=PERIOD, split=split), 2, initial_state="rest")
    record = structure.record
    evidence = Evidence(structure, record.estimation, record.validation, 0.01)
    noise = lfilter([0.03], [1, -0.998], rng.standard_normal(1200))
    away = far * (1.0 - np.exp(-np.maximum(np.arange(1200) - 800, 0) / 400))
    fit = replace(structure.baseline(record.estimation), output=y - noise - away)
    assert evidence.rows_disagree(fit) == lost


@pytest.mark.parametrize(("second", "kept"), [(0.0, 1), (0.1, 2)])
def test_a_law_found_beside_another_stands_alone_where_the_other_does_nothing(second, kept):
    rng = np.random.default_rng(9)
    u = levels(rng, 800, 1, 4, 4, 30)
    y = second_order(np.minimum(u, 2.5))
    y = y + second * y**2 + 0.01 * rng.standard_normal(800)
    structure = LinearStructure(record_of(u, y), 2, initial_state="rest")
    rows = structure.record.estimation
    fit = structure.baseline(rows)
    for name in ("out_quadratic" if second else "out_rectify", "in_saturation"):
        (effect,) = find_effects([name])
        choices = (*fit.choices, Choice(effect, effect.forms[0]))
        fit = structure.fit(choices, rows, WHITE, fit, effort=Effort.FINE)
    evidence = Evidence(structure, rows, structure.record.validation, 0.01)
    assert len(fit.choices) == 2
    assert len(without_idle(evidence, fit, 0).choices) == kept
