"""Simulation of a two-state model beside scipy's solvers and the plain loop, in one run."""

import numpy as np
import pytest
from scipy.integrate import odeint, solve_ivp

from sysid.physics import load_model
from sysid.physics.simulation import Simulator

PERIOD = 0.1
W0, ZETA, GAIN, CUBIC = 1.0, 0.1, 0.7, 2.0
MODELS = {
    "linear, exact": load_model("mass-spring-damper"),
    "nonlinear, Runge-Kutta": load_model("oscillator").with_parameters(
        start={"w0": W0, "zeta": ZETA, "gain": GAIN, "cubic": CUBIC}
    ),
}


def excitation(n):
    return np.random.default_rng(0).standard_normal(n)


def rate(state, force):
    x, v = state
    return np.array([v, W0**2 * (GAIN * force - x) - 2 * ZETA * W0 * v - CUBIC * x**3])


def plain_loop(u):
    state, y = np.zeros(2), np.empty(u.size)
    for k, force in enumerate(u):
        y[k] = state[0]
        a = rate(state, force)
        b = rate(state + PERIOD / 2 * a, force)
        c = rate(state + PERIOD / 2 * b, force)
        d = rate(state + PERIOD * c, force)
        state = state + PERIOD / 6 * (a + 2 * b + 2 * c + d)
    return y


def by_solve_ivp(u):
    state, y = np.zeros(2), np.empty(u.size)
    for k, force in enumerate(u):
        y[k] = state[0]
        state = solve_ivp(lambda t, x, f=force: rate(x, f), (0, PERIOD), state, rtol=1e-6, atol=1e-9).y[:, -1]
    return y


def by_odeint(u):
    state, y = np.zeros(2), np.empty(u.size)
    for k, force in enumerate(u):
        y[k] = state[0]
        state = odeint(lambda x, t, f=force: rate(x, f), state, [0, PERIOD], rtol=1e-6, atol=1e-9)[-1]
    return y


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("derivatives", [False, True], ids=["output", "output and sensitivities"])
@pytest.mark.benchmark(group="two states, each sample")
def test_simulator(benchmark, name, derivatives):
    u = excitation(500_000)
    simulator = Simulator(MODELS[name], PERIOD, substeps=1)
    run = simulator.sensitivities if derivatives else simulator.run
    benchmark.pedantic(run, ({}, u), rounds=5, warmup_rounds=1)
    benchmark.extra_info["samples_per_second"] = u.size / benchmark.stats.stats.min


@pytest.mark.parametrize("peer", [plain_loop, by_solve_ivp, by_odeint])
@pytest.mark.benchmark(group="two states, each sample")
def test_peer(benchmark, peer):
    u = excitation(500)
    y = benchmark.pedantic(peer, (u,), rounds=3, warmup_rounds=1)
    benchmark.extra_info["samples_per_second"] = u.size / benchmark.stats.stats.min
    ours = Simulator(MODELS["nonlinear, Runge-Kutta"], PERIOD, substeps=1)
    ratio = _rate_of(ours) / benchmark.extra_info["samples_per_second"]
    benchmark.extra_info["times_faster"] = ratio
    assert np.abs(y - ours.run({}, u)[:, 0]).max() < 1e-4


def _rate_of(simulator):
    from time import perf_counter

    u = excitation(500_000)
    simulator.run({}, u)
    began = perf_counter()
    simulator.run({}, u)
    return u.size / (perf_counter() - began)
