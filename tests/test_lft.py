"""The estimator of LFT models against independent brute force, complex steps and its own statistics."""

import math
from dataclasses import replace

import numpy as np
import pytest
from lft_cases import STRUCTURES, predicted_by_hand, simulated
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.optimize import least_squares
from scipy.stats import binom

from sysid.data import make_record
from sysid.errors import DataError, IdentifiabilityError, ModelError, UsageError
from sysid.lft import (
    LftStructure,
    basis_conditions,
    compare_problems,
    fit_lft,
    initial_estimate,
    lags,
    printed_search,
)
from sysid.lft.problem import LftProblem
from sysid.lft.signals import signals_of, usable_rows
from sysid.separable import golub_pereyra_jacobian, kaufman_jacobian, project

Floats = NDArray[np.float64]


def problem_of(case: str, n: int = 300, **changes: object) -> LftProblem:
    structure = replace(STRUCTURES[case], **changes)  # type: ignore[arg-type]
    signals = signals_of(simulated(case, n))
    return LftProblem.of(signals, structure, usable_rows(signals, structure, None))


def somewhere(problem: LftProblem) -> Floats:
    return np.random.default_rng(3).uniform(-0.3, 0.3, problem.n_tangents + problem.structure.n_g)


def clamped_spline(z: Floats, coefficients: Floats, n_knots: int, degree: int) -> BSpline:
    """Return a spline with knots equally spaced over the range of z, by another library."""
    knots = np.linspace(z.min(), z.max(), n_knots)
    return BSpline(np.r_[[knots[0]] * degree, knots, [knots[-1]] * degree], coefficients, degree)


@pytest.mark.parametrize("case", list(STRUCTURES))
def test_fit_reaches_the_cost_of_a_joint_search_by_another_library(case: str) -> None:
    structure = STRUCTURES[case]
    u, y = simulated(case, 400)
    fit = fit_lft((u, y), structure)
    n_a, n_b, n_g, n_d = structure.n_a, len(structure.b_lags), structure.n_g, len(structure.z_lags)
    times = np.arange(structure.largest_lag, y.size)

    def taps(k: NDArray[np.int64]) -> Floats:
        return np.column_stack([(y if s == "y" else u)[k - delay] for s, delay in structure.z_lags])

    def residual(x: Floats) -> Floats:
        a, b, g, d, c = np.split(x, np.cumsum([n_a, n_b, n_g, n_d]))
        d = d / np.linalg.norm(d)
        every = np.unique(times[:, None] - np.arange(n_g + 1))
        curve = clamped_spline(taps(every) @ d, c, structure.knots, structure.degree)
        value = sum(
            (gain * curve(taps(times - i) @ d) for i, gain in enumerate([1.0, *g])), np.zeros(times.size)
        )
        value -= sum((a[i] * y[times - 1 - i] for i in range(n_a)), np.zeros(times.size))
        value += sum(
            (b[i] * u[times - lag] for i, (_, lag) in enumerate(structure.b_lags)), np.zeros(times.size)
        )
        return y[times] - value

    start = initial_estimate((u, y), structure)
    slope = np.linspace(-1.0, 1.0, structure.n_coefficients)
    x0 = np.concatenate([start.a[1:], start.b, start.g[1:], start.d, slope])
    other = least_squares(residual, x0, x_scale="jac", xtol=1e-12, ftol=1e-14, gtol=1e-12, max_nfev=400)
    # Both stop where the cost is flat to about 1e-10 of itself; forward differences limit the other one.
    assert fit.cost == pytest.approx(2.0 * other.cost, rel=1e-7)
    ours = np.concatenate(
        [
            fit.a[1:],
            fit.b,
            fit.g[1:],
            fit.d * np.sign(fit.d @ other.x[-1 - slope.size - n_d + 1 : -slope.size]),
        ]
    )
    theirs = other.x[: -slope.size].copy()
    theirs[-n_d:] /= np.linalg.norm(theirs[-n_d:])
    np.testing.assert_allclose(ours[: theirs.size], theirs, atol=2e-4)


