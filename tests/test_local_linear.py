"""Composite local linear models: algebra against printed formulas, derivatives against finite differences."""

import numpy as np
import pytest
from local_linear_cases import SHAPES, phi_of, random_case, random_model

from sysid.local_linear import (
    Experiment,
    LocalLinearModel,
    Problem,
    blocked_cost,
    blocked_kaufman,
    gradients,
    printed,
)
from sysid.local_linear.passes import fly, pull_back, sensitivities
from sysid.local_linear.projected import complement, identity_descent, identity_step, tangent
from sysid.local_linear.recursion import plain
from sysid.local_linear.structure import course
from sysid.separable import descend

FD_STEP, FD_TOLERANCE = 1e-6, 1e-7
"""Central differences err by h^2 and by eps / h: some 1e-10, times the condition of Phi (below 1e3)."""


def problem_of(shape, seed=0, **options):
    sizes, eta, experiment = random_case(shape, seed)
    y = np.random.default_rng(seed + 9).standard_normal((experiment.n_samples, sizes.n_outputs))
    used = np.ones(experiment.n_samples, dtype=bool)
    return Problem(sizes, [experiment], [y], [used], **options), eta


def finite_differences(function, x, step=FD_STEP):
    rows = [(function(x + step * e) - function(x - step * e)) / (2 * step) for e in np.eye(x.size)]
    return np.column_stack(rows)


# Regressors and simulation ----------------------------------------------------------------------------


@pytest.mark.parametrize("shape", SHAPES)
def test_recursion_agrees_with_the_printed_kronecker_formula(shape):
    sizes, eta, experiment = random_case(shape)
    found = phi_of(sizes, eta, experiment)
    oracle = printed.kronecker_regressors(course(sizes, eta, experiment))
    # The print goes through vec(G) column by column, the code row by row.
    oracle = oracle.reshape(-1, sizes.channels, sizes.n_states).transpose(0, 2, 1).reshape(found.shape)
    assert np.abs(found - oracle).max() <= 1e-12 * np.abs(oracle).max()
    by_numpy = phi_of(sizes, eta, experiment, respond=plain)
    assert np.abs(found - by_numpy).max() <= 1e-12 * np.abs(oracle).max()


@pytest.mark.parametrize("columns", [1, 3, 4, 7, 12, 29])
def test_every_width_of_a_block_is_right(columns):
    from sysid.local_linear.recursion import recursion

    rng = np.random.default_rng(columns)
    A, C = 0.4 * rng.standard_normal((9, 3, 3)), rng.standard_normal((2, 3))
    for row, channels in ((1, 1), (-1, 3)):
        drives = rng.standard_normal((9, channels, columns))
        found, expected = np.zeros((2, 9, 2, columns + 2))
        x = rng.standard_normal((3, columns))
        end = x.copy()
        recursion(3, 2)(A, C, drives, row, found, 1, x)
        plain(A, C, drives, row, expected, 1, end)
        assert np.allclose(found, expected, atol=1e-13)
        assert np.allclose(x, end, atol=1e-13)


def test_simulation_is_phi_theta_and_an_explicit_loop():
    model, u, phi = random_model((3, 4, 2, 2, 2, 60))
    y = model.simulate(u, phi)
    theta = model.G.ravel()
    assert np.allclose(phi_of(model.sizes, model.eta, Experiment.of(u, phi)) @ theta, y.ravel(), atol=1e-12)
    x, weights = np.zeros(3), model.weights(phi)
    for k in range(60):
        assert np.allclose(y[k], model.C @ x, atol=1e-12)
        x = sum(weights[k, i] * (model.A[i] @ x + model.B[i] @ u[k] + model.O[i]) for i in range(4))


@pytest.mark.parametrize(
    "shape", [(1, 1, 1, 1, 1, 9), (2, 5, 1, 3, 2, 9), (4, 7, 2, 1, 1, 9), (9, 6, 1, 2, 3, 9)]
)
def test_passes_of_every_size_are_their_loops(shape):
    """Odd sizes leave parts of vectors over; only rounding (1e-12) may differ from NumPy step by step."""
    model, u, phi = random_model(shape)
    one = course(model.sizes, model.eta, Experiment.of(u, phi))
    start = np.random.default_rng(4).standard_normal(shape[0])
    flight = fly(one, model.G, start)
    x = start
    for k, weights in enumerate(model.weights(phi)):
        local = model.A @ x + model.B @ u[k] + model.O
        mixed = weights @ local
        moves = weights * one.slopes[k].transpose(0, 2, 1) * (local - mixed).T[:, None, None]
        assert np.allclose(flight.drives[k, 0], np.kron(weights, x), rtol=0, atol=1e-12)
        assert np.allclose(
            flight.moves[k],
            moves.transpose(0, 1, 3, 2).reshape(shape[0], -1),
            rtol=0,
            atol=1e-12 * abs(moves).max(),
        )
        x = mixed
        assert np.allclose(flight.x[k + 1], x, rtol=0, atol=1e-12 * np.abs(x).max())
    r = np.random.default_rng(5).standard_normal((u.shape[0], shape[3]))
    pulled = pull_back(one, flight, r).by_eta
    pushed = np.einsum("kop,ko->p", sensitivities(one, flight, respond=plain), r)
    assert np.allclose(pulled, pushed, rtol=0, atol=1e-12 * np.abs(pushed).max())


