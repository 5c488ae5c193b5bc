"""The preimage method: the criterion against the paper's matrices, the four solvers, bad input."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from replications.lacy.exactness import brute_force
from replications.lacy.notation import Notation
from sysid.errors import DataError, IdentifiabilityError, UsageError
from sysid.linear import simulate_polynomial
from sysid.nonlinearities import (
    DEAD_ZONE,
    EVEN_DEAD_ZONE,
    SATURATION,
    SIGN,
    MonotonePieces,
    PiecewiseAffine,
    Quantiser,
    sine,
)
from sysid.wiener import (
    Criterion,
    equation_error_matrix,
    identify_wiener,
    naive_fit,
    nonlinearity_from_steps,
)
from sysid.wiener.solvers import ZERO

TRUE = np.array([-1.03, 0.9048, 0.0, 0.445, 0.4299])
A, B = [1.0, *TRUE[:2]], TRUE[2:]
DEAD = PiecewiseAffine.of(DEAD_ZONE, 1.0)
SQUARE = MonotonePieces("square", np.square, [-np.inf, 0.0, np.inf])


def record(seed, samples, noise=0.0):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples)
    return u, simulate_polynomial(B, A, u) + noise * rng.standard_normal(samples)


def derivative(function, point, step=1e-2):
    """Central differences of eighth order: truncation and rounding below 1e-11 for these functions."""
    weights = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
    return np.array(
        [
            sum(
                w * (function(point + k * step * e) - function(point - k * step * e))
                for k, w in weights.items()
            )
            / step
            for e in np.eye(point.size)
        ]
    )


@pytest.mark.parametrize("normalisation", ["free", "dc-gain", "sum-b"])
@given(seed=st.integers(0, 10_000), order=st.integers(1, 3))
@settings(max_examples=15, deadline=None)
def test_gradient_and_hessian_are_those_of_finite_differences(normalisation, seed, order):
    rng = np.random.default_rng(seed)
    u, y = rng.standard_normal((2, 3 * order + 6))
    problem = Criterion(u, order, normalisation)
    # Where the regressors are nearly dependent J_y has large derivatives of high order, which bound the
    # accuracy of the differences, not that of the formulas.
    factor = np.abs(np.diag(problem.eliminate(y)[1]))
    if factor.min() < 0.3:
        return
    scale = 1.0 + np.abs(problem.hessian(y)).max()
    np.testing.assert_allclose(problem.gradient(y), derivative(problem.value, y), atol=1e-6 * scale)
    np.testing.assert_allclose(problem.hessian(y), derivative(problem.gradient, y), atol=1e-6 * scale)


def test_fast_forms_are_the_matrices_of_the_paper():
    rng = np.random.default_rng(7)
    u, y = rng.standard_normal((2, 14))
    paper, problem = Notation(u, y, 2), Criterion(u, 2)
    # Both are exact up to the rounding of an inverse of a small matrix.
    np.testing.assert_allclose(problem.value(y), y @ paper.Q.T @ paper.Pi @ paper.Q @ y, rtol=1e-12)
    np.testing.assert_allclose(problem.parameters(y), paper.Psi @ paper.Q @ y, rtol=1e-10)
    np.testing.assert_allclose(problem.gradient(y), paper.gradient(y), atol=1e-11)
    np.testing.assert_allclose(problem.hessian(y), paper.hessian(y), atol=1e-11)
    residual = problem.eliminate(y)[3]
    filtered = equation_error_matrix(problem.parameters(y)[:2], 14)
    np.testing.assert_allclose(problem.gradient(y), 2 * filtered.T @ residual, atol=1e-12)


@pytest.mark.parametrize("normalisation", ["dc-gain", "sum-b"])
def test_a_normalisation_is_constrained_least_squares(normalisation):
    u, y = record(3, 25, noise=0.1)
    theta = Criterion(u, 2, normalisation).parameters(y)
    phi, target = np.column_stack([-y[1:-1], -y[:-2], u[2:], u[1:-1], u[:-2]]), y[2:]
    row = (
        np.array([-1.0, -1.0, 1.0, 1.0, 1.0])
        if normalisation == "dc-gain"
        else np.array([0, 0, 1.0, 1.0, 1.0])
    )
    system = np.block([[phi.T @ phi, row[:, None]], [row[None], np.zeros((1, 1))]])
    expected = np.linalg.solve(system, np.append(phi.T @ target, 1.0))[:5]
    np.testing.assert_allclose(theta, expected, rtol=1e-9)  # the normal equations square the condition
    assert row @ theta == pytest.approx(1.0, abs=1e-12)


def test_one_point_is_least_squares():
    u, y = record(1, 30, noise=0.1)
    arctan = MonotonePieces("arctan", np.arctan, [-np.inf, np.inf])
    fit = identify_wiener(u, np.arctan(y), arctan, 2)
    assert fit.solver == "direct"
    assert fit.exact
    np.testing.assert_allclose(fit.theta, naive_fit(u, y, 2), rtol=1e-6)  # tan amplifies rounding


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize(("known", "width"), [(sine((-np.pi, np.pi)), np.pi), (SQUARE, np.inf)])
@pytest.mark.parametrize("normalisation", ["free", "dc-gain", "sum-b"])
def test_branch_and_bound_agrees_with_brute_force(known, width, normalisation, seed):
    u, y = record(seed, 9, noise=0.2 * (seed % 2))
    y = np.clip(y, -width + 1e-3, width - 1e-3)
    fit = identify_wiener(u, known(y), known, 2, normalisation=normalisation, keep=4)
    preimage = fit.preimage
    sets = [preimage.lower[preimage.first[k] : preimage.first[k + 1]] for k in range(9)]
    sequences = np.array(list(itertools.product(*sets)))
    if normalisation == "free":
        costs = brute_force(u, sequences, 2)
    else:
        costs = np.array([Criterion(u, 2, normalisation).value(sequence) for sequence in sequences])
    costs.sort()
    found = [one.cost for one in fit.candidates]
    # Sums of squares of numbers of order one: rounding, nothing else.
    np.testing.assert_allclose(found, costs[: len(found)], atol=1e-12 * float(y @ y))
    assert fit.exact
    assert len(found) == 4


def test_twenty_samples_of_a_sine_are_solved_and_a_node_limit_is_reported():
    u, y = record(0, 20)
    fit = identify_wiener(u, np.sin(y), sine(), 2)
    np.testing.assert_allclose(fit.theta, TRUE, atol=1e-9)
    np.testing.assert_allclose(fit.y, y, atol=1e-9)
    assert fit.preimage.log10_regions > 11
    z = np.sin(y + 0.3 * np.sin(np.arange(20)))
    effort = identify_wiener(u, z, sine(), 2).effort
    stopped = identify_wiener(u, z, sine(), 2, node_limit=effort - 1)
    assert not stopped.exact
    assert f"stopped at the limit of {effort - 1} nodes" in stopped.status
    with pytest.raises(IdentifiabilityError, match="limit of 50 nodes before it reached a complete sequence"):
        identify_wiener(u, np.sin(y), sine(), 2, node_limit=50)


@pytest.mark.parametrize("known", [DEAD, Quantiser(1.0), PiecewiseAffine.of(SATURATION, 1.0)])
def test_the_box_minimum_is_that_of_another_minimiser(known):
    u, y = record(5, 30, noise=0.15)
    fit = identify_wiener(u, known(y), known, 2, relative=False)
    problem, preimage = Criterion(u, 2), fit.preimage
    bounds = list(zip(preimage.lower, preimage.upper, strict=True))
    other = minimize(problem.value, fit.y, jac=problem.gradient, bounds=bounds, method="L-BFGS-B",
                     options={"maxiter": 2000, "ftol": 1e-15, "gtol": 1e-9})  # fmt: skip
    # From our minimum it finds nothing lower; from its own starts at best the same.
    assert fit.cost <= other.fun * (1 + 1e-5) + 1e-12
    gradient = problem.gradient(fit.y)
    free = (fit.y > preimage.lower) & (fit.y < preimage.upper)
    assert np.max(np.abs(gradient[free]), initial=0.0) < 1e-3 * np.sqrt(fit.cost) + 1e-9
    assert np.all(gradient[(fit.y == preimage.lower) & (fit.y < preimage.upper)] >= -1e-4)
    assert np.all(gradient[(fit.y == preimage.upper) & (fit.y > preimage.lower)] <= 1e-4)


def test_a_dead_zone_without_noise_gives_the_true_system():
    u, y = record(2, 30)
    fit = identify_wiener(u, DEAD(y), DEAD, 2)
    np.testing.assert_allclose(fit.theta, TRUE, atol=1e-7)
    np.testing.assert_allclose(fit.simulate(u), DEAD(y), atol=1e-6)
    assert fit.identifiability.sentence == "all parameters are identifiable"


@pytest.mark.parametrize("limit", [4096, 2])
def test_unions_of_points_and_an_interval(limit):
    known = PiecewiseAffine.of(EVEN_DEAD_ZONE, 0.4)
    u, y = record(4, 14)
    y *= 0.6
    fit = identify_wiener(u, known(y), known, 2, region_limit=limit)
    assert fit.solver == "mixed"
    assert fit.preimage.nearest(fit.y) == pytest.approx(fit.y)
    assert not fit.identifiability.gain_sign
    if limit > 2:  # every region was examined, the true one among them
        assert fit.criterion < 1e-12


def test_signs_tell_neither_gain_nor_more_than_bounds():
    u, y = record(6, 80)
    fit = identify_wiener(u, SIGN(y), SIGN, 2)
    assert fit.criterion <= ZERO
    assert fit.candidates[0].driven
    assert not fit.identifiability.gain
    assert fit.identifiability.exact_directions == 0
    assert "the gain is not identifiable" in repr(fit)
    normalised = identify_wiener(u, SIGN(y), SIGN, 2, normalisation="sum-b")
    assert np.sum(normalised.b) == pytest.approx(1.0)
    assert normalised.identifiability.gain


def test_the_relative_criterion_does_not_shrink_with_y():
    u, y = record(7, 40, noise=0.2)
    problem = Criterion(u, 2)
    assert problem.relative(1e-6 * y) == pytest.approx(problem.relative(y), rel=1e-9)
    assert problem.value(1e-6 * y) == pytest.approx(1e-12 * problem.value(y), rel=1e-6)
    assert problem.relative(0 * y) == np.inf


def test_data_outside_the_range_are_reported():
    u, y = record(0, 20)
    z = np.sin(y)
    z[3] = 1.2
    fit = identify_wiener(u, z, sine(), 2)
    assert fit.moved == 1
    assert "1 data moved into the range" in repr(fit)


def test_step_tests_show_the_nonlinearity():
    amplitudes = np.linspace(-6, 6, 49)
    gain = np.sum(B) / np.sum(A)
    settled = [DEAD(simulate_polynomial(B, A, np.full(400, one)))[-1] for one in amplitudes]
    known = nonlinearity_from_steps(amplitudes, settled)
    axis = np.linspace(-5.9, 5.9, 300)
    np.testing.assert_allclose(known(axis), DEAD(gain * axis), atol=2e-3)  # kinks lie beside the steps
    u, y = record(8, 60)
    fit = identify_wiener(u, DEAD(y), known, 2, normalisation="dc-gain")
    expected = np.concatenate([TRUE[:2], B / gain])
    np.testing.assert_allclose(fit.theta, expected, atol=2e-3)
    assert np.sum(fit.b) / np.sum(fit.a) == pytest.approx(1.0, abs=1e-9)


def test_noise_in_step_tests_leaves_a_flat_region_flat():
    rng = np.random.default_rng(0)
    amplitudes = np.linspace(-4, 4, 33)
    known = nonlinearity_from_steps(amplitudes, DEAD(amplitudes) + 1e-3 * rng.standard_normal(33), flat=2e-3)
    assert np.sum(known.slope == 0.0) == 8
    preimage = known.preimage([known(0.0)])
    assert (preimage.lower[0], preimage.upper[0]) == (-1.0, 1.0)


U, Y = record(9, 30)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: identify_wiener(U, Y[:-1], DEAD, 2), DataError, "30 samples and the output 29"),
        (lambda: identify_wiener(U[:6], Y[:6], DEAD, 2), IdentifiabilityError, "needs at least 7 samples"),
        (lambda: identify_wiener(np.ones(30), Y, DEAD, 2), IdentifiabilityError, "1 of the 3 lagged inputs"),
        (lambda: identify_wiener(0 * U, Y, DEAD, 2), IdentifiabilityError, "the input does not excite"),
        (lambda: identify_wiener(U, np.append(Y[:-1], np.nan), DEAD, 2), DataError, "sample 29 is nan"),
        (lambda: identify_wiener(np.append(U[:-1], np.inf), Y, DEAD, 2), UsageError, "sample 29 is inf"),
        (lambda: identify_wiener(U, 0 * Y, DEAD, 2), IdentifiabilityError, "y = 0 explains all 30 data"),
        (lambda: identify_wiener(U, Y, DEAD, 0), UsageError, "the order is 0"),
        (lambda: identify_wiener(U, Y, DEAD, 2, starts=0), UsageError, "starts is 0"),
        (lambda: identify_wiener(U, Y, DEAD, 2, normalisation="one"), UsageError, "no normalisation 'one'"),
        (lambda: Criterion(U[:, None], 2), UsageError, r"shape \(30, 1\)"),
        (lambda: Criterion(U, 2).parameters(0 * Y), IdentifiabilityError, "3 of 5 regressors"),
        (lambda: nonlinearity_from_steps([1.0], [1.0]), DataError, "two steps or more"),
        (
            lambda: nonlinearity_from_steps([1.0, 1.0], [1.0, 2.0]),
            DataError,
            "two steps have the amplitude 1",
        ),
        (lambda: nonlinearity_from_steps([1.0, 2.0], [1.0, np.nan]), DataError, "step 1 has amplitude"),
        (lambda: nonlinearity_from_steps([1.0, 2.0], [0.0, 0.0]), IdentifiabilityError, r"G\(1\) is zero"),
    ],
)
def test_bad_input_is_one_clear_error(call, error, message):
    with pytest.raises(error, match=message):
        call()