@pytest.mark.parametrize("case", list(STRUCTURES))
def test_one_step_prediction_follows_the_printed_equations(case: str) -> None:
    structure = STRUCTURES[case]
    u, y = simulated(case, 200)
    fit = fit_lft((u, y), structure)
    by_hand = predicted_by_hand(
        structure, u, y, fit.a[1:], fit.b, fit.g[1:], fit.d, lambda z: fit.map([z])[0]
    )
    predicted = fit.one_step((u, y))
    assert np.isnan(predicted[: structure.largest_lag]).all()
    np.testing.assert_allclose(predicted[structure.largest_lag :], by_hand, atol=1e-12)
    np.testing.assert_allclose(y[fit.times] - predicted[fit.times], fit.residual, atol=1e-11)


@pytest.mark.parametrize("basis", ["bspline", "thesis"])
@pytest.mark.parametrize("case", list(STRUCTURES))
def test_products_of_the_derivative_are_those_of_differences(case: str, basis: str) -> None:
    problem = problem_of(case, basis=basis)
    eta = somewhere(problem)
    theta = np.random.default_rng(1).standard_normal(problem.regressors(eta).shape[1])
    residual = np.random.default_rng(2).standard_normal(problem.y.size)
    derivative, h = problem.derivative(eta), 1e-6
    for j in range(eta.size):
        step = h * np.eye(eta.size)[j]
        slope = (problem.regressors(eta + step) - problem.regressors(eta - step)) / (2.0 * h)
        # Central differences: error h^2 times third derivatives of order 1e2, and rounding 1e-16 / h.
        np.testing.assert_allclose(derivative.along(theta)[:, j], slope @ theta, atol=1e-6)
        np.testing.assert_allclose(derivative.correlated(residual)[:, j], slope.T @ residual, atol=1e-6)


@pytest.mark.parametrize("case", ["wiener", "wiener-hammerstein", "both in the map"])
def test_exact_jacobian_is_that_of_differences_and_kaufman_has_its_gradient(case: str) -> None:
    problem = problem_of(case)
    eta, h = somewhere(problem), 1e-6
    projection = project(problem.regressors(eta), problem.y)
    exact = golub_pereyra_jacobian(projection, problem.derivative(eta))
    kaufman = kaufman_jacobian(projection, problem.derivative(eta))
    for j in range(eta.size):
        step = h * np.eye(eta.size)[j]
        up, down = (project(problem.regressors(eta + s * step), problem.y).residual for s in (1, -1))
        np.testing.assert_allclose(exact[:, j], (up - down) / (2.0 * h), atol=1e-7)
    np.testing.assert_allclose(kaufman.T @ projection.residual, exact.T @ projection.residual, atol=1e-9)
    assert np.abs(kaufman - exact).max() > 1e-3  # the approximation differs where the residual is large


def complex_basis(
    z: NDArray[np.complex128], knots: NDArray[np.complex128], degree: int
) -> NDArray[np.complex128]:
    """Cox and de Boor's recursion for complex numbers; intervals are found by the real parts."""
    full = np.r_[[knots[0]] * degree, knots, [knots[-1]] * degree]
    last = np.clip(np.searchsorted(knots.real, z.real, side="right") - 1, 0, knots.size - 2) + degree
    basis = np.zeros((z.size, full.size - 1), dtype=complex)
    basis[np.arange(z.size), last] = 1.0
    for d in range(1, degree + 1):
        new = np.zeros((z.size, full.size - 1 - d), dtype=complex)
        for i in range(new.shape[1]):
            if full[i + d] != full[i]:
                new[:, i] += (z - full[i]) / (full[i + d] - full[i]) * basis[:, i]
            if full[i + d + 1] != full[i + 1]:
                new[:, i] += (full[i + d + 1] - z) / (full[i + d + 1] - full[i + 1]) * basis[:, i + 1]
        basis = new
    return basis


