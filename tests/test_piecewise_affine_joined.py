"""Kinks: submodels joined at their borders, where the points do not speak for a jump."""

import numpy as np
import pytest
from piecewise_affine_cases import EXAMPLES

from sysid.nonlinearities.piecewise_affine import (
    BoundedError,
    GlobalSearch,
    Joined,
    KPlane,
    global_search,
    joined,
    label_error,
)


def seeded(seed=0):
    return np.random.default_rng(seed)


def kink_in_the_plane(rng, n=400, noise=0.2):
    z = rng.standard_normal((n, 2))
    clean = z @ [0.3, -0.2] + 1.5 * np.maximum(z @ [1.0, 0.5] - 0.3, 0.0)
    return z, clean + noise * rng.standard_normal(n), clean


@pytest.mark.parametrize("stage", [BoundedError(0.3), GlobalSearch(2)])
def test_a_kink_is_found_where_a_free_border_strays(stage):
    free, met, good = [], [], 0
    for seed in range(60):
        z, w, truth = EXAMPLES["5.1"](seeded(seed))
        fit = stage(z, w, seeded(seed))
        better = joined(fit, z, w)
        free.append(abs(fit.map.tau[0]) if fit.modes == 2 else np.nan)
        met.append(abs(better.map.tau[0]) if better.modes == 2 else np.nan)
        good += better.modes == 2 and label_error(better.labels, truth) < 0.05
    assert good >= 58
    assert np.nanmean(met) < 0.6 * np.nanmean(free)


def test_the_map_is_continuous_then():
    z, w, _ = EXAMPLES["5.1"](seeded(1))
    found = joined(global_search(z, w, 2), z, w).map
    np.testing.assert_allclose(np.diff(found.theta @ [found.tau[0], 1.0]), 0.0, atol=1e-12)
    z, w, _ = kink_in_the_plane(seeded(2))
    found = joined(global_search(z, w, 2), z, w).map
    step = found.theta[1] - found.theta[0]
    np.testing.assert_allclose(np.abs(step / np.linalg.norm(step[:-1])), np.abs(found.hyperplane), atol=1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_the_kink_is_that_of_a_fine_grid(seed):
    z, w, _ = EXAMPLES["5.1"](seeded(seed))
    found = joined(global_search(z, w, 2), z, w)
    costs = []
    for tau in np.linspace(-0.5, 0.5, 2001):
        basis = np.column_stack([z, np.ones(z.size), np.maximum(z - tau, 0.0)])
        costs.append(((w - basis @ np.linalg.lstsq(basis, w, rcond=None)[0]) ** 2).sum())
    assert 0.999 * min(costs) < found.cost <= min(costs) * (1.0 + 1e-9)  # between the grid's points


def test_a_kink_in_the_plane_comes_nearer_to_the_truth():
    errors = []
    for seed in range(20):
        z, w, clean = kink_in_the_plane(seeded(seed))
        fit = global_search(z, w, 2)
        errors.append([np.sqrt(np.mean((one.values - clean) ** 2)) for one in (fit, joined(fit, z, w))])
    free, met = np.mean(errors, axis=0)
    assert met < 0.85 * free


@pytest.mark.parametrize("example", ["5.2", "5.3"])
@pytest.mark.parametrize("noise", [0.2, 1.0])  # four times that of the paper's examples
def test_a_jump_stays_a_jump(example, noise):
    for seed in range(5):
        z, w, _ = EXAMPLES[example](seeded(seed), 400, noise)
        fit = global_search(z, w, 2)
        assert joined(fit, z, w) is fit


def test_each_border_decides_for_itself():
    z = seeded().uniform(-3, 3, 300)
    clean = np.where(z < -1, -z, np.where(z < 1, 1.0 + 0.5 * (z + 1), z - 4.0))
    w = clean + 0.1 * seeded(1).standard_normal(300)
    found = joined(global_search(z, w, 3), z, w)
    gaps = [np.diff(found.map.theta[i : i + 2] @ [tau, 1.0])[0] for i, tau in enumerate(found.map.tau)]
    assert abs(gaps[0]) < 1e-12
    assert abs(gaps[1] + 5.0) < 0.2
    assert "joined" in found.status
    np.testing.assert_allclose(found.map.theta[:, 0], [-1.0, 0.5, 1.0], atol=0.1)
    np.testing.assert_array_equal(found.map.mode(z), found.labels)


def test_without_noise_nothing_is_lost():
    z, w, truth = EXAMPLES["5.1"](seeded(), 200, noise=0.0)
    found = joined(global_search(z, w, 2), z, w)
    np.testing.assert_allclose(found.map.tau, 0.0, atol=1e-12)
    assert label_error(found.labels, truth) == 0.0


def test_what_has_no_rule_is_returned_with_a_word():
    z, w, _ = kink_in_the_plane(seeded(), 100)
    both = np.column_stack([w, -w])
    fit = Joined(KPlane(2))(z, both, seeded())
    assert "no rule for several outputs" in fit.status
    assert "no rule for 3 modes" in Joined(KPlane(3))(z, w, seeded()).status
