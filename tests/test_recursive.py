"""Recursive estimators against their formulas in NumPy, batch least squares and simulation."""

import json
import math

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from sysid.errors import DataError, IdentifiabilityError, ModelError, UsageError
from sysid.excitation import impulse_levels
from sysid.linear.simulation import simulate_polynomial
from sysid.nonlinearities import Segments
from sysid.recursive import (
    Kaczmarz,
    ProjectionGradient,
    Recursive,
    RecursiveLeastSquares,
    Snapshot,
    averaged_rate,
    convergence_rate,
    excitation_of,
    identify_levels,
    interpolation_coefficients,
    interpolation_polynomial,
    rank_one,
    recover,
    regressors,
    stationary_period,
    structured,
    transition_matrix,
)

LEVELS = (-6.0, -3.0, 3.0, 6.0)
A, B = (-1.5, 0.56), (1.0, -2.0)
SEGMENTS = Segments(1.0, 2.0, 1.0, -2.0, 1.0, -2.0)


def record(periods=20, noise=0.0, seed=0):
    rng = np.random.default_rng(seed)
    u = impulse_levels(LEVELS, 2, periods)
    y = simulate_polynomial([0.0, *B], [1.0, *A], SEGMENTS(u))
    return u, y + noise * rng.standard_normal(u.size)


def theta_star():
    d = interpolation_coefficients(LEVELS, SEGMENTS)
    return np.concatenate([A, np.outer(d, B).ravel()])


def made(kind):
    settings = {
        "projection-gradient": lambda: ProjectionGradient(2, LEVELS, radius=4.0, step=1.3, offset=0.5),
        "kaczmarz": lambda: Kaczmarz(2, LEVELS, step=0.9),
        "recursive-least-squares": lambda: RecursiveLeastSquares(2, LEVELS, forgetting=0.98),
    }
    return settings[kind]()


KINDS = ("projection-gradient", "kaczmarz", "recursive-least-squares")


# The regression ---------------------------------------------------------------------------------------


def test_regressors_are_those_of_the_polynomial_form():
    """Eq. (3.8b) written out with Lagrange's polynomials, which the implementation never evaluates."""
    u, y = record(3, noise=0.1)
    rows = regressors(u, y, 2, LEVELS)
    units = np.eye(4)
    basis = [interpolation_polynomial(u, LEVELS, unit) for unit in units]  # v P_j(v)
    for t in range(u.size):
        expected = [-y[t - i] if t >= i else 0.0 for i in (1, 2)]
        expected += [column[t - i] if t >= i else 0.0 for column in basis for i in (1, 2)]
        np.testing.assert_allclose(rows[t], expected, atol=1e-12)  # rounding of the polynomials


def test_the_regression_holds_exactly():
    u, y = record(10)
    np.testing.assert_allclose(regressors(u, y, 2, LEVELS) @ theta_star(), y, atol=1e-11)


def test_simulation_agrees_with_python_control():
    u, y = record(4)
    plant = control.tf([1.0, -2.0], [1.0, *A], True)
    _, response = control.forced_response(plant, np.arange(u.size), SEGMENTS(u))
    np.testing.assert_allclose(y, response, atol=1e-11)


# The algorithms ---------------------------------------------------------------------------------------


def test_gradient_is_equation_4_1():
    u, y = record(5, noise=0.3)
    radius, step, offset = 2.0, 0.8, 1.0
    estimator = ProjectionGradient(2, LEVELS, radius=radius, step=step, offset=offset)
    theta = np.zeros(10)
    projected = 0
    for phi, sample in zip(regressors(u, y, 2, LEVELS), zip(u, y, strict=True), strict=True):
        error = sample[1] - phi @ theta
        assert estimator.update(*sample) == pytest.approx(error, abs=1e-12)
        theta = theta + step * phi * error / (offset + phi @ phi)
        if np.linalg.norm(theta) > radius:
            theta *= radius / np.linalg.norm(theta)
            projected += 1
        np.testing.assert_allclose(estimator.theta, theta, atol=1e-12)
    assert projected > 0