def test_derivative_with_moving_knots_is_that_of_a_complex_step() -> None:
    problem = problem_of("wiener-hammerstein")
    structure, eta = problem.structure, somewhere(problem)
    theta = np.random.default_rng(1).standard_normal(structure.n_coefficients)
    inner = problem.taps @ problem.direction(eta)
    first, last = int(np.argmin(inner)), int(np.argmax(inner))

    def output(point: NDArray[np.complex128]) -> NDArray[np.complex128]:
        z = problem.taps @ (problem.centre + problem.tangents @ point[: problem.n_tangents])
        knots = z[first] + np.linspace(0.0, 1.0, structure.knots) * (z[last] - z[first])
        w = complex_basis(z, knots, structure.degree) @ theta
        return w[problem.index[:, 0]] + point[-1] * w[problem.index[:, 1]]

    along = problem.derivative(eta).along(np.concatenate([np.zeros(problem.n_fixed), theta]))
    for j in range(eta.size):
        moved = eta + 1e-30j * np.eye(eta.size)[j]
        # A complex step has no cancellation: only rounding remains.
        np.testing.assert_allclose(along[:, j], output(moved).imag / 1e-30, atol=1e-10)


@pytest.mark.parametrize("case", list(STRUCTURES))
def test_both_bases_give_the_same_fit(case: str) -> None:
    data = simulated(case, 400)
    fits = [
        fit_lft(data, replace(STRUCTURES[case], basis=basis), tolerance=1e-14)
        for basis in ("bspline", "thesis")
    ]
    z = np.linspace(fits[0].z.min(), fits[0].z.max(), 100)
    assert fits[0].cost == pytest.approx(fits[1].cost, rel=1e-12)
    # The cost is flat to rounding around its minimum, within sqrt(1e-16) of a standard error.
    np.testing.assert_allclose(fits[0].residual, fits[1].residual, atol=1e-7)
    np.testing.assert_allclose(fits[0].map(z), fits[1].map(z), atol=1e-7)
    np.testing.assert_allclose(fits[0].standard_errors, fits[1].standard_errors, rtol=1e-4, atol=1e-9)


def test_both_bases_give_the_same_map_to_1e_9_where_nothing_is_searched() -> None:
    structure = LftStructure(n_a=1, z_lags=lags("u", 1), knots=8)
    data = simulated("hammerstein", 400)
    one, other = (fit_lft(data, replace(structure, basis=basis)) for basis in ("bspline", "thesis"))
    z = np.linspace(-2.4, 2.4, 50)
    np.testing.assert_allclose(one.map(z), other.map(z), atol=1e-9)
    np.testing.assert_allclose(one.covariance, other.covariance, atol=1e-9)


def test_both_jacobians_end_at_the_same_minimum() -> None:
    data = simulated("wiener-hammerstein", 500)
    exact, kaufman = (
        fit_lft(data, STRUCTURES["wiener-hammerstein"], jacobian=jacobian)
        for jacobian in ("exact", "kaufman")
    )
    assert exact.cost == pytest.approx(kaufman.cost, rel=1e-9)


def test_intervals_and_band_cover_the_truth() -> None:
    """A cubic map lies in the space of the spline, so only the noise is between estimate and truth."""
    structure = LftStructure(n_a=1, n_g=1, z_lags=lags("u", 1, 2), knots=4)
    runs, places = 200, np.array([-1.0, 0.3, 1.5])
    truth = {"a1": -0.5, "g1": 0.4, "d1": 0.6, "d2": 0.8}
    inside = dict.fromkeys(truth, 0)
    band = np.zeros(places.size)
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        u, y, w = rng.uniform(-1.5, 1.5, 300), np.zeros(300), np.zeros(300)
        for k in range(2, 300):
            z = 0.6 * u[k - 1] + 0.8 * u[k - 2]
            w[k] = 0.5 + z - 0.3 * z**3
            y[k] = 0.5 * y[k - 1] + w[k] + 0.4 * w[k - 1] + 0.1 * rng.standard_normal()
        fit = fit_lft((u, y), structure)
        for name, (value, error) in fit.parameters().items():
            inside[name] += abs(value - truth[name]) <= 1.96 * error
        low, high = fit.map_band(places)
        target = 0.5 + places - 0.3 * places**3
        band += (low <= target) & (target <= high)
    # Counts within the range that a true coverage of 95 % leaves with probability below 1e-4 each.
    least, most = binom.ppf([5e-5, 1.0 - 5e-5], runs, 0.95)
    assert all(least <= count <= most for count in [*inside.values(), *band]), (inside, band)


