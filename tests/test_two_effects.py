"""Two effects at once: neither is missed for what the other does to rows, to the plant, or to a curve."""

import numpy as np
import pytest
from scipy.signal import lfilter

import sysid
from sysid.data import make_record
from sysid.diagnosis.decide.allowance import Allowance
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.decide.revision import among_its_kind
from sysid.diagnosis.decide.trials import Trials
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.physics.structure import PhysicsStructure
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort
from sysid.physics import load_model
from sysid.progress import Progress


def test_a_gain_that_changes_where_rows_are_held_out_hides_no_other_effect():
    """The spring is all that the rows of the search lack, but does not hold on those after the change."""
    rng = np.random.default_rng(0)
    n = 1200
    u = lfilter([0.3], [1.0, -0.7], rng.uniform(-1.0, 1.0, n))
    u = u / u.std()
    y, gain = np.zeros(n), np.where(np.arange(n) < 601, 1.0, 0.6)
    for k in range(1, n):
        y[k] = 0.9 * y[k - 1] + 0.1 * (gain[k - 1] * u[k - 1] - 20.0 * y[k - 1] ** 3)
    y += 0.03 * y.std() * rng.standard_normal(n)
    split = np.repeat(["est", "val", "test"], [600, 400, 200])
    effects = ["cubic_stiffness", "time_variation", "in_saturation", "quad_drag"]
    found = sysid.diagnose(
        make_record(u, y, 1.0, split=split), order=1, initial_state="rest", effects=effects
    )
    assert set(found.accepted) == {"cubic_stiffness", "time_variation"}


@pytest.mark.parametrize(("slope", "hold"), [(0.4, 12), (1.0, 1)], ids=["like a relay", "with a slope"])
def test_a_jump_at_the_edges_of_a_dead_zone_is_found_with_it(slope, hold):
    """Alone, the dead zone is too narrow, or a relay does better than either of the two."""
    rng = np.random.default_rng(2)
    n = 1200
    u = np.repeat(rng.uniform(-2.0, 2.0, n // hold), hold)
    beyond = np.sign(u) * np.maximum(np.abs(u) - 0.7, 0.0)
    x = slope * beyond + 1.2 * np.sign(beyond)
    y = lfilter([0.0, 0.3], [1.0, -0.7], x)
    y += 0.03 * y.std() * rng.standard_normal(n)
    effects = ["in_deadzone", "in_preload", "in_relay", "in_saturation", "time_variation", "op_gain"]
    split = np.repeat(["est", "val"], [800, 400])
    found = sysid.diagnose(
        make_record(u, y, 1.0, split=split), order=1, initial_state="rest", effects=effects
    )
    assert set(found.accepted) == {"in_deadzone", "in_preload"}
    for width in found.final.fitted.parameters_of("in_deadzone"):
        assert abs(width.value - 0.7) < 2.6 * width.std_error < 0.04  # it lies between two inputs


def test_two_that_explain_little_alone_are_found_where_neither_leads():
    """A jump of the input does better than the drag or the drift, and no effect beside it mends it."""
    rng = np.random.default_rng(1)
    n, load = 1000, 0.0
    u = np.repeat(rng.uniform(-1.0, 1.0, n), rng.integers(2, 50, n))[:n]
    x = np.zeros(n)
    for k in range(2, n):
        x[k] = 1.7385 * x[k - 1] - 0.7548 * x[k - 2] + 0.0196 * (u[k - 1] - load)
        speed = x[k] - x[k - 1]
        load = 1500.0 * speed * abs(speed)
    y = x - 1.5e-4 * np.arange(n)
    y += 0.05 * y.std() * rng.standard_normal(n)
    effects = ["in_saturation", "in_deadzone", "in_preload", "in_backlash", "out_offset", "out_drift"]
    effects += ["quad_drag", "op_gain", "extra_mode"]
    split = np.repeat(["est", "val", "test"], [600, 250, 150])
    found = sysid.diagnose(
        make_record(u, y, 1.0, split=split), order=2, initial_state="rest", effects=effects
    )
    assert set(found.accepted) == {"quad_drag", "out_drift"}


def sliding(drag, friction):
    """Return a mass with drag and dry friction under steps of a force."""
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(-4.0, 4.0, 60), 10)
    x = v = 0.0
    y, h = [], 0.1 / 40
    for force in u:
        y.append(x)
        for _ in range(40):
            pulled = v + h * (force - 0.2 * v - drag * v * abs(v))
            v = np.sign(pulled) * max(abs(pulled) - h * friction, 0.0)
            x += h * v
    y = np.array(y) + 0.002 * np.std(y) * rng.standard_normal(u.size)
    return make_record(u, y, period=0.1)


def revised_among_its_kind(record, first, second, other):
    """Return which effects stand in the end for two on a stage, where another one may take a place."""
    model = load_model("positioning-stage").with_parameters(
        {"M": 1.1, "F_v": 0.22}, {"gain": 1.0, "offset": 0.0}
    )
    structure = PhysicsStructure(record, model, "rest", ())
    evidence = Evidence(structure, record.estimation, record.validation, 0.01)
    first, second, other = find_effects([first, second, other])
    trials = Trials(evidence, (first, other, second), 0, 1, Progress(), Allowance())
    choices = [Choice(effect, effect.forms[0]) for effect in (first, second)]
    baseline = structure.baseline(evidence.rows)
    fit = structure.fit(choices, evidence.rows, WHITE, baseline, effort=Effort.COARSE)
    return among_its_kind(trials, fit, 0).names


def test_a_friction_that_falls_gives_way_to_a_constant_one_beside_a_drag():
    names = revised_among_its_kind(sliding(0.5, 1.0), "stribeck", "quad_drag", "coulomb")
    assert names == ("coulomb", "quad_drag")


def test_one_force_gives_way_to_another_behind_a_quantiser():
    """Without any force the run misses whole steps: no screen there tells what should be searched."""
    plain = sliding(2.0, 0.0)
    step = 0.25 * float(np.std(plain.y))
    record = make_record(plain.u[:, 0], step * np.round(plain.y[:, 0] / step), period=0.1)
    names = revised_among_its_kind(record, "cubic_stiffness", "out_quantisation", "quad_drag")
    assert names == ("quad_drag", "out_quantisation")
