"""The bounded-error procedure, step by step, and the choice of its bound."""

import sys

import numpy as np
import pytest
from piecewise_affine_cases import EXAMPLES, THETA_2, two_modes
from scipy.optimize import linprog

from sysid.errors import IdentifiabilityError, UsageError
from sysid.nonlinearities.piecewise_affine import (
    ModesAgainstDelta,
    PartitionSearch,
    bounded_error,
    knee,
    label_error,
    modes_against_delta,
    plot_modes_against_delta,
)
from sysid.nonlinearities.piecewise_affine.points import Points, regions_of
from sysid.nonlinearities.piecewise_affine.refinement import INFEASIBLE, UNDECIDED, classify
from sysid.nonlinearities.piecewise_affine.separation import by_linear_programming
from sysid.nonlinearities.piecewise_affine.subsystems import partition


def seeded(seed=0):
    return np.random.default_rng(seed)


def four_modes(rng, n=800, noise=0.02):
    """A submodel in each quadrant."""
    z = rng.uniform(-1, 1, (n, 2))
    modes = (z[:, 0] > 0) + 2 * (z[:, 1] > 0)
    theta = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, -1.0], [-1.0, 1.0, 2.0], [2.0, 1.0, -3.0]])
    w = np.einsum("kj,kj->k", np.column_stack([z, np.ones(n)]), theta[modes])
    return z, w + rng.uniform(-noise, noise, n), modes


# Its steps --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_relaxation_finds_the_largest_subsystem(seed):
    """Against the best of all submodels through three points, to which the largest set is close."""
    rng = seeded(seed)
    z, w, modes = EXAMPLES["5.2"](rng, 60, noise=0.1)
    points = Points.of(z, w, who="test")
    bound = 0.1 / points.unit
    phi = np.column_stack([points.z, np.ones(60)])
    triples = np.array([rng.choice(60, 3, replace=False) for _ in range(20_000)])
    theta = np.linalg.solve(phi[triples], points.w[triples])
    inside = (np.abs(points.w - phi @ theta)[:, :, 0] <= bound).sum(axis=1)
    first = partition(points, bound, seeded(), starts=6, cycles=15, smallest=4)[0]
    ours = (np.abs(points.w - phi @ first)[:, 0] <= bound).sum()
    assert ours >= inside.max() - 1
    assert ours >= np.bincount(modes).max() - 1


def test_points_are_sorted_as_their_definition_says():
    z = np.array([0.0, 0.1, 0.9, 1.0, 0.05, 0.95, 0.5, -1.0])
    w = np.array([0.0, 0.0, 1.0, 1.0, 0.5, 0.5, 3.0, -0.0])
    points = Points.of(z, w, who="test")
    flat = np.array([[[0.0], [level]] for level in (0.0, 1.0)])
    theta = np.array(flat)
    theta[:, 1] = (flat[:, 1] - points.level) / points.unit
    near = np.argsort(np.abs(points.z - points.z.T), axis=1)
    labels = classify(points, theta, 0.6 / points.unit, near, 2)
    assert labels.tolist() == [0, 0, 1, 1, 0, 1, INFEASIBLE, 0]
    # With as many neighbours on either side, an undecided point stays so.
    assert classify(points, theta, 0.6 / points.unit, near, 5)[5] in (0, 1, UNDECIDED)


@pytest.mark.parametrize("classes", [2, 3])
def test_the_dual_programme_solves_the_primal(classes):
    """The same objective as the programme written out with its slacks, on overlapping classes."""
    rng = seeded(classes)
    n, p = 60, 3
    labels = np.arange(n) % classes
    z = rng.standard_normal((n, 2)) + np.array([[0, 0], [1, 0], [0, 1.0]])[labels]
    phi = np.column_stack([z, np.ones(n)])
    pairs = [(k, j) for k in range(n) for j in range(classes) if j != labels[k]]
    matrix = np.zeros((len(pairs), classes * p + len(pairs)))
    for row, (k, j) in enumerate(pairs):
        matrix[row, labels[k] * p : labels[k] * p + p] = -phi[k]
        matrix[row, j * p : j * p + p] = phi[k]
        matrix[row, classes * p + row] = -1.0
    weights = np.array([1.0 / np.sum(labels == labels[k]) for k, _ in pairs])
    primal = linprog(
        np.concatenate([np.zeros(classes * p), weights]),
        A_ub=matrix,
        b_ub=-np.ones(len(pairs)),
        bounds=[(None, None)] * (classes * p) + [(0, None)] * len(pairs),
    )
    rows = by_linear_programming(z, labels, classes)
    values = phi @ rows.T
    ours = sum(
        weight * max(0.0, 1.0 - values[k, labels[k]] + values[k, j])
        for weight, (k, j) in zip(weights, pairs, strict=True)
    )
    assert ours == pytest.approx(primal.fun, rel=1e-6)  # HiGHS' feasibility tolerance is 1e-7


