"""A force with the sign of the velocity: found where there is one, and hardly ever where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from sysid.data import make_record
from sysid.diagnosis.comparison.reversal_force import LOOKS, reversal_finding, reversal_force
from sysid.diagnosis.comparison.series import judged_series
from sysid.diagnosis.ports.opening import plant_of
from sysid.linear import fit_output_error
from sysid.linear.simulation import predict

NULLS, MOST_ALARMS = 300, 9
"""At a level of 1 % more than 9 alarms in 300 come once in a thousand times."""


def slide(n=1500, friction=0.0, spring=0.0, seed=0):
    """A mass on a damped slide, its force smooth, its position with a little noise."""
    rng = np.random.default_rng(seed)
    u = 3.0 * lfilter([0.1], [1.0, -0.9], rng.standard_normal(n))
    steps, y, x, v = 10, np.empty(n), 0.0, 0.0
    d = 0.05 / steps
    for k in range(n):
        y[k] = x
        for _ in range(steps):
            v += d * (u[k] - 1.5 * v - 4.0 * x - spring * x**3)
            v = np.sign(v) * max(abs(v) - d * friction, 0.0)
            x += d * v
    y += 0.01 * y.std() * rng.standard_normal(n)
    split = np.repeat(["train", "test"], [n * 3 // 5, n - n * 3 // 5])
    return make_record(u, y, 0.05, inputs=["F"], units={"F": "N", "y": "m"}, split=split)


def prepared(record):
    fit = fit_output_error(record, 2)
    free_run = predict(fit, record).free_run
    series = judged_series(record, "test", record.scored_rows("test"), free_run, fit.delay)
    return series, free_run, plant_of(fit)


def test_dry_friction_is_found():
    finding = reversal_finding(*prepared(slide(friction=0.15)))
    assert finding.kind == "velocity-sign"
    assert finding.p_value < 0.001
    assert 0.3 < finding.error_share < 1.0
    assert "at F against the motion is missing, which changes its sign with the velocity" in finding.sentence


def test_a_hardening_spring_is_no_friction():
    assert reversal_finding(*prepared(slide(spring=8.0))) is None


def noises(n, rng):
    """White, coloured, integrated, and with bursts."""
    white = rng.standard_normal(n)
    return (
        white,
        lfilter([1.0], [1.0, -0.95], white),
        lfilter([1.0, 0.8], [1.0, -1.6, 0.8], white),
        np.cumsum(white),
        white * (1.0 + 2.0 * (np.arange(n) // 100 % 2)),
    )


def test_false_alarms_are_nominal():
    series, free_run, plant = prepared(slide())
    rng, p_values = np.random.default_rng(1), []
    for _ in range(NULLS // 5):
        for noise in noises(series.places.size, rng):
            found = reversal_force(replace(series, residual=noise), free_run, plant)
            p_values.append(found.p_value / LOOKS)
    assert np.sum(np.array(p_values) <= 0.01) <= MOST_ALARMS


def test_nothing_is_said_of_few_reversals():
    series, free_run, plant = prepared(slide())
    slow = replace(series, velocity=np.abs(series.velocity) + 0.1)
    assert reversal_force(slow, free_run, plant) is None


def test_emps(records):
    from sysid.data import read_record
    from sysid.diagnosis.compare import compare

    record = read_record(records / "emps" / "emps.csv.gz", split="split", experiment="experiment")
    found = compare(record, "linear", 2, delay=1, constant=True, ports=False)
    (finding,) = [one for one in found.where if one.kind == "velocity-sign"]
    assert finding.p_value < 0.01
    assert finding.error_share == pytest.approx(0.5, abs=0.2)