def test_weights_are_the_printed_ones_and_hold_far_away():
    model, _, phi = random_model((2, 3, 1, 1, 2, 50))
    r = np.exp(-np.square((phi[:, None] - model.centres) * model.widths).sum(axis=2))
    assert np.allclose(model.weights(phi), r / r.sum(axis=1, keepdims=True), rtol=1e-12)
    far = model.weights(np.full((1, 2), 1e4))
    assert np.isfinite(far).all()
    assert np.isclose(far.sum(), 1.0)


def test_blocks_of_rows_go_on_where_the_last_one_stopped():
    sizes, eta, experiment = random_case((3, 4, 2, 2, 2, 60))
    y = np.random.default_rng(2).standard_normal((60, 2))
    whole = gradients.eliminate(phi_of(sizes, eta, experiment), y.ravel())
    for block in (7, 60, 100):
        found = blocked_cost(sizes, eta, experiment, y, block)
        assert np.isclose(found.cost, whole.cost, rtol=1e-12)
        assert np.allclose(found.theta, whole.theta, rtol=1e-9, atol=1e-9)
        jac = gradients.kaufman(course(sizes, eta, experiment), whole)
        linear = blocked_kaufman(sizes, eta, experiment, y, block)
        assert np.allclose(linear.jacobian.T @ linear.jacobian, jac.T @ jac, rtol=1e-8, atol=1e-8)
        assert np.allclose(linear.jacobian.T @ linear.residual, jac.T @ whole.tail, rtol=1e-8, atol=1e-8)


# Derivatives ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", SHAPES)
def test_sensitivities_are_derivatives_of_the_output(shape):
    model, u, phi = random_model(shape)
    one = course(model.sizes, model.eta, Experiment.of(u, phi))
    found = sensitivities(one, fly(one, model.G)).reshape(-1, model.sizes.n_eta)

    def outputs(eta):
        return LocalLinearModel.of(model.sizes, eta, model.G).simulate(u, phi).ravel()

    expected = finite_differences(outputs, model.eta)
    assert np.linalg.norm(found - expected) <= FD_TOLERANCE * np.linalg.norm(expected)


@pytest.mark.parametrize("shape", SHAPES)
def test_which_derivative_is_the_jacobian_of_the_projected_residual(shape):
    problem, eta = problem_of(shape)
    at = problem(eta)
    one, found = at.courses[0], at.solution

    def residual(values):
        return problem(values).solution.residual

    expected = finite_differences(residual, eta)
    size = np.linalg.norm(expected)
    first, fixed = gradients.approach_1(one, found), gradients.approach_2b(one, at.gains())
    exact = found.back(*gradients.exact(one, found))
    assert np.linalg.norm(first - expected) <= FD_TOLERANCE * size
    assert np.linalg.norm(exact - expected) <= FD_TOLERANCE * size
    assert np.allclose(gradients.approach_2a(one, found), fixed, rtol=1e-9, atol=1e-10)
    # (39) is no equality of Jacobians, Kaufman's is an approximation, and both give the gradient of the cost.
    tail = gradients.kaufman(one, found)
    kaufman = found.back(np.zeros((found.n_linear, eta.size)), tail)
    assert np.linalg.norm(fixed - expected) > 0.3 * size
    assert np.linalg.norm(kaufman - expected) > 0.3 * size
    projected = fixed - found.back(found.rotate(fixed)[0], np.zeros_like(fixed))
    assert np.allclose(projected, kaufman, rtol=1e-9, atol=1e-9)
    gradient = 2 * expected.T @ found.residual
    scale = np.linalg.norm(gradient)
    for jac in (first, fixed, kaufman, exact):
        assert np.linalg.norm(2 * jac.T @ found.residual - gradient) <= FD_TOLERANCE * scale
    assert np.linalg.norm(gradients.cost_gradient(one, found) - gradient) <= FD_TOLERANCE * scale