def test_classes_that_can_be_parted_are_parted():
    rng = seeded(3)
    z = rng.standard_normal((300, 3))
    truth = rng.standard_normal((4, 4))
    labels = regions_of(z, truth)
    labels = np.unique(labels, return_inverse=True)[1]
    rows = by_linear_programming(z, labels, labels.max() + 1)
    np.testing.assert_array_equal(regions_of(z, rows), labels)


# The whole ----------------------------------------------------------------------------------------------


def test_the_number_of_modes_is_found():
    z, w, modes = four_modes(seeded())
    fit = bounded_error(z, w, 0.025, rng=seeded(1))
    assert fit.modes == 4
    assert label_error(fit.labels, modes) < 0.02
    assert fit.outlier_share < 0.01
    assert "4 modes" in fit.status


def test_one_mode_is_enough_where_one_is():
    z = seeded().standard_normal((100, 2))
    fit = bounded_error(z, z @ [1.0, 2.0] + 3.0, 0.1, rng=seeded())
    assert fit.modes == 1
    np.testing.assert_allclose(fit.map.theta, [[1.0, 2.0, 3.0]], atol=1e-12)


def test_outliers_are_left_out_and_reported():
    z, w, truth = EXAMPLES["5.2"](seeded(2), 600, noise=0.1)
    struck = seeded(3).choice(600, 30, replace=False)
    w[struck] += seeded(4).uniform(1.0, 8.0, 30) * seeded(5).choice([-1.0, 1.0], 30)
    fit = bounded_error(z, w, 0.12, rng=seeded())
    assert fit.modes == 2
    assert fit.outliers[struck].all()
    assert fit.outlier_share == pytest.approx(0.05, abs=0.01)
    assert label_error(fit.labels, truth) < 0.02
    # The submodels are those of the other points: noise of 0.06 RMS over some 250 points each.
    np.testing.assert_allclose(fit.map.theta, THETA_2, atol=0.05)


def test_a_mode_on_both_sides_of_another_gets_two_regions():
    z = seeded().uniform(-3, 3, 300)
    w = np.where(np.abs(z) < 1, 1.0, 0.0) + seeded(1).uniform(-0.05, 0.05, 300)
    fit = bounded_error(z, w, 0.06, rng=seeded())
    assert fit.modes == 2
    assert fit.map.merged
    assert "3 regions share the modes" in fit.status
    np.testing.assert_allclose(fit.map.tau, [-1.0, 1.0], atol=0.05)  # the largest gap of 300 points


def test_a_mode_around_another_gets_several_regions():
    z = seeded(1).uniform(-3, 3, (600, 2))
    w = np.where((z**2).sum(axis=1) < 3, 1.0, 0.0)
    fit = bounded_error(z, w, 0.1, rng=seeded())
    assert fit.modes == 2
    assert fit.map.regions > 2
    assert fit.outlier_share < 0.1


def test_the_bound_holds_for_every_output():
    z, w, _ = EXAMPLES["5.2"](seeded(4), 400, noise=0.1)
    other = two_modes(z, [[1.0, 0.0, 1.0], [0.0, 1.0, -1.0]], [1.5, -0.5, 1.0])[0]
    both = np.column_stack([w, other + seeded(5).uniform(-0.1, 0.1, 400)])
    fit = bounded_error(z, both, 0.12, rng=seeded())
    off = np.abs(both - fit.values).max(axis=1)
    np.testing.assert_array_equal(fit.outliers, off > 0.12)


def test_polishing_helps_where_noise_hides_the_border():
    errors = []
    for seed in range(20):
        z, w, truth = EXAMPLES["5.2"](seeded(seed), 300, noise=0.6)
        fits = [bounded_error(z, w, 0.7, rng=seeded(seed), polish=polish) for polish in (False, True)]
        errors.append([label_error(fit.labels, truth) for fit in fits])
    plain, polished = np.mean(errors, axis=0)
    assert polished < 0.5 * plain