def test_kaczmarz_explains_the_newest_sample():
    u, y = record(5, noise=0.3)
    estimator = Kaczmarz(2, LEVELS)
    for sample in zip(u, y, strict=True):
        phi = estimator.regressor
        estimator.update(*sample)
        if np.any(phi):
            assert phi @ estimator.theta == pytest.approx(sample[1], abs=1e-10)


@pytest.mark.parametrize("forgetting", [1.0, 0.97])
def test_least_squares_is_the_batch_solution(forgetting):
    u, y = record(8, noise=0.2)
    covariance, start = 50.0, np.linspace(-1, 1, 10)
    estimator = RecursiveLeastSquares(
        2, LEVELS, initial_covariance=covariance, forgetting=forgetting, start=start
    )
    estimator.run(u, y)
    rows = regressors(u, y, 2, LEVELS)
    weights = np.sqrt(forgetting ** np.arange(u.size - 1, -1, -1.0))
    prior = np.sqrt(forgetting**u.size / covariance)
    stacked = np.vstack([rows * weights[:, None], prior * np.eye(10)])
    target = np.concatenate([y * weights, prior * start])
    expected = np.linalg.lstsq(stacked, target, rcond=None)[0]
    # Both are backward stable; the condition of the rows is below 1e3.
    np.testing.assert_allclose(estimator.theta, expected, atol=1e-11)
    np.testing.assert_allclose(
        estimator.covariance, np.linalg.inv(stacked.T @ stacked), rtol=1e-8, atol=1e-12
    )


@pytest.mark.parametrize("kind", KINDS)
def test_run_and_update_give_the_same_bits(kind):
    u, y = record(6, noise=0.2)
    one, many = made(kind), made(kind)
    errors = [one.update(*sample) for sample in zip(u, y, strict=True)]
    kept, found = many.run(u, y, every=7)
    np.testing.assert_array_equal(errors, found)
    np.testing.assert_array_equal(one.theta, many.theta)
    np.testing.assert_array_equal(kept[-1], many.theta)
    assert kept.shape == (u.size // 7, 10)
    assert one.samples == many.samples == u.size


@pytest.mark.parametrize("kind", KINDS)
def test_a_restored_state_goes_on_to_the_bit(kind):
    u, y = record(6, noise=0.2)
    estimator = made(kind)
    estimator.run(u[:37], y[:37])
    again = Recursive.from_json(estimator.to_json())
    assert type(again) is type(estimator)
    for each in (estimator, again):
        each.run(u[37:], y[37:])
    np.testing.assert_array_equal(estimator.theta, again.theta)
    assert again.samples == u.size
    assert again.to_json() == estimator.to_json()


def test_an_infinite_radius_survives_json():
    again = ProjectionGradient.from_json(ProjectionGradient(1, [1.0, 2.0]).to_json())
    assert again.radius == math.inf


def test_least_squares_survives_forgetting_everything():
    estimator = RecursiveLeastSquares(2, LEVELS, forgetting=0.5)
    u, y = record(4)
    estimator.run(u, y)
    before = estimator.theta
    estimator.restart()
    estimator.run(np.zeros(20_000), np.zeros(20_000))
    np.testing.assert_allclose(estimator.theta, before, atol=1e-9)


def test_every_algorithm_finds_the_plant():
    u, y = record(1800)
    for estimator in (ProjectionGradient(2, LEVELS, radius=50.0), Kaczmarz(2, LEVELS)):
        estimator.run(u, y)
        np.testing.assert_allclose(estimator.theta, theta_star(), atol=1e-8)
    fast = RecursiveLeastSquares(2, LEVELS)
    fast.run(u[:100], y[:100])
    np.testing.assert_allclose(fast.theta, theta_star(), atol=1e-6)


# Bad input --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Kaczmarz(0, LEVELS), "order is 0"),
        (lambda: Kaczmarz(2, [1.0, 0.0]), "one of the levels is 0"),
        (lambda: Kaczmarz(2, [1.0, 1.0]), "not distinct"),
        (lambda: Kaczmarz(2, [np.nan]), "finite numbers"),
        (lambda: Kaczmarz(2, "no"), "sequence of numbers"),
        (lambda: Kaczmarz(2, LEVELS, start=[1.0]), "give 10 finite numbers"),
        (lambda: Kaczmarz(2, LEVELS, step=2.0), r"outside \(0, 2\)"),
        (lambda: ProjectionGradient(2, LEVELS, radius=0.0), "radius is 0"),
        (lambda: ProjectionGradient(2, LEVELS, offset=-1.0), "offset is -1"),
        (lambda: RecursiveLeastSquares(2, LEVELS, forgetting=1.1), "forgetting factor is 1.1"),
        (lambda: RecursiveLeastSquares(2, LEVELS, initial_covariance=0.0), "initial covariance is 0"),
        (lambda: Kaczmarz(2, LEVELS).run([0.0], [0.0], every=0), "every is 0"),
    ],
)
def test_a_wrong_setting_is_named(make, message):
    with pytest.raises(UsageError, match=message):
        make()


