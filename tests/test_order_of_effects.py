"""Two effects at one port: which of them acts first is asked of the record."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.data import Record, make_record
from sysid.diagnosis.decide.noise_colour import WHITE_NOISE
from sysid.diagnosis.decide.paths import begun_elsewhere
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.decide.revision import freed, reordered
from sysid.diagnosis.diagnose import diagnose
from sysid.diagnosis.effects.catalogue import find_effects
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort, StructureFit, kept_and_new


def _record(*, limited_first: bool) -> Record:
    """Return a first-order plant behind a gain that falls by half and a limit, in this or the other order."""
    rng = np.random.default_rng(5)
    n = 900
    u = np.convolve(rng.standard_normal(n), np.ones(3) / 3.0**0.5, mode="same")
    gain = np.where(np.arange(n) < 400, 1.0, 0.5)
    x = gain * np.clip(u, -1.0, 1.0) if limited_first else np.clip(gain * u, -1.0, 1.0)
    y = np.zeros(n)
    for k in range(1, n):
        y[k] = 0.8 * y[k - 1] + x[k - 1]
    return make_record(u, y + 0.02 * rng.standard_normal(n), period=0.1)


def _fitted(structure: LinearStructure, names: list[str]) -> StructureFit:
    """Return the fit of two effects in this order, the second one searched beside the first."""
    forms = {"in_saturation": "symmetric", "time_variation": "step"}
    choices = [Choice(effect, effect.form(forms[effect.name])) for effect in find_effects(names)]
    fit = structure.baseline(structure.record.estimation)
    for count in (1, 2):
        fit = structure.fit(choices[:count], fit.rows, WHITE, fit, effort=Effort.FINE)
    return fit


@pytest.mark.parametrize("limited_first", [True, False])
def test_maps_of_the_input_change_places_where_that_explains_more(limited_first: bool) -> None:
    record = _record(limited_first=limited_first)
    structure = LinearStructure(record, 1, initial_state="rest")
    right = ["in_saturation", "time_variation"] if limited_first else ["time_variation", "in_saturation"]
    wrong = _fitted(structure, right[::-1])
    evidence = Evidence(structure, record.estimation, record.validation, 0.01)
    found = reordered(evidence, wrong, 0)
    assert found.names == tuple(right)
    assert found.cost < 0.5 * wrong.cost
    assert reordered(evidence, found, 0) is found
    assert reordered(evidence, wrong, 1) is wrong  # what is given stays where it is


def test_the_order_of_two_effects_is_found() -> None:
    effects = ["in_saturation", "in_deadzone", "in_preload", "time_variation", "out_saturation", "op_gain"]
    found = diagnose(_record(limited_first=False), order=1, initial_state="rest", effects=effects)
    assert set(found.accepted) == {"in_saturation", "time_variation"}
    assert found.final.fitted.names == ("time_variation", "in_saturation")
    assert found.final.fitted.parameters_of("in_saturation")[0].value == pytest.approx(1.0, abs=0.03)


def test_a_ramp_before_a_limit_is_found_in_one_descent() -> None:
    """What the limit makes of a ramp is not linear in its rate, however small the step."""
    rng = np.random.default_rng(2)
    n = 1200
    u = np.repeat(rng.uniform(-1.7, 1.7, n // 2), 2)
    x, y = np.clip(u * (1.0 - 4e-4 * np.arange(n)), -0.8, 0.8), np.zeros(n)
    for k in range(1, n):
        y[k] = 0.9 * y[k - 1] + x[k - 1]
    record = make_record(u, y + 0.05 * rng.standard_normal(n), period=1.0)
    structure = LinearStructure(record, 1, initial_state="rest")
    limit, ramp = (Choice(e, e.forms[0]) for e in find_effects(["in_saturation", "time_variation"]))
    rows = record.estimation
    fit = structure.baseline(rows)
    for choices in ([limit], [limit, ramp]):
        fit = structure.fit(choices, rows, WHITE, fit, effort=Effort.FINE)
    found = structure.fit([ramp, limit], rows, WHITE, fit, effort=Effort.REFIT)
    assert found.parameters_of("in_saturation")[0].value == pytest.approx(0.8, abs=0.02)
    assert found.parameters_of("time_variation")[0].value == pytest.approx(-4e-4, abs=1e-5)


def test_an_effect_that_is_new_is_searched_where_it_is_to_stand() -> None:
    structure = LinearStructure(_record(limited_first=True), 1, initial_state="rest")
    behind = _fitted(structure, ["in_saturation", "time_variation"])
    fit = structure.fit(behind.choices[1:], behind.rows, WHITE, behind, effort=Effort.REFIT)
    again = structure.fit(behind.choices, behind.rows, WHITE, fit, effort=Effort.FINE)
    assert again.names == ("in_saturation", "time_variation")
    assert again.cost == pytest.approx(behind.cost, rel=1e-3)


def test_where_an_actuator_stood_at_first_is_asked_again_beside_a_second_effect() -> None:
    record = _record(limited_first=True)
    (lag,) = find_effects(["in_rate_limit"])
    u = record.u[:, 0] + 8.0  # far from zero, where it began
    x, position = np.zeros(u.size), 0.0
    for k, wanted in enumerate(u):
        position += min(max(wanted - position, -0.3), 0.3)
        x[k] = position
    y = np.zeros(u.size)
    for k in range(1, u.size):
        y[k] = 0.8 * y[k - 1] + x[k - 1]
    y = np.minimum(y, 39.0) + 0.02 * np.random.default_rng(0).standard_normal(u.size)
    structure = LinearStructure(make_record(u, y, period=0.1), 1, initial_state="rest")
    evidence = Evidence(structure, record.estimation, record.validation, 0.01)
    (limit,) = find_effects(["out_saturation"])
    fit = structure.baseline(record.estimation)
    choices = [Choice(lag, lag.form("symmetric")), Choice(limit, limit.forms[0])]
    for count in (1, 2):
        fit = structure.fit(choices[:count], fit.rows, WHITE, fit, effort=Effort.FINE)
    found = freed(evidence, fit, 0)
    assert found.choices[0].form.name.endswith("from rest")
    assert found.parameters_of("in_rate_limit")[0].value == pytest.approx(3.0, rel=0.05)


def test_a_longer_search_of_the_same_effects_searches_the_last_one_anew() -> None:
    structure = LinearStructure(_record(limited_first=True), 1, initial_state="rest")
    fit = _fitted(structure, ["in_saturation", "time_variation"])
    assert kept_and_new(fit.choices, fit, Effort.REFIT) == (fit.choices, ())
    assert kept_and_new(fit.choices, fit, Effort.COARSE) == (fit.choices[:1], fit.choices[1:])
    assert kept_and_new((), fit, Effort.COARSE) == ((), ())


@pytest.mark.parametrize("family", ["linear", "mass-spring-damper"])
@pytest.mark.parametrize("behind", [False, True])
def test_where_a_path_beside_the_plant_begins_is_asked_of_the_record(family: str, behind: bool) -> None:
    from sysid.diagnosis.export.saved_effects import SavedEffect
    from sysid.diagnosis.export.saved_linear import SavedModel
    from sysid.diagnosis.export.saved_physics import SavedPhysicalModel
    from sysid.physics import load_model
    from sysid.physics.writing import model_text

    form = "behind" if behind else "direct"
    effects = (
        SavedEffect("in_deadzone", "symmetric", {"width": 0.5}),
        SavedEffect("feedthrough", form, {"d": 0.3}),
    )
    truth: SavedModel | SavedPhysicalModel = SavedModel((-1.5, 0.7), (0.1, 0.1), 0.0, 0.2, effects)
    if family != "linear":
        truth = SavedPhysicalModel(model_text(load_model(family)), 0.2, "zero", 1, effects)
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(-2.0, 2.0, 400), 3)
    y = truth.simulate(u)
    found = diagnose(
        make_record(u, y + 0.01 * np.std(y) * rng.standard_normal(u.size), period=0.2),
        family,
        2 if family == "linear" else None,
        initial_state="rest",
        effects=["in_deadzone", "in_saturation", "feedthrough", "out_quadratic", "in_backlash"],
    )
    assert found.verdict == "missing-effect"
    assert set(found.accepted) == {"in_deadzone", "feedthrough"}
    (chosen,) = (c for c in found.final.fitted.choices if c.name == "feedthrough")
    assert chosen.form.name == form
    (gain,) = found.final.fitted.parameters_of("feedthrough")
    assert abs(gain.value - 0.3) < 4.0 * gain.std_error < 0.05


def test_a_quantiser_before_an_offset_is_seen_where_it_stands() -> None:
    """Its counts are moved by what is added behind it, and no multiples of its step."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(-1.0, 1.0, 300), 4)
    z = np.zeros(u.size)
    for k in range(1, u.size):
        z[k] = 0.9 * z[k - 1] + u[k - 1]
    y = 1.5 * np.round(z / 1.5) + 2.2 + 0.05 * rng.standard_normal(u.size)
    effects = ["out_offset", "out_quantisation", "out_quadratic", "in_preload", "op_gain"]
    found = diagnose(make_record(u, y, period=0.1), order=1, initial_state="rest", effects=effects)
    assert set(found.accepted) == {"out_quantisation", "out_offset"}
    assert found.final.fitted.names == ("out_quantisation", "out_offset")
    assert found.final.fitted.parameters_of("out_quantisation")[0].value == pytest.approx(1.5, abs=0.01)


