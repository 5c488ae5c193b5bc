"""The colour of noise of which part was fitted away."""

import numpy as np
import pytest
from scipy.linalg import toeplitz

from sysid.diagnosis.decide.noise_colour import _lagged_root, noise_beside, noise_of
from sysid.diagnosis.decide.remains import ROWS_PER_DIRECTION, leading


def cosines(n, count):
    k = np.arange(n)
    return np.linalg.qr(np.column_stack([np.cos(np.pi * i * (k + 0.5) / n) for i in range(count)]))[0]


def autoregressive(rng, n, pole):
    e = rng.standard_normal(n + 200)
    for k in range(1, e.size):
        e[k] += pole * e[k - 1]
    return e[200:]


def test_moments_of_lags_are_the_sums_they_stand_for():
    rows = np.ones(60, dtype=bool)
    rows[[20, 41, 42]] = False
    hidden, largest = np.random.default_rng(0).standard_normal((rows.sum(), 5)), 4
    expected, runs = np.zeros((largest + 1, largest + 1)), [slice(0, 20), slice(20, 40), slice(40, 57)]
    lags = [1, 2, 3, 4, 0]
    for z in (hidden[run] for run in runs):
        for k in range(largest, len(z)):
            lagged = z[[k - lag for lag in lags]]
            expected += lagged @ lagged.T
    root = _lagged_root(hidden, rows, largest)
    np.testing.assert_allclose(root.T @ root, expected, rtol=1e-10, atol=1e-10)


def test_white_noise_stays_white_beside_many_columns():
    rng, n = np.random.default_rng(1), 300
    Q, rows = cosines(n, 60), np.ones(n, dtype=bool)
    orders = []
    for _ in range(100):
        e = rng.standard_normal(n)
        orders.append((noise_of(e - Q @ (Q.T @ e), rows).order, noise_beside(e, Q, rows)[0].order))
    plain, beside = np.mean(np.array(orders) > 0, axis=0)
    assert plain > 0.9
    assert beside <= 0.05  # the information criterion takes few white records for coloured


def penalty(polynomial, pole):
    """Return how much larger the log of the innovations is under a filter than under the true one."""
    w = np.exp(-1j * np.linspace(0.0, np.pi, 2048))
    ratio = np.polyval(polynomial[::-1], w) / (1.0 - pole * w)
    return np.log(np.mean(np.abs(ratio) ** 2))


@pytest.mark.parametrize("pole", [0.6, 0.9])
def test_the_colour_beside_columns_is_that_of_the_noise(pole):
    rng, n = np.random.default_rng(2), 600
    Q, rows = cosines(n, 60), np.ones(n, dtype=bool)
    effect = Q @ (30.0 * rng.standard_normal(60))
    found = []
    for _ in range(60):
        e = autoregressive(rng, n, pole)
        noise, left = noise_beside(e + effect, Q, rows)
        taken = noise_of(e - Q @ (Q.T @ e), rows)
        found.append([penalty(noise.polynomial, pole), penalty(taken.polynomial, pole), left / (n - 60)])
    beside, taken, variance = np.median(found, axis=0)
    # All that is slow is hidden: a pole at 0.9 is told by what is left of its flank, not fully in few rounds.
    assert beside < 0.2 * taken
    assert variance == pytest.approx(1.0, abs=0.05 if pole < 0.9 else 0.15)


def test_the_expected_moments_are_those_of_the_whole_noise():
    """E[r r'] of a generalised fit is R less what is put back, whatever the colour."""
    n, q, pole = 80, 12, 0.7
    R = toeplitz(pole ** np.arange(n)) / (1.0 - pole**2)
    Q = cosines(n, q)
    inverse = np.linalg.inv(R)
    taken_out = Q @ np.linalg.inv(Q.T @ inverse @ Q) @ Q.T
    hat = taken_out @ inverse
    left = (np.eye(n) - hat) @ R @ (np.eye(n) - hat).T
    np.testing.assert_allclose(left + taken_out, R, atol=1e-10)


def test_few_rows_are_asked_in_few_directions():
    rng, rows = np.random.default_rng(3), np.ones(160, dtype=bool)
    tangent = rng.standard_normal((160, 3))
    probes = np.column_stack([tangent @ [1.0, 2.0, 0.5], rng.standard_normal((160, 40))])
    found = leading(tangent, probes, rows)
    assert found.shape == (160, 160 // ROWS_PER_DIRECTION)
    together = np.linalg.matrix_rank(np.hstack([probes, found]))
    assert together == np.linalg.matrix_rank(probes)
    few = probes[:, :10]
    assert leading(tangent, few, rows) is few
