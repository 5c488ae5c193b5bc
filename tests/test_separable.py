"""The estimator core against dense references, finite differences, brute force and SciPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from sysid.errors import DataError, IdentifiabilityError, UsageError
from sysid.separable import (
    BlockedQR,
    LaggedRegression,
    Residual,
    Status,
    descend,
    fit,
    golub_pereyra_jacobian,
    kaufman_jacobian,
    levenberg_marquardt,
    project,
    search,
    search_pieces,
    search_two_pieces,
)
from sysid.separable.pieces import AffinePieces


def saturation_pieces(u, upper):
    order = np.argsort(np.abs(u), kind="stable")
    order = order[np.abs(u)[order] < upper]
    return AffinePieces(
        0.0, upper, np.zeros(u.size), np.sign(u), np.abs(u)[order], order, u[order], np.zeros(order.size)
    )


def relay_pieces(u, upper):
    order = np.argsort(np.abs(u), kind="stable")
    order = order[np.abs(u)[order] < upper]
    zero = np.zeros(order.size)
    return AffinePieces(0.0, upper, np.sign(u), np.zeros(u.size), np.abs(u)[order], order, zero, zero)


def second_order(rng, signal, noise):
    y = rng.uniform(-noise, noise, signal.size)
    for k in range(2, signal.size):
        y[k] += -0.8333 * y[k - 1] - 0.1667 * y[k - 2] + signal[k - 1] + signal[k - 2]
    return y


class Decays:
    """Two decaying exponentials: a regression with two nonlinear and two linear parameters."""

    def __init__(self, t):
        self.t = t

    def regressors(self, eta):
        return np.exp(-np.outer(self.t, eta))

    def derivative(self, eta):
        derivative = np.zeros((2, self.t.size, 2))
        for j in range(2):
            derivative[j, :, j] = -self.t * np.exp(-eta[j] * self.t)
        return derivative


@pytest.fixture
def decays(rng):
    t = np.linspace(0, 3, 60)
    model = Decays(t)
    y = model.regressors(np.array([0.7, 3.0])) @ [2.0, -1.0] + 0.01 * rng.standard_normal(t.size)
    return model, y


@pytest.fixture
def rng():
    return np.random.default_rng(20021113)


# Orthogonal elimination ------------------------------------------------------------------------


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n_rows=st.integers(8, 80), n_linear=st.integers(1, 6))
def test_projection_agrees_with_a_dense_reference(seed, n_rows, n_linear):
    rng = np.random.default_rng(seed)
    phi, y = rng.standard_normal((n_rows, n_linear)), rng.standard_normal(n_rows)
    projection = project(phi, y)
    theta, cost, *_ = np.linalg.lstsq(phi, y)
    # Both are backward stable; the condition number of a Gaussian matrix bounds the difference.
    tolerance = 1e-13 * np.linalg.cond(phi) ** 2
    np.testing.assert_allclose(
        projection.theta, theta, rtol=0, atol=tolerance * np.linalg.norm(theta) + 1e-14
    )
    np.testing.assert_allclose(projection.cost, cost[0], rtol=1e-10)
    assert np.max(np.abs(phi.T @ projection.residual)) < 1e-12 * np.linalg.norm(y) * np.linalg.norm(phi)


def test_projection_keeps_digits_that_normal_equations_lose(rng):
    phi = np.vander(np.linspace(1, 1.2, 40), 6)
    theta = np.arange(1.0, 7.0)
    y = phi @ theta
    by_qr = project(phi, y).theta
    by_normal_equations = np.linalg.solve(phi.T @ phi, phi.T @ y)
    assert np.linalg.cond(phi) > 1e7
    # eps * cond = 1e-8 for QR; the normal equations pay eps * cond^2.
    assert np.max(np.abs(by_qr - theta)) < 1e-5
    assert np.max(np.abs(by_normal_equations - theta)) > 100 * np.max(np.abs(by_qr - theta))


def test_projection_leaves_out_dependent_columns(rng):
    phi = rng.standard_normal((30, 3))
    dependent = np.column_stack([phi[:, 0], np.zeros(30), phi[:, 1], phi[:, 0] - 2 * phi[:, 1], phi[:, 2]])
    y = rng.standard_normal(30)
    projection = project(dependent, y)
    assert projection.rank == 3
    assert projection.theta[1] == 0
    np.testing.assert_allclose(projection.cost, project(phi, y).cost, rtol=1e-12)
    np.testing.assert_allclose(dependent @ projection.theta + projection.residual, y, atol=1e-12)


def test_projection_refuses_what_cannot_be_solved():
    with pytest.raises(IdentifiabilityError, match="2 rows cannot determine 3 linear parameters"):
        project(np.ones((2, 3)), np.ones(2))
    with pytest.raises(UsageError, match=r"shape \(5,\)"):
        project(np.ones((4, 2)), np.ones(5))


@pytest.mark.parametrize("block", [1, 7, 100, 1000])
def test_blocked_factor_agrees_with_one_factorisation(rng, block):
    phi, y = rng.standard_normal((1000, 5)), rng.standard_normal(1000)
    factor = BlockedQR(6)
    for start in range(0, 1000, block):
        factor.update(np.column_stack([phi, y])[start : start + block])
    theta, cost = factor.solve(5)
    reference = project(phi, y)
    np.testing.assert_allclose(theta, reference.theta, rtol=1e-11)
    np.testing.assert_allclose(cost, reference.cost, rtol=1e-12)
    assert factor.n_rows == 1000


def test_blocked_factor_gives_the_gauss_newton_step(rng):
    phi, moved, y = rng.standard_normal((200, 3)), rng.standard_normal((200, 2)), rng.standard_normal(200)
    factor = BlockedQR(6)
    factor.update(np.column_stack([phi, moved, y]))
    projected = moved - phi @ np.linalg.lstsq(phi, moved)[0]
    np.testing.assert_allclose(factor.r[3:5, 3:5].T @ factor.r[3:5, 3:5], projected.T @ projected, rtol=1e-11)
    np.testing.assert_allclose(
        factor.r[3:5, 3:5].T @ factor.r[3:5, 5], projected.T @ y, rtol=1e-9, atol=1e-10
    )


def test_blocked_factor_names_the_dependent_column(rng):
    phi = rng.standard_normal((50, 2))
    factor = BlockedQR(4)
    factor.update(np.column_stack([phi, phi @ [1, 1], np.ones(50)]))
    with pytest.raises(IdentifiabilityError, match="column 2"):
        factor.solve(3)


# Jacobians ---------------------------------------------------------------------------------------


def finite_difference(model, y, eta, step=1e-6):
    columns = []
    for j in range(eta.size):
        shift = np.zeros(eta.size)
        shift[j] = step
        after, before = (project(model.regressors(eta + s * shift), y).residual for s in (1, -1))
        columns.append((after - before) / (2 * step))
    return np.column_stack(columns)


def test_jacobians_of_the_projected_residual(decays):
    model, y = decays
    eta = np.array([0.5, 4.0])
    projection = project(model.regressors(eta), y)
    reference = finite_difference(model, y, eta)
    exact = golub_pereyra_jacobian(projection, model.derivative(eta))
    kaufman = kaufman_jacobian(projection, model.derivative(eta))
    scale = np.linalg.norm(reference)
    # Central differences with step 1e-6: truncation 1e-12, rounding 1e-10.
    assert np.linalg.norm(exact - reference) < 1e-8 * scale
    assert np.linalg.norm(kaufman - reference) > 1e-4 * scale  # it is an approximation ...
    gradient = exact.T @ projection.residual
    np.testing.assert_allclose(
        kaufman.T @ projection.residual, gradient, rtol=1e-9
    )  # ... with the exact gradient


@pytest.mark.parametrize("jacobian", ["kaufman", "golub-pereyra"])
def test_descent_agrees_with_a_joint_fit(decays, jacobian):
    model, y = decays
    ours = fit(model, y, [1.0, 2.0], jacobian=jacobian)
    joint = least_squares(
        lambda p: model.regressors(p[:2]) @ p[2:] - y,
        [1.0, 2.0, 1.0, -1.0],
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    assert ours.status.converged
    np.testing.assert_allclose(ours.cost, 2 * joint.cost, rtol=1e-9)
    np.testing.assert_allclose([*ours.eta, *ours.theta], joint.x, rtol=1e-5)
    covariance = np.linalg.inv(joint.jac.T @ joint.jac) * ours.noise_variance
    np.testing.assert_allclose(ours.covariance, covariance, rtol=1e-4)
    assert list(ours.costs) == sorted(ours.costs, reverse=True)


def test_standard_errors_are_calibrated():
    # 400 runs: the relative standard deviation of a sample standard deviation is 1/sqrt(800) = 3.5 %.
    t = np.linspace(0, 3, 60)
    model = Decays(t)
    clean = model.regressors(np.array([0.7, 3.0])) @ [2.0, -1.0]
    rng = np.random.default_rng(5)
    fits = [fit(model, clean + 0.01 * rng.standard_normal(t.size), [0.8, 2.5]) for _ in range(400)]
    estimates = np.array([[*f.eta, *f.theta] for f in fits])
    claimed = np.sqrt(np.mean([f.std_error**2 for f in fits], axis=0))
    np.testing.assert_allclose(claimed, estimates.std(axis=0, ddof=1), rtol=0.15)


def test_descent_respects_bounds(decays):
    model, y = decays
    bounded = fit(model, y, [0.8, 2.0], bounds=([0.6, 0.0], [1.0, 2.5]))
    reference = least_squares(
        lambda eta: project(model.regressors(eta), y).residual, [0.8, 2.0], bounds=([0.6, 0], [1, 2.5])
    )
    assert bounded.eta[1] == 2.5
    np.testing.assert_allclose(bounded.cost, 2 * reference.cost, rtol=1e-4)


def test_a_dependent_parameter_has_no_standard_error(rng):
    class Redundant:
        def regressors(self, eta):
            return np.column_stack([np.ones(20), np.ones(20) * (1 + eta[0])])

        def derivative(self, eta):
            return np.stack([np.column_stack([np.zeros(20), np.ones(20)])])

    result = fit(Redundant(), rng.standard_normal(20), [0.5])
    assert np.isnan(result.std_error).sum() == 2


def test_non_finite_data_are_named(decays):
    model, y = decays
    y[17] = np.nan
    with pytest.raises(DataError, match="data value 17 is nan"):
        fit(model, y, [1.0, 2.0])


# Levenberg-Marquardt -------------------------------------------------------------------------------


def rosenbrock(x):
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def rosenbrock_jacobian(x):
    return np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])


def test_minimum_of_a_curved_valley():
    result = levenberg_marquardt(rosenbrock, rosenbrock_jacobian, [-1.2, 1.0])
    np.testing.assert_allclose(result.x, [1, 1], atol=1e-8)
    assert result.status.converged


@pytest.mark.parametrize("factor", [1e-6, 1.0, 1e8])
def test_units_do_not_change_the_path(factor):
    scale = np.array([factor, 1 / factor])
    result = levenberg_marquardt(
        lambda x: rosenbrock(x * scale),
        lambda x: rosenbrock_jacobian(x * scale) * scale,
        np.array([-1.2, 1.0]) / scale,
    )
    reference = levenberg_marquardt(rosenbrock, rosenbrock_jacobian, [-1.2, 1.0])
    assert result.n_evaluations == reference.n_evaluations
    np.testing.assert_allclose(result.costs[:-1], reference.costs[:-1], rtol=1e-6, atol=1e-20)


def test_infeasible_trial_points_shorten_the_step():
    def residual(x):
        return np.log(x) if x[0] > 0 else np.array([np.nan])

    result = levenberg_marquardt(residual, lambda x: 1 / x[:, None], [20.0])
    np.testing.assert_allclose(result.x, [1.0], rtol=1e-8)


def test_points_are_linearised_only_where_a_step_was_taken():
    seen = []

    class Valley(Residual):
        def linearise(self):
            seen.append(self.cost)
            return super().linearise()

    result = descend(lambda x: Valley(rosenbrock(x), lambda: rosenbrock_jacobian(x)), [-1.2, 1.0])
    assert result.n_evaluations > len(result.costs)  # some steps were refused
    assert seen == list(result.costs)[: len(seen)]
    assert len(seen) >= len(result.costs) - 1


def test_a_triangular_factor_serves_as_well_as_the_residual(rng):
    t = np.linspace(0, 2, 300)
    y = 2 * np.exp(-1.5 * t) + 0.1 * rng.standard_normal(t.size)

    def dense(x):
        signal = x[0] * np.exp(-x[1] * t)
        return Residual(signal - y, lambda: np.column_stack([np.exp(-x[1] * t), -t * signal]))

    class Compressed(Residual):
        def linearise(self):
            factor = np.linalg.qr(np.column_stack(super().linearise()), mode="r")
            return factor[:2, :2], factor[:2, 2]

    full = descend(dense, [1.0, 1.0])
    small = descend(lambda x: Compressed(dense(x).residual, dense(x).derivative), [1.0, 1.0])
    # The same steps up to the rounding of two factorisations.
    np.testing.assert_allclose(small.x, full.x, rtol=1e-9)
    assert small.n_evaluations == full.n_evaluations


@pytest.mark.parametrize("share", [1e-2, 1e-4])
def test_descent_stops_where_no_step_is_worth_the_given_share(rng, share):
    t = np.linspace(0, 2, 300)
    y = np.exp(-1.5 * t) + 0.1 * rng.standard_normal(t.size)

    def evaluate(x):
        return Residual(np.exp(-x[0] * t) - y, lambda: (-t * np.exp(-x[0] * t))[:, None])

    best = descend(evaluate, [4.0])
    early = descend(evaluate, [4.0], negligible=share)
    assert early.status is Status.NEGLIGIBLE
    assert early.status.converged
    assert early.n_evaluations < best.n_evaluations
    # The linear prediction of what is left is good to a factor of two this near to the minimum.
    assert early.costs[-1] - best.costs[-1] < 2 * share * best.costs[-1]


def test_a_descent_ends_where_another_has_been():
    whole = levenberg_marquardt(rosenbrock, rosenbrock_jacobian, [-1.2, 1.0])
    first = descend(
        lambda x: Residual(rosenbrock(x), lambda: rosenbrock_jacobian(x)),
        [-1.2, 1.0],
        met=lambda point: point.cost < 1.0,
    )
    assert first.status is Status.MET
    assert first.costs == whole.costs[: len(first.costs)]
    assert first.costs[-1] < 1.0 <= first.costs[-2]


def test_a_cost_that_counts_as_zero_ends_the_descent():
    result = descend(
        lambda x: Residual(rosenbrock(x), lambda: rosenbrock_jacobian(x)), [-1.2, 1.0], zero=1e-3
    )
    assert result.status is Status.NEGLIGIBLE
    assert result.costs[-1] <= 1e-3 < result.costs[-2]


def test_the_limit_is_reported():
    result = levenberg_marquardt(rosenbrock, rosenbrock_jacobian, [-1.2, 1.0], max_evaluations=3)
    assert result.status is Status.MAX_EVALUATIONS
    assert not result.status.converged


def test_a_start_outside_its_bounds_is_refused():
    with pytest.raises(UsageError, match="start value 1 is 5, outside"):
        levenberg_marquardt(rosenbrock, rosenbrock_jacobian, [0.0, 5.0], bounds=([-1, -1], [1, 1]))


# Exact search over one parameter -------------------------------------------------------------------


def check_against_grid(regression, pieces, result, n_grid=700):
    grid = np.linspace(pieces.lower, pieces.upper, n_grid + 1)[:-1] + 1e-9
    costs = [project(regression.regressors(pieces.at(a)), regression.y).cost for a in grid]
    assert result.cost <= min(costs) * (1 + 1e-9) + 1e-12
    return grid[int(np.argmin(costs))]


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    a=st.floats(0.2, 3.2),
    noise=st.sampled_from([0.0, 0.01, 0.2, 2.0]),
    n=st.integers(12, 60),
)
def test_kinked_search_is_never_above_a_dense_grid(seed, a, noise, n):
    rng = np.random.default_rng(seed)
    u = rng.uniform(-4, 4, n)
    regression = LaggedRegression.arx(second_order(rng, np.clip(u, -a, a), noise), 2)
    pieces = saturation_pieces(u, 3.5)
    result = search_pieces(regression, pieces)
    check_against_grid(regression, pieces, result)
    phi = regression.regressors(pieces.at(float(result.eta[0])))
    reference = project(phi, regression.y)
    np.testing.assert_allclose(result.residual, reference.residual, atol=1e-9 * np.linalg.norm(regression.y))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(12, 60), noise=st.sampled_from([0.0, 0.2, 2.0]))
def test_flat_cells_are_enumerated_exactly(seed, n, noise):
    rng = np.random.default_rng(seed)
    u = rng.uniform(-4, 4, n)
    relay = np.where(np.abs(u) <= 1, 0, np.sign(u))
    regression = LaggedRegression.arx(second_order(rng, relay, noise), 2)
    result = search_pieces(regression, relay_pieces(u, 3.5))
    knots = np.unique(np.abs(u[:-1]))  # the last input enters no row
    edges = np.concatenate([[0.0], knots[knots < 3.5], [3.5]])
    middles = (edges[1:] + edges[:-1]) / 2
    costs = np.array(
        [
            project(regression.regressors(np.where(np.abs(u) <= a, 0, np.sign(u))), regression.y).cost
            for a in middles
        ]
    )
    np.testing.assert_allclose(result.cost, costs.min(), rtol=1e-9, atol=1e-20)
    low, high = result.cells[0]
    assert result.flat
    assert result.eta[0] == (low + high) / 2
    if np.sum(costs <= costs.min() + 1e-9 * (regression.y @ regression.y)) == 1:
        best = int(np.argmin(costs))
        assert (low, high) == (edges[best], edges[best + 1])
    assert np.isnan(result.std_error[0])


def test_smooth_search_and_its_covariance(rng):
    u = rng.uniform(-4, 4, 100)
    preload = AffinePieces(
        0.0, 3.5, u, np.sign(u), *(np.empty(0),), np.empty(0, dtype=np.int64), *(np.empty(0),) * 2
    )
    regression = LaggedRegression.arx(second_order(rng, u + 1.0 * np.sign(u), 0.2), 2)
    ours = search_pieces(regression, preload)
    y, times = regression.y, regression.times

    def joint(p):
        x = u + p[0] * np.sign(u)
        return regression.fixed @ p[1:3] + p[3] * x[times - 1] + p[4] * x[times - 2] - y

    reference = least_squares(joint, [1, -0.8333, -0.1667, 1, 1], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    np.testing.assert_allclose([*ours.eta, *ours.theta], reference.x, rtol=1e-6)
    covariance = np.linalg.inv(reference.jac.T @ reference.jac) * ours.noise_variance
    np.testing.assert_allclose(ours.covariance, covariance, rtol=1e-4)


def valleys(costs, depth):
    """Count falls and rises of at least ``depth``: below the smallest |u| the cost is flat up to rounding."""
    count, lowest, highest, falling = 0, np.inf, -np.inf, True
    for cost in [*costs, np.inf]:
        if falling:
            lowest = min(lowest, cost)
            if cost > lowest + depth:
                count, falling, highest = count + 1, False, cost
        else:
            highest = max(highest, cost)
            if cost < highest - depth:
                falling, lowest = True, cost
    return count


def test_local_minima_are_counted_as_on_a_fine_grid(rng):
    for _ in range(4):
        u = rng.uniform(-4, 4, 40)
        regression = LaggedRegression.arx(second_order(rng, np.clip(u, -1, 1), 1.5), 2)
        knots = np.abs(u)[np.abs(u) < 3.5]
        grid = np.sort(np.concatenate([np.linspace(0, 3.5, 4001)[1:], knots, knots + 1e-4]))
        costs = [project(regression.regressors(np.clip(u, -a, a)), regression.y).cost for a in grid]
        seen = valleys(costs, 1e-9)
        assert search_pieces(regression, saturation_pieces(u, 3.5)).n_minima == seen


def test_rows_do_not_reach_across_experiments(rng):
    u = rng.uniform(-4, 4, 80)
    parts = [second_order(rng, np.clip(part, -1, 1), 0.0) for part in (u[:30], u[30:])]
    regression = LaggedRegression.arx(np.concatenate(parts), 2, starts=[0, 30])
    assert regression.y.size == 28 + 48
    result = search_pieces(regression, saturation_pieces(u, 3.5))
    np.testing.assert_allclose(result.eta, [1.0], atol=1e-9)
    assert result.cost < 1e-20


def test_dependent_regressors_are_survived():
    # The input never exceeds 1, so a relay with a > 1 gives no signal at all and two zero columns.
    rng = np.random.default_rng(3)
    u = rng.uniform(-1, 1, 50)
    y = second_order(rng, np.zeros(50), 0.2)
    result = search_pieces(LaggedRegression.arx(y, 2), relay_pieces(u, 3.5))
    assert np.all(np.isfinite(result.theta))
    assert result.n_minima >= 1


def test_short_and_mismatched_data_are_refused():
    with pytest.raises(IdentifiabilityError, match="too short for order 2"):
        LaggedRegression.arx(np.ones(2), 2)
    with pytest.raises(IdentifiabilityError, match="4 rows cannot determine 5 parameters"):
        LaggedRegression.arx(np.ones(6), 2)
    with pytest.raises(DataError, match="data value 3 is inf"):
        LaggedRegression.arx([0, 1, 2, np.inf, 4, 5, 6, 7], 2)
    with pytest.raises(UsageError, match="signal has 5 samples and the output 20"):
        search_pieces(LaggedRegression.arx(np.arange(20.0) ** 2, 2), saturation_pieces(np.ones(5), 2.0))


# Two parameters, and arbitrary regressors -----------------------------------------------------------


def sided(u, upper, build):
    return build(np.minimum(u, 0), upper), build(np.maximum(u, 0), upper)


def test_two_sided_relay_examines_every_rectangle(rng):
    u = rng.uniform(-3, 3, 25)
    x = np.where(u > 0.7, 1.0, np.where(u < -1.4, -1.0, 0.0))
    regression = LaggedRegression.arx(second_order(rng, x, 0.8), 2)
    negative, positive = sided(u, 2.9, relay_pieces)
    result = search_two_pieces(regression, negative, positive)
    edges = [np.concatenate([[0], p.knot, [2.9]]) for p in (negative, positive)]
    middles = [(e[1:] + e[:-1]) / 2 for e in edges]
    costs = [
        project(regression.regressors(negative.at(a) + positive.at(b)), regression.y).cost
        for a in middles[0]
        for b in middles[1]
    ]
    np.testing.assert_allclose(result.cost, min(costs), rtol=1e-9)
    assert result.status is Status.GLOBAL


def test_two_sided_saturation(rng):
    u = rng.uniform(-4, 4, 150)
    regression = LaggedRegression.arx(second_order(rng, np.clip(u, -0.8, 1.7), 0.1), 2)
    negative, positive = sided(u, 3.5, saturation_pieces)
    result = search_two_pieces(regression, negative, positive)
    generic = search(
        lambda eta: regression.regressors(np.clip(u, -eta[0], eta[1])),
        regression.y,
        [0, 0],
        [3.5, 3.5],
        points=25,
    )
    np.testing.assert_allclose(result.eta, [0.8, 1.7], atol=0.1)
    np.testing.assert_allclose(result.cost, generic.cost, rtol=1e-6)
    assert result.cost <= generic.cost * (1 + 1e-9)


def test_search_of_any_regressors_by_known_knots(rng):
    u = rng.uniform(-4, 4, 80)
    regression = LaggedRegression.arx(second_order(rng, np.clip(u, -1, 1), 0.2), 2)
    by_knots = search(
        lambda eta: regression.regressors(np.clip(u, -eta[0], eta[0])),
        regression.y,
        [0.0],
        [3.5],
        knots=[np.abs(u)],
    )
    exact = search_pieces(regression, saturation_pieces(u, 3.5))
    np.testing.assert_allclose(by_knots.cost, exact.cost, rtol=1e-8)
    relay = search(
        lambda eta: regression.regressors(np.where(np.abs(u) <= eta[0], 0, np.sign(u))),
        regression.y, [0.0], [3.5], knots=[np.abs(u)], constant_cells=True,
    )  # fmt: skip
    exact_relay = search_pieces(regression, relay_pieces(u, 3.5))
    np.testing.assert_allclose(relay.cost, exact_relay.cost, rtol=1e-9)
    assert relay.flat


def test_search_bounds_are_checked():
    with pytest.raises(UsageError, match=r"bounds \[2, 1\] of parameter 0"):
        search(lambda eta: np.ones((3, 1)), np.ones(3), [2.0], [1.0])
    with pytest.raises(UsageError, match="one or two parameters"):
        search(lambda eta: np.ones((3, 1)), np.ones(3), [0, 0, 0], [1, 1, 1])
