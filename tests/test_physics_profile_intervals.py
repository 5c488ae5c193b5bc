"""Intervals of physical models where the error is no parabola, against profiles by scipy."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from benchmarks.hidden_effects.plan import assign
from sysid.data import make_record
from sysid.diagnosis.diagnose import structure_of
from sysid.diagnosis.effects.catalogue import find_effects
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort

NOISE = np.array([1.0, -0.87])


@pytest.fixture(scope="module")
def play():
    """A two-mass system behind play, whose second damper a sweep hardly shows."""
    case = assign(10602, 1, "hard", "two-mass", "single", "in_backlash").case
    record = make_record(case.u, case.y, period=case.plant.period, split=case.sets)
    structure = structure_of(record, "two-mass", None, "rest", dict(case.start))
    (effect,) = structure.offered(find_effects(["in_backlash"]))
    rows = record.learning
    plain = structure.fit(
        [Choice(effect, effect.forms[0])], rows, WHITE, structure.baseline(rows), effort=Effort.FINE
    )
    return structure, structure.fit(plain.choices, rows, NOISE, plain, effort=Effort.REFIT)


def rise_where_held(structure, fit, noise, place, coordinate):
    """Return by how many noise variances the sum of squares rises where one unknown is held, by scipy."""
    problem = structure._problem(fit.choices, fit.rows, noise)
    rest = np.delete(np.arange(problem.size), place)

    def residual(free):
        return problem.residual(np.insert(free, place, coordinate))

    found = least_squares(residual, fit.point[rest], x_scale="jac", diff_step=1e-6)
    return (2.0 * found.cost / fit.cost - 1.0) * (problem.target.size - problem.size)


@pytest.mark.parametrize("name", ["c2", "k2"])
def test_a_bent_valley_is_followed_to_where_the_profile_of_scipy_rises(play, name):
    structure, fit = play
    finished = structure.finish(fit, NOISE, closely=True)
    place = [p.name for p in finished.parameters].index(name)
    parameter = finished.parameters[place]
    longer = np.log(parameter.value + 1.96 * parameter.std_error)
    assert rise_where_held(structure, fit, NOISE, place, longer) == pytest.approx(3.84, abs=0.3)


def test_where_slopes_hold_they_are_kept(play):
    structure, fit = play
    by_slopes, close = (structure.finish(fit, NOISE, closely=closely) for closely in (False, True))
    for one, other in zip(by_slopes.parameters, close.parameters, strict=True):
        assert one.value == other.value
        if one.name in ("c1", "k1"):  # the spring and the damper of the driven mass are well seen
            assert other.std_error == pytest.approx(one.std_error, rel=0.25)
        assert other.std_error > 0.9 * one.std_error
    ratios = {
        p.name: p.std_error / q.std_error for p, q in zip(close.parameters, by_slopes.parameters, strict=True)
    }
    assert ratios["c2"] > 1.15


def test_a_plain_fit_under_slow_noise_is_followed_to_where_its_scatter_ends(play):
    """Of plain errors a rise counts as many times less as the noise's memory widens what slopes foretell."""
    structure, fit = play
    plain = structure.fit(fit.choices, structure.record.learning, WHITE, fit, effort=Effort.REFIT)
    by_slopes, close, white = (
        structure.finish(plain, noise, plain=True, closely=closely).parameters
        for noise, closely in ((NOISE, False), (NOISE, True), (WHITE, False))
    )
    place = [p.name for p in close].index("m1")
    widened = by_slopes[place].std_error / white[place].std_error
    assert widened > 1.1
    assert close[place].std_error > 1.1 * by_slopes[place].std_error
    rises = [
        rise_where_held(structure, plain, WHITE, place, np.log(close[place].value + end))
        for end in (-1.96 * close[place].std_error, 1.96 * close[place].std_error)
    ]
    assert min(rises) / widened**2 == pytest.approx(3.84, abs=0.3)