def test_bad_settings_are_said_in_one_sentence():
    z, w, _ = EXAMPLES["5.1"](seeded(), 40)
    for delta in (0.0, -1.0, np.nan):
        with pytest.raises(UsageError, match="delta is"):
            bounded_error(z, w, delta, rng=seeded())
    with pytest.raises(UsageError, match="starts is 0"):
        bounded_error(z, w, 1.0, rng=seeded(), search=PartitionSearch(starts=0))
    with pytest.raises(UsageError, match="separation is 'magic'"):
        bounded_error(z, w, 0.3, rng=seeded(), separation="magic")
    with pytest.raises(IdentifiabilityError, match=r"no 3 points agree .* larger delta"):
        bounded_error(seeded().standard_normal(12), seeded(1).standard_normal(12), 1e-9, rng=seeded())


def test_support_vectors_are_an_alternative(monkeypatch):
    z, w, _ = EXAMPLES["5.2"](seeded(), 300)
    monkeypatch.setitem(sys.modules, "sklearn.svm", None)
    with pytest.raises(UsageError, match="needs scikit-learn"):
        bounded_error(z, w, 0.3, rng=seeded(), separation="svm")
    monkeypatch.undo()
    for example, classes in ((EXAMPLES["5.2"](seeded(), 300), 2), (four_modes(seeded()), 4)):
        z, w, truth = example
        fit = bounded_error(z, w, 0.3 if classes == 2 else 0.025, rng=seeded(), separation="svm")
        assert fit.modes == classes
        assert label_error(fit.labels, truth) < 0.02


# The choice of the bound ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("example", "noise"), [("5.2", 0.25), ("5.3", 0.2)])
def test_the_knee_is_just_above_the_noise(example, noise):
    z, w, _ = EXAMPLES[example](seeded(6), 500)
    curve = modes_against_delta(z, w, np.geomspace(0.05, 1.5, 12), rng=seeded())
    assert noise * 0.8 < curve.knee < noise * 2.0  # a grid of steps of 1.36
    assert curve.modes[curve.deltas == curve.knee] == [2]
    assert np.all(curve.unexplained < 0.3)
    assert "knee" in repr(curve)


def test_the_knee_of_a_curve():
    assert knee([1, 2, 4, 8], [8, 2, 2, 2]) == 2
    assert knee([8, 4, 2, 1], [2, 2, 2, 8]) == 2
    assert knee([1, 2, 4], [1, 1, 1]) == 1
    assert knee([1, 2, 4, 8], [8, 2, 3, 1]) == 2
    for deltas, modes, message in (([1], [1], "two bounds"), ([1, 1], [2, 1], "different bounds")):
        with pytest.raises(UsageError, match=message):
            knee(deltas, modes)


def test_the_curve_is_drawn_with_its_knee():
    curve = ModesAgainstDelta(np.array([0.1, 0.2, 0.4, 0.8]), np.array([9, 2, 2, 1]), np.zeros(4))
    axes = plot_modes_against_delta(curve)
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), curve.modes)
    assert axes.lines[1].get_xdata() == [curve.knee]
    assert axes.texts[0].get_text() == "knee: 2 modes at 0.2"


def test_more_runs_never_need_more_modes():
    z, w, _ = EXAMPLES["5.1"](seeded(), 100)
    once = modes_against_delta(z, w, [0.1], rng=seeded())
    assert modes_against_delta(z, w, [0.1], rng=seeded(), runs=5).modes[0] <= once.modes[0]
    with pytest.raises(UsageError, match="runs is 0"):
        modes_against_delta(z, w, [0.1], rng=seeded(), runs=0)
    with pytest.raises(UsageError, match="deltas are"):
        modes_against_delta(z, w, [0.0, 1.0], rng=seeded())


def test_convex_gives_each_mode_one_region():
    z = np.linspace(-1.0, 1.0, 300)
    w = np.where(np.abs(z) > 0.4, 1.0 + z, -1.0)  # the first mode lies on both sides of the second
    cut = bounded_error(z, w, 0.05, rng=seeded())
    whole = bounded_error(z, w, 0.05, rng=seeded(), convex=True)
    assert (cut.modes, cut.map.separators.shape[0], whole.map.separators.shape[0]) == (2, 3, 2)
    assert "another mode's region" in whole.status
