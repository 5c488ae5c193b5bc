"""Effects that stand alone: whatever form, place in the list, start or order the search met them at first."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from sysid import diagnose
from sysid.data import make_record
from sysid.data.record import Record
from sysid.diagnosis.decide.decision import Trial
from sysid.diagnosis.decide.noise_colour import WHITE_NOISE
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.decide.revision import simplified
from sysid.diagnosis.decide.trials import _switch_first, _without_memory_first
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort

Floats = np.ndarray


def record_of(u: Floats, y: Floats, noise: float, seed: int) -> Record:
    rng = np.random.default_rng(seed)
    split = np.repeat(["est", "val", "test"], [u.size // 2, u.size // 4, u.size // 4])
    return make_record(u, y + noise * y.std() * rng.standard_normal(u.size), period=1.0, split=split)


def play(u: Floats, lower: float, upper: float) -> Floats:
    x, out = 0.0, []
    for value in u:
        x = min(max(x, value - upper), value + lower)
        out.append(x)
    return np.array(out)


def sweeps(seed: int) -> Floats:
    """Four sweeps of sizes of their own."""
    k = np.arange(400)
    sizes = np.random.default_rng(seed).uniform(1.0, 2.0, 4)
    return np.outer(sizes, np.sin(2.0 * np.pi * (0.002 * k + 0.5 * (0.05 / 400) * k**2))).ravel()


@pytest.mark.parametrize("seed", [0, 1])
def test_an_uneven_play_is_one_effect_and_leads_the_list(seed: int) -> None:
    # With one width for both sides it looks like less than the offset that it brings with it.
    u = sweeps(seed)
    y = lfilter([0.0, 0.3], [1.0, -0.7], play(u, 1.6, 0.2))
    effects = [
        "in_backlash",
        "out_offset",
        "in_preload",
        "extra_mode",
        "in_relay",
        "op_gain",
        "in_saturation",
    ]
    effects += ["out_drift", "in_deadzone", "out_quadratic", "time_variation"]
    found = diagnose(record_of(u, y, 0.03, seed), order=1, initial_state="rest", effects=effects)
    assert found.accepted == ("in_backlash",)
    assert found.decision.trials[0].name == "in_backlash"
    assert not found.decision.tie
    widths = [p.value for p in found.final.fitted.parameters_of("in_backlash")]
    assert widths == pytest.approx([1.6, 0.2], abs=0.05)


def test_effects_ask_for_the_order_of_the_plant_behind_them() -> None:
    # Folded over, a plant of order four seems to be of a lower one, and a mode to be missing beside the fold.
    rng = np.random.default_rng(10)
    u = np.repeat(rng.uniform(-1.0, 1.0, 80), 20) + 0.3 * rng.standard_normal(1600)
    poles = np.poly([0.9 + 0.2j, 0.9 - 0.2j, 0.75 + 0.1j, 0.75 - 0.1j]).real
    y = np.abs(lfilter([0.0, 0.0, 0.1, 0.2, 0.3], poles, u + 0.25))
    found = diagnose(record_of(u, y, 0.02, 0), effects=["out_rectify", "out_quadratic", "extra_mode"])
    assert found.accepted == ("out_rectify",)
    assert found.ladder[-1].scores["test"]["nrmse"] < 0.03


def test_a_switch_may_have_been_left_on_either_side() -> None:
    # The first input lies below the threshold: its sign does not tell how the switch stood.
    rng = np.random.default_rng(3)
    u = 0.5 * np.sin(0.05 * np.arange(800)) + 0.35 * rng.standard_normal(800)
    u[:40] = 0.4 + 0.1 * rng.uniform(0.0, 1.0, 40)
    stand, x = -1.0, np.empty(u.size)
    for k, value in enumerate(u):
        stand = 1.0 if value > 0.6 else (-1.0 if value < -0.6 else stand)
        x[k] = stand
    y = lfilter([0.0, 0.1], [1.0, -0.95], x)
    record = record_of(u, y, 0.02, 3)
    structure = LinearStructure(record, 1, initial_state="rest")
    (effect,) = find_effects(["in_hysteresis"])
    rows = record.estimation
    fit = structure.fit(
        [Choice(effect, effect.form("left as it was"))],
        rows,
        WHITE,
        structure.baseline(rows),
        effort=Effort.FINE,
    )
    assert fit.parameters_of("in_hysteresis")[-1].value == pytest.approx(-1.0, abs=0.1)
    assert np.std((record.y[:, 0] - fit.output)[rows]) < 0.03 * np.std(y)


def test_a_threshold_passes_levels_at_which_nothing_switches() -> None:
    # Beside the first cell of a switch that holds, most inputs do not reach it: they are not what counts.
    from sysid.diagnosis.linear.levenberg import Minimum
    from sysid.diagnosis.linear.narrowing import Narrowing

    def fit(point: Floats) -> Minimum:
        return Minimum(point, float((np.floor(point[0] / 10.0) - 3.0) ** 2), True)

    def cell(point: Floats) -> bytes:
        return bytes([int(point[0] // 10.0)])

    start = np.array([2.5])
    narrowing = Narrowing(fit(start), np.array([0]), [np.array([0.0, 50.0])], fit, cell)
    narrowing.walk(np.arange(60.0))
    assert narrowing.best.cost == 0.0


def test_sides_of_its_own_take_the_place_of_a_jump_beside_a_dead_zone() -> None:
    # A jump back and a dead zone make up an uneven dead zone: only together their widths are known.
    u = sweeps(2)
    uneven = u - np.clip(u, -0.9, 0.4)
    record = record_of(u, lfilter([0.0, 0.3], [1.0, -0.7], uneven), 0.03, 2)
    structure = LinearStructure(record, 1, initial_state="rest")
    rows, baseline = record.estimation, structure.baseline(record.estimation)
    preload, zone = find_effects(["in_preload", "in_deadzone"])
    choices = [Choice(preload, preload.form("two-sided")), Choice(zone, zone.form("symmetric"))]
    pair = structure.fit(choices, rows, WHITE, baseline, effort=Effort.FINE)
    found = simplified(Evidence(structure, rows, record.validation, 0.01), pair, 0)
    assert found.names == ("in_deadzone",)
    widths = [p.value for p in found.parameters_of("in_deadzone")]
    assert widths == pytest.approx([0.9, 0.4], abs=0.05)


def test_a_jump_beside_which_the_slope_is_lost_is_a_relay() -> None:
    # The quantiser behind it leaves errors that the lost slope follows a little: a bit of noise.
    rng = np.random.default_rng(0)
    u = rng.uniform(-1.0, 1.0, 1200)
    y = lfilter([0.0, 0.3], [1.0, -0.7], np.sign(u))
    structure = LinearStructure(record_of(u, y, 0.05, 0), 1, initial_state="rest")
    rows = structure.record.estimation
    baseline = structure.baseline(rows)
    preload, relay = (
        Trial(
            name,
            structure.fit(choices, rows, WHITE, baseline, effort=Effort.COARSE),
            WHITE_NOISE,
            criterion,
            9.0,
        )
        for name, criterion in (("in_preload", -101.5), ("in_relay", -100.0))
        for choices in [[Choice(effect, effect.forms[0]) for effect in find_effects([name])]]
    )
    assert _switch_first([preload, relay]) == [relay, preload]
    plainly = replace(preload, criterion=-103.0)
    assert _switch_first([plainly, relay]) == [plainly, relay]


def test_a_switch_whose_two_thresholds_are_one_has_no_memory() -> None:
    rng = np.random.default_rng(0)
    u = rng.uniform(-1.0, 1.0, 600)
    y = lfilter([0.0, 0.3], [1.0, -0.7], np.sign(u))
    structure = LinearStructure(record_of(u, y, 0.05, 0), 1, initial_state="rest")
    baseline = structure.baseline(structure.record.estimation)
    other, hysteresis, relay = (
        Trial(name, replace(baseline, choices=choices), WHITE_NOISE, criterion, 9.0)
        for name, criterion in (("in_preload", -150.0), ("in_hysteresis", -100.00001), ("in_relay", -100.0))
        for choices in [tuple(Choice(effect, effect.forms[0]) for effect in find_effects([name]))]
    )
    assert _without_memory_first([other, hysteresis, relay]) == [other, relay, hysteresis]
    plainly = replace(hysteresis, criterion=-101.0)
    assert _without_memory_first([other, plainly, relay]) == [other, plainly, relay]
