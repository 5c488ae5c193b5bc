"""Tanks that empty through holes or pipes and run over, simulated by small steps of the balance alone."""

import numpy as np
import pytest

from sysid.data import make_record
from sysid.diagnosis.diagnose import diagnose
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.physics.free_run import free_run
from sysid.diagnosis.physics.problem import COARSE_STEP, Problem
from sysid.diagnosis.physics.scatter import within_limits
from sysid.diagnosis.physics.structure import PhysicsStructure
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort
from sysid.physics import load_model

PERIOD, STEPS = 4.0, 200
NOISE = 0.02
A1, A2, B = 0.05, 0.047, 0.045
LIMITS, CAUGHT = (9.0, 9.5), 0.7


def levels(u, start, powers, steps=STEPS):
    """Return the lower level: Euler's steps of a fiftieth of a second, tanks cut off at their rims."""
    upper, lower = start
    step, shown = PERIOD / steps, np.empty(u.size)
    for k, pump in enumerate(u.tolist()):
        shown[k] = lower
        for _ in range(steps):
            between = A1 * max(upper, 0.0) ** powers[0]
            risen = upper + step * (B * pump - between)
            over = max(risen - LIMITS[0], 0.0)
            upper = risen - over
            lower += step * (between - A2 * max(lower, 0.0) ** powers[1]) + CAUGHT * over
            lower = min(lower, LIMITS[1])
    return shown


def pumped(rng, n):
    """Return a pump voltage that wanders slowly, with some floods."""
    wandering = np.convolve(rng.standard_normal(n + 40), np.hanning(41), mode="valid")[:n]
    return np.clip(2.6 + 1.0 * wandering / wandering.std(), 0.4, None)


def tanks(powers, seed=0, starts=((6.0, 4.0), (2.0, 7.0))):
    """Return a record of two experiments, the second one a test, each from levels of its own."""
    rng = np.random.default_rng(seed)
    inputs = [pumped(rng, 700), pumped(rng, 400)]
    y = np.concatenate([levels(u, start, powers) for u, start in zip(inputs, starts, strict=True)])
    split = np.repeat(["train", "test"], [700, 400])
    experiment = np.repeat([1, 2], [700, 400])
    y_noisy = y + NOISE * rng.standard_normal(y.size)
    record = make_record(
        np.concatenate(inputs), y_noisy, period=PERIOD, split=split, experiment=experiment, skip=40
    )
    return record, y


def value(found, effect, name):
    return next(p.value for p in found.final.parameters if p.owner == effect and p.name == name)


def test_roots_and_a_flood_that_is_caught_in_part_are_named_and_measured():
    record, _ = tanks((0.5, 0.5))
    found = diagnose(record, "two-tanks", effects=["sqrt_outflow", "overflow", "op_gain", "out_offset"])
    assert found.verdict == "missing-effect"
    assert set(found.accepted) == {"sqrt_outflow", "overflow"}
    # In a step of 4 s the upper level rises by some 0.3: that is how sharply its rim is seen.
    assert value(found, "overflow", "limit_1") == pytest.approx(LIMITS[0], abs=0.3)
    assert value(found, "overflow", "limit_2") == pytest.approx(LIMITS[1], abs=0.05)
    assert value(found, "overflow", "caught") == pytest.approx(CAUGHT, abs=0.03)
    # From an initial state of its own, found on 40 rows, the test runs nearly at the noise.
    assert found.ladder[-1].scores["test"]["rmse"] < 2.0 * NOISE


def test_a_finer_law_of_what_was_found_comes_before_further_names():
    record, _ = tanks((0.7, 0.4))
    found = diagnose(record, "two-tanks", effects=["sqrt_outflow", "overflow"])
    assert set(found.accepted) == {"sqrt_outflow", "overflow"}
    choices = {choice.name: choice.form.name for choice in found.final.fitted.choices}
    assert choices["sqrt_outflow"] == "power"
    assert value(found, "sqrt_outflow", "power_1") == pytest.approx(0.7, abs=0.03)
    assert value(found, "sqrt_outflow", "power_2") == pytest.approx(0.4, abs=0.03)
    assert found.ladder[-1].scores["test"]["rmse"] < 3.0 * NOISE


@pytest.mark.parametrize("start", [(0.3, 7.0), (8.5, 3.0)])
def test_a_new_experiment_starts_from_levels_of_its_own(start):
    powers = (1.5, 0.35)
    record, y = tanks(powers, starts=((6.0, 4.0), start))
    structure = PhysicsStructure(record, load_model("two-tanks"))
    choices = [choice("sqrt_outflow", "power"), choice("overflow", "cascade")]
    problem = Problem(structure.setting, choices, record.estimation, WHITE, COARSE_STEP)
    names = [p.name for p in structure.setting.searched]
    own = np.log([{"a1": A1, "a2": A2, "b": B}[name] for name in names])
    x = np.concatenate([own, powers, LIMITS, [CAUGHT], (6.0, 4.0)])
    test = record.scored_rows("test")
    # A start from rest stays there: an empty tank's outflow does not feel a small change of its level.
    assert rms((free_run(problem, x) - y)[test]) < 2.0 * NOISE


def choice(name, form):
    (effect,) = find_effects([name])
    return Choice(effect, effect.form(form))


def rms(error):
    return float(np.sqrt(np.mean(error**2)))


def test_a_point_starts_below_the_rims():
    record, _ = tanks((0.5, 0.5))
    structure = PhysicsStructure(record, load_model("two-tanks"))
    choices = [choice("sqrt_outflow", "square root"), choice("overflow", "cascade")]
    problem = Problem(structure.setting, choices, record.estimation, WHITE, COARSE_STEP)
    x = np.concatenate([np.zeros(3), LIMITS, [CAUGHT], (50.0, 4.0)])
    assert within_limits(problem, x)[-2:].tolist() == [LIMITS[0], 4.0]
    assert x[-2] == 50.0


@pytest.mark.parametrize("unit", [1.0, 10.0])
def test_a_root_is_found_of_levels_in_any_unit(unit):
    """Two tanks of which no value is known: the first search for the law comes down to the noise."""
    rng, gains, x, z = np.random.default_rng(0), (0.285, 0.253), 4.0, 5.0
    u, y = np.maximum(2.6 + 1.2 * (pumped(rng, 700) - 2.6), 0.0), np.empty(700)
    for k, volts in enumerate(u):
        y[k] = z
        for _ in range(40):
            flow = gains[0] * np.sqrt(x)
            x = max(x + 0.1 * (0.24 * volts - flow), 0.0)
            z = max(z + 0.1 * (flow - gains[1] * np.sqrt(z)), 0.0)
    record = make_record(u, unit * (y + 0.008 * rng.standard_normal(700)), period=PERIOD)
    structure = PhysicsStructure(record, load_model("two-tanks"), "estimate")
    (effect,) = structure.offered(find_effects(["sqrt_outflow"]))
    rows = record.estimation
    baseline = structure.baseline(rows)
    choice = Choice(effect, effect.form("square root"))
    fit = structure.fit([choice], rows, WHITE, baseline, effort=Effort.COARSE)
    assert np.sqrt(fit.cost / rows.sum()) < 0.009 * unit
