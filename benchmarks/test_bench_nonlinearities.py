"""Compiled memory maps against the same recursions in plain Python, and the pieces of every map.

Each group is one comparison: pytest-benchmark prints the ratios within it.
"""

import numpy as np
import pytest

from sysid.nonlinearities import NONLINEARITIES, OneParameterMap

N = 100
A = 1.0


def plain_schmitt(u, a):
    x, out = 0.0, np.empty(u.size)
    for k, v in enumerate(u):
        x = 1.0 if v > a else -1.0 if v < -a else x
        out[k] = x
    return out


def plain_play(u, a):
    x, out = 0.0, np.empty(u.size)
    for k, v in enumerate(u):
        x = min(max(x, v - a), v + a)
        out[k] = x
    return out


PLAIN = {"hysteresis-relay-schmitt": plain_schmitt, "hysteresis-play": plain_play}


@pytest.fixture
def u():
    return np.random.default_rng(0).uniform(-4, 4, N)


@pytest.mark.parametrize("name", PLAIN)
@pytest.mark.parametrize("kind", ["compiled", "plain"])
def test_memory_map(benchmark, name, kind):
    benchmark.group = f"{name}, N = {100 * N}"
    function = NONLINEARITIES[name] if kind == "compiled" else PLAIN[name]
    long = np.random.default_rng(0).uniform(-4, 4, 100 * N)
    np.testing.assert_array_equal(function(long, A), PLAIN[name](long, A))  # compiles, too
    benchmark(function, long, A)


@pytest.mark.parametrize("name", [key for key, m in NONLINEARITIES.items() if isinstance(m, OneParameterMap)])
def test_pieces(benchmark, u, name):
    benchmark.group = "pieces, N = 100"
    NONLINEARITIES[name].piece_arrays(u, 0.0, 3.5)  # compiled before the clock starts
    benchmark(NONLINEARITIES[name].piece_arrays, u, 0.0, 3.5)


@pytest.mark.parametrize("kind", ["as pieces", "by simulation"])
def test_play_over_its_whole_range(benchmark, u, kind):
    """The signal for every parameter: its events once, or one simulation at each of them."""
    benchmark.group = f"play over its whole range, N = {N}"
    play = NONLINEARITIES["hysteresis-play"]
    knots = play.pieces(u, 0.0, 3.5).knot

    def simulate_each():
        return [play(u, a) for a in knots]

    if kind == "as pieces":
        benchmark(play.piece_arrays, u, 0.0, 3.5)
    else:
        benchmark(simulate_each)