@pytest.mark.parametrize(
    ("u", "y", "message"),
    [
        ([0.0, 2.0], [0.0, 0.0], "input value 1 is 2, which is none of the levels -6, -3, 0, 3, 6"),
        ([0.0, 3.0], [0.0, np.nan], "output value 1 is nan"),
        ([0.0, np.inf], [0.0, 0.0], "input value 1 is inf"),
        ([0.0], [0.0, 0.0], r"shape \(1,\) and output of shape \(2,\) differ"),
        (["a"], [0.0], "sequences of numbers"),
    ],
)
def test_a_wrong_record_is_named(u, y, message):
    with pytest.raises(DataError, match=message):
        Kaczmarz(2, LEVELS).run(u, y)


def test_a_wrong_sample_leaves_the_estimate_alone():
    estimator = Kaczmarz(2, LEVELS)
    estimator.update(3.0, 1.0)
    before = estimator.to_json()
    for sample, message in (
        ((2.5, 0.0), "none of the levels"),
        ((3.0, math.nan), "output value 1 is nan"),
        ((None, 1.0), r"sample 1 is \(u, y\) = \(None, 1.0\)"),
    ):
        with pytest.raises(DataError, match=message):
            estimator.update(*sample)
    assert estimator.to_json() == before
    assert estimator.update(3.0 + 1e-12, 0.0) == 0.0  # rounding of a level is no error


def damaged(**changes):
    return json.dumps({**json.loads(made("recursive-least-squares").to_json()), **changes})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not JSON"),
        ("[]", "schema"),
        (damaged(schema=2), "schema"),
        (damaged(algorithm="magic"), "'magic'"),
        (damaged(theta=[1.0]), "damaged"),
        (damaged(settings={}), "damaged"),
        (damaged(order=-1), "damaged"),
    ],
)
def test_a_damaged_state_is_refused(text, message):
    with pytest.raises(ModelError, match=message):
        Recursive.from_json(text)


def test_a_state_of_another_algorithm_is_refused():
    with pytest.raises(ModelError, match="RecursiveLeastSquares cannot restore"):
        RecursiveLeastSquares.from_json(made("kaczmarz").to_json())


# Recovery ---------------------------------------------------------------------------------------------

numbers = st.floats(-5, 5).filter(lambda value: abs(value) > 0.1)


@given(st.lists(numbers, min_size=1, max_size=4), st.lists(numbers, min_size=4, max_size=4))
def test_a_product_is_taken_apart(b, d):
    product = np.outer(b, d)
    for normalisation in ("first", "unit-norm"):
        found = rank_one(product, normalisation)
        np.testing.assert_allclose(np.outer(found.b, found.d), product, atol=1e-12 * np.abs(product).max())
        assert found.ratio < 1e-14
    assert np.linalg.norm(found.b) == pytest.approx(1.0)
    assert found.b[np.argmax(np.abs(found.b))] > 0
    assert rank_one(product).b[0] == pytest.approx(1.0)


def test_what_cannot_be_taken_apart_is_named():
    with pytest.raises(IdentifiabilityError, match="all zero"):
        rank_one(np.zeros((2, 4)))
    with pytest.raises(IdentifiabilityError, match="'unit-norm'"):
        rank_one([[0.0, 0.0], [1.0, 2.0]])
    with pytest.raises(UsageError, match="'unit'"):
        rank_one([[1.0]], "unit")


