"""What an order that nobody gave does as well as an effect, and what one effect of a pair does alone."""

from itertools import pairwise

import numpy as np
from scipy.signal import lfilter

from sysid import diagnose
from sysid.data import make_record
from sysid.data.record import Record
from sysid.diagnosis.decide.acceptance import is_better_held_out
from sysid.diagnosis.decide.search import Search
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort

Floats = np.ndarray


def record_of(u: Floats, y: Floats, noise: float, rng: np.random.Generator) -> Record:
    split = np.repeat(["est", "val", "test"], [u.size // 2, u.size // 6, u.size - u.size // 2 - u.size // 6])
    return make_record(u, y + noise * y.std() * rng.standard_normal(u.size), period=1.0, split=split)


def play(u: Floats, width: float) -> Floats:
    x, held = np.empty_like(u), 0.0
    for k, moved in enumerate(u):
        held = min(max(held, moved - width), moved + width)
        x[k] = held
    return x


def test_a_pole_behind_a_play_is_the_plants_and_no_slow_sensor() -> None:
    """Play hides the third pole of a plant from the model without effects: the order is chosen too low."""
    rng = np.random.default_rng(5)
    u = lfilter([0.02], [1.0, -1.65, 0.7], rng.standard_normal(1800))
    u *= 1.4 / u.std()
    plant = [0.0, 0.186, 0.102, -0.040], [1.0, -1.756, 1.276, -0.332]
    record = record_of(u, lfilter(*plant, play(u, 0.55)), 0.018, rng)
    found = diagnose(record, effects=["in_backlash", "out_lowpass", "in_deadzone"])
    assert found.accepted == ("in_backlash",)


def test_an_order_too_low_by_two_is_mended_beside_the_leader() -> None:
    """A sensor without sign hides two poles of three; ramps lead to each set-point, with some dither."""
    rng = np.random.default_rng(8)
    points, lengths = rng.uniform(-1.6, 1.6, 61), rng.integers(10, 30, 60)
    ways = [
        np.r_[np.linspace(a, b, n), np.full(n, b)]
        for (a, b), n in zip(pairwise(points), lengths, strict=True)
    ]
    u = np.concatenate(ways)[:1200] + 0.8 + 0.1 * lfilter([1.0], [1.0, -0.6], rng.standard_normal(1200))
    plant = [0.0, 0.177, -0.069, 0.006], [1.0, -2.021, 1.640, -0.533]
    record = record_of(u, np.abs(lfilter(*plant, u)), 0.016, rng)
    found = diagnose(record, effects=["out_rectify", "in_backlash", "out_quadratic"])
    assert found.accepted == ("out_rectify",)


def test_one_effect_of_a_pair_is_asked_for_evidence_when_the_other_does_nothing() -> None:
    """A sensor that cuts what lies below zero has next to nothing to cut, and may not be named for it."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(0.5, 2.0, 60), 10)
    u[:20] = u[350:380] = 0.0
    u[[0, 350]] = -0.01
    y = np.maximum(lfilter([0.0, 0.3], [1.0, -0.7], u), 0.0)
    noise = 0.02 * rng.standard_normal(u.size)
    noise[u == 0.0] = 1e-3 * np.abs(noise[u == 0.0])
    record = make_record(u, y + noise, period=1.0, split=np.repeat(["est", "val", "test"], [300, 150, 150]))
    structure = LinearStructure(record, 1, initial_state="rest")
    search = Search(structure, find_effects(["out_rectify", "out_quantisation"]))
    attempt = search._attempt(record.estimation, record.validation)
    decision = attempt.decided()
    assert decision.verdict == "nothing-missing"
    (effect,) = (each for each in search.candidates if each.name == "out_rectify")
    fits = [
        structure.fit(
            (Choice(effect, form),), record.estimation, WHITE, decision.baseline, effort=Effort.FINE
        )
        for form in effect.found_by
    ]
    lone = [fit for fit in fits if fit.usable and is_better_held_out(attempt.evidence, fit, decision.final)]
    assert lone
    assert attempt._otherwise(decision, decision.trials, lone) is decision
