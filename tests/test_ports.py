"""Free-form curves at ports: the right port, the right curve, an honest band and share."""

import numpy as np
import pytest
from ports_cases import A1, A2, B1, B2, MAPS, PERIOD, deviation, simulate

from sysid.data import make_record
from sysid.diagnosis.ports import explore_ports
from sysid.diagnosis.ports.loop import DEGREE, Loop
from sysid.diagnosis.ports.plants import PORTS, plant_of
from sysid.diagnosis.ports.search import fit_baseline
from sysid.diagnosis.ports.stretches import make_stretches
from sysid.linear import fit_output_error
from sysid.nonlinearities import Spline
from sysid.physics import fit_physics

CASES = [(port, name) for port, maps in MAPS.items() for name in maps]


def loop_at(port_kind, fit, record, knots, coefficients):
    """The problem of a port with every coefficient of its map free, and a point of it."""
    plant = plant_of(fit)
    stretches = make_stretches(record, plant, record.validation)
    port = plant.ports(record, (port_kind,))[0]
    _, point = fit_baseline(plant, port, stretches)
    fed = tuple(plant.map_input(s.u, 0) for s in stretches) if port_kind == "input" else ()
    n_map = knots.size - 1 + DEGREE
    loop = Loop(plant, port, stretches, knots, np.eye(n_map), np.zeros((0, n_map)), fed)
    n_plant = plant.start.size
    return loop, np.concatenate([point[:n_plant], coefficients, point[n_plant:]])


@pytest.mark.parametrize("port", PORTS)
def test_a_loop_is_the_difference_equation_with_its_map(port):
    """A y = B (u - f) with f of the input, of y, of its difference; or a map behind."""
    rng = np.random.default_rng(3)
    u = rng.standard_normal(60)
    y = np.zeros(60)
    y[1] = B1 * u[0]
    for k in range(2, 60):
        y[k] = -A1 * y[k - 1] - A2 * y[k - 2] + B1 * u[k - 1] + B2 * u[k - 2]
    fit = fit_output_error(make_record(u, y, PERIOD), 2, initial_state="rest")
    knots = np.linspace(-2.0, 2.0, 4)
    f = Spline(knots, 0.2 * rng.standard_normal(6))
    record = make_record(u, y, PERIOD)
    loop, point = loop_at(port, fit, record, knots, f.coefficients)
    # At rest the spline's value at zero would act before the record: it is as if it began then.
    x, force = np.zeros(60), np.zeros(60)
    for k in range(60):
        if k > 0:
            last = force[k - 2] if k > 1 else 0.0
            older = u[k - 2] if k > 1 else 0.0
            x[k] = -A1 * x[k - 1] - (A2 * x[k - 2] if k > 1 else 0.0)
            x[k] += B1 * (u[k - 1] + force[k - 1]) + B2 * (older + last)
        if port == "input":
            force[k] = f([u[k]])[0]
        elif port == "position":
            force[k] = -f([x[k]])[0]
        elif port == "velocity":
            force[k] = -f([(x[k] - x[k - 1]) / PERIOD if k else 0.0])[0]
    expected = x + f(x) if port == "output" else x
    # The fit finds the plant to rounding times the condition of two poles: 1e-9 is far above.
    np.testing.assert_allclose(loop.run(point)[0][0], expected, atol=1e-9)


@pytest.mark.parametrize("port", PORTS)
@pytest.mark.parametrize(
    ("order", "delay", "initial_state"), [(1, 1, "rest"), (3, 2, "estimate"), (2, 0, "rest")]
)
def test_derivatives_of_a_linear_loop_are_those_of_finite_differences(port, order, delay, initial_state):
    record, _ = simulate("position", "cubic stiffness", n=200)
    fit = fit_output_error(record, order, delay=delay, initial_state=initial_state)
    knots = np.linspace(-2.0, 2.0, 4) * (10.0 if port == "velocity" else 1.0)
    loop, point = loop_at(port, fit, record, knots, 0.1 * np.random.default_rng(0).standard_normal(6))
    check_derivatives(loop, point)


