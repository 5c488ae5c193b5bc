"""The experiments of Giri's example: their plant, their bounds, their theory, and that a seed fixes them."""

import pickle

import numpy as np
import pytest
from scipy.signal import lfilter

from replications.giri import convergence, disturbance, excitation, precision, setting, theory
from replications.giri.paper import paper
from sysid.nonlinearities import SEGMENT


def rng(seed=0):
    return np.random.default_rng(seed)


def test_the_plant_is_the_papers():
    assert np.all(np.abs(np.roots([1.0, *setting.A])) < 1)  # A3
    assert not set(np.roots([1.0, *setting.A])) & set(np.roots(setting.B))  # A2
    below, above = setting.LEVELS[:2], setting.LEVELS[2:]
    assert max(below) < setting.SEGMENTS.D2 <= 0 <= setting.SEGMENTS.D1 < min(above)  # (3.1)
    expected = [-1.5, 0.56, 5 / 3, -10 / 3, 4 / 3, -8 / 3, 1, -2, 1, -2]
    np.testing.assert_allclose(setting.theta_star(), expected, rtol=1e-15)


def test_an_experiment_is_that_of_the_model():
    z, eta = rng(1).standard_normal((2, 10 * setting.PERIOD))
    u, y = setting.experiment(10, disturbance=z, equation_error=eta)
    x = SEGMENT(u, 1.0, 2.0, 1.0, -2.0, 1.0, -2.0)
    denominator = [1.0, -1.5, 0.56]
    expected = lfilter([0.0, 1.0, -2.0], denominator, x) + z + lfilter([1.0], denominator, eta)
    np.testing.assert_allclose(y, expected, atol=1e-11)
    assert set(u) == {0.0, *setting.LEVELS}


@pytest.mark.parametrize(
    "task", [disturbance.DisturbedRun("sinusoidal", periods=20), precision.NoisyRun("output", 10)]
)
def test_a_run_is_fixed_by_its_seed(task):
    first = task(rng(3))
    assert first == task(rng(3)) == pickle.loads(pickle.dumps(task))(rng(3))
    assert first != task(rng(4))


def test_the_plan_names_every_study():
    plan = paper.plan(200)
    assert len(plan) == len(disturbance.KINDS) + len(precision.NOISES) * len(precision.SIZES)
    assert all(runs >= 10 for _, runs in paper.plan(10).values())


# Bounds -----------------------------------------------------------------------------------------------


def composite_of(values):
    """Return theta of (a1, a2, b2, K1, K2, H1, H2)."""
    a1, a2, b2, K1, K2, H1, H2 = values
    levels = np.array(setting.LEVELS)
    d = np.where(levels > 0, K1 + H1 / levels, K2 + H2 / levels)
    return np.concatenate([[a1, a2], np.outer(d, [1.0, b2]).ravel()])


def test_the_derivative_of_the_composite_parameters():
    true = np.array(list(setting.TRUE.values()))
    np.testing.assert_allclose(composite_of(true), setting.theta_star(), rtol=1e-14)
    steps = 1e-6 * np.eye(7)
    numeric = [(composite_of(true + s) - composite_of(true - s)) / 2e-6 for s in steps]
    # Quadratic in the parameters: a central difference has rounding errors alone.
    np.testing.assert_allclose(precision.composite_derivative(), np.transpose(numeric), atol=1e-8)


def test_the_sensitivities_of_the_output():
    u, _ = setting.experiment(4)

    def output(values):
        theta = composite_of(values)
        forced = np.zeros(u.size)
        for j, level in enumerate(setting.LEVELS):
            impulses = np.where(u == level, level, 0.0)
            forced += lfilter([0.0, *theta[2 + 2 * j : 4 + 2 * j]], [1.0], impulses)
        return lfilter([1.0], [1.0, *theta[:2]], forced)

    true = np.array(list(setting.TRUE.values()))
    numeric = np.transpose([(output(true + s) - output(true - s)) / 2e-6 for s in 1e-6 * np.eye(7)])
    found = precision.output_sensitivities(4)
    # Truncation of the central difference: step^2 times a third derivative of some 1e5.
    np.testing.assert_allclose(found, numeric, atol=1e-6 * np.abs(found).max())


