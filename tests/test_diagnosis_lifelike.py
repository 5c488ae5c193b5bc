"""Records as machines give them: run-away baselines, rectified speeds, short logs, runs that are lost."""

from dataclasses import replace

import numpy as np
import pytest

from sysid.data import make_record
from sysid.diagnosis.decide.evidence import score_screen
from sysid.diagnosis.decide.innovations import foreseen, uneven
from sysid.diagnosis.decide.noise_colour import noise_of
from sysid.diagnosis.diagnose import diagnose, structure_of
from sysid.diagnosis.effects.catalogue import find_effects
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort
from sysid.physics.reading import read_model

SERVO = """
name = "servo"
title = "Servo unit, voltage to angle"
[states]
q = { unit = "rad" }
w = { unit = "rad/s" }
[inputs]
u = { unit = "V" }
[outputs]
y = { unit = "rad", terms = { q = "q" } }
[parameters]
K = { unit = "rad/(s V)", start = 1.6, minimum = 0.0 }
tau = { unit = "s", start = 0.025, minimum = 0.0 }
[[equations]]
state = "q"
unit = "rad/s"
terms = { w = "w" }
[[equations]]
state = "w"
factor = "tau"
unit = "rad/s"
terms = { drive = "K*u", damping = "-w" }
"""


def steps(rng, n, low, high, longest):
    """A signal that is held for random times."""
    held = []
    while len(held) < n:
        held += [rng.uniform(low, high)] * int(rng.integers(5, longest))
    return np.array(held[:n])


