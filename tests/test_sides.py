"""An effect with sides of their own, when what hid them has been found."""

import numpy as np
import pytest

from sysid.data import make_record
from sysid.diagnosis.diagnose import diagnose
from sysid.diagnosis.effects.catalogue import find_effects
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.structures.sides import freer_forms, with_forms_of
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort


def _preloaded(step: float, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Return random steps through a preload with two sides, a first-order lag and a quantiser."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(-2.0, 2.0, 60), 20)
    x = u + np.where(u > 0.0, 0.61, -0.68)
    y = np.zeros(u.size)
    for k in range(1, u.size):
        y[k] = 0.93 * y[k - 1] + 0.065 * x[k - 1]
    return u, (step * np.round(y / step) if step else y) + noise * rng.standard_normal(u.size)


def test_sides_that_a_coarse_quantiser_hides_are_no_third_effect() -> None:
    u, y = _preloaded(step=1.0, noise=0.05)
    names = ["in_preload", "in_deadzone", "in_saturation", "out_quantisation", "out_saturation"]
    found = diagnose(make_record(u, y, period=1.0), order=1, effects=names, initial_state="rest")
    assert sorted(found.accepted) == ["in_preload", "out_quantisation"]
    jumps = {p.name: p.value for p in found.final.fitted.parameters_of("in_preload")}
    # Cells of one unit place a jump to some hundredths.
    assert jumps == pytest.approx({"jump_positive": 0.61, "jump_negative": 0.68}, abs=0.04)


def test_a_form_with_two_sides_starts_as_the_one_with_one() -> None:
    u, y = _preloaded(step=0.0, noise=0.05)
    # At rest: beside a free constant the two sides would be told by nothing.
    structure = LinearStructure(make_record(u, y, period=1.0), 1, initial_state="rest")
    rows = structure.record.learning
    (effect,) = find_effects(["in_preload"])
    one = Choice(effect, effect.form("symmetric"))
    fit = structure.fit([one], rows, WHITE, structure.baseline(rows), effort=Effort.FINE)
    (form,) = freer_forms(one)
    two = Choice(effect, form)
    places = structure.chain(fit.choices).places(structure.data(rows))
    moved = with_forms_of([two], fit, places)
    own = fit.point[places[0]]
    assert moved.choices == (two,)
    assert np.array_equal(moved.point[places[0].start : places[0].start + 2], np.repeat(own, 2))
    assert moved.point.size == fit.point.size + 1
    again = structure.fit([two], rows, WHITE, fit, effort=Effort.REFIT)
    assert again.cost < 0.99 * fit.cost


def test_an_offset_that_only_the_start_of_a_play_tells_from_its_sides_is_named() -> None:
    # Once the play has been crossed its sides stand for any constant: held-out rows cannot tell.
    rng = np.random.default_rng(7)
    u = np.repeat(rng.uniform(-2.0, 2.0, 120), 10)
    x, y = 0.0, np.zeros(u.size)
    for k in range(1, u.size):
        x = min(max(x, u[k - 1] - 0.6), u[k - 1] + 0.7)
        y[k] = 0.9 * y[k - 1] + 0.1 * x
    y += 0.14 + 0.02 * rng.standard_normal(u.size)
    names = ["in_backlash", "in_deadzone", "in_preload", "out_offset", "out_drift"]
    found = diagnose(make_record(u, y, period=1.0), order=1, effects=names, initial_state="rest")
    assert sorted(found.accepted) == ["in_backlash", "out_offset"]
    (offset,) = found.final.fitted.parameters_of("out_offset")
    assert abs(offset.value - 0.14) < 4.0 * offset.std_error


def test_a_play_is_tried_by_how_far_the_input_moves() -> None:
    (play,) = find_effects(["in_backlash"])
    u = np.random.default_rng(0).uniform(-0.1, 0.1, 500)
    (near,), (far,) = (play.forms[0].starts(u + level, u, 1.0) for level in (0.0, 5.0))
    assert near == pytest.approx(far, abs=0.005)  # the median of these is not quite zero