def test_free_run_is_the_recursion_from_measured_lags_and_from_rest() -> None:
    structure = STRUCTURES["both in the map"]
    u, y = simulated("both in the map", 200)
    fit = fit_lft((u, y), structure)
    first = structure.largest_lag
    run = np.array(y)
    w = [float(fit.map(fit.d[0] * u[k - 1] + fit.d[1] * run[k - 2])) if k >= 2 else 0.0 for k in range(first)]
    for k in range(first, y.size):
        w.append(float(fit.map(fit.d[0] * u[k - 1] + fit.d[1] * run[k - 2])))
        run[k] = -fit.a[1] * run[k - 1] + fit.b[0] * u[k] + w[k] + fit.g[1] * w[k - 1]
    np.testing.assert_allclose(fit.simulate((u, y)), run, atol=1e-12)
    padded = np.concatenate([np.zeros(first), u]), np.concatenate([np.zeros(first), y])
    np.testing.assert_allclose(
        fit.simulate((u, y), initial_state="rest"), fit.simulate(padded)[first:], atol=1e-12
    )


def test_experiments_and_rows_are_respected() -> None:
    structure = STRUCTURES["wiener-hammerstein"]
    parts = [simulated("wiener-hammerstein", n, seed=n) for n in (150, 200)]
    u, y = (np.concatenate(pair) for pair in zip(*parts, strict=True))
    labels = np.where(np.arange(350) < 300, "est", "test")
    record = make_record(u, y, 1.0, split=labels, experiment=np.repeat(["one", "two"], (150, 200)))
    fit = fit_lft(record, structure, rows=record.estimation)
    assert set(np.flatnonzero(record.estimation)) - set(fit.times) == {0, 1, 2, 150, 151, 152}
    assert fit_lft(record, structure).n_rows == 300 - 6
    alone = fit.simulate(parts[1])
    np.testing.assert_array_equal(fit.simulate(record)[150:], alone)


def test_orientation_is_a_convention_that_changes_nothing() -> None:
    u, y = simulated("wiener-hammerstein", 300)
    fit = fit_lft((u, y), STRUCTURES["wiener-hammerstein"])
    other = fit.oriented(-fit.d)
    np.testing.assert_array_equal(other.d, -fit.d)
    np.testing.assert_allclose(other.one_step((u, y)), fit.one_step((u, y)), atol=1e-12)
    z = np.linspace(-2.0, 2.0, 9)
    np.testing.assert_allclose(other.map(-z), fit.map(z), atol=1e-13)
    np.testing.assert_allclose(other.map_band(-z), fit.map_band(z), atol=1e-10)
    assert fit.oriented(fit.d) is fit
    np.testing.assert_allclose(other.standard_errors[:4], fit.standard_errors[:4])
    assert fit_lft((u, y), fit.structure, start=(-fit.d, fit.g)).d @ fit.d < -0.999


def test_length_of_the_direction_does_not_matter_and_its_covariance_is_tangent() -> None:
    fit = fit_lft(simulated("wiener", 400), STRUCTURES["wiener"])
    assert np.linalg.norm(fit.d) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(fit.covariance[:3, :3] @ fit.d, 0.0, atol=1e-15)


