"""Excitation signals: spectra, correlations and ranges."""

import math

import numpy as np
import pytest

from sysid.distributions import Uniform
from sysid.errors import UsageError
from sysid.excitation import multisine, prbs, random_steps


@pytest.mark.parametrize("period", [63, 64])
@pytest.mark.parametrize("rng", [None, np.random.default_rng(4)], ids=["schroeder", "random"])
def test_multisine_excites_its_lines_alone(period, rng):
    lines = [1, 4, 9, 31]
    u = multisine(period, lines, rms=1.5, rng=rng, periods=3)
    assert u.shape == (3 * period,)
    np.testing.assert_array_equal(u[:period], u[period : 2 * period])
    assert np.sqrt(np.mean(u**2)) == pytest.approx(1.5, rel=1e-12)
    spectrum = np.abs(np.fft.rfft(u[:period])) / period
    expected = np.zeros_like(spectrum)
    expected[lines] = 1.5 / math.sqrt(2 * len(lines))
    np.testing.assert_allclose(spectrum, expected, atol=1e-12)


def test_schroeder_phases_keep_the_crest_low():
    u = multisine(1024, np.arange(1, 101))
    assert np.abs(u).max() < 2.0  # zero phases would give sqrt(200) = 14


@pytest.mark.parametrize("order", range(2, 11))
def test_prbs_has_the_correlation_of_a_maximal_sequence(order):
    u = prbs(order, amplitude=2.0)
    n = 2**order - 1
    assert u.shape == (n,)
    assert set(u) == {-2.0, 2.0}
    correlation = np.fft.irfft(np.abs(np.fft.rfft(u)) ** 2, n)
    np.testing.assert_allclose(correlation[0], 4 * n, rtol=1e-12)
    np.testing.assert_allclose(correlation[1:], -4.0, atol=1e-9)


def test_prbs_holds_and_repeats():
    once = prbs(4)
    np.testing.assert_array_equal(prbs(4, hold=3, periods=2), np.tile(np.repeat(once, 3), 2))


def test_random_steps_hold_their_levels():
    levels = Uniform(-1.0, 2.0)
    u = random_steps(np.random.default_rng(3), 10, levels, hold=4)
    drawn = levels.sample(np.random.default_rng(3), 3)
    np.testing.assert_array_equal(u, np.repeat(drawn, 4)[:10])
    np.testing.assert_array_equal(random_steps(np.random.default_rng(3), 3, levels), drawn)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: multisine(16, [8]), r"distinct harmonics in 1..7 for a period of 16"),
        (lambda: multisine(16, [0, 1]), "unusable"),
        (lambda: multisine(16, [2, 2]), "distinct"),
        (lambda: multisine(16, []), "at least one harmonic"),
        (lambda: multisine(16, [1.5]), "integers"),
        (lambda: multisine(2, [1]), "period is 2; give an integer >= 3"),
        (lambda: multisine(16, [1], rms=0.0), "rms is 0.0"),
        (lambda: multisine(16, [1], periods=0), "periods is 0"),
        (lambda: prbs(1), "order is 1"),
        (lambda: prbs(40), "from 2 to 20"),
        (lambda: prbs(3, amplitude=math.nan), "amplitude is nan"),
        (lambda: prbs(3, hold=0), "hold is 0"),
        (lambda: random_steps(np.random.default_rng(), 0, Uniform(0, 1)), "n is 0"),
        (lambda: random_steps(np.random.default_rng(), 5, Uniform(0, 1), hold=-1), "hold is -1"),
    ],
)
def test_unusable_arguments_are_named(make, message):
    with pytest.raises(UsageError, match=message):
        make()


def test_impulse_levels_are_those_of_giri():
    from sysid.excitation import impulse_levels

    levels, order = [-6.0, -3.0, 3.0, 6.0], 3
    u = impulse_levels(levels, order, periods=2)
    assert u.size == 2 * order * 7
    assert {t: u[t] for t in np.flatnonzero(u[:21])} == {6: -6.0, 12: -3.0, 15: 3.0, 18: 6.0}  # (5.1), n = 3
    even = impulse_levels(levels, order, even=True)
    assert list(np.flatnonzero(even)) == [6, 9, 12, 15]


@pytest.mark.parametrize(
    ("levels", "order", "periods", "message"),
    [
        ([1.0], 2, 1, "at least two"),
        ([1.0, 0.0], 2, 1, "none zero"),
        ([1.0, np.nan], 2, 1, "finite"),
        ([1.0, 2.0], 0, 1, "order is 0"),
        ([1.0, 2.0], 1, 0, "periods is 0"),
    ],
)
def test_unusable_impulses_are_named(levels, order, periods, message):
    from sysid.excitation import impulse_levels

    with pytest.raises(UsageError, match=message):
        impulse_levels(levels, order, periods)
