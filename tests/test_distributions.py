"""Distributions: closed moments against quadrature and against large samples."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sysid.distributions import Gaussian, PiecewiseUniform, Uniform
from sysid.errors import UsageError

DISTRIBUTIONS = [
    Uniform.symmetric(4.0),
    Uniform(-1.0, 3.0),
    PiecewiseUniform.zero_mean(2.0, 5.0),
    PiecewiseUniform.mass_and_uniform(3.0),
    PiecewiseUniform(((-3.0, -2.0, 0.2), (-2.5, 1.0, 0.3)), ((0.0, 0.1), (2.0, 0.4))),
    Gaussian(),
    Gaussian(-0.7, 2.5),
]


@pytest.mark.parametrize("u", DISTRIBUTIONS, ids=repr)
@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize(
    "interval", [(-math.inf, math.inf), (-1.5, 0.5), (0.0, math.inf), (1.0, 1.0), (3.0, -1.0)]
)
def test_partial_moment_equals_quadrature(u, order, interval):
    lower, upper = interval
    value = u.expectation(lambda v: v**order if lower < v <= upper else 0.0, interval)
    # the quadrature promises 1e-12 on each of some ten panels
    assert u.partial_moment(order, lower, upper) == pytest.approx(value, abs=1e-11)


@pytest.mark.parametrize("u", DISTRIBUTIONS, ids=repr)
def test_mean_and_variance_describe_the_samples(u):
    n = 200_000
    draws = u.sample(np.random.default_rng(1), n)
    assert draws.shape == (n,)
    assert u.probability(-math.inf, math.inf) == pytest.approx(1.0, abs=1e-15)
    # five standard errors of a mean, and of a variance with kurtosis at most 3
    assert abs(draws.mean() - u.mean) < 5 * math.sqrt(u.variance / n)
    assert abs(draws.var() - u.variance) < 5 * u.variance * math.sqrt(2 / n)
    assert abs(np.mean((draws > -1) & (draws <= 1)) - u.probability(-1, 1)) < 5 * 0.5 / math.sqrt(n)


@pytest.mark.parametrize("u", DISTRIBUTIONS, ids=repr)
def test_reflection_mirrors_every_interval(u):
    mirrored = u.reflected()
    assert mirrored.reflected() == u
    assert mirrored.mean == pytest.approx(-u.mean, abs=1e-15)
    assert mirrored.variance == pytest.approx(u.variance, rel=1e-15)
    assert mirrored.partial_moment(1, 0.3, 2.2) == pytest.approx(-u.partial_moment(1, -2.2, -0.3), abs=1e-15)


def test_equation_3_7_is_a_zero_mean_density():
    d1, d2 = 2.0, 5.0
    u = PiecewiseUniform.zero_mean(d1, d2)
    scale = d1 * d2**2 + d2 * d1**2
    assert u.probability(-d1, 0.0) / d1 == pytest.approx(d2**2 / scale, rel=1e-15)
    assert u.probability(0.0, d2) / d2 == pytest.approx(d1**2 / scale, rel=1e-15)
    assert u.mean == pytest.approx(0.0, abs=1e-15)


def test_equation_3_10_has_mean_minus_a_quarter_of_its_bound():
    u = PiecewiseUniform.mass_and_uniform(3.0)
    assert u.mean == -0.75
    assert u.probability(0.0, 3.0) / 3.0 == pytest.approx(1 / (2 * 3.0), rel=1e-15)
    draws = u.sample(np.random.default_rng(0), 1000)
    assert 400 < np.count_nonzero(draws == -3.0) < 600


def test_narrow_interval_far_from_zero_keeps_its_digits():
    u = Uniform(1e6, 1e6 + 1e-3)
    width = u.high - u.low
    assert u.variance == pytest.approx(width**2 / 12, rel=1e-12)


def test_gaussian_tail_keeps_its_digits():
    # P(z > 10) to ten digits, from tables of the complementary error function
    assert Gaussian().probability(10.0, math.inf) == pytest.approx(7.61985302416e-24, rel=1e-10)
    assert Gaussian().probability(-math.inf, -10.0) == pytest.approx(7.61985302416e-24, rel=1e-10)


def test_samples_depend_on_the_seed_alone():
    for u in DISTRIBUTIONS:
        first, second = (u.sample(np.random.default_rng(5), 50) for _ in range(2))
        np.testing.assert_array_equal(first, second)


@settings(max_examples=50, deadline=None)
@given(
    low=st.floats(-50, 49),
    width=st.floats(1e-3, 50),
    cut=st.floats(-60, 60),
    order=st.sampled_from([0, 1, 2]),
)
def test_moments_add_over_a_cut(low, width, cut, order):
    u = Uniform(low, low + width)
    whole = u.partial_moment(order, -math.inf, math.inf)
    parts = u.partial_moment(order, -math.inf, cut) + u.partial_moment(order, cut, math.inf)
    assert parts == pytest.approx(whole, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Uniform(1.0, 1.0), r"Uniform: the interval \[1.0, 1.0\]"),
        (lambda: Uniform(math.nan, 1.0), "finite ends"),
        (lambda: Uniform.symmetric(-2.0), "low < high"),
        (lambda: PiecewiseUniform(((0.0, 1.0, 0.5),)), "sum to 0.5"),
        (lambda: PiecewiseUniform(((0.0, 1.0, 1.5),), ((0.0, -0.5),)), "nonnegative"),
        (lambda: PiecewiseUniform((), ((math.inf, 1.0),)), "finite point"),
        (lambda: PiecewiseUniform.zero_mean(0.0, 1.0), "zero_mean"),
        (lambda: Gaussian(0.0, 0.0), "standard deviation is 0.0"),
        (lambda: Gaussian(math.inf), "mean is inf"),
        (lambda: Gaussian().partial_moment(3, 0.0, 1.0), "order 3"),
        (lambda: Uniform(0.0, 1.0).partial_moment(-1, 0.0, 1.0), "order -1"),
        (lambda: Uniform(0.0, 1.0).expectation(lambda v: 1.0 / v**2), "breaks"),
    ],
)
def test_unusable_arguments_are_named(make, message):
    with pytest.raises(UsageError, match=message):
        make()
