"""Diagnosis of records like those of public benchmarks, by simulators apart from the models."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

import sysid
from sysid.data import make_record
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.linear.sign_retrieval import retrieved_signs
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.physics.structure import PhysicsStructure
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort
from sysid.physics import load_model

SPLIT = ("est", "test")


def held(A, B, C, u, period):
    """Return the output of a linear plant from rest, its input held between samples."""
    n = len(B)
    M = np.zeros((n + 1, n + 1))
    M[:n, :n], M[:n, n] = np.multiply(A, period), np.multiply(B, period)
    E, x, y = expm(M), np.zeros(n), np.empty(len(u))
    for k, value in enumerate(u):
        y[k] = np.dot(C, x)
        x = E[:n, :n] @ x + E[:n, n] * value
    return y


def steps(rng, n, low, high, shortest, longest):
    """Return levels drawn at random, each held for a random time."""
    found = []
    while len(found) < n:
        found += [rng.uniform(low, high)] * int(rng.integers(shortest, longest + 1))
    return np.array(found[:n])


def record_of(u, y, period, n_est, **options):
    split = np.repeat(SPLIT, [n_est, u.size - n_est])
    return make_record(u, y, period=period, split=split, **options)


def coupled_drives(rng, u, period=0.02):
    """Return the speed of a pulley driven by a belt, of a drive with a lag: lightly damped, third order."""
    w, lag = 2 * np.pi * 1.3, 0.35
    A = [[-1 / lag, 0, 0], [0, 0, 1], [w**2, -(w**2), -0.32 * w]]
    return held(A, [1.35 / lag, 0, 0], [0, 1, 0], u, period)


@pytest.mark.parametrize("seed", range(6))
def test_signs_are_retrieved_where_all_of_the_signal_is_folded_over(seed):
    """At 2 % noise all but the samples near zero, an eighth of them, have their sign."""
    rng = np.random.default_rng(seed)
    u = steps(rng, 300, -1.5, 1.5, 5, 5)
    speed = coupled_drives(rng, u)
    size = np.abs(speed) + 0.02 * rng.standard_normal(300)
    data = Data(u, size, np.ones(300, dtype=bool), np.array([0, 300]), 0.02)
    agreement = [abs(float(np.mean(sign * np.sign(speed)))) for sign in retrieved_signs(data, u, True)]
    assert max(agreement) > 0.75


@pytest.mark.parametrize("kind", ["binary", "levels"])
def test_a_speed_from_pulses_is_found_rectified(kind):
    """The coupled electric drives: the counter does not tell the direction, the speed has no mean."""
    rng = np.random.default_rng(3)
    u = steps(rng, 500, -1.5, 1.5, 5, 5)
    if kind == "binary":
        u = np.repeat([0.5, 1.0, 1.5], [170, 170, 160]) * np.sign(u)
    y = np.abs(coupled_drives(rng, u)) + 0.02 * rng.standard_normal(500)
    found = sysid.diagnose(record_of(u, y, 0.02, 300), order=3)
    assert found.accepted[0] == "out_rectify", found
    score = found.ladder[-1].scores["test"]
    assert score["rmse"] < 0.05  # noise of 0.02, and errors of a third-order model of 300 rows


PLANT = {"A": [[0, 1], [-16, -2.8]], "B": [0, 32], "C": [1, 0]}
SLOW = ["time_variation", "out_lowpass", "extra_mode", "out_drift", "in_backlash", "coloured_noise"]


def wandering(rng, u):
    """Return a disturbance of the load that steps now and then, through the plant."""
    return held(**PLANT, u=steps(rng, u.size, -0.3, 0.3, 40, 150), period=0.05)


def slow_noise(rng, u):
    return 0.19 * lfilter([1], [1, -0.92], rng.standard_normal(u.size))


@pytest.mark.parametrize("disturbance", [wandering, slow_noise])
def test_a_slow_disturbance_is_no_physical_effect(disturbance):
    rng = np.random.default_rng(1)
    u = steps(rng, 1200, -2, 2, 4, 30)
    y = held(**PLANT, u=u, period=0.05)
    y = y + disturbance(rng, u) + 0.02 * rng.standard_normal(u.size)
    found = sysid.diagnose(record_of(u, y, 0.05, 800), order=2, effects=SLOW)
    assert found.verdict == "coloured-noise", found


def test_an_order_is_chosen_where_higher_ones_have_poles_on_the_unit_circle():
    """A lamp that heats with its voltage to the power 1.6: a linear model of high order drifts away."""
    rng, T, temperature = np.random.default_rng(0), 2.0, [0.0, 0.0]
    u, y = steps(rng, 800, 0, 8, 20, 60), np.empty(800)
    for k, value in enumerate(u):
        y[k] = temperature[1]
        for _ in range(20):
            wall, body = temperature
            loss = 0.22 * wall + 2.2e-9 * ((wall + 293) ** 4 - 293**4)
            temperature = [
                wall + T / 20 * (1.2 * value**1.6 - loss) / 12,
                body + T / 20 * (wall - body) / 9,
            ]
    record = record_of(u, y + 0.25 * rng.standard_normal(800), T, 500)
    assert 1 <= LinearStructure(record).order <= 6
    for order in (4, 5, 6):
        assert np.isfinite(LinearStructure(record, order).baseline(record.estimation).cost)


def bouc_wen(force, period, pieces):
    """Return the position of the benchmark's hysteretic oscillator under a force sampled finely."""
    m, c, k, alpha, beta, gamma, delta = 2.0, 10.0, 5e4, 5e4, 1e3, 0.8, -1.1
    h, x, v, z = period / pieces, 0.0, 0.0, 0.0

    def rate(x, v, z, F):
        loop = gamma * abs(v) * z + delta * v * abs(z)
        return v, (F - c * v - k * x - z) / m, alpha * v - beta * loop

    y, F = np.empty(force.size // pieces), np.append(force, force[-1])
    for i in range(force.size // pieces * pieces):
        if i % pieces == 0:
            y[i // pieces] = x
        middle = 0.5 * (F[i] + F[i + 1])
        a = rate(x, v, z, F[i])
        b = rate(x + h / 2 * a[0], v + h / 2 * a[1], z + h / 2 * a[2], middle)
        x, v, z = x + h * b[0], v + h * b[1], z + h * b[2]
    return y


def multisine(rng, n, rate, low, high, size):
    frequency = np.fft.rfftfreq(n, 1 / rate)
    inside = (frequency >= low) & (frequency <= high)
    spectrum = np.where(inside, np.exp(2j * np.pi * rng.uniform(size=frequency.size)), 0)
    u = np.fft.irfft(spectrum, n)
    return size * u / u.std()


def test_the_law_of_the_hysteretic_oscillator_is_fitted_under_a_sampled_force():
    """The baseline takes the force as held; with the course that it had, the law leaves the noise."""
    rng, pieces, n = np.random.default_rng(1), 20, 1500
    force = multisine(rng, n * pieces, 750.0 * pieces, 5.0, 150.0, 50.0)
    y = bouc_wen(force, 1 / 750, pieces) + 8e-6 * rng.standard_normal(n)
    record = record_of(force[::pieces], y, 1 / 750, 1200)
    model = load_model("mass-spring-damper").with_parameters({"m": 2.0, "c": 10.0, "k": 1e5}, None)
    structure, rows = PhysicsStructure(record, model, "rest"), record.estimation
    (effect,) = find_effects(["hysteresis_force"])
    baseline = structure.baseline(rows)
    choice, held_cost = Choice(effect, effect.form("Bouc-Wen")), baseline.cost
    assert structure.plant.hold == "zero"
    assert structure.held_or_smooth()
    fit = structure.fit([choice], rows, WHITE, structure.baseline(rows), effort=Effort.FINE)
    # The noise's share of the error of the baseline, and as much again for the course between samples.
    assert fit.cost < 2.0 * rows.sum() * 8e-6**2 < 0.02 * held_cost
    values = {p.name: p.value for p in fit.parameters_of("hysteresis_force")}
    # Of the benchmark: alpha, alpha / (beta gamma), delta / gamma.  The noise moves them by some 0.2 %.
    assert values["sigma"] == pytest.approx(5e4, rel=0.02)
    assert values["Fc"] == pytest.approx(62.5, rel=0.02)
    assert values["g"] == pytest.approx(-1.375, rel=0.02)
    assert structure.held_or_smooth()
    assert structure.plant.hold == "zero"


def test_the_hysteretic_oscillator_is_named():
    """Its loop hardens, so that one that only yields explains next to nothing."""
    rng, pieces, n = np.random.default_rng(5), 20, 1800
    force = multisine(rng, n * pieces, 750.0 * pieces, 5.0, 150.0, 50.0)
    y = bouc_wen(force, 1 / 750, pieces) + 8e-6 * rng.standard_normal(n)
    record = record_of(force[::pieces], y, 1 / 750, 1400)
    given = {"m": 2.0, "c": 10.0, "k": 1e5}
    names = ["hysteresis_force", "gravity_sine", "cubic_stiffness", "extra_mode", "feedthrough", "quad_drag",
             "in_deadzone", "out_offset", "time_variation", "op_gain"]  # fmt: skip
    found = sysid.diagnose(record, "mass-spring-damper", start=given, initial_state="rest", effects=names)
    assert found.accepted == ("hysteresis_force",)
    assert found.ladder[-1].scores["test"]["rmse"] < 1.1 * 8e-6


def test_an_output_that_the_input_does_not_drive_is_said_to_be_so():
    rng = np.random.default_rng(5)
    record = record_of(rng.uniform(-1, 1, 600), rng.standard_normal(600), 0.1, 400)
    found = sysid.diagnose(record, order=1, effects=["in_saturation"])
    assert found.verdict == "nothing-missing"
    assert any("follows next to nothing of 'y'" in sentence for sentence in found.sentences())


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_dead_time_is_named_in_a_record_that_begins_in_a_run(seed):
    """A hair dryer under a switched heater: what was before the first row was not zero."""
    rng = np.random.default_rng(100 + seed)
    u = np.repeat(rng.choice([3.41, 6.41], 275), 4)
    air = held([[-2.6, 0], [3.1, -3.1]], [2.4, 0], [0, 1], np.concatenate([np.full(3, 5.0), u[:-3]]), 0.08)
    y = air + 0.04 * lfilter([1], [1, -0.7], rng.standard_normal(u.size))
    begin = 51 + seed
    record = record_of(u[begin : begin + 1000], y[begin : begin + 1000], 0.08, 700)
    found = sysid.diagnose(record, order=2)
    assert set(found.accepted) <= {"in_delay", "coloured_noise"}
    (delay,) = found.final.fitted.parameters_of("in_delay")
    assert delay.value == pytest.approx(
        0.24, abs=0.08
    )  # a sample: two coefficients of the input can shift it


def test_from_rest_nothing_was_before_the_first_row():
    (delay, lag) = (effect.within("linear", False) for effect in find_effects(["in_delay", "out_lowpass"]))
    assert [form.name for form in delay.forms] == ["delay"]
    assert [form.name for form in lag.forms] == ["first order", "straight between samples"]
    at_first = delay.forms[0].apply(np.array([2.0, 4.0, 6.0]), np.array([0.15]), 0.1)
    np.testing.assert_allclose(at_first, [0.0, 1.0, 3.0])
    (delay, lag) = find_effects(["in_delay", "out_lowpass"])
    started = delay.form("delay in motion").apply(np.array([2.0, 4.0, 6.0]), np.array([0.15]), 0.1)
    np.testing.assert_allclose(started, [2.0, 2.0, 3.0])
    shown = lag.form("first order in motion").apply(np.array([2.0, 2.0, 4.0]), np.array([0.1]), 0.1)
    np.testing.assert_allclose(shown, [2.0, 2.0, 4.0 - 2.0 * np.exp(-1.0)])
