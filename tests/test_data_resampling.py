"""Resampling: exact means of a held input, no shift, no aliasing, labels and gaps."""

import numpy as np
import pytest

from sysid.data import make_record, read_record, resample
from sysid.data.resampling import resample_rows
from sysid.errors import DataError, UsageError
from sysid.linear import fit_output_error

PERIOD = 0.01


def smooth(t):
    return np.sin(2.0 * t) + 0.5 * np.cos(5.1 * t + 1.0)


def jittered(rng, n=2000):
    t = PERIOD * (np.arange(n) + rng.uniform(-0.3, 0.3, n))
    u = rng.standard_normal(n)
    return t - t[0], u


def test_same_period_changes_nothing():
    rng = np.random.default_rng(0)
    record = make_record(rng.standard_normal(200), rng.standard_normal(200), PERIOD)
    same = resample(record, PERIOD)
    np.testing.assert_allclose(same.u, record.u, atol=1e-9)  # differences of an integral of 200 terms
    np.testing.assert_allclose(same.y, record.y, atol=1e-12)


def test_input_is_the_mean_of_what_was_held():
    rng = np.random.default_rng(1)
    t, u = jittered(rng, 300)
    found = resample_rows(t, u[:, np.newaxis], smooth(t)[:, np.newaxis], 0.7 * PERIOD)
    assert not found.filtered
    fine = np.linspace(0.0, 1.0, 20_001)[:-1] + 2.5e-5
    for k in (0, 57, 200):
        instants = (k + fine) * 0.7 * PERIOD
        held = u[np.searchsorted(t, instants, "right") - 1]
        # The midpoint sum misses an edge of the steps by at most one of 20,000 cells.
        assert found.u[k, 0] == pytest.approx(held.mean(), abs=3e-4)


@pytest.mark.parametrize("period", [0.5 * PERIOD, PERIOD, 3.0 * PERIOD, 7.3 * PERIOD])
def test_a_slow_output_is_kept_at_its_instants(period):
    t, u = jittered(np.random.default_rng(2))
    found = resample_rows(t, u[:, np.newaxis], smooth(t)[:, np.newaxis], period)
    error = found.y[:, 0] - smooth(period * np.arange(found.y.shape[0]))
    inside = slice(8, -8) if found.filtered else slice(None)
    # Cubics over steps of 0.01 s leave (0.01 * 5.1)^3 / 10 or so; the filter passes 0.8 Hz to a thousandth.
    assert np.abs(error[inside]).max() < 2e-3
    assert np.abs(error).max() < 0.1


def test_what_would_alias_is_taken_off_both_signals():
    t = PERIOD * np.arange(5000)
    fast, slow = np.sin(2.0 * np.pi * 17.0 * t), np.sin(2.0 * np.pi * 0.4 * t)
    signal = (fast + slow)[:, np.newaxis]
    found = resample_rows(t, signal, signal, 0.1)  # 17 Hz would appear as 3 Hz
    assert found.filtered
    instants = 0.1 * np.arange(found.y.shape[0])
    expected = np.sin(2.0 * np.pi * 0.4 * instants)
    assert np.abs(found.y[8:-8, 0] - expected[8:-8]).max() < 3e-3
    centre = np.sin(2.0 * np.pi * 0.4 * (instants + 0.05 - 0.5 * PERIOD))
    # The mean over a tenth of a second, of samples held for 0.01 s each, lies half a new step later, half
    # an old one earlier.
    assert np.abs(found.u[8:-8, 0] - centre[8:-8]).max() < 1e-2


def test_a_plant_is_the_same_after_resampling():
    rng = np.random.default_rng(3)
    t, _ = jittered(rng, 4000)
    u = np.repeat(rng.standard_normal(200), 20)
    y, state = np.empty(4000), 0.0
    for k in range(4000):
        y[k] = state
        step = (t[k + 1] if k + 1 < 4000 else t[k] + PERIOD) - t[k]
        state = np.exp(-2.0 * step) * state + (1.0 - np.exp(-2.0 * step)) * u[k]
    for period in (PERIOD, 0.05):
        found = resample_rows(t, u[:, np.newaxis], y[:, np.newaxis], period)
        fit = fit_output_error(make_record(found.u, found.y, period), 1)
        # The pole at -2 1/s; edges of the input inside a step leave errors of a percent or so.
        assert -np.log(fit.poles[0].real) / period == pytest.approx(2.0, rel=0.02)
        assert fit.b[0, 0] / (1.0 + fit.a[1]) == pytest.approx(1.0, rel=0.01)


def test_labels_experiments_and_skips_go_with_their_rows():
    rng = np.random.default_rng(4)
    u, y = rng.standard_normal(600), rng.standard_normal(600)
    split = np.repeat(["train", "val", "test"], 200)
    y[550:] = np.nan
    experiment = np.repeat(["a", "b"], [400, 200])
    record = make_record(u, y, PERIOD, split=split, experiment=experiment, skip=30, warnings=["kept"])
    half = resample(record, 2.0 * PERIOD)
    assert half.n_samples == 300
    assert [int((half.split == name).sum()) for name in ("train", "val", "test")] == [100, 100, 100]
    assert half.experiments == ("a", "b")
    assert dict(half.skip) == {"test": 15}
    assert np.isnan(half.y[276:, 0]).all()
    assert np.isfinite(half.y[:274, 0]).all()
    assert half.warnings[0] == "kept"
    assert "low-passed below 25 Hz" in half.warnings[1]


def test_uneven_times_are_read_with_a_period(tmp_path):
    t, u = jittered(np.random.default_rng(5), 400)
    path = tmp_path / "pump.csv"
    path.write_text(
        "t,u,y\n" + "".join(f"{a:.7f},{b:.5f},{smooth(a):.7f}\n" for a, b in zip(t, u, strict=True))
    )
    with pytest.raises(DataError, match=r"sampling must be uniform; resample \(--resample 0.0\d+\)"):
        read_record(path, time="t")
    record = read_record(path, time="t", resample=PERIOD)
    assert record.period == PERIOD
    np.testing.assert_allclose(record.y[:, 0], smooth(PERIOD * np.arange(record.n_samples)), atol=2e-3)
    assert any(warning.startswith("Resampled from steps of") for warning in record.warnings)
    by_period = read_record(path, period=PERIOD, resample=2.0 * PERIOD)
    assert by_period.n_samples == 200


def test_gaps_and_senseless_periods_are_refused():
    rng = np.random.default_rng(6)
    t = np.concatenate([PERIOD * np.arange(100), 5.0 + PERIOD * np.arange(100)])
    u = rng.standard_normal((200, 1))
    with pytest.raises(DataError, match="row 101: nothing was measured for 4"):
        resample_rows(t, u, u, PERIOD)
    record = make_record(u, u[::-1], PERIOD)
    for period in (0.0, -1.0, float("nan"), 1e-12, 1e300, "a", None):
        with pytest.raises(UsageError):
            resample(record, period)
    with pytest.raises(UsageError, match="record is of type ndarray"):
        resample(u, PERIOD)