@pytest.mark.parametrize("noise", precision.NOISES)
def test_the_bound_falls_with_the_root_of_the_samples(noise):
    few, many = precision.bound(noise, 100), precision.bound(noise, 400)
    assert list(few) == list(setting.PARAMETERS)
    for name, value in few.items():
        assert value / many[name] == pytest.approx(2.0, rel=1e-12)


# Theory of small disturbances ---------------------------------------------------------------------------


def test_the_mean_norm_of_a_gaussian_vector():
    assert theory.mean_norm(np.array([[4.0]])) == pytest.approx(2 * np.sqrt(2 / np.pi), rel=1e-8)
    # Three equal variances: the Maxwell distribution.
    assert theory.mean_norm(np.eye(3)) == pytest.approx(2 * np.sqrt(2 / np.pi), rel=1e-8)
    draws = rng(2).standard_normal((200_000, 3)) * [2.0, 1.0, 0.1]
    found = theory.mean_norm(np.diag([4.0, 1.0, 0.01]))
    assert found == pytest.approx(np.linalg.norm(draws, axis=1).mean(), rel=0.01)  # standard error 0.14 %


def test_the_mean_of_the_uniform_disturbance():
    z = rng(3).uniform(-1, 1, (3, 400_000))
    drawn = np.abs(z[0] + setting.A[0] * z[1] + setting.A[1] * z[2]).mean()
    assert theory.mean_absolute_uniform() == pytest.approx(drawn, rel=0.005)  # standard error 0.1 %


def test_a_periodic_disturbance_settles_where_theory_says():
    u, y = setting.experiment(2500)
    z = 1e-6 * np.tile(rng(4).standard_normal(setting.PERIOD), 2500)
    task = disturbance.DisturbedRun("constant")
    kept, _ = task.estimator().run(u, y + z)
    last = slice(-setting.PERIOD, None)
    eta = lfilter([1.0, *setting.A], [1.0], z)[last]
    ratio = np.linalg.norm(kept[last] - setting.theta_star(), axis=1).mean() / np.abs(eta).mean()
    # z / y is 1e-7, and so is what the theory neglects.
    assert theory.periodic_ratio(z[last]) == pytest.approx(ratio, rel=1e-5)


# Convergence and excitation ---------------------------------------------------------------------------


def test_counting():
    assert convergence.first_below(np.array([3.0, 1.0, 2.0]), 1.0) == 2.0
    assert np.isnan(convergence.first_below(np.array([3.0]), 1.0))
    assert convergence.time_constant(np.exp(-0.1)) == pytest.approx(10.0)
    assert convergence.time_constant(1.0) == np.inf


def test_figure_3_ends_near_the_truth():
    data = convergence.figure_3(300)
    assert data["relative_error"]["gradient"][-1] < 0.01
    assert data["segments"]["K1"][-1] == pytest.approx(1.0, abs=0.01)
    assert len(data["samples"]) == 300


def test_the_lost_pole_solves_its_equation():
    pole = excitation.lost_pole()
    heights = setting.SEGMENTS(np.array(setting.LEVELS))
    assert 0.0 < pole < 1.0
    assert heights @ pole ** (-2.0 * np.arange(4)) == pytest.approx(0.0, abs=1e-9)
    for segments in (excitation.counter_example(),):
        assert float(segments(setting.LEVELS[0])) == 0.0
        values = segments(np.array(setting.LEVELS))
        x = excitation.COUNTER_POLE**-2
        assert values[1] + values[2] * x + values[3] * x**2 == pytest.approx(0.0, abs=1e-12)
