"""Spline maps against SciPy's B-splines, the thesis's basis and finite differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.errors import IdentifiabilityError, ModelError, UsageError
from sysid.nonlinearities.spline import (
    Spline,
    absolute_power_basis,
    equal_knots,
    quantile_knots,
    spline_basis,
    supported_knots,
)
from sysid.separable import project

KNOTS = np.array([-1.0, -0.3, 0.1, 0.2, 0.9, 1.5])


def random_spline(degree, extrapolation="linear", seed=0):
    coefficients = np.random.default_rng(seed).standard_normal(KNOTS.size - 1 + degree)
    return Spline(KNOTS, coefficients, degree, extrapolation)


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_values_and_slopes_are_those_of_scipy(degree):
    from scipy.interpolate import BSpline

    spline = random_spline(degree)
    full = np.concatenate([np.full(degree, KNOTS[0]), KNOTS, np.full(degree, KNOTS[-1])])
    peer = BSpline(full, spline.coefficients, degree)
    z = np.linspace(KNOTS[0], KNOTS[-1], 301)
    # Another algorithm (de Boor's control points) for the same numbers: rounding only.
    np.testing.assert_allclose(spline(z), peer(z), atol=1e-13)
    np.testing.assert_allclose(spline.basis(z) @ spline.coefficients, spline(z), atol=1e-13)
    inner = np.setdiff1d(z, KNOTS)  # at degree 1 the slope jumps at the knots
    np.testing.assert_allclose(spline.slope(inner), peer.derivative()(inner), atol=1e-11)


def test_both_bases_span_the_same_space_and_the_better_one_is_better_conditioned():
    rng = np.random.default_rng(1)
    z = np.sort(rng.uniform(-2.5, 2.5, 1000))
    w = np.arctan(3.0 * z) + 0.1 * rng.standard_normal(z.size)
    knots = equal_knots(z, 14)  # the 15 knots of the thesis's Example 4.3
    powers, splines = absolute_power_basis(z, knots), spline_basis(z, knots)
    assert powers.shape == splines.shape
    # Equal fits: the tolerance is rounding times the condition of the worse basis, about 1e6.
    apart = project(powers, w).residual - project(splines, w).residual
    assert np.abs(apart).max() < 1e-9
    # Each function of one basis is a combination of the other's.
    for function in powers.T:
        assert np.linalg.norm(project(splines, function).residual) < 1e-9 * np.linalg.norm(function)
    assert np.linalg.cond(splines) < 20.0 < 1e4 < np.linalg.cond(powers)


@pytest.mark.parametrize("extrapolation", ["linear", "constant"])
@pytest.mark.parametrize("degree", [1, 2, 3, 5])
def test_derivatives_by_the_knots_are_those_of_finite_differences(degree, extrapolation):
    spline = random_spline(degree, extrapolation)
    z = np.array([-1.7, -0.95, -0.31, 0.05, 0.15, 0.5, 0.89, 1.49, 2.2])
    step = 1e-6
    for number in range(KNOTS.size):
        ends = []
        for sign in (1.0, -1.0):
            moved = KNOTS.copy()
            moved[number] += sign * step
            ends.append(Spline(moved, spline.coefficients, degree, extrapolation)(z))
        numeric = (ends[0] - ends[1]) / (2.0 * step)
        # Central differences: error about step^2 times the third derivative, plus rounding / step.
        np.testing.assert_allclose(spline.by_knots(z)[:, number], numeric, atol=2e-8 * 10.0**degree)


def test_knots_that_move_with_the_range_leave_the_shape():
    """f((z - low) / (high - low)): the derivatives by the knots add up to those by the range."""
    spline = random_spline(3)
    z = np.linspace(-1.6, 2.1, 60)
    share = (KNOTS - KNOTS[0]) / (KNOTS[-1] - KNOTS[0])
    place = (z - KNOTS[0]) / (KNOTS[-1] - KNOTS[0])
    np.testing.assert_allclose(spline.by_knots(z) @ (1 - share), -spline.slope(z) * (1 - place), atol=1e-12)
    np.testing.assert_allclose(spline.by_knots(z) @ share, -spline.slope(z) * place, atol=1e-12)


@given(st.floats(-50.0, 50.0), st.integers(1, 5), st.sampled_from(["linear", "constant"]))
def test_a_basis_sums_to_one_everywhere(z, degree, extrapolation):
    total = spline_basis([z], KNOTS, degree=degree, extrapolation=extrapolation).sum()
    assert abs(total - 1.0) < 1e-10 * (1.0 + abs(z))


@given(st.floats(0.001, 100.0), st.sampled_from([-1.0, 1.0]))
def test_outside_the_knots_a_spline_is_a_line_or_constant(distance, side):
    end = KNOTS[0] if side < 0 else KNOTS[-1]
    z = end + side * distance
    line, level = random_spline(3), random_spline(3, "constant")
    assert np.isclose(line([z])[0], line([end])[0] + side * distance * line.slope([end])[0], rtol=1e-9)
    assert level([z])[0] == level([end])[0]
    assert level.slope([z])[0] == 0.0


def test_knots_from_data():
    z = np.random.default_rng(2).standard_normal(400)
    assert equal_knots(z, 7).size == quantile_knots(z, 7).size == 8
    counts = np.histogram(z, quantile_knots(z, 8))[0]
    assert counts.min() == counts.max() == 50
    counts = np.histogram(z, supported_knots(z, 16, 20))[0]
    assert counts.min() >= 20
    assert quantile_knots([0.0] * 31 + [1.0] * 10, 4).tolist() == [0.0, 1.0]


def test_bad_forms_are_told_in_one_sentence():
    with pytest.raises(ModelError, match="do not ascend"):
        Spline(np.array([1.0, 0.0]), np.zeros(4))
    with pytest.raises(ModelError, match="take 4"):
        Spline(np.array([0.0, 1.0]), np.zeros(3))
    with pytest.raises(ModelError, match="degree is 9"):
        spline_basis([0.0], [0.0, 1.0], degree=9)
    with pytest.raises(UsageError, match="choose linear or constant"):
        spline_basis([0.0], [0.0, 1.0], extrapolation="cubic")
    with pytest.raises(UsageError, match="take an odd one"):
        absolute_power_basis([0.0], [0.0, 1.0], degree=2)
    with pytest.raises(IdentifiabilityError, match="take fewer knots"):
        Spline.fitted(np.linspace(0.0, 0.1, 50), np.zeros(50), np.linspace(0.0, 1.0, 9))
    with pytest.raises(IdentifiabilityError, match="one value"):
        equal_knots(np.ones(5), 3)
