"""The colour of noise: the first rows of a run, and an autoregression of rows that begin anywhere."""

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from sysid.diagnosis.decide.noise_colour import noise_of
from sysid.diagnosis.structures.structure import filtered
from sysid.diagnosis.structures.whitening import opening

ROOTS = [0.9, 0.5 + 0.3j, 0.5 - 0.3j]


def test_stationary_noise_is_white_from_its_first_row():
    noise = np.poly(ROOTS).real
    response = lfilter([1.0], noise, np.eye(2000)[0])
    covariance = toeplitz([response[: 2000 - lag] @ response[lag:] for lag in range(8)])
    # 0.9^2000 is below rounding: the covariance is exact, and so is the whitening.
    white = filtered(np.linalg.cholesky(covariance), np.ones(8, dtype=bool), noise)
    assert np.allclose(white @ white.T, np.eye(8), atol=1e-10)


def test_each_run_of_rows_begins_anew():
    values, noise = np.random.default_rng(0).standard_normal(30), np.poly(ROOTS).real
    rows = np.ones(30, dtype=bool)
    rows[[2, 11, 13]] = False  # runs of two rows, of eight, of one, and of sixteen
    runs = [values[0:2], values[3:11], values[12:13], values[14:30]]
    expected = np.concatenate([filtered(run, np.ones(run.size, dtype=bool), noise) for run in runs])
    assert np.allclose(filtered(values, rows, noise), expected, atol=1e-14)


@pytest.mark.parametrize("noise", [[1.0, -1.0], [1.0, -2.0, 1.0], [1.0, -1.2]])
def test_a_row_without_a_past_says_nothing_where_noise_is_not_stationary(noise):
    assert not opening(np.array(noise)).any()


def test_a_large_first_row_does_not_hide_the_memory():
    """A random walk that begins far from zero: its steps are small all the same."""
    steps = 0.01 * np.random.default_rng(1).standard_normal(3000)
    walk = 5.0 + np.cumsum(steps)
    found = noise_of(walk, np.ones(3000, dtype=bool))
    # Three standard errors of a variance from 3000 rows.
    assert found.variance == pytest.approx(1e-4, rel=3 * np.sqrt(2 / 3000))
    assert found.polynomial.sum() == pytest.approx(0.0, abs=0.01)


def test_short_runs_of_rows_are_not_foreseen_from_zeros():
    noise, e = np.array([1.0, -0.95]), np.random.default_rng(2).standard_normal(6000)
    rows = np.ones(6000, dtype=bool)
    rows[::40] = False
    found = noise_of(lfilter([1.0], noise, e), rows)
    # Three standard errors of a pole near one: sqrt(1 - 0.95^2) / sqrt(6000) each.
    assert found.order == 1
    assert found.polynomial[1] == pytest.approx(-0.95, abs=0.013)