@pytest.mark.parametrize("port", ["input", "output", "position", "velocity"])
def test_derivatives_of_a_physical_loop_are_those_of_finite_differences(port):
    record = oscillator_record(lambda x, v: 0.0 * x, n=200)
    fit = fit_physics(record, "mass-spring-damper")
    knots = np.linspace(-2.0, 2.0, 4)
    loop, point = loop_at(port, fit, record, knots, 0.1 * np.random.default_rng(0).standard_normal(6))
    check_derivatives(loop, point)


def oscillator_record(force, n=1500, noise=0.005, seed=0):
    """A mass on a spring and a damper with one more force against it, by fine Runge-Kutta steps."""
    rng = np.random.default_rng(seed)
    m, c, k, substeps = 1.0, 0.6, 9.0, 10
    h = PERIOD / substeps
    u = np.convolve(10.0 * rng.standard_normal(n + 100), np.ones(4) / 4.0, "same")

    def rate(state, push):
        x, v = state
        return np.array([v, (push - c * v - k * x - force(x, v)) / m])

    states = np.zeros((u.size, 2))
    for row in range(u.size - 1):
        s = states[row]
        for _ in range(substeps):
            k1 = rate(s, u[row])
            k2 = rate(s + 0.5 * h * k1, u[row])
            k3 = rate(s + 0.5 * h * k2, u[row])
            s = s + h * (k1 + 2.0 * k2 + 2.0 * k3 + rate(s + h * k3, u[row])) / 6.0
        states[row + 1] = s
    y = states[:, 0] + noise * states[:, 0].std() * rng.standard_normal(u.size)
    return make_record(u[100:], y[100:], PERIOD, units={"u": "N", "y": "m"})


def check_derivatives(loop, point):
    J = loop.jacobian(point)
    for j in range(point.size):
        step = 1e-6 * max(1.0, abs(point[j]))
        ends = [loop.residual(point + sign * step * np.eye(point.size)[j]) for sign in (1.0, -1.0)]
        numeric = (ends[0] - ends[1]) / (2.0 * step)
        # Central differences of a cubic with kinks in its third derivative: step^2 and rounding / step.
        assert np.linalg.norm(J[:, j] - numeric) < 1e-5 * np.linalg.norm(J[:, j]) + 1e-9


@pytest.mark.parametrize(("port", "name"), CASES)
def test_the_right_port_comes_first_and_shows_the_map(port, name):
    record, seen = simulate(port, name)
    curves = explore_ports(record, fit_output_error(record, 2))
    assert [curve.explains_at_most for curve in curves] == sorted(
        (curve.explains_at_most for curve in curves), reverse=True
    )
    first, second = curves[:2]
    assert first.port == port
    assert first.explains_at_most > 0.98
    assert second.explains_at_most < 0.75 * first.explains_at_most
    truth = deviation(port, name, seen[record.estimation[: seen.size]], first.value)
    dense = first.density > 0.05 * first.density.max()
    inside = (truth >= first.lower) & (truth <= first.upper)
    # Hard knees lie between knots, where a spline rounds them off: they may leave the band near the knee.
    assert inside[dense].mean() > (0.75 if name in ("arctan", "quadratic", "cubic stiffness") else 0.5)
    error = np.sqrt(np.mean((truth - first.centre)[dense] ** 2) / np.mean(truth[dense] ** 2))
    assert error < 0.1


def test_nothing_is_found_where_nothing_is_missing():
    shares = []
    for seed in range(5):
        record, _ = simulate(seed=seed, n=1000)
        shares += [curve.explains_at_most for curve in explore_ports(record, fit_output_error(record, 2))]
    assert max(shares) < 0.05
    assert np.mean(shares) < 0.01
