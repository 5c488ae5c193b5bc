"""What poor minima of a model without its effect make of a search: no false names, no refusal."""

import numpy as np
import pytest
from scipy.signal import lfilter

import sysid
from sysid.data import make_record
from sysid.diagnosis.decide.allowance import Allowance
from sysid.diagnosis.decide.growth import Growth
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.decide.trials import Trials
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort
from sysid.diagnosis.structures.work import Work
from sysid.progress import Progress


def limited(rng, n=900):
    """Return an input, and the output of a first-order plant behind a limit at 0.5."""
    u = rng.uniform(-1.0, 1.0, n)
    y = lfilter([0.0, 0.5], [1.0, -0.8], np.clip(u, -0.5, 0.5))
    return u, y + 0.03 * y.std() * rng.standard_normal(n)


def better_with_fewer(seed, current, grown, allowance):
    """Return the fit that takes the place of one with the ``current`` effects, of a record behind a limit."""
    structure = LinearStructure(make_record(*limited(np.random.default_rng(seed)), 1.0), 1)
    record = structure.record
    evidence = Evidence(structure, record.estimation, record.validation, 0.01)
    candidates = find_effects(["in_preload", "in_saturation", "out_drift"])
    trials = Trials(evidence, candidates, 0, 1, Progress(), allowance)
    baseline = structure.baseline(evidence.rows)
    trial = trials.beside(baseline, False)[0]

    def fitted(names):
        choices = [Choice(effect, effect.found_by[0]) for effect in find_effects(names)]
        return structure.fit(choices, evidence.rows, WHITE, baseline, effort=Effort.FINE)

    return Growth(trials, (), 3)._better_with_fewer(fitted(current), fitted(grown), trial, baseline)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_effect_that_led_another_into_the_place_of_the_first_must_hold_beside_it(seed):
    better = better_with_fewer(seed, ["in_preload"], ["in_saturation", "out_drift"], Allowance())
    assert better is not None
    assert better.names == ("in_saturation",)


def test_a_search_without_work_left_is_not_cut_short_where_nothing_is_asked_again():
    allowance = Allowance(Work(given=100_000.0))
    allowance.work.note("all that went before", 260_000)  # no other look may begin
    assert better_with_fewer(1, ["in_saturation"], ["in_saturation", "out_drift"], allowance) is None
    assert not allowance.ended


def with_a_constant():
    """Return a record of slow stairs through a plant of two modes, with a constant force against its input.

    Without the force its searches end in different places, none of which follows the output.
    """
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice(np.linspace(-2.0, 2.0, 9), 15), 60)
    b, a = [0.0, 0.00176, 0.00196, -0.000432, 0.000476], [1.0, -2.5926, 2.81232, -1.69047, 0.476379]
    y = lfilter(b, a, u + 1.0)
    return make_record(u, y + 0.04 * y.std() * rng.standard_normal(u.size), 1.0)


def test_searches_that_disagree_for_want_of_an_effect_do_not_hide_it():
    record = with_a_constant()
    assert not LinearStructure(record, 4, initial_state="rest").baseline(record.estimation).restarts_agree
    effects = ["constant_force", "in_deadzone", "out_quadratic"]
    found = sysid.diagnose(record, order=4, initial_state="rest", effects=effects)
    assert (found.verdict, found.accepted) == ("missing-effect", ("constant_force",))
    (force,) = found.final.fitted.parameters_of("constant_force")
    assert abs(force.value + 1.0) < 3.3 * force.std_error < 0.1  # one record in a thousand is farther off


def test_searches_that_disagree_and_that_no_effect_makes_agree_are_no_basis_for_a_name():
    record = with_a_constant()
    found = sysid.diagnose(record, order=4, initial_state="rest", effects=["in_deadzone", "out_quadratic"])
    assert (found.verdict, found.accepted) == ("not-identifiable", ())


def test_a_side_that_only_held_out_rows_reach_is_not_missing():
    """The rows of the search see next to nothing of the lower limit, so that one number does for both."""
    rng = np.random.default_rng(6)
    levels = np.concatenate([rng.uniform(-0.62, 1.5, 60), rng.uniform(-1.5, 1.5, 40)])
    u = np.repeat(levels, 8)
    y = lfilter([0.0, 0.3], [1.0, -0.7], np.clip(u, -0.8, 0.6))
    y += 0.15 * y.std() * rng.standard_normal(u.size)
    split = np.repeat(["est", "val"], [480, 320])
    effects = ["in_saturation", "in_preload", "time_variation", "out_quadratic", "coloured_noise"]
    found = sysid.diagnose(
        make_record(u, y, 1.0, split=split), order=1, initial_state="rest", effects=effects
    )
    assert (found.verdict, found.accepted) == ("missing-effect", ("in_saturation",))
    values = {p.name: (p.value, p.std_error) for p in found.final.fitted.parameters_of("in_saturation")}
    for name, level in {"level_negative": 0.8, "level_positive": 0.6}.items():
        assert abs(values[name][0] - level) < 3.3 * values[name][1] < 0.2