def test_thresholds_are_searched_again_beside_a_second_effect() -> None:
    """Alone a relay stands where it also does what a stiffening spring does."""
    rng = np.random.default_rng(6)
    u = rng.uniform(-1.0, 1.0, 900)
    z, x = np.zeros(u.size), np.where(np.abs(u) > 0.3, np.sign(u), 0.0)
    for k in range(2, u.size):
        pushed = (x[k - lag] - 0.05 * z[k - lag] ** 3 for lag in (1, 2))
        z[k] = 1.5 * z[k - 1] - 0.7 * z[k - 2] + np.dot((0.5, 0.3), [*pushed])
    record = make_record(u, z + 0.02 * rng.standard_normal(u.size), period=0.1)
    structure = LinearStructure(record, 2, initial_state="rest")
    relay, spring = (Choice(e, e.forms[0]) for e in find_effects(["in_relay", "cubic_stiffness"]))
    rows = record.estimation
    right = structure.baseline(rows)
    for choices in ([relay], [relay, spring]):
        right = structure.fit(choices, rows, WHITE, right, effort=Effort.FINE)
    place = 4
    wrong = replace(right, point=np.where(np.arange(right.point.size) == place, 0.26, right.point))
    structure = LinearStructure(record, 2, initial_state="rest")  # remembers nothing
    evidence = Evidence(structure, record.estimation, record.validation, 0.01)
    wrong = structure.fit([relay, spring], rows, WHITE, wrong, effort=Effort.REFIT)
    assert wrong.parameters_of("in_relay")[0].value == pytest.approx(0.26)
    found = freed(evidence, wrong, 0)
    assert found.parameters_of("in_relay")[0].value == pytest.approx(0.3, abs=0.01)
    assert found.cost < 0.5 * wrong.cost


@pytest.mark.parametrize(("fall", "moves"), [(1e-9, False), (1e-3, True)])
def test_a_path_begins_elsewhere_only_where_that_is_better_by_more_than_rounding(monkeypatch, fall, moves):
    choices = tuple(Choice(e, e.forms[0]) for e in find_effects(["in_saturation", "feedthrough"]))
    fit, other = (SimpleNamespace(choices=choices, usable=True, worth=worth) for worth in (0.0, -fall))
    structure = SimpleNamespace(fit=lambda *given, **further: other)
    monkeypatch.setattr(Evidence, "criterion", lambda self, fit, noise: fit.worth)
    evidence = Evidence(structure, np.ones(3, dtype=bool), np.zeros(3, dtype=bool), 0.01)
    assert (begun_elsewhere(evidence, fit, WHITE_NOISE) is other) == moves