def exact(segments, levels=LEVELS):
    d = interpolation_coefficients(levels, segments)
    return Snapshot(0, np.concatenate([A, np.outer(d, B).ravel()]), 2, tuple(levels))


@pytest.mark.parametrize(
    ("structure", "segments"),
    [
        ("dead-zone", Segments(0.7, 1.9, 1.2, -0.4)),
        ("preload", Segments(0.7, -1.9, 0.0, 0.0, 0.6, 1.3)),
        ("symmetric", Segments(0.7, 1.9, 1.2, -1.2, 0.6, -0.6)),
    ],
)
def test_each_class_is_recovered(structure, segments):
    found = recover(exact(segments), structure)
    assert found.note == ""
    for name, value in segments.__dict__.items():
        assert getattr(found.segments, name) == pytest.approx(value, abs=1e-12), name
    unit = recover(exact(segments), structure, "unit-norm")
    np.testing.assert_allclose(unit.D1, segments.D1, atol=1e-12)  # the gain cancels
    np.testing.assert_allclose(unit.K1, -math.sqrt(5.0) * segments.K1, rtol=1e-12)


def test_outside_the_classes_only_slopes_and_offsets_are_returned():
    found = recover(exact(SEGMENTS))
    np.testing.assert_allclose([found.K1, found.K2, found.H1, found.H2], [1.0, 2.0, 0.0, 2.0], atol=1e-12)
    assert all(math.isnan(getattr(found, name)) for name in ("D1", "D2", "L1", "L2"))
    with pytest.raises(IdentifiabilityError, match="D1, D2, L1, L2 are not identifiable"):
        _ = found.segments


def test_more_levels_give_a_line_by_least_squares():
    levels = (-6.0, -4.0, -3.0, 3.0, 5.0, 6.0)
    found = recover(exact(SEGMENTS, levels))
    np.testing.assert_allclose([found.K1, found.K2, found.H1, found.H2], [1.0, 2.0, 0.0, 2.0], atol=1e-12)


def test_degenerate_classes_are_named():
    same = recover(exact(Segments(1.0, 1.0, 1.0, -1.0, 0.5, -0.5)), "symmetric")
    assert "K1 = K2" in same.note
    flat = recover(exact(Segments(0.0, 1.0, 0.5, -0.5)), "dead-zone")
    assert flat.note.startswith("D1 not identifiable")
    with pytest.raises(IdentifiabilityError, match="negative side has 1"):
        recover(exact(SEGMENTS, (-6.0, 3.0, 6.0)))
    with pytest.raises(UsageError, match="'other'"):
        recover(exact(SEGMENTS), "other")


def test_the_linear_part_is_a_transfer_function():
    found = recover(exact(SEGMENTS)).transfer_function(0.1)
    np.testing.assert_allclose(np.sort(found.poles().real), [0.7, 0.8], atol=1e-9)
    assert found.zeros().real == pytest.approx([2.0])
    assert found.dt == 0.1


def test_structured_least_squares_against_a_general_optimiser():
    u, y = record(6, noise=0.5)
    estimator = RecursiveLeastSquares(2, LEVELS)
    estimator.run(u, y)
    factor, target = estimator.triangle

    def theta(x):
        return np.concatenate([x[:2], np.outer(x[3:], [1.0, x[2]]).ravel()])

    start = recover(estimator.snapshot())
    peer = least_squares(
        lambda x: factor @ theta(x) - target,
        [*start.a, start.b[1], *start.d],
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-12,
    )
    np.testing.assert_allclose(structured(estimator).theta, theta(peer.x), atol=1e-6)
    assert rank_one(structured(estimator).composite).ratio < 1e-14


def test_structured_least_squares_of_a_first_order_plant():
    estimator = RecursiveLeastSquares(1, LEVELS)
    estimator.run(*record(6, noise=0.1))
    np.testing.assert_array_equal(structured(estimator).theta, estimator.theta)


# Excitation and convergence ---------------------------------------------------------------------------


