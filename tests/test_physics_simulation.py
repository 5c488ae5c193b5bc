"""Simulation of physical models against scipy's solvers, and sensitivities against finite differences."""

import numpy as np
import pytest
from physics_cases import VALUES, duffing, free_model
from scipy import signal
from scipy.integrate import solve_ivp

from sysid.errors import ModelError, UsageError
from sysid.physics import load_model, model_names
from sysid.physics.generator import compiled_kernels
from sysid.physics.model import Parameter
from sysid.physics.simulation import Simulator, choose_substeps, step_error


def tanks_of_torricelli():
    """A model with where, max and sqrt in a state equation, an input and a parameter in the output."""
    return (
        load_model("two-tanks")
        .with_parameters(start={"a1": 0.3, "a2": 0.2, "b": 0.5})
        .with_term("x1", "root", "a1*x1 - r*sqrt(max(x1, 0))", (Parameter("r", "1", 0.2),))
        .with_term("y", "overflow", "where(x2 > 1, r*(x2 - 1)**2, 0) + 0.1*r*u")
    )


def excitation(n=300, seed=0):
    return np.repeat(np.random.default_rng(seed).uniform(-1, 2, n // 5), 5)


def state_space(name, v):
    matrices = {
        "mass-spring-damper": (lambda m, c, k: ([[0, 1], [-k / m, -c / m]], [[0, 0], [1 / m, 0]], [1, 0], 0)),
        "dc-motor": (
            lambda J, b, K, L, R: ([[-b / J, K / J], [-K / L, -R / L]], [[0, 0], [1 / L, 0]], [1, 0], 0)
        ),
        "two-tanks": (lambda a1, a2, b: ([[-a1, 0], [a1, -a2]], [[b, 0], [0, 0]], [0, 1], 0)),
        "two-tanks-offset": (
            lambda a1, a2, b, offset: ([[-a1, 0], [a1, -a2]], [[b, 0], [0, 0]], [0, 1], offset)
        ),
        "positioning-stage": (
            lambda M, F_v, gain, offset: (
                [[0, 1], [0, -F_v / M]],
                [[0, 0], [gain / M, -offset / M]],
                [1, 0],
                0,
            )
        ),
        "two-mass": (
            lambda m1, c1, k1, m2, c2, k2: (
                [
                    [0, 1, 0, 0],
                    [-(k1 + k2) / m1, -(c1 + c2) / m1, k2 / m1, c2 / m1],
                    [0, 0, 0, 1],
                    [k2 / m2, c2 / m2, -k2 / m2, -c2 / m2],
                ],
                [[0, 0], [1 / m1, 0], [0, 0], [0, 0]],
                [1, 0, 0, 0],
                0,
            )
        ),
        "oscillator": (
            lambda w0, zeta, gain: (
                [[0, 1], [-(w0**2), -2 * zeta * w0]],
                [[0, 0], [gain * w0**2, 0]],
                [1, 0],
                0,
            )
        ),
        "thermal-first-order": (lambda C, G, ambient, delay: ([[-G / C]], [[1 / C, 0]], [1], ambient)),
        "thermal-second-order": (
            lambda lag, C, G, ambient, delay: (
                [[-1 / lag, 0], [1 / C, -G / C]],
                [[1 / lag, 0], [0, 0]],
                [0, 1],
                ambient,
            )
        ),
    }
    return matrices[name](**v)


@pytest.mark.parametrize("name", model_names())
def test_linear_models_run_as_scipy_discretises_them(name):
    period, u = 0.1, excitation()
    A, B, C, offset = (np.asarray(part, dtype=float) for part in state_space(name, VALUES[name]))
    start = np.linspace(0.5, -0.3, A.shape[0])
    known = u
    if "delay" in VALUES[name]:  # 2.3 samples
        padded = np.concatenate([np.zeros(3), u])
        known = 0.7 * padded[1:-2] + 0.3 * padded[:-3]
    pair = np.column_stack([known, np.ones(u.size)])
    discrete = signal.cont2discrete((A, B, C[None, :], np.zeros((1, 2))), period)[:4]
    expected = signal.dlsim((*discrete, period), pair, x0=start)[1][:, 0] + offset
    y = Simulator(free_model(name), period).run(VALUES[name], u, start)[:, 0]
    # Two exponentials of the same matrix and 300 steps: rounding only.
    np.testing.assert_allclose(y, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("make", [duffing, tanks_of_torricelli])
def test_nonlinear_models_run_as_a_tight_solver_does(make):
    model, period, u = make(), 0.1, np.abs(excitation(100)) + 0.1
    start = np.array([0.5, 0.3])
    v = {p.name: p.start for p in model.parameters}

    def duffing_rate(t, x, force):
        spring = v["w0"] ** 2 * (v["gain"] * force - x[0]) - v["cubic"] * x[0] ** 3
        return [x[1], spring - 2 * v["zeta"] * v["w0"] * x[1]]

    def tank_rate(t, x, pump):
        return [v["b"] * pump - v["r"] * np.sqrt(max(x[0], 0)), v["a1"] * x[0] - v["a2"] * x[1]]

    rate = duffing_rate if make is duffing else tank_rate
    states = [start]
    for force in u[:-1]:
        run = solve_ivp(rate, (0, period), states[-1], args=(force,), rtol=1e-11, atol=1e-12)
        states.append(run.y[:, -1])
    states = np.array(states)
    if make is duffing:
        expected = states[:, 0]
    else:
        x2 = states[:, 1]
        expected = x2 + np.where(x2 > 1, v["r"] * (x2 - 1) ** 2, 0) + 0.1 * v["r"] * u
        assert (x2 > 1).any()
    # Fine steps; the error of Runge-Kutta falls with the fourth power.
    fine = Simulator(model, period, 40).run({}, u, start)[:, 0]
    np.testing.assert_allclose(fine, expected, atol=1e-8)
    # The steps the library chooses: small beside what any record can show.
    chosen = Simulator(model, period)
    error = np.abs(chosen.run({}, u, start)[:, 0] - expected).max()
    assert error < 2e-5 * np.std(expected)
    assert step_error(chosen, chosen.values(), u, start) < 2e-5


@pytest.mark.parametrize("name", [*model_names(), "duffing", "torricelli"])
def test_sensitivities_are_finite_differences(name):
    special = {"duffing": duffing, "torricelli": tanks_of_torricelli}
    model = special[name]() if name in special else free_model(name)
    simulator = Simulator(model, 0.1, substeps=3)
    u = np.abs(excitation(150)) + 0.1
    start = np.linspace(0.5, 0.2, model.order)
    values = simulator.values()
    y, J = simulator.sensitivities(values, u, start, before=1.0)
    np.testing.assert_allclose(y, simulator.run(values, u, start, before=1.0), rtol=1e-11, atol=1e-12)
    assert J.shape == (u.size, 1, len(simulator.searched) + model.order)
    step = 1e-6
    for column, searched in enumerate(simulator.searched):
        ahead, behind = ({**values, searched: values[searched] + s} for s in (step, -step))
        difference = simulator.run(ahead, u, start, before=1.0) - simulator.run(behind, u, start, before=1.0)
        # Central differences of step 1e-6: about 1e-9 of rounding and truncation.
        np.testing.assert_allclose(J[:, :, column], difference / (2 * step), rtol=1e-6, atol=2e-7)
    for i in range(model.order):
        shift = step * np.eye(model.order)[i]
        difference = simulator.run(values, u, start + shift, before=1.0)
        difference = difference - simulator.run(values, u, start - shift, before=1.0)
        np.testing.assert_allclose(
            J[:, :, len(simulator.searched) + i], difference / (2 * step), rtol=1e-6, atol=2e-7
        )


def test_an_oscillator_without_cubic_stiffness_is_linear():
    assert Simulator(load_model("oscillator"), 0.1).linear
    assert not Simulator(duffing(), 0.1).linear


def test_kernels_without_a_cache_folder(monkeypatch):
    source = Simulator(duffing(), 0.1).source
    monkeypatch.setattr("sysid.physics.generator.stored", lambda source: None)
    run, _ = compiled_kernels.__wrapped__(source)
    u, y = np.ones((5, 1)), np.empty((5, 1))
    run(u, np.zeros(2), np.array([3.0, 0.1, 0.7, 20.0]), 0.1, 1, y)
    assert np.isfinite(y).all()


def test_wrong_use_is_named():
    model = load_model("two-tanks")
    with pytest.raises(UsageError, match="sampling period is 0"):
        Simulator(model, 0.0)
    simulator = Simulator(model, 0.1)
    with pytest.raises(UsageError, match="takes 1 inputs"):
        simulator.run({}, np.ones((10, 2)))
    with pytest.raises(UsageError, match=r"must be \(2,\)"):
        simulator.run({}, np.ones(10), [1.0])
    with pytest.raises(ModelError, match="no parameter 'a3'"):
        simulator.run({"a3": 1.0}, np.ones(10))
    with pytest.raises(ModelError, match="'cubic' of model 'oscillator' is fixed at 0 and cannot be 2"):
        Simulator(load_model("oscillator"), 0.1).run({"cubic": 2.0}, np.ones(10))
    stiff = duffing()
    with pytest.raises(ModelError, match="too fast for the sampling period"):
        choose_substeps(
            stiff, {**Simulator(stiff, 1.0).values(), "w0": 1e6}, 1.0, np.ones((5, 1)), np.zeros(2)
        )