def test_several_starts_report_how_many_agree() -> None:
    data = simulated("wiener-hammerstein", 400)
    fit = fit_lft(data, STRUCTURES["wiener-hammerstein"], starts=5, seed=1)
    assert fit.cost <= fit_lft(data, STRUCTURES["wiener-hammerstein"]).cost * (1.0 + 1e-9)
    assert "of 5 searches ended at this cost" in fit.status


def test_overlap_of_a_linear_lag_and_the_map() -> None:
    u, y = simulated("hammerstein", 300)
    both = LftStructure(n_a=1, b_lags=lags("u", 1), z_lags=lags("u", 1), knots=6)
    with pytest.raises(ModelError, match=r"b1 and the slope of the map act on the same lag"):
        fit_lft((u, y), both)
    for overlap in ("drop", "keep"):
        fit = fit_lft((u, y), replace(both, overlap=overlap))
        assert "left out, since the slope of the map does the same: b1" in fit.notes
        assert "b1" not in fit.parameters()
        assert fit.b[0] == 0.0
    without = fit_lft((u, y), replace(both, b_lags=()))
    assert fit.cost == pytest.approx(without.cost, rel=1e-12)
    # With G the map's slope acts on two lags, b1 on one of them: both can be told apart.
    kept = fit_lft((u, y), replace(both, n_g=1, overlap="keep"))
    assert "b1" in kept.parameters()


def test_initial_estimate_follows_the_steps() -> None:
    u, y = simulated("wiener-hammerstein", 400)
    structure = STRUCTURES["wiener-hammerstein"]
    found = initial_estimate((u, y), structure)
    k = np.arange(structure.largest_lag, 400)
    columns = np.column_stack([-y[k - 1], np.ones(k.size)])
    linear = np.linalg.solve(columns.T @ columns, columns.T @ y[k])
    assert found.a[1] == pytest.approx(linear[0], rel=1e-10)
    v = y[k] + linear[0] * y[k - 1]
    np.testing.assert_allclose(found.v, v, atol=1e-12)
    taps = np.column_stack([u[k - 1], u[k - 2]])
    d = np.linalg.lstsq(taps, v)[0]
    np.testing.assert_allclose(found.d, d / np.linalg.norm(d), atol=1e-12)
    assert found.g.tolist() == [1.0, 0.0]
    assert found.constant == pytest.approx(linear[1])
    centred = initial_estimate((u, y), structure, centred=True)
    d = np.linalg.lstsq(np.column_stack([taps, np.ones(k.size)]), v)[0][:2]
    np.testing.assert_allclose(centred.d, d / np.linalg.norm(d), atol=1e-12)


@pytest.mark.parametrize("case", ["wiener", "wiener-hammerstein", "both in the map"])
def test_separated_and_joint_problem_share_their_minimum(case: str) -> None:
    found = compare_problems(simulated(case, 300), STRUCTURES[case])
    assert found.separated_cost == pytest.approx(found.joint_cost, rel=1e-10)
    np.testing.assert_allclose(found.separated, found.joint, atol=1e-5)
    assert max(found.separated_gradient, found.joint_gradient) < 1e-8
    # Theorem 4.2 holds for the projected Jacobian of eq. (4.31) always.
    assert found.condition_kaufman <= found.condition_joint * (1.0 + 1e-12)


def test_printed_iteration_stops_at_its_first_good_step_and_keeps_uphill_ones() -> None:
    data = simulated("wiener-hammerstein", 400, noise=0.3, seed=4)
    structure = STRUCTURES["wiener-hammerstein"]
    at_minimum = fit_lft(data, structure)
    stopped = printed_search(data, structure, start=([1.0, 1.0], [1.0, 0.5]))
    assert stopped.stopped
    assert stopped.ratios[-1] <= 0.95 < stopped.ratios[:-1].min(initial=2.0)
    assert stopped.costs[-1] * 2 * at_minimum.n_rows > at_minimum.cost * 1.01
    going_on = printed_search(data, structure, start=at_minimum, max_steps=20)
    assert not going_on.stopped
    assert len(going_on.costs) == 21


