"""Piecewise affine maps: values, regions, breakpoints, files, and what is refused."""

import numpy as np
import pytest

from sysid.errors import ModelError, UsageError
from sysid.nonlinearities.piecewise_affine import PiecewiseAffineMap

rng = np.random.default_rng(5)
THREE = PiecewiseAffineMap(rng.standard_normal((3, 3)), rng.standard_normal((3, 3)))
VECTOR = PiecewiseAffineMap(rng.standard_normal((3, 3, 2)), rng.standard_normal((3, 3)))
Z = rng.standard_normal((200, 2))


def plainly(one, z):
    phi = np.column_stack([z, np.ones(len(z))])
    modes = one.owners[np.argmax(phi @ one.separators.T, axis=1)]
    return np.einsum("kj,kj...->k...", phi, one.theta[modes]), modes


@pytest.mark.parametrize("one", [THREE, VECTOR])
def test_values_and_modes_follow_the_definition(one):
    values, modes = plainly(one, Z)
    np.testing.assert_allclose(one(Z), values, atol=1e-13)  # sums of three terms, in another order
    np.testing.assert_array_equal(one.mode(Z), modes)


def test_the_inequalities_describe_the_regions():
    phi = np.column_stack([Z, np.ones(len(Z))])
    for region in range(3):
        H, strict = THREE.inequalities(region)
        inside = np.where(strict, phi @ H.T < 0, phi @ H.T <= 0).all(axis=1)
        np.testing.assert_array_equal(inside, THREE.region(Z) == region)


def test_points_on_a_border_belong_to_one_region():
    step = PiecewiseAffineMap([[0.0, 0.0], [0.0, 1.0]], [[0.0, 0.0], [1.0, 0.0]])
    assert step.mode([0.0]).tolist() == [0]  # h phi <= 0 is the first region, eq. (5.26b)
    assert [strict.tolist() for _, strict in map(step.inequalities, range(2))] == [[False], [True]]


def test_the_hyperplane_of_two_regions():
    two = PiecewiseAffineMap(np.eye(2, 3), [[0.0, 0.0, 0.0], [1.5, -0.5, 1.0]])
    np.testing.assert_allclose(two.hyperplane, np.array([1.5, -0.5, 1.0]) / np.hypot(1.5, 0.5))
    phi = np.column_stack([Z, np.ones(len(Z))])
    np.testing.assert_array_equal(two.mode(Z), (phi @ two.hyperplane > 0).astype(int))
    with pytest.raises(ModelError, match="this map has 3"):
        _ = THREE.hyperplane


@pytest.mark.parametrize("seed", range(20))
def test_breakpoints_are_where_the_mode_changes(seed):
    generator = np.random.default_rng(seed)
    owners = [0, 1, 2, 1, 0][: 3 + seed % 3]
    one = PiecewiseAffineMap(
        generator.standard_normal((3, 2)), generator.standard_normal((len(owners), 2)), owners
    )
    grid = np.linspace(-50, 50, 200_001)
    modes = one.mode(grid)
    changes = grid[:-1][np.diff(modes) != 0]
    tau = one.tau[np.abs(one.tau) < 50]
    assert tau.size == changes.size or np.diff(one.tau).min() < 1e-3
    if tau.size == changes.size:
        np.testing.assert_allclose(tau, changes, atol=1e-3)  # twice the step of the grid


def test_equal_slopes_and_hidden_regions_have_no_breakpoint():
    one = PiecewiseAffineMap(np.eye(3, 2), [[0.0, 0.0], [0.0, -1.0], [1.0, -2.0]])
    np.testing.assert_allclose(one.tau, [2.0])


def test_breakpoints_there_and_back():
    tau = [-1.5, 0.25, 0.5, 7.0]
    one = PiecewiseAffineMap.of_breakpoints(np.arange(10.0).reshape(5, 2), tau)
    np.testing.assert_allclose(one.tau, tau, rtol=1e-14)
    assert one.mode([-2, 0, 0.3, 1, 8]).tolist() == [0, 1, 2, 3, 4]


def test_regions_that_share_a_submodel():
    hat = PiecewiseAffineMap([[0.0, 0.0], [0.0, 1.0]], [[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]], [0, 1, 0])
    assert hat.merged
    assert not THREE.merged
    assert hat([-2.0, 0.0, 2.0]).tolist() == [0.0, 1.0, 0.0]
    np.testing.assert_allclose(hat.tau, [-1.0, 1.0])


@pytest.mark.parametrize("one", [THREE, VECTOR])
def test_json_loses_nothing(one):
    again = PiecewiseAffineMap.from_json(one.to_json())
    for name in ("theta", "separators", "owners"):
        np.testing.assert_array_equal(getattr(again, name), getattr(one, name))
    with pytest.raises(ModelError, match="no JSON text"):
        PiecewiseAffineMap.from_json("{}")


def test_the_representation_names_what_counts():
    assert "tau" in repr(PiecewiseAffineMap.of_breakpoints([[1, 2], [3, 4]], [0.5]))
    assert "h   " in repr(PiecewiseAffineMap(np.eye(2, 3), np.eye(2, 3)))
    assert "3 submodels of 2 inputs" in repr(VECTOR)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([1.0, 2.0], [[1.0, 2.0]]), "theta of shape"),
        (([[1.0, 2.0]], [[1.0, 2.0, 3.0]]), "separators have 3 columns and theta 2"),
        (([[1.0, np.nan]], [[1.0, 2.0]]), "theta is not finite"),
        (([[1.0, 2.0]], [[1.0, 2.0], [1.0, 3.0]]), "1 submodels, 2 regions"),
        (([[1.0, 2.0]], [[1.0, 2.0], [1.0, 3.0]], [0, 2]), "owners"),
    ],
)
def test_wrong_maps_are_refused(arguments, message):
    with pytest.raises(ModelError, match=message):
        PiecewiseAffineMap(*arguments)


def test_wrong_points_are_refused():
    with pytest.raises(UsageError, match=r"takes \(n_points, 2\)"):
        THREE(np.zeros(4))
    with pytest.raises(UsageError, match="not finite"):
        THREE([[0.0, np.inf]])
    with pytest.raises(ModelError, match="do not ascend"):
        PiecewiseAffineMap.of_breakpoints(np.eye(3, 2), [1.0, 0.0])
