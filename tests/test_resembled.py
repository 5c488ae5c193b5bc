"""Names that only resemble what is missing: one law that is not theirs explains as much."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

import sysid
from sysid.data import make_record
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.ports import explore_ports
from sysid.diagnosis.shortfall import resembled
from sysid.linear import fit_output_error

PERIOD, N = 0.1, 1500
SENSOR = ("out_saturation", "out_lowpass")


def stage(force, memory):
    """Return x'' = u - 0.1 x' - force(x') under a sweep, 32 dB above noise with a memory."""
    t, state, y = PERIOD * np.arange(N), np.zeros(2), []
    u = 2.0 * np.sin(0.1 * t + 0.006 * t**2)
    for held in u:
        y.append(state[0])
        slope = lambda _, s, held=held: [s[1], held - 0.1 * s[1] - force(s[1])]  # noqa: E731
        state = solve_ivp(slope, (0.0, PERIOD), state, rtol=1e-7, atol=1e-9).y[:, -1]
    noise = lfilter([1.0], [1.0, -memory], np.random.default_rng(1).standard_normal(N))
    return make_record(u, y + np.std(y) * 10 ** (-32 / 20) * noise * np.sqrt(1.0 - memory**2), PERIOD)


@pytest.mark.parametrize(
    ("force", "memory", "verdict", "accepted"),
    [
        (lambda v: v**3, 0.0, "unexplained", ()),
        (lambda v: v * abs(v), 0.6, "missing-effect", ("quad_drag", "coloured_noise")),
    ],
    ids=["a damper of the third degree is no drag", "a drag is one beside coloured noise, too"],
)
def test_a_law_is_named_only_if_no_curve_follows_the_force_better(force, memory, verdict, accepted):
    found = sysid.diagnose(
        stage(force, memory),
        "positioning-stage",
        initial_state="rest",
        start={"M": 1.05, "F_v": 0.11},
        fixed={"gain": 1.0},
        effects=["quad_drag", "cubic_stiffness", "in_saturation", "coloured_noise"],
    )
    assert (found.verdict, found.accepted) == (verdict, accepted)
    if not accepted:
        assert found.ports[0].port == "velocity"
        assert found.ports[0].explains_at_most > 0.8


def actuated(limited, slow_sensor):
    """Return a first-order plant under steps, its actuator or its sensor limited, the sensor slow or not."""
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(0.0, 3.0, N // 10), 10)
    y = lfilter([0.0, 0.2], [1.0, -0.8], np.minimum(u, 1.8) if limited == "actuator" else u)
    y = np.minimum(y, 1.8) if limited == "sensor" else y
    y = lfilter([0.15], [1.0, -0.85], y) if slow_sensor else y
    return make_record(u, y + 0.03 * np.std(y) * rng.standard_normal(N), PERIOD)


@pytest.mark.parametrize(
    ("limited", "slow_sensor", "accepted"), [("actuator", False, ()), ("sensor", True, SENSOR)]
)
def test_two_effects_stand_in_for_one_if_a_single_curve_does_as_much(limited, slow_sensor, accepted):
    """A limited sensor with another lag moves the plant behind the limit: as a limited actuator is."""
    found = sysid.diagnose(
        actuated(limited, slow_sensor),
        order=1,
        initial_state="rest",
        effects=[*SENSOR, "out_quadratic", "op_gain", "coloured_noise"],
    )
    assert found.accepted == accepted
    if accepted:
        assert found.verdict == "missing-effect"
        return
    assert (found.verdict, found.decision.rejected) == ("unexplained", SENSOR)
    assert found.decision.resembled_at == found.ports[0].port == "input"
    assert "stood in for something else: one free-form curve at the input explains as much" in found.advice


@pytest.mark.parametrize(
    ("names", "port", "left", "taken"),
    [
        pytest.param(("out_quadratic", "in_deadzone"), "output", 1.05, True, id="as much as both"),
        pytest.param(("out_quadratic", "in_deadzone"), "output", 1.2, False, id="less than both"),
        pytest.param(("in_saturation", "in_deadzone"), "input", 0.95, False, id="both at its place"),
        pytest.param(("in_saturation", "in_deadzone"), "input", 0.85, True, id="another law there"),
        pytest.param(("in_saturation", "out_offset"), "input", 0.95, False, id="beside a constant"),
        pytest.param(("in_saturation", "out_drift"), "input", 1.03, False, id="beside a slow drift"),
        pytest.param(("coulomb", "cubic_stiffness"), "velocity", 0.95, False, id="one motion"),
    ],
)
def test_where_a_curve_stands_says_how_well_it_must_do(names, port, left, taken):
    """Of errors 100 without effects, 40 with one and 1 with two, a curve leaves about as much as both.

    Of how much it takes off the model beside which it was fitted, which may be lost there, nothing follows.
    """
    curve = SimpleNamespace(port=port, left=left, left_fitted=left, explains_at_most=0.9999)
    assert is_resembled(names, curve) == taken
    curve.left_fitted = 1.5  # as much as both on few held-out rows, by luck
    assert not is_resembled(names, curve)


def is_resembled(names, curve):
    """Whether a curve says that two names only resemble what is missing."""
    every = np.ones(1, dtype=bool)
    record = SimpleNamespace(estimation=every, validation=every, y=np.zeros((1, 1)))
    choices = [SimpleNamespace(effect=e, name=e.name, form=e.forms[0]) for e in find_effects(names)]
    fits = [SimpleNamespace(output=np.array([np.sqrt(error)]), choices=choices) for error in (40.0, 1.0)]
    plain = SimpleNamespace(output=np.array([10.0]))
    decision = SimpleNamespace(baseline=plain, fits=fits, final=fits[-1])
    return resembled(record, decision, [curve]) is curve


@pytest.mark.parametrize("n", [1500, 15_000], ids=["a whole record", "windows of a long one"])
def test_what_a_curve_leaves_is_held_against_names_over_the_same_rows(n):
    """A window has a start of its own: what is left in it tells nothing of a free run over all rows."""
    rng = np.random.default_rng(7)
    u = np.repeat(rng.uniform(-2.0, 2.0, n // 10), 10)
    y = lfilter([0.0, 0.1], [1.0, -0.9], np.clip(u, -1.0, 1.0)) + 0.02 * rng.standard_normal(n)
    record = make_record(u, y, PERIOD)
    (curve,) = explore_ports(record, fit_output_error(record, 1), ports=("input",))
    if n > 1500:
        assert curve.left is None
        return
    # The noise alone is left; of 300 rows its variance is known within 8 % (one standard deviation).
    assert curve.left == pytest.approx(0.02**2, rel=0.25)
    assert 1.0 - curve.explains_at_most < 0.05


def test_in_windows_the_share_that_a_curve_takes_off_counts():
    """Of errors 100 without effects a curve leaves 1.05, as much as both, or 1.2."""
    for share, taken in ((0.9895, True), (0.988, False)):
        curve = SimpleNamespace(port="output", left=None, left_fitted=None, explains_at_most=share)
        assert is_resembled(("out_quadratic", "in_deadzone"), curve) == taken
