"""The experiment that separates two candidates: predicted, then carried out."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import sysid
from sysid.data import make_record
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.experiment import Responding, separating_experiment
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.physics.structure import PhysicsStructure
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort
from sysid.physics import load_model


def test_a_small_signal_record_gets_a_larger_one():
    """Saturation and cubic stiffness differ little for an input that hardly reaches the knee."""
    rng = np.random.default_rng(2)
    u, y = np.repeat(rng.uniform(-1, 1, 100), 5), np.zeros(500)
    for k in range(1, 500):
        y[k] = 0.8 * y[k - 1] + 0.2 * np.clip(u[k - 1], -0.8, 0.8)
    record = make_record(u, y + 0.02 * rng.standard_normal(500), period=1.0)
    structure = LinearStructure(record, 1, initial_state="rest")
    assert isinstance(structure, Responding)
    rows = record.learning
    base = structure.baseline(rows)
    fits = [
        structure.fit([Choice(effect, effect.forms[0])], rows, WHITE, base, effort=Effort.FINE)
        for effect in find_effects(["in_saturation", "cubic_stiffness"])
    ]
    found = separating_experiment(structure, fits[0], fits[1], record.u[:, 0], 0.02)
    assert found.separation > 3.0
    same = separating_experiment(structure, fits[0], fits[0], record.u[:, 0], 0.02)
    assert same.separation < 1e-9
    # From rest, the response is the free run of the fit.
    response, slopes = structure.respond(fits[0], record.u[:, 0].copy())
    assert np.allclose(response, fits[0].output)
    assert slopes.shape == (500, fits[0].n_parameters)


def delayed_and_limited(delay: float, hold: int):
    """A thermal plant whose heating is limited and acts late, by so many samples."""
    rng = np.random.default_rng(3)
    n, pole = 900, np.exp(-0.1 / 0.8)
    u = np.repeat(rng.uniform(-1.5, 1.5, n // hold), hold)
    late = np.interp(np.arange(n) - delay, np.arange(n), np.clip(u, -0.8, 0.8), left=0.0)
    y = lfilter([0.0, 2.0 * (1.0 - pole)], [1.0, -pole], late) + 0.01 * rng.standard_normal(n)
    split = np.array(["est"] * 500 + ["val"] * 200 + ["test"] * 200)
    return make_record(u, y, period=0.1, split=split)


def test_a_physical_response_is_the_free_run_of_the_fit_and_its_slopes_are_those_of_moved_parameters():
    record = delayed_and_limited(2.4, 3)
    structure = PhysicsStructure(record, load_model("thermal-first-order"), "rest")
    rows = record.learning
    (effect,) = find_effects(["in_saturation"])
    base = structure.baseline(rows)
    fit = structure.fit([Choice(effect, effect.forms[0])], rows, WHITE, base, effort=Effort.COARSE)
    response, slopes = structure.respond(fit, record.u[:, 0].copy())
    assert np.allclose(response, fit.output, rtol=0.0, atol=1e-9)
    # The direction of each unknown, against the free run with it moved by 1e-4: truncation is of that size.
    assert slopes.shape == (900, fit.n_parameters)
    for number in range(fit.n_parameters):
        moved = fit.point.copy()
        moved[number] += 1e-4
        other, _ = structure.respond(replace(fit, point=moved), record.u[:, 0].copy())
        quotient = (other - response) / 1e-4
        assert np.abs(quotient - slopes[:, number]).max() < 2e-3 * np.abs(quotient).max()


@pytest.mark.parametrize(("delay", "hold", "place"), [(2.4, 3, 0), (0.6, 30, 1)])
def test_an_effect_that_others_equal_is_told_whenever_it_was_found(delay, hold, place):
    """Late at the input or late at the sensor: the same for a linear plant, and both beside a limit."""
    names = ["in_saturation", "in_delay", "out_delay", "out_quadratic"]
    found = sysid.diagnose(delayed_and_limited(delay, hold), "thermal-first-order", effects=names)
    assert found.decision.trials[0].name in (("in_delay", "out_delay"), ("in_saturation",))[place]
    assert set(found.accepted) > {"in_saturation"}
    (tie,) = found.decision.ties
    assert {trial.name for trial in tie} == {"in_delay", "out_delay"}
    assert "standard deviations of the noise" in found.advice
