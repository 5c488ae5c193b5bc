"""Orders of a linear model where the model without effects says little of them."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from sysid import diagnose
from sysid.data import make_record
from sysid.data.record import Record

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
