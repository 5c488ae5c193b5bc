"""Physical parameters matched to an identified transfer function; two-mass systems found from nothing."""

import numpy as np
import pytest
from physics_cases import VALUES, free_model

from sysid.data import make_record
from sysid.linear.output_error import make_segments
from sysid.physics import fit_physics, load_model
from sysid.physics.matching import Match, Target, identified_response, matched_points
from sysid.physics.problem import Problem
from sysid.physics.simulation import Simulator
from sysid.physics.starts import draw_widths
from sysid.separable.descent import Status, levenberg_marquardt

PERIOD = 0.02


def two_masses(seed):
    """Resonances of 0.5 to 3 Hz and damping ratios of 1 to 20 % in either mass."""
    rng = np.random.default_rng(1000 + seed)
    m1, m2 = np.exp(rng.uniform(np.log(0.3), np.log(5.0), 2))
    w1, w2 = 2.0 * np.pi * np.exp(rng.uniform(np.log(0.5), np.log(3.0), 2))
    z1, z2 = np.exp(rng.uniform(np.log(0.01), np.log(0.2), 2))
    truth = {"m1": m1, "c1": 2.0 * z1 * w1 * m1, "k1": w1**2 * m1}
    truth |= {"m2": m2, "c2": 2.0 * z2 * w2 * m2, "k2": w2**2 * m2}
    u = 10.0 * np.repeat(rng.standard_normal(500), 4)
    y = Simulator(load_model("two-mass").with_parameters(start=truth), PERIOD).run({}, u)[:, 0]
    noise = 0.02 * y.std()
    return make_record(u, y + noise * rng.standard_normal(y.size), PERIOD), truth, noise


# Searches from random parameters alone fail in each of these four.
@pytest.mark.parametrize("seed", [0, 4, 5, 9])
def test_two_masses_are_found_without_a_start(seed):
    record, truth, noise = two_masses(seed)
    fit = fit_physics(record, "two-mass", initial_state="rest")
    assert fit.rms == pytest.approx(noise, rel=0.06)  # 2000 rows: four deviations of the rms
    assert fit.restarts_agree
    scaled = [(fit.values[name] - truth[name]) / fit.parameters()[name][1] for name in truth]
    assert np.abs(scaled).max() < 4.5


@pytest.mark.parametrize("name", ["two-mass", "thermal-second-order", "dc-motor"])
def test_distance_of_responses_has_the_slopes_of_differences(name):
    rng = np.random.default_rng(1)
    record = make_record(rng.standard_normal(100), rng.standard_normal(100), 0.1)
    model = free_model(name)
    problem = Problem(model, make_segments(record, record.learning), 0.1, False)
    z = np.exp(1j * np.array([0.03, 0.4, 1.1, 2.5]))
    response = np.array([[1.0 + 0.2j], [0.5 - 0.3j], [0.1j], [0.01]])
    match = Match(problem, Target(z, response, np.array([[1.0], [0.9], [0.5], [0.1]])))
    point = problem.coordinates(VALUES[name])
    step = 1e-6 * np.eye(point.size)
    differences = [(match.residual(point + s) - match.residual(point - s)) / 2e-6 for s in step]
    np.testing.assert_allclose(match.jacobian(point), np.array(differences).T, rtol=1e-5, atol=1e-7)


def test_a_dead_time_is_matched_too():
    rng = np.random.default_rng(2)
    u = np.repeat(rng.uniform(-1.0, 1.5, 400), 3)
    truth = VALUES["thermal-first-order"] | {"delay": 0.7}
    y = Simulator(free_model("thermal-first-order"), 0.1).run(truth, u)[:, 0]
    record = make_record(u, y + 0.01 * y.std() * rng.standard_normal(u.size), 0.1)
    model = load_model("thermal-first-order").with_parameters(start={"ambient": 0.0, "delay": 0.01})
    problem = Problem(model, make_segments(record, None), 0.1, True)
    assert np.all(identified_response(problem).weight <= 1.0)
    centre = problem.coordinates(problem.simulator.values())
    width = np.maximum(draw_widths(problem, centre), 5.0)
    values = problem.values(matched_points(problem, centre, width, 1)[0])
    assert values["delay"] == pytest.approx(0.7, abs=0.05)
    assert values["C"] == pytest.approx(5.0, rel=0.05)


def test_a_slope_without_a_value_ends_a_search_without_a_traceback():
    end = levenberg_marquardt(
        lambda x: np.array([x[0] - 1.0, 2.0]), lambda x: np.array([[np.inf], [1.0]]), [0.0]
    )
    assert end.status is Status.STUCK
