"""Intervals of linear models where the error is no parabola, against profiles by scipy and known truth."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter

from benchmarks.hidden_effects.plan import assign
from sysid.data import make_record
from sysid.diagnosis.decide.noise_colour import noise_of
from sysid.diagnosis.diagnose import diagnose
from sysid.diagnosis.linear.levenberg import minimise
from sysid.diagnosis.linear.restarts import exchanged_poles
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.structures.structure import WHITE, Effort

ROWS = 900


def hidden_pole(seed, shown):
    """A plant of the second order whose second pole stands a distance from a zero."""
    rng = np.random.default_rng(seed)
    a, b = np.poly([0.8, 0.5]), 0.2 * np.array([1.0, -(0.5 + shown)])
    u = np.repeat(rng.standard_normal(ROWS // 10), 10)
    y = lfilter(np.r_[0.0, b], a, u)
    return np.r_[a[1:], b], u, y + 0.05 * np.std(y) * rng.standard_normal(ROWS)


def fitted(u, y, order=2, *, closely=True):
    record = make_record(u, y, period=1.0)
    structure = LinearStructure(record, order, initial_state="rest")
    return structure.finish(structure.baseline(record.learning), WHITE, closely=closely)


def profiled(u, y, fit, i, value):
    """Return by how many noise variances the sum of squares rises where one coefficient is held, by scipy."""
    point = np.array([p.value for p in fit.parameters])
    rest = np.delete(np.arange(point.size), i)

    def error(free):
        full = np.insert(free, i, value)
        if np.abs(np.roots(np.r_[1.0, full[:2]])).max() >= 1.0:
            return np.full(ROWS, 1e3)
        return lfilter(np.r_[0.0, full[2:]], np.r_[1.0, full[:2]], u) - y

    found = least_squares(error, point[rest], jac="3-point", xtol=1e-12, ftol=1e-12, x_scale="jac")
    return (2.0 * found.cost - fit.cost) * (ROWS - point.size) / fit.cost


def test_where_slopes_hold_they_are_kept():
    _, u, y = hidden_pole(1, shown=0.9)
    by_slopes, close = (fitted(u, y, closely=closely) for closely in (False, True))
    for one, other in zip(by_slopes.parameters, close.parameters, strict=True):
        assert one.value == other.value
        # Within what a rise of 2.5 or 5.5 in place of 3.84 would tell.
        assert other.std_error == pytest.approx(one.std_error, rel=0.25)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_bent_valley_is_followed_to_where_the_profile_of_scipy_rises(seed):
    _, u, y = hidden_pole(seed, shown=0.03)
    fit = fitted(u, y)
    first = fit.parameters[0]  # its valley is longer towards a faster pole
    # 3.84 to a line between two points of a walk.
    assert profiled(u, y, fit, 0, first.value + 1.96 * first.std_error) == pytest.approx(3.84, abs=0.3)


def test_intervals_of_a_hardly_seen_pole_hold_the_truth():
    inside, slopes = [], []
    for seed in range(100, 120):
        truth, u, y = hidden_pole(seed, shown=0.03)
        for answers, closely in ((inside, True), (slopes, False)):
            for parameter, value in zip(fitted(u, y, closely=closely).parameters, truth, strict=True):
                answers.append(abs(parameter.value - value) < 1.96 * parameter.std_error)
    # 80 intervals of 20 records: three standard deviations of 20 independent ones are 15 %.
    assert np.mean(inside) > 0.8
    assert np.mean(slopes) < np.mean(inside)


def test_poles_are_exchanged_one_or_one_pair_at_a_time():
    poles = np.array([0.85, 0.5 + 0.3j, 0.5 - 0.3j])
    found = list(exchanged_poles(np.real(np.poly(poles))[1:], 3))
    assert len(found) == 9
    for other in found:
        assert np.allclose(np.imag(np.poly(other)), 0.0, atol=1e-12)
        kept = [min(abs(pole - poles)) < 1e-9 for pole in other]
        assert sum(kept) in (1, 2)


def test_a_far_more_likely_model_takes_the_place_of_the_fit():
    """Poles that zeros all but cancel, in place of a resonance: the close look meets the resonance."""
    rng = np.random.default_rng(4)
    a = np.real(np.poly([0.9, 0.8 * np.exp(0.8j), 0.8 * np.exp(-0.8j)]))
    u = rng.standard_normal(ROWS)
    y = lfilter([0.0, 0.1, 0.05, 0.02], a, u)
    record = make_record(u, y + 0.05 * np.std(y) * rng.standard_normal(ROWS), period=1.0)
    structure = LinearStructure(record, 3, initial_state="rest")
    good = structure.baseline(record.learning)
    chain, data = structure.chain(()), structure.data(record.learning)
    slow = LinearStructure(record, 1, initial_state="rest").baseline(record.learning).point
    pair, nearly = np.array([1.0, -0.1, 0.02]), np.array([1.0, -0.101, 0.02])
    point = np.r_[np.convolve(np.r_[1.0, slow[0]], pair)[1:], slow[1] * nearly]
    error = chain.error(data, chain.run(data, point), WHITE)
    stuck = replace(good, point=point, cost=float(error @ error))
    assert stuck.cost > 10.0 * good.cost
    put_right = structure.finish(stuck, WHITE, closely=True)
    assert put_right.cost == pytest.approx(good.cost, rel=1e-6)
    np.testing.assert_allclose(put_right.output, good.output, atol=1e-3 * np.std(y))


def test_a_reader_is_told_where_the_record_does_not_tell_the_poles():
    for shown, told in ((0.0, True), (0.9, False)):
        _, u, y = hidden_pole(3, shown)
        found = diagnose(
            make_record(u, y, period=1.0), "linear", 2, initial_state="rest", effects=["in_relay"]
        )
        assert any("does not tell all 2 poles" in sentence for sentence in found.sentences()) == told


@pytest.mark.parametrize("number", [84, 90, 121])
def test_under_coloured_noise_the_model_alone_is_as_likely_as_from_the_true_poles(number):
    """Plain fits to these records take slow noise for a pole at 1; effects would be credited with others."""
    case = assign(5991, number, "hard", "difference-equation", "null").case
    record = make_record(case.u, case.y, period=1.0, split=case.sets)
    structure, rows = LinearStructure(record, 3, initial_state="rest"), record.estimation
    plain = structure.baseline(rows)
    noise = noise_of(record.y[:, 0] - plain.output, rows).polynomial
    fit = structure.fit((), rows, noise, plain, effort=Effort.REFIT)
    true = np.array(list(case.plant.parameters.values()))
    from_truth = minimise(structure.chain(()), structure.data(rows), true, noise)
    assert fit.cost < from_truth.cost * (1.0 + 1e-3 / rows.sum())
    assert plain.point[:3] != pytest.approx(fit.point[:3], abs=0.1)
