"""Where the error lies: failures that are there are found, and nothing else."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from sysid.data import make_record, read_record
from sysid.diagnosis.compare import compare
from sysid.diagnosis.comparison import surrogates
from sysid.diagnosis.comparison.bands import band_shares
from sysid.diagnosis.comparison.regions import divisions
from sysid.diagnosis.comparison.series import judged_series
from sysid.diagnosis.comparison.surrogates import normal_scores
from sysid.diagnosis.comparison.where import locate

PERIOD = 0.1


def plant(u):
    return signal.lfilter([0.0, 0.06, 0.04], [1.0, -1.6, 0.7], u)


def held(rng, n, rows=5):
    return np.repeat(rng.standard_normal(n // rows + 1), rows)[:n]


def oscillator(u, *, cubic=0.0, friction=0.0):
    """Integrate x'' = 3 u - x' / 2 - x - cubic x^3 with dry friction by small implicit steps."""
    y, x, v, step = np.empty(u.size), 0.0, 0.0, PERIOD / 20
    for k, force in enumerate(u):
        y[k] = x
        for _ in range(20):
            v += step * (3.0 * force - x - 0.5 * v - cubic * x**3)
            v = np.sign(v) * max(abs(v) - step * friction, 0.0)
            x += step * v
    return y


def missing(name, rng, n=3000):
    """Return a record of a plant with one effect that a linear model lacks."""
    u, keywords = held(rng, n), {}
    if name == "saturation":
        y = plant(np.clip(u, -0.9, 0.9))
    elif name == "coulomb":
        y = oscillator(u, friction=1.0)
    elif name == "cubic":
        y = oscillator(u, cubic=1.0)
    else:
        y = plant(u)
    size = y.std()
    if name == "bad window":
        y[2100:2250] += 0.15 * size * np.sin(0.3 * np.arange(150))
    if name == "bad experiment":
        keywords["experiment"] = np.repeat(np.arange(6), n // 6)
        y[4 * n // 6 : 5 * n // 6] += 0.06 * size * rng.standard_normal(n // 6)
    if name == "missing mode":
        y = y + signal.lfilter([0.0, 0.05], [1.0, -1.94 * np.cos(1.2), 0.97**2], u)
    y = y + 0.01 * size * rng.standard_normal(n)
    split = np.repeat(["train", "test"], n // 2)
    return make_record(u, y, PERIOD, units={"u": "N", "y": "m"}, split=split, **keywords)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("saturation", "input"),
        ("coulomb", "velocity-sign"),
        ("cubic", "output"),
        ("bad window", "time"),
        ("bad experiment", "experiment"),
        ("missing mode", "frequency"),
    ],
)
def test_each_missing_effect_is_found_in_its_kind(name, kind):
    comparison = compare(missing(name, np.random.default_rng(1)), order=2, delay=1, constant=False)
    found = {finding.kind: finding for finding in comparison.where}
    assert kind in found
    assert found[kind].p_value <= 0.01
    assert found[kind].sentence in comparison.sentences()
    if name == "bad window":
        assert comparison.where[0].kind == "time"
        assert found[kind].region["from_s"] == pytest.approx(210.0, abs=8.0)
        assert found[kind].contrast > 4.0
    if name == "bad experiment":
        assert found[kind].region == {"experiment": "4"}
    if name == "missing mode":
        resonance = 1.2 / (2.0 * np.pi * PERIOD)
        # The peak has a width of 3 % and may lie at the edge of a band.
        assert 0.97 * found[kind].region["from_hz"] <= resonance <= 1.03 * found[kind].region["to_hz"]


def test_nothing_is_found_in_a_linear_plant():
    comparison = compare(missing("none", np.random.default_rng(2)), order=2, delay=1, constant=False)
    assert comparison.where == ()
    assert any("Nothing of note fails locally" in sentence for sentence in comparison.sentences())
    assert all(test.passed for test in comparison.tests.values())


def well_specified(rng, n, noise, laplace):
    """Return the series of a true model: its residual is noise of some colour, independent of the input."""
    u = held(rng, n + 500, (1, 8)[int(rng.integers(2))])
    model = plant(u)[500:]
    draws = rng.laplace(size=n + 500) if laplace else rng.standard_normal(n + 500)
    y = model + 0.1 * signal.lfilter([1.0], noise, draws)[500:]
    record = make_record(u[500:], y, PERIOD, units={"y": "m"})
    return judged_series(record, "test", np.ones(n, dtype=bool), model, 1)


def test_false_alarms_are_at_most_nominal(monkeypatch):
    """In 80 well-specified records, white, coloured, resonant and heavy-tailed, 1 % is 0.8 +- 0.9."""
    monkeypatch.setattr(surrogates, "MOST_DRAWS", 199)
    monkeypatch.setattr(surrogates, "FEWEST_DRAWS", 199)
    rng = np.random.default_rng(3)
    alarms = 0
    for number in range(80):
        noise = ([1.0], [1.0, -0.9], [1.0, -1.8, 0.95], [1.0, -0.98])[number % 4]
        alarms += bool(locate(well_specified(rng, 400, noise, laplace=number % 3 == 0)).findings)
    assert alarms <= 4  # five have a chance of 0.2 % if the rate is nominal


def test_smallest_p_value_is_uniform(monkeypatch):
    """The family-wise p-value of one examination falls below 5 and 20 % as often as it should."""
    monkeypatch.setattr(surrogates, "MOST_DRAWS", 99)
    monkeypatch.setattr(surrogates, "FEWEST_DRAWS", 99)
    rng = np.random.default_rng(4)
    smallest = []
    for number in range(160):
        series = well_specified(rng, 400, ([1.0], [1.0, -0.9])[number % 2], laplace=False)
        evidence = surrogates.examine(series, divisions(series), None)
        smallest.append(min(float(e.p_values.min()) for e in evidence))
    # Binomial bands of 99.9 % around 8 and 32 of 160.
    assert 1 <= np.sum(np.array(smallest) <= 0.05) <= 18
    assert 16 <= np.sum(np.array(smallest) <= 0.2) <= 50


def test_false_alarms_of_bands_are_nominal():
    """Coherence by chance in any band: 1 % of 300 is 3 +- 1.7."""
    rng = np.random.default_rng(5)
    alarms = 0
    for number in range(300):
        noise = ([1.0], [1.0, -0.9], [1.0, -1.8, 0.95])[number % 3]
        alarms += (
            min(band.p_value for band in band_shares(well_specified(rng, 600, noise, laplace=False))) <= 0.01
        )
    assert alarms <= 9


def test_shares_are_those_of_direct_sums():
    rng = np.random.default_rng(6)
    series = well_specified(rng, 400, [1.0], laplace=False)
    squared = series.residual**2
    for division in divisions(series):
        for region, share, data in zip(
            division.regions, division.share(squared), division.data_share, strict=True
        ):
            place = region.place
            signal_of = {"input": series.u[:, 0], "output": series.output, "velocity": series.velocity}
            if division.kind not in signal_of:
                continue
            x = signal_of[division.kind]
            inside = (x > place.get("above", -np.inf)) & (x <= place.get("up_to", np.inf))
            if "or_above" in place:
                inside = (x <= place["up_to"]) | (x > place["or_above"])
            assert share == pytest.approx(squared[inside].sum() / squared.sum(), abs=1e-12)
            assert data == pytest.approx(inside.mean(), abs=1e-12)


def test_windows_do_not_cross_experiments():
    rng = np.random.default_rng(7)
    u = rng.standard_normal(900)
    record = make_record(u, plant(u), PERIOD, experiment=np.repeat(["a", "b", "c"], [450, 250, 200]))
    series = judged_series(record, "test", np.ones(900, dtype=bool), np.zeros(900), 1)
    windows = [r for d in divisions(series) if d.kind == "time" for r in d.regions]
    for window in windows:
        first, last = window.place["first_row"] - 1, window.place["last_row"] - 1
        assert series.experiment[first] == series.experiment[last]
        assert window.place["to_s"] - window.place["from_s"] == pytest.approx((last - first + 1) * PERIOD)


def test_velocity_is_the_derivative_of_the_free_run_and_inputs_are_delayed():
    t = np.arange(300) * PERIOD
    record = make_record(np.arange(300.0), np.sin(t), PERIOD)
    series = judged_series(record, "test", np.arange(300) >= 10, np.sin(t), 3)
    # A central difference of a sine of frequency w is low by (w T)^2 / 6.
    np.testing.assert_allclose(series.velocity[:-1], np.cos(t)[10:-1], atol=PERIOD**2 / 6 + 1e-9)
    np.testing.assert_array_equal(series.u[:, 0], np.arange(7.0, 297.0))


def test_normal_scores_are_quantiles_of_ranks():
    from scipy.stats import norm, rankdata

    x = np.random.default_rng(8).standard_cauchy(101)
    np.testing.assert_allclose(normal_scores(x), norm.ppf((rankdata(x) - 0.5) / 101), atol=1e-12)


@pytest.mark.skipif("SYSID_DATA" not in os.environ, reason="SYSID_DATA names no folder of measured records")
@pytest.mark.parametrize(
    ("name", "options", "kinds"),
    [
        ("emps", {"model": "positioning-stage", "fixed": {"gain": 35.15}}, {"velocity", "velocity-sign"}),
        ("cascaded_tanks", {"order": 2, "delay": 1}, {"output"}),
        ("silverbox", {"order": 2, "delay": 0}, {"output", "velocity"}),
        ("hair_dryer", {"order": 2, "delay": 3}, set()),
    ],
)
def test_known_failures_of_real_records_are_visible(name, options, kinds):
    comparison = compare(read_record(Path(name)), **options)
    found = {finding.kind for finding in comparison.where}
    assert kinds <= found
    if not kinds:
        assert found == set()