def test_the_steady_state_is_where_a_long_run_ends():
    u, y = record(60)
    rows, output = stationary_period(
        A, np.outer(B, interpolation_coefficients(LEVELS, SEGMENTS)), u[:14], LEVELS
    )
    np.testing.assert_allclose(output, y[-14:], atol=1e-10)  # 0.8^840 is nothing
    np.testing.assert_allclose(rows, regressors(u, y, 2, LEVELS)[-14:], atol=1e-10)


def test_the_rate_is_that_of_a_run():
    u, y = record(1500)
    rows, _ = stationary_period(A, np.outer(B, interpolation_coefficients(LEVELS, SEGMENTS)), u[:14], LEVELS)
    for step, offset in ((1.0, 1.0), (1.5, 3.0)):
        estimator = ProjectionGradient(2, LEVELS, step=step, offset=offset)
        kept, _ = estimator.run(u, y, every=14)
        error = np.linalg.norm(kept - theta_star(), axis=1)
        simulated = (error[1450] / error[1350]) ** 0.01  # one mode is left
        assert convergence_rate(rows, step, offset) == pytest.approx(simulated, rel=1e-6)
    direct = np.eye(10)
    for row in rows:
        direct = (np.eye(10) - np.outer(row, row) / (1 + row @ row)) @ direct
    np.testing.assert_allclose(transition_matrix(rows), direct, atol=1e-12)


def test_averaging_is_right_for_small_steps_alone():
    u, _ = record(1)
    rows, _ = stationary_period(A, np.outer(B, interpolation_coefficients(LEVELS, SEGMENTS)), u, LEVELS)
    for step, tolerance in ((1e-3, 1e-3), (1.0, None)):
        ratio = math.log(averaged_rate(rows, step)) / math.log(convergence_rate(rows, step))
        assert ratio == pytest.approx(1.0, rel=tolerance) if tolerance else ratio < 0.7


def test_excitation_of_a_period():
    rows = regressors(*record(2), 2, LEVELS)[14:]
    found = excitation_of(rows)
    assert found.persistent
    found.require()
    assert found.smallest == pytest.approx(np.linalg.svd(rows, compute_uv=False)[-1])
    scaled = excitation_of(rows * np.array([1e-6] * 2 + [1e6] * 8))
    assert scaled.rank == 10  # units do not matter
    poor = excitation_of(rows[:, [0, 1, 2, 2]])
    assert poor.rank == 3
    with pytest.raises(IdentifiabilityError, match="3 of 4 directions"):
        poor.require()
    with pytest.raises(DataError, match="finite rows"):
        excitation_of(np.full((3, 2), np.nan))
    assert excitation_of(rows[:4]).rank <= 4


def test_no_steady_state_where_there_is_none():
    with pytest.raises(ModelError, match="largest pole has modulus"):
        stationary_period([-1.1], [[1.0, 1.0]], [1.0, -1.0, 0.0], [1.0, -1.0])
    with pytest.raises(DataError, match="shorter than the order"):
        stationary_period([0.1, 0.1], np.ones((2, 2)), [1.0], [1.0, -1.0])


# A whole record ---------------------------------------------------------------------------------------


def test_a_record_is_identified_in_one_call():
    u, y = record(30, noise=0.05)
    found = identify_levels(u, y, 2)
    np.testing.assert_allclose(found.a, A, atol=0.01)  # some standard errors at this noise
    np.testing.assert_allclose([found.K1, found.K2], [1.0, 2.0], atol=0.05)
    again = identify_levels(u, y, 2, levels=LEVELS)
    np.testing.assert_array_equal(found.d, again.d)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda u, y: (u[5:14], y[5:14]), "9 samples cannot determine 8 parameters of order 2 with 3 levels"),
        (lambda u, y: (np.where(u > 3, u, 0.0), np.zeros_like(y)), "excites 2 of 4 directions"),
        (lambda u, y: (np.abs(u), y), "negative side has 0"),
    ],
)
def test_a_record_that_cannot_be_identified_is_named(change, message):
    with pytest.raises(IdentifiabilityError, match=message):
        identify_levels(*change(*record(6, noise=0.1)), 2)


def test_a_record_without_input_is_named():
    with pytest.raises(UsageError, match="levels are"):
        identify_levels(np.zeros(30), np.ones(30), 2)
