"""Every gate on both sides of its edges, and the false alarms of the Monte-Carlo bands."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from sysid import gates
from sysid.errors import UsageError

UP, DOWN = (lambda x: math.nextafter(x, math.inf)), (lambda x: math.nextafter(x, -math.inf))

# Constructor of a gate from a value, and the lowest and highest values that pass.
EDGES = {
    "exact": (lambda v: gates.exact("g", v, 3, ""), 3.0, 3.0),
    "relative": (lambda v: gates.relative("g", v, -2.0, 0.25, ""), -2.5, -1.5),
    "absolute": (lambda v: gates.absolute("g", v, 1.0, 0.5, ""), 0.5, 1.5),
    "slope": (lambda v: gates.slope("g", v, -0.5, 0.25, ""), -0.75, -0.25),
    "at most": (lambda v: gates.at_most("g", v, 2.0, "exact", ""), -1e300, 2.0),
    "at least": (lambda v: gates.at_least("g", v, 2.0, "exact", ""), 2.0, 1e300),
}


@pytest.mark.parametrize("kind", EDGES)
def test_a_gate_holds_to_the_last_bit(kind):
    build, low, high = EDGES[kind]
    assert build(low).passed
    assert build(high).passed
    assert build(UP(high)).passed == (kind == "at least")
    assert build(DOWN(low)).passed == (kind == "at most")


CONSTRUCTORS = {
    **{kind: entry[0] for kind, entry in EDGES.items()},
    "digits": lambda v: gates.digits("g", v, 0.83, 2, ""),
    "band": lambda v: gates.monte_carlo_band("g", v, 0.0, 1.0, ""),
}


@pytest.mark.parametrize("kind", CONSTRUCTORS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_not_finite_never_passes(kind, value):
    gate = CONSTRUCTORS[kind](value)
    assert not gate.passed
    assert json.loads(json.dumps(gate.to_json(), allow_nan=False))["passed"] is False


@given(st.integers(-(10**6), 10**6), st.integers(0, 4), st.floats(-0.4999, 0.4999))
def test_digits_agree_with_rounding(units, decimals, share):
    printed = round(units * 10.0**-decimals, decimals)
    assert gates.digits("g", (units + share) * 10.0**-decimals, printed, decimals, "").passed
    for outside in (0.501, -0.501):
        assert not gates.digits("g", (units + outside) * 10.0**-decimals, printed, decimals, "").passed


@pytest.mark.parametrize(
    ("value", "passed"), [(1.005, True), (0.995, True), (1.00501, False), (0.99499, False)]
)
def test_half_a_digit_counts_as_the_printed_value(value, passed):
    assert gates.digits("g", value, 1.0, 2, "").passed is passed


@pytest.mark.parametrize("false_alarm", [0.01, 1e-4])
def test_the_band_of_a_false_alarm(false_alarm):
    half = stats.norm.isf(false_alarm / 2)
    gate = gates.monte_carlo_band("g", 0.0, 5.0, 0.1, "", allowance=0.02, false_alarm=false_alarm)
    # Two implementations of the normal quantile agree to rounding.
    np.testing.assert_allclose([gate.lower, gate.upper], [4.98 - 0.1 * half, 5.02 + 0.1 * half], rtol=1e-12)
    assert gate.false_alarm == false_alarm
    assert gates.monte_carlo_band("g", 5 + 0.1 * half, 5.0, 0.1, "", false_alarm=false_alarm * 0.99).passed
    assert not gates.monte_carlo_band(
        "g", 5 + 0.1 * half, 5.0, 0.1, "", false_alarm=false_alarm * 1.01
    ).passed


@pytest.mark.parametrize("false_alarm", [0.01, 0.05])
def test_false_alarms_come_as_often_as_stated(false_alarm):
    rng = np.random.default_rng(31)
    draws = 20_000
    red = sum(
        not gates.monte_carlo_band("g", value, 1.0, 0.3, "", false_alarm=false_alarm).passed
        for value in rng.normal(1.0, 0.3, draws)
    )
    # Binomial: four standard deviations of the count, 56 of 200 for 0.01.
    assert abs(red - draws * false_alarm) < 4 * math.sqrt(draws * false_alarm * (1 - false_alarm))


def test_a_wrong_mean_turns_the_band_red():
    rng = np.random.default_rng(32)
    sample = rng.normal(0.02, 0.1, 1000)  # a bias of 6.3 standard errors
    error = sample.std(ddof=1) / math.sqrt(1000)
    assert not gates.monte_carlo_band("bias", sample.mean(), 0.0, error, "").passed
    assert gates.monte_carlo_band("bias", sample.mean() - 0.02, 0.0, error, "").passed


@pytest.mark.parametrize("std_error", [math.nan, math.inf])
def test_a_band_without_a_standard_error_is_red(std_error):
    assert not gates.monte_carlo_band("g", 0.0, 0.0, std_error, "").passed


@pytest.mark.parametrize("false_alarm", [0.0, 1.0, -0.1, 2.0, math.nan])
def test_a_false_alarm_must_be_a_chance(false_alarm):
    with pytest.raises(UsageError, match=r"gate g: the false alarm .* give one between 0 and 1"):
        gates.monte_carlo_band("g", 0.0, 0.0, 1.0, "", false_alarm=false_alarm)


def test_open_sides_become_null():
    gate = gates.at_most("g", 1.0, 2.0, "relative", "why")
    assert gate.to_json() == {
        "id": "g", "value": 1.0, "lower": None, "upper": 2.0, "type": "relative", "reason": "why",
        "false_alarm": None, "passed": True,
    }  # fmt: skip


def test_the_summary_names_every_red_gate():
    green, red = gates.exact("one", 1, 1, ""), gates.exact("two", 2, 1, "")
    assert gates.summary({"a": [green], "b": [green]}) == "all 2 gates passed"
    assert gates.summary({"a": [green, red], "b": [red]}) == "1 of 3 gates passed; red: a two, b two"
    assert gates.summary({}) == "all 0 gates passed"
