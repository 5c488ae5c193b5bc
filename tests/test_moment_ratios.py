"""Closed forms of section 3 against exact moments, and against the numerical solution."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from sysid import moment_ratios
from sysid.distributions import PiecewiseUniform, Uniform
from sysid.errors import IdentifiabilityError, UsageError
from sysid.nonlinearities import NONLINEARITIES

SATURATION, DEAD_ZONE = NONLINEARITIES["saturation"], NONLINEARITIES["dead-zone"]
RELAY, PRELOAD = NONLINEARITIES["two-sided-relay"], NONLINEARITIES["two-sided-preload"]

# Half-widths at least a quarter apart, thresholds well inside: c then fixes a with a condition number
# below about 1e4, which leaves 1e-16 * 1e4 = 1e-12; 1e-9 is asked for.
widths = st.tuples(st.floats(1.0, 10.0), st.floats(1.25, 3.0), st.booleans()).map(
    lambda t: (t[0] * t[1], t[0]) if t[2] else (t[0], t[0] * t[1])
)
shares = st.floats(0.2, 0.9)
units = st.sampled_from([1e-8, 1.0, 1e8])


def symmetric(b):
    return Uniform.symmetric(b)


def ratio(nonlinearity, first, second, *parameters):
    return nonlinearity.moment(first, *parameters) / nonlinearity.moment(second, *parameters)


@settings(max_examples=100, deadline=None)
@given(b=widths, share=shares, unit=units)
def test_saturation(b, share, unit):
    b1, b2 = (unit * value for value in b)
    a = share * min(b1, b2)
    solution = moment_ratios.saturation(ratio(SATURATION, symmetric(b1), symmetric(b2), a), b1, b2)
    np.testing.assert_allclose(solution.parameters, a, rtol=1e-9)
    assert solution.regular


@settings(max_examples=100, deadline=None)
@given(b=widths, share=shares, unit=units)
def test_dead_zone(b, share, unit):
    b1, b2 = (unit * value for value in b)
    a = share * min(b1, b2)
    solution = moment_ratios.dead_zone(ratio(DEAD_ZONE, symmetric(b1), symmetric(b2), a), b1, b2)
    # Towards a = b the cubic has a double root; at 0.9 b that costs two digits more.
    np.testing.assert_allclose(solution.parameters, a, rtol=1e-9)
    assert solution.regular


@settings(max_examples=100, deadline=None)
@given(b=widths, share1=shares, share2=shares, d=st.tuples(st.floats(1.0, 3.0), st.floats(1.0, 3.0)))
def test_two_sided_relay(b, share1, share2, d):
    b1, b2 = b
    d1, d2 = d
    a1, a2 = share1 * min(b1, b2, d1), share2 * min(b1, b2, d2)
    inputs = symmetric(b1), symmetric(b2), PiecewiseUniform.zero_mean(d1, d2)
    # Equal sides of the third input weigh a1 and a2 alike; near that the equations lose digits.
    assume(abs(d1 - d2) > 0.3)
    c1, c2 = (ratio(RELAY, inputs[0], other, a1, a2) for other in inputs[1:])
    solution = moment_ratios.two_sided_relay(c1, c2, b1, b2, d1, d2)
    np.testing.assert_allclose(solution.parameters, [a1, a2], rtol=1e-9)
    assert solution.regular


@settings(max_examples=100, deadline=None)
@given(b=widths, a=st.tuples(st.floats(0.1, 3.0), st.floats(0.1, 3.0)), b3=st.floats(0.5, 5.0))
def test_two_sided_preload_from_plain_moments(b, a, b3):
    b1, b2 = b
    inputs = symmetric(b1), symmetric(b2), PiecewiseUniform.mass_and_uniform(b3)
    c1, c2 = (ratio(PRELOAD, inputs[0], other, *a) for other in inputs[1:])
    assert moment_ratios.preload_sum(c1, b1, b2) == pytest.approx(sum(a), rel=1e-9)
    solution = moment_ratios.two_sided_preload(c1, c2, b1, b2, b3)
    # a1 and a2 differ by a small share of moments that hold b^2: up to three digits go.
    np.testing.assert_allclose(solution.parameters, a, rtol=1e-9, atol=1e-9)
    assert solution.regular


@settings(max_examples=100, deadline=None)
@given(
    b=widths,
    a=st.tuples(st.floats(0.1, 3.0), st.floats(0.1, 3.0)),
    gain=st.sampled_from([-3.0, 1e-6, 1.0, 1e6]),
)
def test_preload_from_the_exact_offset(b, a, gain):
    b1, b2 = b
    alpha, beta = np.array([-0.8333, -0.1667]), gain * np.array([1.0, 0.5])
    first = symmetric(b1)
    mean = PRELOAD.mean(first, *a) * beta.sum() / (1 - alpha.sum())
    c1 = ratio(PRELOAD, first, symmetric(b2), *a)
    q = PRELOAD.moment(first, *a)
    solution = moment_ratios.preload_from_offset(c1, b1, b2, alpha, q * beta, mean)
    np.testing.assert_allclose(solution.parameters, a, rtol=1e-9, atol=1e-9)
    assert solution.regular


@pytest.mark.parametrize("share", [0.25, 0.5, 0.85])
@pytest.mark.parametrize(("b1", "b2"), [(2.0, 3.0), (1.0, 4.0), (3.0, 2.0)])
def test_closed_forms_agree_with_the_numerical_solution(share, b1, b2):
    a = share * min(b1, b2)
    for nonlinearity, solve in ((SATURATION, moment_ratios.saturation), (DEAD_ZONE, moment_ratios.dead_zone)):
        moments = [lambda p, b=b, f=nonlinearity: f.moment(symmetric(b), float(p[0])) for b in (b1, b2)]
        c = moments[0]([a]) / moments[1]([a])
        numerical = moment_ratios.any_map(moments, [c], [0.0], [min(b1, b2)])
        # The solver stops at a gradient of 1e-14: half the digits and more.
        np.testing.assert_allclose(numerical.parameters, solve(c, b1, b2).parameters, rtol=1e-6)
        assert numerical.regular


def test_two_parameters_numerically():
    inputs = symmetric(2.0), symmetric(6.0), PiecewiseUniform.zero_mean(2.0, 4.0)
    moments = [lambda p, f=f: RELAY.moment(f, float(p[0]), float(p[1])) for f in inputs]
    true = np.array([0.6, 1.4])
    ratios = [moments[0](true) / q(true) for q in moments[1:]]
    numerical = moment_ratios.any_map(moments, ratios, [0.0, 0.0], [2.0, 2.0])
    closed = moment_ratios.two_sided_relay(*ratios, 2.0, 6.0, 2.0, 4.0)
    np.testing.assert_allclose(numerical.parameters, true, rtol=1e-6)
    np.testing.assert_allclose(closed.parameters, true, rtol=1e-12)


# Ratios that noise has pushed out of their range ------------------------------------------------------


def test_a_ratio_out_of_range_is_flagged():
    # q(b) of a saturation lies between the linear b^2/3 and the relay's b a / 2: c in (b1/b2)^2 .. b1/b2.
    low, high = (2 / 3) ** 2, 2 / 3
    inside = np.linspace(low, high, 12)[2:-2]
    assert all(moment_ratios.saturation(c, 2.0, 3.0).regular for c in np.linspace(0.58, 0.66, 9))
    assert not moment_ratios.saturation(high + 0.01, 2.0, 3.0).regular  # a^2 < 0
    assert not moment_ratios.saturation(low + 0.01, 2.0, 3.0).regular  # a > b1: nothing saturates
    assert all(math.isfinite(moment_ratios.saturation(c, 2.0, 3.0).parameters[0]) for c in inside)
    assert not moment_ratios.saturation(1.5, 2.0, 3.0).regular  # the pole of (3.14)
    assert not moment_ratios.dead_zone(0.5, 2.0, 3.0).regular  # above (b1/b2)^2
    assert not moment_ratios.dead_zone(-0.01, 2.0, 3.0).regular  # below zero
    assert all(
        0 <= moment_ratios.dead_zone(c, 2.0, 3.0).parameters[0] <= 2 for c in (-1.0, 0.0, 0.5, 1.5, 9.0)
    )
    exact = ratio(RELAY, symmetric(2.0), symmetric(6.0), 0.1, 0.1)
    assert not moment_ratios.two_sided_relay(exact * 1.05, 0.5, 2.0, 6.0, 2.0, 4.0).regular
    assert not moment_ratios.any_map([lambda a: a[0], lambda a: 1 + a[0]], [5.0], [0.0], [1.0]).regular


def test_the_absolute_value_stands_for_a_negative_square():
    solution = moment_ratios.saturation(0.68, 2.0, 3.0)
    square = 3 * (0.68 * 3 - 2) * 6 / (0.68 * 2 - 3)
    assert square < 0
    assert solution.parameters[0] == pytest.approx(math.sqrt(-square))


CALLS = {
    "saturation": lambda c, b1, b2: moment_ratios.saturation(c, b1, b2),
    "dead zone": lambda c, b1, b2: moment_ratios.dead_zone(c, b1, b2),
    "relay": lambda c, b1, b2: moment_ratios.two_sided_relay(c, 0.5, b1, b2, 2.0, 4.0),
    "preload sum": lambda c, b1, b2: moment_ratios.preload_sum(c, b1, b2),
    "preload": lambda c, b1, b2: moment_ratios.two_sided_preload(c, 0.5, b1, b2, 3.0),
    "offset": lambda c, b1, b2: moment_ratios.preload_from_offset(c, b1, b2, np.zeros(1), np.ones(1), 0.0),
}


@pytest.mark.parametrize("name", CALLS)
def test_inputs_without_a_solution_end_in_one_sentence(name):
    call = CALLS[name]
    with pytest.raises(IdentifiabilityError, match=r"both inputs have the half-width 2, .* use two widths"):
        call(0.5, 2.0, 2.0)
    with pytest.raises(UsageError, match="must be positive: give b > 0"):
        call(0.5, -2.0, 3.0)
    for bad in (math.nan, math.inf):
        with pytest.raises(IdentifiabilityError, match="not all finite"):
            call(bad, 2.0, 3.0)


def test_dependent_equations_end_in_one_sentence():
    with pytest.raises(IdentifiabilityError, match="dependent: use inputs that weigh"):
        moment_ratios.two_sided_relay(0.4, 0.5, 2.0, 6.0, 3.0, 3.0)  # a symmetric third input
    with pytest.raises(IdentifiabilityError, match="no static gain"):
        moment_ratios.preload_from_offset(0.3, 2.0, 6.0, np.array([0.5]), np.array([1.0, -1.0]), 0.1)
    with pytest.raises(IdentifiabilityError, match="2 moments and 1 ratios cannot determine 2 parameters"):
        moment_ratios.any_map([lambda a: 1.0] * 2, [1.0], [0.0, 0.0], [1.0, 1.0])
