"""What is left of a record: noise of some colour, or something that goes with its signals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from sysid.data import make_record
from sysid.diagnosis.decide.acceptance import rests_on_few_rows
from sysid.diagnosis.decide.decision import Trial
from sysid.diagnosis.decide.remains import chance_by_likelihood, clearest
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.diagnose import diagnose
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.structures.probe_functions import FUNCTIONS, families, probe_functions
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort


def slow_noise(rng, n, pole=0.9):
    return lfilter([1.0], [1.0, -pole], rng.standard_normal(n + 200))[200:]


def second_order(u):
    return lfilter([0.0, 0.25], [1.0, -1.5, 0.75], u)


def test_likelihood_and_kinds_of_probes_keep_their_chances_under_coloured_noise():
    """40 records of slow noise beside 30 smooth directions: of either chance 4 % at most are below 0.001.

    Were the chances right, two or more of 40 would be so small with a probability of 0.0008.
    """
    small = np.zeros(2)
    for seed in range(40):
        rng = np.random.default_rng(seed)
        residual, constant, rows = slow_noise(rng, 600), np.ones((600, 1)), np.ones(600, dtype=bool)
        probes = np.column_stack([slow_noise(rng, 600, 0.8) for _ in range(30)])
        by_kind, _ = clearest(residual[1:] - 0.9 * residual[:-1], *(
            part[1:] - 0.9 * part[:-1] for part in (constant, probes)
        ), [slice(0, 10), slice(10, 20), slice(20, 30)])  # fmt: skip
        small += np.array([chance_by_likelihood(residual, constant, probes, rows), by_kind]) < 1e-3
    assert (small <= 1).all()


def test_families_hold_every_probe_once():
    signals = np.random.default_rng(0).standard_normal((5, 50))
    assert len([*probe_functions(*signals)]) == FUNCTIONS
    for n_probes in (2 * FUNCTIONS + 13, 3 * FUNCTIONS + 13, 7):
        kept = np.concatenate([np.arange(n_probes)[family] for family in families(n_probes)])
        assert kept.tolist() == list(range(n_probes))


@pytest.mark.parametrize("begins", [0, 900])
def test_a_gain_that_changes_is_not_taken_for_coloured_noise(begins):
    """Nobody listed it, and from row 900 on it shows in held-out rows alone."""
    rng = np.random.default_rng(begins)
    n = 1200
    u = np.repeat(rng.uniform(-1.0, 1.0, n), rng.integers(3, 12, n))[:n]
    noise = slow_noise(rng, n)
    share = np.clip((np.arange(n) - begins) / 500.0, 0.0, 1.0)
    y = second_order(u * (1.0 + 0.8 * share)) + 0.2 * noise / noise.std()
    asked = ["in_deadzone", "out_drift", "out_offset", "coloured_noise"]
    found = diagnose(make_record(u, y, period=1.0), order=2, initial_state="rest", effects=asked)
    assert (found.verdict, found.accepted) == ("unexplained", ())


def test_a_play_under_three_sines_is_not_put_down_to_a_controller():
    """Noise of order 12 foresees sines: by its colour alone the residual goes with nothing."""
    rng = np.random.default_rng(2)
    k, u, x = np.arange(1200), np.zeros(1200), np.zeros(1200)
    for frequency in (0.02, 0.05, 0.11):
        u += np.sin(frequency * k + rng.uniform(0.0, 6.0))
    for i in range(1, 1200):
        x[i] = min(max(x[i - 1], u[i] - 0.9), u[i] + 0.4)
    y = second_order(x) + 0.02 * rng.standard_normal(1200)
    structure = LinearStructure(make_record(u, y, period=1.0), 2, initial_state="rest")
    record = structure.record
    evidence = Evidence(structure, record.estimation, record.validation, 0.01)
    assert not evidence.only_at_once(structure.baseline(record.estimation))


@pytest.mark.parametrize(("moved", "few"), [(1, True), (60, False)])
def test_behind_a_quantiser_one_row_is_no_evidence(moved, few):
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-1.0, 1.0, 800), 5)[:800]
    y = 0.5 * np.round(second_order(u) / 0.5) + 0.02 * rng.standard_normal(800)
    structure = LinearStructure(make_record(u, y, period=1.0), 2, initial_state="rest")
    record = structure.record
    (effect,) = find_effects(["out_quantisation"])
    rows = record.estimation
    evidence = Evidence(structure, rows, record.validation, 0.01)
    choices = (Choice(effect, effect.forms[0]),)
    fit = structure.fit(choices, rows, WHITE, structure.baseline(rows), effort=Effort.FINE)
    output = fit.output.copy()
    output[rng.choice(np.flatnonzero(rows), moved, replace=False)] += 0.5
    current = replace(fit, output=output, n_parameters=fit.n_parameters - 1)
    trial = Trial("in_delay", fit, evidence.noise(fit), 0.0, looks=100)
    assert rests_on_few_rows(evidence, trial, current) is few