def servo_record(n=700, period=0.004, fine=20):
    """A position loop with dry friction, simulated in small steps; the angle by an encoder."""
    rng, reference = np.random.default_rng(3), 0.0
    q = w = before = slope = 0.0
    u, y, line = np.empty(n), np.empty(n), 2 * np.pi / 4096
    for k in range(n):
        if k % 140 == 0:
            reference = rng.uniform(0.4, 0.9) * (-1) ** (k // 140)
        y[k] = np.round(q / line) * line
        slope, before = 0.8 * slope + 0.2 * (y[k] - before) / period, y[k]
        u[k] = np.clip(12 * (reference - y[k]) - 0.35 * slope, -10, 10)
        for _ in range(fine):
            step = period / fine
            free, dry = w + step * (1.7 * u[k] - w) / 0.028, 0.9 * step / 0.028
            w = np.sign(free) * max(abs(free) - dry, 0.0)
            q += step * w
    return make_record(u, y, period)


def test_friction_is_found_where_the_plain_fit_runs_off():
    """In a loop that holds the angle the time constant goes to nothing, and the first speed anywhere."""
    found = diagnose(servo_record(), read_model(SERVO, "servo"), effects=["coulomb", "quad_drag"])
    assert found.accepted[:1] == ("coulomb",)
    assert not {"quad_drag"} & set(found.accepted)
    (friction,) = found.final.fitted.parameters_of("coulomb")
    # The encoder's lines and the coarse simulation leave half a per cent.
    assert friction.value == pytest.approx(0.9, rel=0.01)


def test_a_search_from_nowhere_ends_in_no_fit_and_no_error():
    structure = structure_of(servo_record(), read_model(SERVO, "servo"), None, "estimate")
    rows = structure.record.estimation
    (friction,) = structure.offered(find_effects(["coulomb"]))
    base = structure.baseline(rows)
    nowhere = replace(base, point=np.full(base.point.size, 1e200))
    for effort in (Effort.COARSE, Effort.FINE, Effort.REFIT):
        fit = structure.fit([Choice(friction, friction.forms[0])], rows, WHITE, nowhere, effort=effort)
        assert fit.usable or fit.cost == np.inf


def test_a_rectified_speed_needs_nothing_besides_and_has_no_double():
    """A pulse counter at a belt drive: the model without it loses the plant, and drifts on another scale."""
    rng = np.random.default_rng(1)
    n, speed, belt, drive = 500, np.zeros(500), 0.0, 0.0
    u = steps(rng, n, -1.5, 1.5, 40)
    for k in range(n - 1):
        drive += 0.02 * (-0.7 * drive + 3.2 * u[k] - 4.0 * belt)
        belt += 0.02 * (drive - speed[k])
        speed[k + 1] = speed[k] + 0.02 * (30.0 * belt - 1.6 * speed[k])
    y = np.round(np.abs(speed) / 0.0045) * 0.0045 + 0.004 * rng.standard_normal(n)
    names = ["out_rectify", "out_drift", "gravity_sine", "time_variation", "out_saturation"]
    found = diagnose(make_record(u, y, 0.02), order=3, effects=names)
    assert found.accepted == ("out_rectify",)
    assert found.decision.tie == ()


def test_a_short_record_is_tried_at_lower_orders_with_effects():
    rng = np.random.default_rng(2)
    u, y, x = np.repeat(rng.uniform(-4, 4, 20), 6), np.zeros(120), np.zeros(2)
    for k in range(120):
        y[k] = x[0]
        x = x + 0.05 * np.array([4 * x[1], -3 * x[1] - 4 * x[0] + 4 * np.clip(u[k], -2, 2.5)])
    noisy = make_record(u, y + 0.05 * rng.standard_normal(120), 0.05)
    found = diagnose(noisy, effects=["in_saturation", "in_deadzone"])
    assert found.accepted == ("in_saturation",)


def linear_run(rng, n, memory):
    """A second-order plant with coloured noise, and its innovations."""
    u, e = steps(rng, n, -2, 2, 20), rng.standard_normal(n)
    z, r = np.zeros(n), np.zeros(n)
    for k in range(2, n):
        z[k] = 1.6 * z[k - 1] - 0.7 * z[k - 2] + 0.1 * u[k - 1]
        r[k] = memory * r[k - 1] + 0.05 * e[k]
    return u, z, r


@pytest.mark.parametrize("question", [foreseen, uneven])
def test_innovations_of_a_coloured_noise_cannot_be_foreseen(question):
    """Neither they nor their size."""
    chances = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        u, z, r = linear_run(rng, 1200, rng.uniform(0.3, 0.97))
        record = make_record(u, z + r, 0.1)
        rows = record.learning
        chances.append(question(record, rows, r, noise_of(r, rows).polynomial).p_value)
    # Uniform but for chance: of 30 the smallest lies below 1e-4 three times in a thousand.
    assert min(chances) > 1e-4
    assert 0.2 < np.median(chances) < 0.8


def test_what_follows_the_plant_in_a_bent_way_is_foreseen():
    rng = np.random.default_rng(5)
    u, z, _ = linear_run(rng, 1200, 0.5)
    r = np.zeros(1200)
    for k in range(1, 1200):
        r[k] = 0.9 * r[k - 1] + 0.05 * rng.standard_normal() + 0.06 * (abs(z[k - 1]) - 0.8)
    record = make_record(u, z + r, 0.1)
    told = foreseen(record, record.learning, r, noise_of(r, record.learning).polynomial)
    assert told.plainly
    assert told.share == pytest.approx(1 - 1 / (1 + np.var(0.06 * np.abs(z)) / 0.05**2), abs=0.25)
    few = np.arange(1200) < 300  # too few for as many directions
    assert not foreseen(record, few & record.learning, r, WHITE).plainly


def test_the_size_of_innovations_is_asked_within_each_experiment():
    """In whatever order experiments are given, whose levels differ, the answer is the same."""
    rng = np.random.default_rng(8)
    runs = [linear_run(rng, 150, 0.5) for _ in range(4)]
    chances = []
    for order in ([0, 1, 2, 3], [2, 0, 3, 1]):
        u, y, r = (
            np.concatenate([runs[i][j] + (3.0 * i if j < 2 else 0.0) for i in order]) for j in range(3)
        )
        record = make_record(u, y + r, 0.1, experiment=np.repeat(order, 150))
        chances.append(uneven(record, np.ones(600, dtype=bool), r, WHITE).p_value)
    assert chances[0] == pytest.approx(chances[1], rel=1e-6)


def test_samples_at_odd_times_are_no_noise():
    """What a clock errs by goes with how fast the output moves, not with where it is or what drives it."""
    rng = np.random.default_rng(3)
    u, z, _ = linear_run(rng, 1200, 0.5)
    y = z + 0.3 * rng.standard_normal(1200) * np.gradient(z) + 0.005 * rng.standard_normal(1200)
    found = diagnose(make_record(u, y, 0.1), order=2, effects=["in_delay", "out_lowpass", "coloured_noise"])
    assert (found.verdict, found.accepted) == ("unexplained", ())
    assert "samples that are taken too early or too late" in found.advice


@pytest.mark.parametrize("constant", [0.0, 0.7, 2.0])
def test_a_sensor_may_be_noisier_at_some_levels(constant):
    """The error of a sensor in per cent of what it reads is noise, whatever level the plant works about."""
    rng = np.random.default_rng(4)
    u, z, _ = linear_run(rng, 1200, 0.5)
    y = z + 0.03 * rng.standard_normal(1200) * (constant * z.std() + np.abs(z))
    found = diagnose(make_record(u, y, 0.1), order=2, effects=["in_delay", "out_lowpass", "coloured_noise"])
    assert found.verdict == "nothing-missing"


def test_without_directions_a_fit_decides():
    """A plain fit that has run off has no slopes: that is no evidence against an effect that mends it."""
    screen = score_screen(np.ones(50), np.zeros((50, 0)), {"coulomb": [np.zeros((50, 1))]}, 1.0, None)
    assert screen.p_value(0.0) == 1.0
    assert screen.fitted_p_value(1e4, 1) < 1e-3
