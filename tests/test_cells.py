"""Fits behind a quantiser: by the cells that were read."""

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.hidden_effects.outcome import judge
from benchmarks.hidden_effects.plan import assign
from sysid.data import make_record
from sysid.diagnosis.diagnose import structure_of
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.structures.cells import Cells, are_steps, cells_of, inside_cells, place_of_quantiser
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort


def quantised_line(rng, step, noise, n=400):
    X = np.column_stack([np.ones(n), rng.uniform(-3.0, 3.0, (n, 2))])
    truth = np.array([0.2, 1.3, -0.7])
    y = step * np.round(X @ truth / step) + noise * rng.standard_normal(n)
    return X, truth, y


def test_a_fit_inside_the_cells_is_far_nearer_to_the_truth_than_least_squares():
    rng = np.random.default_rng(5)
    errors = []
    for _ in range(20):
        X, truth, y = quantised_line(rng, 1.0, 0.03)
        cells = cells_of(y, 1.01)
        start = np.linalg.lstsq(X, y, rcond=None)[0]
        found = inside_cells(cells, lambda x, X=X: X @ x, lambda x, X=X: X, start)
        assert np.mean(np.round(X @ found / cells.step) == cells.counts) >= 0.995
        errors.append([np.abs(start - truth).max(), np.abs(found - truth).max()])
    plain, inside = np.median(errors, axis=0)
    # Rounding is noise of 0.29 steps to least squares, with an error of 0.29/20; a cell is missed by 1/400.
    assert inside < 0.3 * plain


def test_the_step_has_the_scatter_that_it_states():
    rng = np.random.default_rng(6)
    scores = []
    for _ in range(300):
        _, _, y = quantised_line(rng, 0.8, 0.1, n=60)
        cells = cells_of(y, 0.79)
        scores.append((cells.step - 0.8) / cells.step_error)
    # The standard deviation of 300 scores has an error of 4 %.
    assert np.std(scores) == pytest.approx(1.0, abs=0.15)
    assert abs(np.mean(scores)) < 0.25


def test_the_step_has_the_scatter_that_it_states_under_noise_with_a_memory():
    rng = np.random.default_rng(9)
    slow = np.repeat(rng.uniform(-3.0, 3.0, 60), 30)
    scores, white = [], []
    for _ in range(200):
        noise = lfilter([0.05], [1.0, -0.9], rng.standard_normal(slow.size + 200))[200:]
        cells = cells_of(0.8 * np.round(slow / 0.8) + noise, 0.79)
        scores.append((cells.step - 0.8) / cells.step_error)
        white.append((cells.step - 0.8) * np.linalg.norm(cells.counts) / cells.noise)
    # The standard deviation of 200 scores has an error of 5 %, that of 30 sums of 13 %.
    assert np.std(scores) == pytest.approx(1.0, abs=0.25)
    assert np.std(white) > 2.0


@pytest.mark.parametrize("step", [0.0, -1.0, 100.0])
def test_readings_without_steps_tell_no_cells(step):
    y = np.random.default_rng(7).standard_normal(100)
    assert cells_of(y, step) is None
    assert cells_of(y, 0.5) is None  # the noise hides them


