"""What a record can show: jumps at zero under inputs of one sign, limits of the rate under held inputs."""

import numpy as np
import pytest

from sysid import diagnose
from sysid.data import make_record
from sysid.data.record import Record
from sysid.diagnosis.effects.catalogue import find_effects
from sysid.diagnosis.structures.exercised import shows


def first_order(u: np.ndarray, seed: int, noise: float = 0.02) -> Record:
    rng = np.random.default_rng(seed)
    y = np.zeros(u.size)
    for k in range(1, u.size):
        y[k] = 0.9 * y[k - 1] + 0.1 * u[k - 1]
    split = np.repeat(["est", "val", "test"], [u.size * 6 // 10, u.size * 2 // 10, u.size * 2 // 10])
    return make_record(u, y + noise * y.std() * rng.standard_normal(u.size), period=0.1, split=split)


def held(seed: int, shortest: int, longest: int, n: int = 1000) -> np.ndarray:
    rng = np.random.default_rng(seed)
    levels = [np.full(rng.integers(shortest, longest), rng.uniform(-1, 1)) for _ in range(n // shortest + 1)]
    return np.concatenate(levels)[:n]


def limited(u: np.ndarray, rate: float, before: float | None = None) -> np.ndarray:
    x, out = u[0] if before is None else before, []
    for value in u:
        x += np.clip(value - x, -rate, rate)
        out.append(x)
    return np.array(out)


def test_a_jump_at_zero_is_not_offered_to_an_input_of_one_sign() -> None:
    (jump,) = find_effects(["in_preload"])
    u = held(0, 10, 40)
    assert shows(first_order(u, 0), jump)
    for one_sided in (u + 1.5, -u - 1.5):
        record = first_order(one_sided, 0)
        assert not shows(record, jump)
        found = diagnose(record, order=1, initial_state="rest", effects=["in_preload", "out_offset"])
        assert "in_preload" not in found.accepted


def test_a_valve_that_is_shut_at_times_shows_the_jump() -> None:
    (jump,) = find_effects(["in_preload"])
    assert shows(first_order(np.maximum(held(1, 10, 40), 0.0), 0), jump)


@pytest.mark.parametrize(("hold", "rate"), [((10, 40), 0.04), ((25, 90), 0.02), ((5, 20), 0.1)])
def test_a_limit_of_the_rate_is_found_under_a_staircase(hold: tuple[int, int], rate: float) -> None:
    # Between its steps a staircase does not change: quantiles of its changes are zero.
    u = held(3, *hold)
    record = first_order(limited(u, rate), 2)
    record = make_record(u, record.y[:, 0], period=record.period, split=record.split)
    found = diagnose(record, order=1, effects=["in_rate_limit", "in_saturation", "out_lowpass", "in_delay"])
    assert found.accepted == ("in_rate_limit",)
    values = [p.value for p in found.final.fitted.parameters_of("in_rate_limit")]
    # Ramps of some hundred samples under 2 % of noise: within a few per cent.
    assert values == pytest.approx([rate / record.period] * len(values), rel=0.05)


@pytest.mark.parametrize("before", [None, 0.0])
def test_an_actuator_may_start_at_rest_or_at_its_first_command(before: float | None) -> None:
    # Some thirty rows to the first command, which the plant remembers for as many.
    u = 1.0 + held(5, 3, 12)
    record = first_order(limited(u, 0.04, before), 1)
    record = make_record(u, record.y[:, 0], period=record.period, split=record.split)
    found = diagnose(record, order=1, initial_state="rest", effects=["in_rate_limit", "out_lowpass"])
    assert found.accepted == ("in_rate_limit",)
    for parameter in found.final.fitted.parameters_of("in_rate_limit"):
        assert abs(parameter.value - 0.4) < 3.0 * parameter.std_error < 0.02


def test_two_steps_of_an_input_show_no_gain_that_changes_with_time():
    # A change of the gain after the last step is a load, one between the two another gain or a slow pole.
    (variation,) = find_effects(["time_variation"])
    heater = make_record(np.repeat([0.0, 70.0, 30.0], [20, 280, 300]), np.arange(600.0), period=1.0)
    assert not shows(heater, variation)
    assert shows(make_record(held(0, 20, 40, 600), np.arange(600.0), period=1.0), variation)