def test_the_second_kaufman_term_in_numpy_is_the_compiled_one():
    problem, eta = problem_of((3, 4, 2, 2, 1, 40))
    at = problem(eta)
    for function in (gradients.exact, gradients.kaufman, gradients.approach_1, gradients.approach_2a):
        compiled = function(at.courses[0], at.solution)
        by_numpy = function(at.courses[0], at.solution, respond=plain)
        for a, b in (
            zip(np.atleast_3d(compiled), np.atleast_3d(by_numpy), strict=True)
            if not isinstance(compiled, tuple)
            else zip(compiled, by_numpy, strict=True)
        ):
            assert np.allclose(a, b, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("jacobian", ["exact", "kaufman"])
def test_several_experiments_with_gaps_and_initial_states(jacobian):
    sizes, eta, first = random_case((3, 2, 1, 2, 1, 50))
    _, _, second = random_case((3, 2, 1, 2, 1, 40), seed=5)
    rng = np.random.default_rng(3)
    used = [rng.random(50) < 0.8, np.ones(40, dtype=bool)]
    y = [rng.standard_normal((50, 2)), rng.standard_normal((40, 2))]
    problem = Problem(sizes, [first, second], y, used, starts=True, jacobian=jacobian)
    at = problem(eta)
    jac, residual = at.linearise()
    assert np.isclose(residual @ residual, at.cost, rtol=1e-12)
    costs = finite_differences(lambda values: np.array([problem(values).cost]), eta).ravel()
    assert np.allclose(2 * jac.T @ residual, costs, rtol=1e-6, atol=1e-6 * np.abs(costs).max())
    if jacobian == "exact":
        expected = finite_differences(lambda values: problem(values).solution.residual, eta)
        # The ridge that fixes the redundant part of the initial states costs the differences some digits.
        assert np.allclose(
            jac.T @ jac, expected.T @ expected, rtol=1e-3, atol=1e-4 * np.linalg.norm(expected) ** 2
        )


# Redundancy -------------------------------------------------------------------------------------------


def test_tangent_is_the_mended_matrix_of_the_print_and_changes_nothing():
    problem, eta = problem_of((3, 4, 2, 2, 2, 60))
    sizes = problem.sizes
    A, C, _, _ = sizes.unpack(eta)
    M = printed.redundant_directions(A, C)
    rows = np.concatenate([
        np.arange(sizes.n_states**2 * sizes.n_models).reshape(-1, sizes.n_states).T.ravel(),
        sizes.n_states**2 * sizes.n_models + np.arange(C.size).reshape(-1, C.shape[0]).T.ravel(),
    ])  # fmt: skip
    columns = np.arange(9).reshape(3, 3).T.ravel()
    assert np.allclose(tangent(sizes, eta)[: sizes.n_dynamic], M[rows][:, columns], atol=1e-13)
    one, found = problem(eta).courses[0], problem(eta).solution
    J = found.back(*gradients.exact(one, found))
    assert np.abs(J @ tangent(sizes, eta)).max() <= 1e-10 * np.linalg.norm(J)
    assert complement(sizes, eta).shape == (sizes.n_eta, sizes.n_eta - 9)


def test_projection_changes_no_step_of_the_exact_jacobian():
    problem, eta = problem_of((3, 4, 2, 2, 2, 60), jacobian="exact")
    jac, residual = problem(eta).linearise()
    basis = complement(problem.sizes, eta)
    for damping in (1e-2, 1.0, 100.0):
        free, bound = (identity_step(jac, residual, damping, b) for b in (None, basis))
        assert np.linalg.norm(free - bound) <= 1e-8 * np.linalg.norm(free)


def test_projected_descent_falls():
    problem, eta = problem_of((2, 2, 1, 1, 1, 60))
    for projected in (False, True):
        found = identity_descent(problem, eta, 8, projected=projected)
        assert all(np.diff(found.costs) <= 0)
        assert found.costs[-1] < 0.98 * found.costs[0]


# Search -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("jacobian", ["kaufman", "exact"])
def test_descent_recovers_a_model_without_noise(jacobian):
    model, u, phi = random_model((2, 2, 1, 1, 1, 300), seed=2)
    y = model.simulate(u, phi)
    used = np.ones(300, dtype=bool)
    problem = Problem(model.sizes, [Experiment.of(u, phi)], [y], [used], jacobian=jacobian)
    start = model.eta + 0.05 * np.random.default_rng(0).standard_normal(model.eta.size)
    found = descend(problem, start, tolerance=1e-12, max_evaluations=100)
    assert found.cost <= 1e-16 * np.sum(y**2)
    again = LocalLinearModel.of(model.sizes, found.x, found.point.gains())
    assert np.allclose(again.simulate(u, phi), y, atol=1e-6 * np.abs(y).max())


def test_a_diverging_simulation_has_an_infinite_cost():
    problem, eta = problem_of((2, 2, 1, 1, 1, 400))
    A, C, widths, centres = problem.sizes.unpack(eta)
    assert np.isinf(problem(problem.sizes.pack(20.0 * A, C, widths, centres)).cost)