def test_the_output_behind_a_quantiser_is_found_for_a_difference_equation_and_a_physical_model():
    rng = np.random.default_rng(8)
    n, a, b = 900, 0.85, 0.3
    u = np.repeat(rng.uniform(-1.0, 1.0, n // 3), 3)
    z = np.zeros(n)
    for k in range(1, n):
        z[k] = a * z[k - 1] + b * u[k - 1]
    step = 1.2 * np.std(z)
    y = step * np.round(z / step) + 0.03 * step * rng.standard_normal(n)
    record = make_record(u, y, period=0.1, split=np.repeat(["est", "test"], [600, 300]))
    structure = structure_of(record, "linear", 1, "rest")
    (quantiser,) = find_effects(["out_quantisation"])
    rows = record.learning
    fit = structure.fit(
        [Choice(quantiser, quantiser.forms[0])], rows, WHITE, structure.baseline(rows), effort=Effort.FINE
    )
    fit = structure.finish(fit, WHITE)
    # One row of 600 in another cell would be an error of step / 24; a fit by slopes alone has several.
    assert np.mean(np.round(fit.output / step) != np.round(z / step)) < 0.01
    (found,) = fit.parameters_of("out_quantisation")
    assert abs(found.value - step) < 4.0 * found.std_error
    # The rounded readings alone tell the step: noise / norm of the counts.
    counts = np.round(y[rows] / step)
    assert found.std_error == pytest.approx(0.03 * step / np.linalg.norm(counts), rel=0.15)


def test_cells_far_away_are_missed_by_a_finite_logarithm():
    cells = Cells(1.0, np.array([0.0, 500.0, -500.0]), 0.1, 0.0)
    X = np.array([[0.0], [1.0], [-1.0]])
    found = inside_cells(cells, lambda x: X @ x, lambda x: X, np.array([0.0]))
    assert found[0] == pytest.approx(500.0, abs=0.5)


def test_readings_in_whole_counts_leave_finite_errors_of_what_lies_before_the_quantiser():
    rng = np.random.default_rng(11)
    n, step = 1200, 0.35
    u = np.repeat(rng.uniform(-1.0, 1.0, n // 3), 3)
    z = lfilter([0.0, 0.3], [1.0, -0.85], u)
    scores = []
    for _ in range(10):
        y = step * np.round((z + 0.05 * rng.standard_normal(n)) / step)  # a converter behind the noise
        record = make_record(u, y, period=0.1, split=np.repeat(["est", "test"], [900, 300]))
        structure = structure_of(record, "linear", 1, "rest")
        (quantiser,) = find_effects(["out_quantisation"])
        start = structure.baseline(record.learning)
        fit = structure.fit(
            [Choice(quantiser, quantiser.forms[0])], record.learning, WHITE, start, effort=Effort.COARSE
        )
        pole, gain = (p for p in structure.finish(fit, WHITE).parameters if p.name in ("a1", "b1"))
        scores += [(pole.value + 0.85) / pole.std_error, (gain.value - 0.3) / gain.std_error]
    # 20 scores of unit variance have a root mean square of 1 within 0.16; it may be said to be too wide.
    assert 0.2 < np.sqrt(np.mean(np.square(scores))) < 1.5


def test_steps_show_in_the_readings_alone():
    rng = np.random.default_rng(11)
    smooth = lfilter([1.0], [1.0, -0.9], rng.standard_normal(1500))
    step = 1.2 * smooth.std()
    rounded = step * np.round(smooth / step)
    assert are_steps(rounded + 0.1 * step * rng.standard_normal(1500))
    assert not are_steps(rounded + 0.4 * step * rng.standard_normal(1500))
    assert not are_steps(smooth)
    assert not are_steps(np.clip(smooth, -1.0, 1.0))
    limited = np.clip(
        smooth, -0.2 * smooth.std(), 0.2 * smooth.std()
    )  # two ends, missed by the sensor's noise
    assert not are_steps(limited + 0.02 * smooth.std() * rng.standard_normal(1500))
    assert not are_steps(np.zeros(9))
    resting = smooth - np.clip(smooth, -smooth.std(), smooth.std())
    assert not are_steps(resting + 0.01 * rng.standard_normal(1500))


def test_a_quantiser_is_the_last_of_the_sensor_wherever_it_was_found():
    quantiser, limit, offset = (
        Choice(effect, effect.forms[0])
        for effect in find_effects(["out_quantisation", "in_saturation", "out_offset"])
    )
    assert place_of_quantiser([quantiser, limit]) == 0
    assert place_of_quantiser([limit, offset, quantiser]) == 2
    assert place_of_quantiser([quantiser, offset]) is None
    assert place_of_quantiser([]) is None


def test_a_quantiser_is_found_behind_an_effect_without_which_the_model_misses_whole_steps(tmp_path):
    # Of a limit and a switch, which leave as much, the switch is taken, behind which no quantiser explains.
    outcome = judge(assign(9870, 3, kind="two"), tmp_path)
    assert outcome["truth"] == ["in_saturation", "out_quantisation"]
    assert set(outcome["accepted"]) == set(outcome["truth"])
