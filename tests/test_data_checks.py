"""Quantisation, drift, units: what is told of signals that look odd."""

import numpy as np
import pytest

from sysid.data import make_record, read_record
from sysid.data.quantisation import quantisation_step

RNG = np.random.default_rng(0)


def noisy_plant(rng, pole=0.9, n=2000, hold=10):
    u = np.repeat(rng.standard_normal(n // hold), hold)
    y = np.zeros(n)
    for k in range(1, n):
        y[k] = pole * y[k - 1] + u[k - 1]
    return u, y + 0.05 * y.std() * rng.standard_normal(n)


@pytest.mark.parametrize("step", [0.01, 10.0 / 4096, 3.0])
@pytest.mark.parametrize("n", [200, 20_000])
def test_the_step_of_a_converter_is_found(step, n):
    values = 50.0 * step * np.random.default_rng(n).standard_normal(n) + 7.0
    found = quantisation_step(np.round(values / step) * step)
    # Errors of the float grid are below 1e-12 of the values.
    assert found == pytest.approx(step, rel=1e-9)


def test_the_step_is_found_where_values_were_printed_with_few_digits():
    step = 10.0 / 4096
    values = np.round(np.random.default_rng(1).uniform(0.0, 10.0, 3000) / step) * step
    assert quantisation_step(np.round(values, 4)) == pytest.approx(step, rel=1e-3)


def test_a_continuous_signal_has_no_step():
    rng = np.random.default_rng(2)
    for values in (rng.standard_normal(150), rng.standard_normal(20_000), np.sin(np.arange(500.0))):
        assert quantisation_step(values) is None
    assert quantisation_step(np.sign(rng.standard_normal(500))) is None  # a binary input is no converter


def test_coarse_steps_are_told_and_fine_ones_are_not():
    u, y = noisy_plant(np.random.default_rng(3))
    coarse, fine = 0.05 * y.std(), 0.005 * y.std()
    (warning,) = make_record(u, np.round(y / coarse) * coarse, 1.0, units={"y": "mm"}).warnings
    assert f"'y' moves in steps of {coarse:.3g} mm, 5 % of its standard deviation" in warning
    assert make_record(u, np.round(y / fine) * fine, 1.0).warnings == ()


def test_a_drift_is_told_and_answers_to_the_input_are_not():
    rng = np.random.default_rng(4)
    u, y = noisy_plant(rng)
    rising = y + np.linspace(0.0, 3.0 * y.std(), y.size)
    (warning,) = make_record(u, rising, 1.0).warnings
    assert "'y' drifts: from row 1 to 2000 its level rises by" in warning
    ramp = np.linspace(0.0, 5.0, u.size)
    answered = y + 10.0 * ramp  # the static gain of the plant
    assert make_record(u + ramp, answered, 1.0).warnings == ()


def test_test_rows_are_not_looked_at_for_drift():
    u, y = noisy_plant(np.random.default_rng(5))
    y[1000:] += np.linspace(0.0, 5.0 * y.std(), 1000)
    split = np.repeat(["train", "test"], 1000)
    assert make_record(u, y, 1.0, split=split).warnings == ()


def test_false_alarms_of_drift_are_rare_even_for_slow_plants():
    rng = np.random.default_rng(6)
    alarms = sum(bool(make_record(*noisy_plant(rng, 0.99), 1.0).warnings) for _ in range(150))
    # One in ten thousand for independent blocks; a slow plant's are not, which the rise must outweigh.
    assert alarms <= 2


def test_units_in_brackets_are_known_and_times_in_milliseconds_become_seconds(tmp_path):
    u, y = noisy_plant(np.random.default_rng(7), n=100)
    path = tmp_path / "pump.csv"
    rows = "".join(f"{20 * k},{u[k]:.6f},{y[k]:.6f}\n" for k in range(100))
    path.write_text("t [ms],u [V],y [rad/s]\n" + rows)
    record = read_record(path, inputs="u [V]", outputs="y [rad/s]", time="t [ms]")
    assert record.period == pytest.approx(0.02, rel=1e-12)
    assert dict(record.units) == {"u [V]": "V", "y [rad/s]": "rad/s"}
    plain = read_record(path, inputs="u", outputs="y", time="t")
    assert (plain.inputs, plain.outputs, plain.period) == (("u",), ("y",), record.period)
    assert dict(plain.units) == {"u": "V", "y": "rad/s"}
    np.testing.assert_array_equal(plain.y, record.y)
    assert "The times in 't [ms]' are in ms: they were brought to seconds." in record.warnings
