"""Orders of a linear model where the model without effects says little of them."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from sysid import diagnose
from sysid.data import make_record
from sysid.data.record import Record
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.linear.structure import LinearStructure

Floats = np.ndarray


def record_of(u: Floats, y: Floats, period: float, noise: float, seed: int) -> Record:
    rng = np.random.default_rng(seed)
    n = u.size
    split = np.array(["est"] * n, dtype=object)
    split[n // 2 : n * 7 // 10], split[n * 7 // 10 :] = "val", "test"
    noisy = y + noise * y.std() * rng.standard_normal(n)
    return make_record(u, noisy, period=period, split=split.astype(str))


def poles_response(poles: list[complex], u: Floats) -> Floats:
    a = np.poly(poles).real
    return lfilter([0.0, a.sum()], a, u)


@pytest.mark.parametrize(
    ("poles", "seed"),
    [([0.9 + 0.25j, 0.9 - 0.25j, 0.8], 1), ([0.85, 0.7], 2), ([0.93 + 0.1j, 0.93 - 0.1j], 3)],
)
def test_a_speed_without_its_sign_is_named_at_any_order(poles: list[complex], seed: int) -> None:
    # A sensor that counts pulses on a drive that runs to both sides: no linear model follows it.
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 100) * rng.uniform(0.3, 1.0, 100), 5)
    y = np.abs(poles_response(poles, u))
    found = diagnose(
        record_of(u, y, 0.02, 0.02, seed), effects=["out_rectify", "out_quadratic", "in_saturation"]
    )
    assert found.accepted == ("out_rectify",)
    assert found.ladder[-1].scores["test"]["nrmse"] < 0.05


@pytest.mark.parametrize("order", [4, 6])
def test_an_acceleration_has_a_direct_path_at_any_order(order: int) -> None:
    # Two lightly damped modes whose acceleration is measured; held input, exact discretisation by scipy.
    rng = np.random.default_rng(0)
    period, u, y = 0.002, rng.standard_normal(900), np.zeros(900)
    for frequency, damping, gain in ((22.0, 0.02, 900.0), (70.0, 0.015, 600.0)):
        w = 2.0 * np.pi * frequency
        A, B = np.array([[0.0, 1.0], [-(w**2), -2.0 * damping * w]]), np.array([[0.0], [gain]])
        Ad, Bd, Cd = cont2discrete((A, B, A[1:], B[1:]), period)[:3]
        x = np.zeros(2)
        for k in range(u.size):
            y[k] += (Cd @ x)[0] + gain * u[k]
            x = Ad @ x + Bd[:, 0] * u[k]
    found = diagnose(record_of(u, y / 1000.0, period, 0.02, 1), order=order)
    assert found.accepted == ("feedthrough",)
    (direct,) = found.final.fitted.parameters_of("feedthrough")
    # Noise of 2 % on 630 rows: the direct gain is known to some thousandths.
    assert direct.value == pytest.approx(1.5, rel=0.02)


def belt_drive(u: Floats, w: float, lag: float, sensor: float, period: float = 0.02) -> Floats:
    """Return the size of the speed of a pulley on a belt, read through a low-pass filter, in small steps."""
    fine = 20
    h, x, v, drive, shown, y = period / fine, 0.0, 0.0, 0.0, 0.0, np.empty(u.size)
    for k, volts in enumerate(u):
        y[k] = shown if sensor else abs(x)
        for _ in range(fine):
            drive += h / lag * (1.4 * volts - drive)
            v += h * (w**2 * (drive - x) - 0.3 * w * v)
            x += h * v
            shown += h / sensor * (abs(x) - shown) if sensor else 0.0
    return y


@pytest.mark.parametrize(
    ("sensor", "named"), [(0.05, ("out_rectify", "out_lowpass")), (0.0, ("out_rectify",))]
)
def test_the_order_of_a_drive_without_sign_is_chosen_with_what_hides_it(
    sensor: float, named: tuple[str, ...]
) -> None:
    """Coupled drives: two records at two amplitudes, of which no linear model follows more than a part."""
    rng, parts = np.random.default_rng(4), []
    for low, high in ((-0.3, 0.7), (-1.5, 1.5)):
        u = np.repeat(rng.uniform(low, high, 100), 5)
        parts.append((u, belt_drive(u, 8.2, 0.34, sensor) + 0.015 * rng.standard_normal(500)))
    u, y = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    split = np.tile(np.repeat(["est", "test"], [400, 100]), 2)
    record = make_record(u, y, period=0.02, split=split, experiment=np.repeat(["low", "high"], 500))
    found = diagnose(record)
    assert found.accepted == named
    assert found.ladder[-1].scores["test"]["rmse"] < 0.02  # noise of 0.015


def test_a_mode_beside_a_bent_sensor_is_a_matter_of_the_order() -> None:
    """Where noise hides a pole from the model without effects the order is chosen once more with them."""
    rng = np.random.default_rng(11)
    u = np.repeat(rng.choice([-1.0, 1.0], 100), 5)
    y = np.round((np.abs(belt_drive(u, 20.5, 0.15, 0.0)) + 0.015 * rng.standard_normal(500)) / 0.005) * 0.005
    found = diagnose(make_record(u, y, period=0.02))
    assert found.accepted == ("out_rectify",)


def test_a_higher_order_of_a_slow_plant_fits_at_least_as_well() -> None:
    """A battery's voltage under a current: its capacity makes a pole at almost 1 beside two slow ones."""
    rng = np.random.default_rng(18)
    u = np.repeat(rng.uniform(-20, 4, 40), rng.integers(5, 60, 40))[:900]
    charge, fast, slow, y = 0.95, 0.0, 0.0, np.empty(u.size)
    for k, current in enumerate(u):
        y[k] = 3.3 + 0.7 * charge - 0.25 * np.exp(-18 * charge) + 0.004 * current + fast + slow
        charge += current / 18000.0
        fast += (0.003 * current - fast) / 12.0
        slow += (0.005 * current - slow) / 90.0
    record = make_record(u, y + 0.001 * rng.standard_normal(u.size), period=1.0)
    fits = [LinearStructure(record, order).baseline(record.estimation) for order in (2, 3, 4)]
    assert all(fit.cost < 1.01 * before.cost for before, fit in pairwise(fits))


def test_an_input_that_stands_still_hands_on_no_noise() -> None:
    """A direct path beside a drift goes with the input of the same row, in an open loop."""
    rng = np.random.default_rng(2)
    u = np.repeat(rng.uniform(-2, 2, 60), 10)
    drift = np.cumsum(0.01 * rng.standard_normal(u.size))
    y = lfilter([0.0, 0.2], [1.0, -0.8], u) + 0.3 * u + drift + 0.01 * rng.standard_normal(u.size)
    structure = LinearStructure(make_record(u, y, period=1.0), 1)
    record = structure.record
    evidence = Evidence(structure, record.estimation, record.validation, 0.01)
    assert not evidence.only_at_once(structure.baseline(record.estimation))
