"""Nonlinearities: against their definitions, their pieces, quadrature and the printed moments."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sysid.distributions import Gaussian, PiecewiseUniform, Uniform
from sysid.errors import ModelError, UsageError
from sysid.nonlinearities import (
    DEAD_ZONE,
    EVEN_DEAD_ZONE,
    HYSTERESIS,
    HYSTERESIS_RELAY,
    NONLINEARITIES,
    PLAY,
    PRELOAD,
    RELAY,
    SATURATION,
    SCHMITT_TRIGGER,
    TWO_SIDED_DEAD_ZONE,
    TWO_SIDED_PRELOAD,
    TWO_SIDED_RELAY,
    TWO_SIDED_SATURATION,
    Hysteresis,
    HysteresisRelay,
    Play,
    SchmittTrigger,
    StaticMap,
    nonlinearity,
)

ODD = [PRELOAD, DEAD_ZONE, SATURATION, RELAY]
TWO_SIDED = [TWO_SIDED_PRELOAD, TWO_SIDED_DEAD_ZONE, TWO_SIDED_SATURATION, TWO_SIDED_RELAY]
STATIC = [*ODD, EVEN_DEAD_ZONE]
MEMORY = [HYSTERESIS_RELAY, SCHMITT_TRIGGER, HYSTERESIS, PLAY]
OTHER_STATES = [HysteresisRelay(1.0, -1.0), SchmittTrigger(-1.0), Hysteresis(-1.0, 0.5), Play(0.75)]


def by_name(entry):
    return entry.name


# Multiples of 1/4 meet ties in |u|, repeated samples and thresholds at samples all the time, and
# their sums are exact; the other values are generic.
LATTICE = st.integers(-12, 12).map(lambda i: i / 4)
GENERIC = st.floats(-4, 4, allow_subnormal=False)
SIGNALS = st.one_of(st.lists(LATTICE, max_size=25), st.lists(GENERIC, max_size=25)).map(
    lambda values: np.array(values, dtype=float)
)
THRESHOLDS = st.one_of(st.integers(0, 14).map(lambda i: i / 4), st.floats(0, 3.5, allow_subnormal=False))


# -- definitions, written once more without any shared code -------------------------------------


def printed_relay(u, a, last, x):
    out = []
    for v in u:
        if v > a or (abs(v) <= a and (v - last < 0 or (v == last and x == 1))):
            x = 1.0
        elif v < -a or (abs(v) <= a and (v - last > 0 or (v == last and x == -1))):
            x = -1.0
        last = v
        out.append(x)
    return np.array(out)


def schmitt(u, a, x):
    out = []
    for v in u:
        x = 1.0 if v > a else -1.0 if v < -a else x
        out.append(x)
    return np.array(out)


def printed_hysteresis(u, a, last, x):
    out = []
    for v in u:
        x = v - a if v > last else v + a if v < last else x
        last = v
        out.append(x)
    return np.array(out)


def play(u, a, x):
    out = []
    for v in u:
        x = min(max(x, v - a), v + a)
        out.append(x)
    return np.array(out)


DEFINITIONS = {
    "preload": lambda u, a: u + a * np.sign(u),
    "dead-zone": lambda u, a: np.where(np.abs(u) <= a, 0.0, u - a * np.sign(u)),
    "saturation": lambda u, a: np.clip(u, -a, a),
    "relay": lambda u, a: np.where(np.abs(u) <= a, 0.0, np.sign(u)),
    "even-dead-zone": lambda u, a: np.maximum(np.abs(u) - a, 0.0),
    "hysteresis-relay": lambda u, a: printed_relay(u, a, 0.0, 0.0),
    "hysteresis-relay-schmitt": lambda u, a: schmitt(u, a, 0.0),
    "hysteresis": lambda u, a: printed_hysteresis(u, a, 0.0, 0.0),
    "hysteresis-play": lambda u, a: play(u, a, 0.0),
    "two-sided-preload": lambda u, a1, a2: np.select([u > 0, u < 0], [u + a2, u - a1], 0.0),
    "two-sided-dead-zone": lambda u, a1, a2: np.select([u > a2, u < -a1], [u - a2, u + a1], 0.0),
    "two-sided-saturation": lambda u, a1, a2: np.clip(u, -a1, a2),
    "two-sided-relay": lambda u, a1, a2: np.select([u > a2, u < -a1], [1.0, -1.0], 0.0),
}


def test_every_map_has_a_definition_here():
    assert set(DEFINITIONS) == set(NONLINEARITIES)
    assert all(entry.name == name and entry.title for name, entry in NONLINEARITIES.items())


@pytest.mark.parametrize("name", DEFINITIONS)
@settings(max_examples=60, deadline=None)
@given(u=SIGNALS, a=THRESHOLDS, b=THRESHOLDS)
def test_values_equal_the_definition(name, u, a, b):
    entry = NONLINEARITIES[name]
    parameters = (a, b)[: len(entry.parameters)]
    before = u.copy()
    np.testing.assert_array_equal(entry(u, *parameters), DEFINITIONS[name](u, *parameters))
    np.testing.assert_array_equal(u, before)


@settings(max_examples=60, deadline=None)
@given(u=SIGNALS, a=THRESHOLDS)
def test_other_initial_states(u, a):
    np.testing.assert_array_equal(HysteresisRelay(1.0, -1.0)(u, a), printed_relay(u, a, 1.0, -1.0))
    np.testing.assert_array_equal(SchmittTrigger(-1.0)(u, a), schmitt(u, a, -1.0))
    np.testing.assert_array_equal(Hysteresis(-1.0, 0.5)(u, a), printed_hysteresis(u, a, -1.0, 0.5))
    np.testing.assert_array_equal(Play(0.75)(u, a), play(u, a, 0.75))


# -- pieces --------------------------------------------------------------------------------------


@pytest.mark.parametrize("entry", [*STATIC, *MEMORY, *OTHER_STATES], ids=repr)
@settings(max_examples=60, deadline=None)
@given(
    u=SIGNALS,
    lower=st.sampled_from([0.0, 0.25, 1.0, 1.3]),
    upper=st.sampled_from([1.5, 2.0, 3.5]),
    generic=st.floats(0, 1),
)
@example(u=np.array([3.0, -3.0, 2.5, -2.5, 2.0, -2.0, 1.5, -1.5]), lower=0.0, upper=3.5, generic=0.1)
@example(u=np.array([1.0, 1.0, 1.0]), lower=1.0, upper=2.0, generic=0.0)
def test_pieces_follow_the_map_over_the_whole_range(entry, u, lower, upper, generic):
    pieces = entry.pieces(u, lower, upper)
    assert (pieces.lower, pieces.upper) == (lower, upper)
    assert np.all(np.diff(pieces.knot) >= 0)
    assert np.all((pieces.knot > lower) & (pieces.knot < upper))
    inside = lower + generic * (upper - lower)
    candidates = np.concatenate([[lower, inside], np.arange(0.0, 3.5, 0.25), pieces.knot, np.abs(u)])
    for a in candidates[(candidates >= lower) & (candidates < upper)]:
        # play meets its knots at half sums of samples: rounding of a few units in the last place
        tolerance = 1e-12 if isinstance(entry, Play | Hysteresis) else 0.0
        np.testing.assert_allclose(pieces.at(a), entry(u, a), rtol=0, atol=tolerance)


@pytest.mark.parametrize("entry", TWO_SIDED, ids=by_name)
@settings(max_examples=60, deadline=None)
@given(u=SIGNALS, a=st.floats(0.25, 2.99), b=st.floats(0.25, 2.99))
@example(u=np.array([1.0, -1.0, 0.0, 2.0]), a=1.0, b=2.0)
def test_sided_pieces_sum_to_the_map(entry, u, a, b):
    negative, positive = entry.sided_pieces(u, 0.25, 3.0)
    np.testing.assert_allclose(negative.at(a) + positive.at(b), entry(u, a, b), rtol=0, atol=0)


@pytest.mark.parametrize("entry", [SCHMITT_TRIGGER, PLAY], ids=by_name)
def test_memory_curves_stay_short_for_random_input(entry):
    n = 5000
    u = np.random.default_rng(2).uniform(-4, 4, n)
    pieces = entry.pieces(u, 0.0, 4.0)
    assert pieces.knot.size < n * math.log(n)
    for a in (0.0, 0.3, 1.0, 2.5, 3.999):
        np.testing.assert_allclose(pieces.at(a), entry(u, a), rtol=0, atol=1e-12)


@pytest.mark.parametrize("entry", [SCHMITT_TRIGGER, PLAY], ids=by_name)
def test_shrinking_swings_keep_every_extremum(entry):
    n = 60
    u = np.linspace(3.0, 0.1, n) * (-1.0) ** np.arange(n)
    pieces = entry.pieces(u, 0.0, 3.5)
    assert pieces.knot.size > n**2 / 4  # more than the arrays hold at first
    for a in np.linspace(0.0, 3.4, 101):
        np.testing.assert_allclose(pieces.at(a), entry(u, a), rtol=0, atol=1e-12)


# -- slopes --------------------------------------------------------------------------------------


@pytest.mark.parametrize("entry", [*STATIC, *MEMORY], ids=by_name)
def test_slope_equals_finite_difference(entry):
    u = np.random.default_rng(3).normal(size=300)
    a, step = 0.618, 1e-7
    difference = (entry(u, a + step) - entry(u, a)) / step
    np.testing.assert_allclose(entry.slope(u, a), difference, atol=1e-7)  # eps / step


@pytest.mark.parametrize("entry", TWO_SIDED, ids=by_name)
def test_two_sided_slope_equals_finite_difference(entry):
    u = np.random.default_rng(3).normal(size=(30, 10))
    a1, a2, step = 0.618, 0.3, 1e-7
    base = entry(u, a1, a2)
    differences = [(entry(u, a1 + step, a2) - base) / step, (entry(u, a1, a2 + step) - base) / step]
    np.testing.assert_allclose(entry.slope(u, a1, a2), np.stack(differences, axis=-1), atol=1e-7)


@pytest.mark.parametrize("entry", [*STATIC, *MEMORY], ids=by_name)
@settings(max_examples=40, deadline=None)
@given(u=SIGNALS, a=st.integers(0, 11).map(lambda i: i / 4))
def test_slope_at_a_kink_is_the_right_one(entry, u, a):
    u = np.round(4 * u) / 4
    np.testing.assert_allclose(entry(u, a) + entry.slope(u, a) / 16, entry(u, a + 1 / 16), rtol=0, atol=1e-12)


# -- properties ----------------------------------------------------------------------------------


@pytest.mark.parametrize("entry", [*ODD, *MEMORY], ids=by_name)
@settings(max_examples=40, deadline=None)
@given(u=SIGNALS, a=THRESHOLDS)
def test_symmetric_maps_are_odd(entry, u, a):
    np.testing.assert_array_equal(entry(-u, a), -entry(u, a))


@settings(max_examples=40, deadline=None)
@given(u=SIGNALS, a=THRESHOLDS)
def test_even_dead_zone_is_even(u, a):
    np.testing.assert_array_equal(EVEN_DEAD_ZONE(-u, a), EVEN_DEAD_ZONE(u, a))


@pytest.mark.parametrize("entry", [*ODD, *TWO_SIDED], ids=by_name)
@settings(max_examples=40, deadline=None)
@given(u=SIGNALS, a=THRESHOLDS, b=THRESHOLDS)
def test_static_maps_are_monotone(entry, u, a, b):
    parameters = (a, b)[: len(entry.parameters)]
    assert np.all(np.diff(entry(np.sort(u), *parameters)) >= 0)


@settings(max_examples=40, deadline=None)
@given(u=SIGNALS, a=THRESHOLDS)
def test_dead_zone_and_saturation_share_the_input(u, a):
    np.testing.assert_allclose(DEAD_ZONE(u, a) + SATURATION(u, a), u, rtol=0, atol=4e-16 * 4)


@pytest.mark.parametrize("entry", TWO_SIDED, ids=by_name)
@settings(max_examples=40, deadline=None)
@given(u=SIGNALS, a=THRESHOLDS)
def test_two_sided_with_equal_sides_is_symmetric(entry, u, a):
    np.testing.assert_array_equal(entry(u, a, a), entry.symmetric(u, a))


@pytest.mark.parametrize("entry", [PLAY, SCHMITT_TRIGGER], ids=by_name)
@settings(max_examples=40, deadline=None)
@given(u=SIGNALS, a=THRESHOLDS, data=st.data())
def test_physical_hysteresis_is_rate_independent(entry, u, a, data):
    held = data.draw(st.lists(st.integers(1, 3), min_size=u.size, max_size=u.size))
    last = np.cumsum(held, dtype=int) - 1
    np.testing.assert_array_equal(entry(np.repeat(u, held), a)[last], entry(u, a))


@settings(max_examples=40, deadline=None)
@given(u=SIGNALS, a=THRESHOLDS)
def test_play_stays_within_its_gap(u, a):
    assert np.all(np.abs(PLAY(u, a) - u) <= a + 1e-15)


@pytest.mark.parametrize("entry", [RELAY, HYSTERESIS_RELAY, SCHMITT_TRIGGER], ids=by_name)
@settings(max_examples=40, deadline=None)
@given(u=SIGNALS, a=THRESHOLDS)
def test_relays_have_three_values(entry, u, a):
    assert np.isin(entry(u, a), [-1.0, 0.0, 1.0]).all()


def test_direction_and_memory_agree_on_full_swings():
    swing = np.concatenate([np.linspace(0, 3, 31), np.linspace(2.9, -3, 60), np.linspace(-2.9, 3, 60)])
    np.testing.assert_array_equal(HYSTERESIS_RELAY(swing, 1.0)[31:], SCHMITT_TRIGGER(swing, 1.0)[31:])
    beyond_the_gap = np.abs(np.gradient(swing)) > 0
    settled = np.r_[np.zeros(52, bool), np.ones(swing.size - 52, bool)] & beyond_the_gap
    settled[91:113] = False  # the play crosses its gap of 2 a after the turn
    np.testing.assert_allclose(HYSTERESIS(swing, 1.0)[settled], PLAY(swing, 1.0)[settled], atol=1e-12)


# -- moments -------------------------------------------------------------------------------------

INPUTS = [
    Uniform.symmetric(2.0),
    Uniform(-1.0, 3.0),
    PiecewiseUniform.zero_mean(2.0, 5.0),
    PiecewiseUniform.mass_and_uniform(3.0),
    PiecewiseUniform(((-3.0, -1.0, 0.5), (0.5, 2.0, 0.2)), ((-1.0, 0.1), (1.5, 0.2))),
    Gaussian(),
    Gaussian(0.4, 2.0),
]


@pytest.mark.parametrize("entry", [*STATIC, *TWO_SIDED], ids=by_name)
@pytest.mark.parametrize("u", INPUTS, ids=repr)
@pytest.mark.parametrize("thresholds", [(0.0, 0.0), (1.0, 1.5), (1.5, 0.3), (7.0, 2.5)])
def test_moment_equals_quadrature(entry, u, thresholds):
    parameters = thresholds[: len(entry.parameters)]
    breaks = (-thresholds[0], 0.0, parameters[-1])
    # the quadrature promises 1e-12 on each of at most a dozen panels
    assert entry.moment(u, *parameters) == pytest.approx(
        entry.moment_by_quadrature(u, *parameters), abs=1e-11
    )
    mean = u.expectation(lambda v: float(entry(v, *parameters)), breaks)
    assert entry.mean(u, *parameters) == pytest.approx(mean, abs=1e-11)
    assert entry.covariance(u, *parameters) == pytest.approx(
        entry.moment(u, *parameters) - mean * u.mean, abs=1e-11
    )


@pytest.mark.parametrize("entry", [*STATIC, *TWO_SIDED], ids=by_name)
@pytest.mark.parametrize("u", INPUTS, ids=repr)
def test_moment_is_the_limit_of_sample_means(entry, u):
    parameters = (0.8, 1.1)[: len(entry.parameters)]
    draws = u.sample(np.random.default_rng(7), 100_000)
    products = entry(draws, *parameters) * draws
    error = products.std() / math.sqrt(draws.size)
    assert abs(products.mean() - entry.moment(u, *parameters)) < 5 * error + 1e-12


@settings(max_examples=60, deadline=None)
@given(
    a=st.floats(0, 5),
    low=st.floats(-5, 4),
    width=st.floats(0.1, 5),
    weight=st.floats(0, 1),
    point=st.floats(-5, 5),
    entry=st.sampled_from(STATIC),
)
def test_moment_of_any_mixture(a, low, width, weight, point, entry):
    u = PiecewiseUniform(((low, low + width, 1 - weight),), ((point, weight),))
    assert entry.moment(u, a) == pytest.approx(entry.moment_by_quadrature(u, a), abs=1e-11)


@pytest.mark.parametrize("a", [0.0, 0.3, 1.7])
@pytest.mark.parametrize("u", [Uniform.symmetric(2.0), Gaussian(0.0, 1.3)], ids=repr)
def test_even_map_is_uncorrelated_with_even_input(u, a):
    assert EVEN_DEAD_ZONE.moment(u, a) == pytest.approx(0.0, abs=1e-16)
    assert EVEN_DEAD_ZONE.mean(u, a) > 0.0
    assert abs(EVEN_DEAD_ZONE.moment(PiecewiseUniform.mass_and_uniform(2.0), a)) > 0.01


# The printed moments (3.8), (3.11), (3.13), (3.15) of Bai (2002); each needs b, d beyond the thresholds.
SIDES = [(0.1, 0.2), (1.0, 0.5), (0.7, 1.9), (2.0, 2.0)]
BOUNDS = [2.1, 3.0, 7.5]


def assert_printed(entry, u, parameters, printed):
    assert printed == pytest.approx(entry.moment_by_quadrature(u, *parameters), abs=1e-10)
    assert printed == pytest.approx(entry.moment(u, *parameters), abs=1e-13)


@pytest.mark.parametrize(("a1", "a2"), SIDES)
@pytest.mark.parametrize("b", BOUNDS)
def test_moments_3_8_of_the_relay(a1, a2, b):
    assert_printed(TWO_SIDED_RELAY, Uniform.symmetric(b), (a1, a2), (2 * b**2 - a1**2 - a2**2) / (4 * b))
    for d1, d2 in [(b, 2.5), (2.2, b), (b, b)]:
        scale = d1 * d2**2 + d2 * d1**2
        printed = d1**2 * d2**2 / scale - 0.5 * (d2**2 * a1**2 + d1**2 * a2**2) / scale
        assert_printed(TWO_SIDED_RELAY, PiecewiseUniform.zero_mean(d1, d2), (a1, a2), printed)


@pytest.mark.parametrize(("a1", "a2"), SIDES)
@pytest.mark.parametrize("b", BOUNDS)
def test_moments_3_11_of_the_preload(a1, a2, b):
    assert_printed(TWO_SIDED_PRELOAD, Uniform.symmetric(b), (a1, a2), b**2 / 3 + b * (a1 + a2) / 4)
    printed = 2 * b**2 / 3 + a1 * b / 2 + a2 * b / 4
    assert_printed(TWO_SIDED_PRELOAD, PiecewiseUniform.mass_and_uniform(b), (a1, a2), printed)


@pytest.mark.parametrize("a", [0.0, 0.4, 1.0, 2.0])
@pytest.mark.parametrize("b", BOUNDS)
def test_moments_3_13_and_3_15(a, b):
    u = Uniform.symmetric(b)
    assert_printed(SATURATION, u, (a,), a / b * (b**2 / 2 - a**2 / 6))
    assert_printed(DEAD_ZONE, u, (a,), a**3 / (6 * b) - a * b / 2 + b**2 / 3)


@pytest.mark.parametrize("a", [0.0, 0.5, 2.0])
@pytest.mark.parametrize("s", [0.5, 2.0])
def test_gaussian_moments(a, s):
    # Stein's lemma: E[x u] = s^2 E[dx/du] for the continuous maps, plus the jumps of the others
    u, density = Gaussian(0.0, s), math.exp(-0.5 * (a / s) ** 2) / math.sqrt(2 * math.pi)
    inside = math.erf(a / (s * math.sqrt(2)))
    assert SATURATION.moment(u, a) == pytest.approx(s**2 * inside, abs=1e-14)
    assert DEAD_ZONE.moment(u, a) == pytest.approx(s**2 * (1 - inside), abs=1e-14)
    assert RELAY.moment(u, a) == pytest.approx(2 * s * density, abs=1e-14)
    assert PRELOAD.moment(u, a) == pytest.approx(s**2 + 2 * a * s / math.sqrt(2 * math.pi), abs=1e-14)


# -- shapes and errors ---------------------------------------------------------------------------


@pytest.mark.parametrize("entry", [*STATIC, *TWO_SIDED], ids=by_name)
def test_static_maps_keep_the_shape(entry):
    parameters = (1.0, 1.0)[: len(entry.parameters)]
    u = np.linspace(-2, 2, 12).reshape(3, 4)
    assert entry(u, *parameters).shape == (3, 4)
    assert entry(1.5, *parameters).shape == ()
    assert entry([], *parameters).shape == (0,)
    read_only = u[:, ::2]
    read_only.flags.writeable = False
    np.testing.assert_array_equal(entry(read_only, *parameters), entry(u, *parameters)[:, ::2])


@pytest.mark.parametrize("entry", NONLINEARITIES.values(), ids=by_name)
@pytest.mark.parametrize(
    ("u", "a", "error", "message"),
    [
        ([1.0], -0.5, ModelError, "is -0.5; give a finite number >= 0"),
        ([1.0], math.nan, ModelError, "is nan"),
        ([1.0], math.inf, ModelError, "is inf"),
        ([1.0], None, ModelError, "is None"),
        ([0.0, math.nan], 1.0, UsageError, "index 1 is nan"),
        ([1j], 1.0, UsageError, "not an array of real numbers"),
        (["one"], 1.0, UsageError, "not an array of real numbers"),
        ([[1.0], [1.0, 2.0]], 1.0, UsageError, "not an array of real numbers"),
    ],
)
def test_unusable_arguments_are_named(entry, u, a, error, message):
    parameters = [a] * len(entry.parameters)
    for method in (entry, entry.slope):
        with pytest.raises(error, match=message) as caught:
            method(u, *parameters)
        assert str(caught.value).startswith(entry.name)


@pytest.mark.parametrize("entry", NONLINEARITIES.values(), ids=by_name)
def test_wrong_number_of_parameters_is_named(entry):
    with pytest.raises(ModelError, match=f"3 parameters were given; it takes {len(entry.parameters)}"):
        entry([1.0], 1.0, 1.0, 1.0)
    if isinstance(entry, StaticMap):
        with pytest.raises(ModelError, match="0 parameters"):
            entry.moment(Gaussian())


@pytest.mark.parametrize("entry", [*STATIC, *MEMORY], ids=by_name)
@pytest.mark.parametrize(("lower", "upper"), [(-1.0, 1.0), (1.0, 1.0), (0.0, math.inf), (math.nan, 1.0)])
def test_unusable_range_is_named(entry, lower, upper):
    with pytest.raises(UsageError, match="give finite 0 <= lower < upper"):
        entry.pieces([1.0, 2.0], lower, upper)


def test_sequence_in_time_has_one_dimension():
    with pytest.raises(UsageError, match=r"hysteresis-play: the input has shape \(2, 2\)"):
        PLAY(np.ones((2, 2)), 1.0)
    with pytest.raises(UsageError, match=r"saturation: the input has shape \(\)"):
        SATURATION.pieces(1.0, 0.0, 1.0)


def test_unusable_state_and_unknown_name_are_named():
    with pytest.raises(ModelError, match="hysteresis-play: initial_output is nan"):
        Play(math.nan)
    with pytest.raises(ModelError, match="previous_input is inf"):
        HysteresisRelay(math.inf)
    with pytest.raises(UsageError, match="no nonlinearity 'backlash'; choose one of preload, "):
        nonlinearity("backlash")


@pytest.mark.parametrize(
    "name", ["hysteresis-relay", "hysteresis", "hysteresis-relay-schmitt", "hysteresis-play"]
)
@pytest.mark.parametrize(("a", "b"), [(0.3, 4.0), (1.0, 4.0), (1.0, 1.5), (2.0, 2.4)])
def test_moments_of_maps_with_memory(name, a, b):
    nonlinearity = NONLINEARITIES[name]
    distribution = Uniform.symmetric(b)
    closed = nonlinearity.moment(distribution, a)
    assert abs(closed - nonlinearity.moment_by_quadrature(distribution, a)) < 1e-10
    u = distribution.sample(np.random.default_rng(8), 400_000)
    products = nonlinearity(u, a) * u
    # Memory correlates neighbours over a few samples: twice the error of independent products.
    assert abs(products.mean() - closed) < 4 * 2 * products.std() / np.sqrt(products.size)


def test_moments_of_maps_with_memory_say_what_they_need():
    with pytest.raises(UsageError, match="known for Uniform"):
        NONLINEARITIES["hysteresis"].moment(Uniform(0.0, 1.0), 0.5)
    with pytest.raises(UsageError, match="reaches only 4; widen it beyond the threshold 5"):
        NONLINEARITIES["hysteresis-play"].moment(Uniform.symmetric(4.0), 5.0)