def test_b_splines_are_better_conditioned_by_orders_of_magnitude() -> None:
    found = basis_conditions(np.random.default_rng(0).uniform(-2.0, 2.0, 1000), 12)
    assert found["bspline"] < 20 < 1e4 < found["thesis scaled"]


def test_repr_names_everything() -> None:
    text = repr(fit_lft(simulated("wiener-hammerstein", 300), STRUCTURES["wiener-hammerstein"]))
    for part in ("a1 ", "g1 ", "d1 ", "d2 ", "±", "8 knots", "converged", "the sign of d is a convention"):
        assert part in text


def test_bad_use_is_one_sentence() -> None:
    u, y = simulated("wiener", 300)
    wiener = STRUCTURES["wiener"]
    with pytest.raises(IdentifiabilityError, match="10 rows cannot determine 12 parameters"):
        fit_lft((u[:13], y[:13]), wiener)
    with pytest.raises(IdentifiabilityError, match=r"u\(k-1\) is constant"):
        fit_lft((np.ones(300), y), LftStructure())
    gap = np.where(np.arange(300) % 2, -5.0, 5.0) + 0.1 * u
    with pytest.raises(IdentifiabilityError, match=r"coefficients of the map have no data.*take fewer knots"):
        fit_lft((gap, y), LftStructure(knots=12))
    with pytest.raises(ModelError, match="there is no signal 'v': choose among u, y"):
        fit_lft((u, y), LftStructure(z_lags=lags("v", 1)))
    with pytest.raises(ModelError, match="lags of the output belong to A"):
        LftStructure(b_lags=lags("y", 1))
    with pytest.raises(ModelError, match="the delay 0: give at least 1"):
        LftStructure(z_lags=lags("y", 0))
    with pytest.raises(ModelError, match="twice"):
        LftStructure(z_lags=lags("u", 1, 1))
    with pytest.raises(ModelError, match="even power"):
        LftStructure(basis="thesis", degree=2)
    with pytest.raises(UsageError, match="give 3 taps that are not all zero"):
        fit_lft((u, y), wiener, start=([1.0], [1.0]))
    with pytest.raises(UsageError, match="the pair"):
        fit_lft(u, wiener)  # type: ignore[arg-type]
    with pytest.raises(DataError, match="do not match"):
        fit_lft((u[:-1], y), wiener)
    with pytest.raises(UsageError, match="choose exact or kaufman"):
        fit_lft((u, y), wiener, jacobian="newton")  # type: ignore[arg-type]


def test_free_run_that_diverges_is_an_error_with_its_row() -> None:
    u, y = simulated("wiener-hammerstein", 300)
    fit = fit_lft((u, y), STRUCTURES["wiener-hammerstein"])
    unstable = replace(fit, a=np.array([1.0, -1.5]))
    with pytest.raises(ModelError, match=r"diverges: in row \d+ .* modulus 1.5"):
        unstable.simulate((u, y))
    y[0] = math.nan
    with pytest.raises(DataError, match="row 1 has none"):
        fit.simulate((u, y))


def test_linearised_model_is_the_one_of_small_deviations() -> None:
    structure = STRUCTURES["both in the map"]
    fit = fit_lft(simulated("both in the map", 400), structure)
    n, h = 60, 1e-5
    rest = np.zeros((n, 1)), np.zeros(n)
    steady = fit.simulate((np.zeros(4000), np.zeros(4000)))[-n:]
    point = fit.d[1] * steady[-1]
    kicked = steady.copy()
    kicked[:3] += h * np.array([0.3, -0.2, 1.0])
    deviation = (fit.simulate((rest[0], kicked)) - fit.simulate((rest[0], steady))) / h
    a = fit.linearised(point)
    left = np.convolve(deviation, a)[structure.largest_lag + 3 : n]
    # The map's curvature bends what h moves by a share of h.
    np.testing.assert_allclose(left, 0.0, atol=1e-3)
    np.testing.assert_array_equal(replace(fit, d=np.array([1.0, 0.0])).linearised(0.0), fit.a)
