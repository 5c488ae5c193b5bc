"""Effects that stand in for what nobody listed: at an end of their parameters where they are no longer it."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

import sysid
from sysid.data import make_record

N = 1000


def test_a_spring_that_stiffens_is_no_hysteresis_that_lost_its_loop():
    """A loop in which next to all is shared by both branches follows any spring."""
    rng = np.random.default_rng(4)
    period, m, c, k = 0.05, 1.0, 0.6, 30.0
    u, y, x, v = np.repeat(rng.standard_normal(N // 2), 2) * 12.0, [], 0.0, 0.0
    for held in u:
        y.append(x)
        for _ in range(50):  # steps of a millisecond
            v += 0.001 * (held - c * v - k * x - 30.0 * x * abs(x)) / m
            x += 0.001 * v
    noise = 0.1 * np.std(y) * rng.standard_normal(N)
    found = sysid.diagnose(
        make_record(u, np.array(y) + noise, period=period),
        "mass-spring-damper",
        initial_state="rest",
        start={"c": 0.65, "k": 32.0},
        fixed={"m": m},
        effects=["hysteresis_force"],
        max_effects=1,
    )
    assert found.verdict == "unexplained"


@pytest.mark.parametrize("seed", [2, 3])
def test_a_drift_is_no_slow_sensor_with_a_wrong_zero(seed):
    """A sensor that takes longer than the record adds up its zero to a drift."""
    rng = np.random.default_rng(seed)
    u = lfilter([0.3], [1.0, -0.7], rng.standard_normal(N))
    y = lfilter([0.0, 0.5, 0.2], [1.0, -1.2, 0.5], u)
    size = np.std(y)
    y = y - size * np.arange(N) / N + 0.126 * size * rng.standard_normal(N)
    found = sysid.diagnose(
        make_record(u, y, period=0.01),
        order=2,
        initial_state="rest",
        effects=["out_offset", "out_lowpass"],
    )
    assert found.verdict == "unexplained"


@pytest.mark.parametrize(("seconds", "rests"), [(9.0, True), (11.0, False)])
def test_a_sensor_that_is_slower_than_the_record_is_long_does_not_settle(seconds, rests):
    from sysid.diagnosis.decide.modes import settles

    lag = [SimpleNamespace(name="time_constant", value=seconds)]
    fit = SimpleNamespace(parameters_of=lambda name: lag if name == "out_lowpass" else [])
    assert settles(fit, 10.0) is rests


def first_order(v, seed, size=0.02):
    y = lfilter([0.0, 0.4], [1.0, -0.8], v)
    return y + size * np.std(y) * np.random.default_rng(seed).standard_normal(N)


@pytest.mark.parametrize("threshold", [0.0, 0.5])
def test_a_limit_below_all_that_comes_in_is_a_relay_that_nobody_listed(threshold):
    u = np.random.default_rng(3).standard_normal(N)
    y = first_order(np.sign(u) * (np.abs(u) > threshold), 1)
    effects = ["in_saturation", "in_deadzone", "in_preload", "in_relay"]
    record = make_record(u, y, period=1.0)
    found = sysid.diagnose(record, order=1, initial_state="rest", effects=effects)
    assert found.accepted == ("in_relay",)
    found = sysid.diagnose(record, order=1, initial_state="rest", effects=effects[:3])
    assert found.verdict == "unexplained"


@pytest.mark.parametrize(
    ("name", "law"),
    [
        ("in_saturation", lambda u: np.clip(u, -0.3, 0.3)),
        ("in_deadzone", lambda u: u - np.clip(u, -2.0, 2.0)),
        ("in_preload", lambda u: u + 3.0 * np.sign(u)),
    ],
)
def test_strong_maps_of_the_input_are_themselves(name, law):
    u = np.random.default_rng(3).standard_normal(N)
    record = make_record(u, first_order(law(u), 1), period=1.0)
    found = sysid.diagnose(record, order=1, initial_state="rest", effects=[name])
    assert found.accepted == (name,)
    assert found.verdict == "missing-effect"


@pytest.mark.parametrize(
    ("gain", "verdict"),
    [(lambda y: 1.0 + 0.3 * y, "unexplained"), (lambda y: 1.0 + 0.97 * np.tanh(y), "missing-effect")],
    ids=["in proportion", "with a bend"],
)
def test_a_gain_in_proportion_to_the_output_is_not_the_bounded_one(gain, verdict):
    rng = np.random.default_rng(2)
    u, y = rng.uniform(-1.0, 1.0, N), np.zeros(N)
    for k in range(1, N):
        y[k] = 0.85 * y[k - 1] + 0.8 * u[k - 1] * gain(y[k - 1])
    y += 0.005 * np.std(y) * rng.standard_normal(N)
    found = sysid.diagnose(
        make_record(u, y, period=1.0), order=1, initial_state="rest", effects=["op_gain", "in_saturation"]
    )
    assert found.verdict == verdict


@pytest.mark.parametrize(("width", "verdict"), [(0.6, "unexplained"), (0.3, "missing-effect")])
def test_a_relay_with_play_that_never_rests_is_a_hysteresis_that_nobody_listed(width, verdict):
    """Behind a relay of levels -1, 0 and 1 play of more than a half holds what was, of less it yields."""
    rng = np.random.default_rng(5)
    u = lfilter([0.3], [1.0, -0.7], rng.standard_normal(N))
    driving = np.where(np.abs(u) > 0.2, np.sign(u), 0.0)
    x, late = 0.0, np.empty(N)
    for k, value in enumerate(driving):
        x = min(max(x, value - width), value + width)
        late[k] = x
    y = lfilter([0.0, 0.5, 0.2], [1.0, -1.2, 0.5], late)
    y = y + 0.02 * np.std(y) * rng.standard_normal(N)
    found = sysid.diagnose(
        make_record(u, y, period=1.0), order=2, initial_state="rest", effects=["in_relay", "in_backlash"]
    )
    assert found.verdict == verdict
    assert ("something else than its name says" in found.advice) == (verdict == "unexplained")


def test_a_relay_without_a_threshold_turns_at_what_a_sine_leaves_of_zero():
    """A sine is 1e-16 where it should be zero: a threshold that cannot be less makes a steep jump lead."""
    k = np.arange(N)
    u = 1.5 * np.sin(np.pi * (k % 250) ** 2 / 1500.0) + 1e-16
    y = first_order(np.sign(u), 5)
    found = sysid.diagnose(
        make_record(u, y, period=1.0),
        order=1,
        initial_state="rest",
        effects=["in_saturation", "in_deadzone", "in_preload", "in_relay"],
    )
    assert found.verdict == "missing-effect"
    assert found.accepted == ("in_relay",)


def test_a_relay_is_named_where_its_equal_leads_by_chance_and_is_only_a_relay():
    """Of five levels a relay leaves three: a jump beside which the slope is lost does as well."""
    leads = 0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0], N // 5), 5)
        effects = ["in_saturation", "in_deadzone", "in_preload", "in_relay"]
        record = make_record(u, first_order(np.sign(u), 10 + seed), period=1.0)
        found = sysid.diagnose(record, order=1, initial_state="rest", effects=effects)
        assert found.accepted == ("in_relay",)
        gains = {candidate.name: candidate.gain for candidate in found.decision.trials}
        leads += gains["in_preload"] > gains["in_relay"]
    assert leads > 0
