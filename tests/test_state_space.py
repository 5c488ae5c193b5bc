"""Subspace estimates and state-space fits: exact systems, noise of every colour, several channels."""

import numpy as np
import pytest

from sysid.data import make_record
from sysid.errors import DataError, IdentifiabilityError, UsageError
from sysid.linear import fit_output_error, fit_state_space, simulate_state_space
from sysid.linear.sections import sections_of
from sysid.linear.state_space_starts import changed, with_poles
from sysid.linear.subspace import INSTRUMENTS, PAST_INPUTS, PAST_OUTPUTS, Run, factorise, stabilised

POLES = np.array([0.8 + 0.4j, 0.8 - 0.4j, 0.6, 0.95])


def system(order, n_inputs, n_outputs, rng):
    """A stable system of one complex pair and real poles, in random coordinates."""
    A = np.zeros((4, 4))
    A[:2, :2] = [[0.8, 0.4], [-0.4, 0.8]]
    A[2, 2], A[3, 3] = 0.6, 0.95
    A = A[:order, :order]
    T = rng.standard_normal((order, order)) + 2.0 * np.eye(order)
    B, C = rng.standard_normal((order, n_inputs)), rng.standard_normal((n_outputs, order))
    return T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T)


def simulated(order, n_inputs, n_outputs, seed=0, n=2000, noise=0.0, colour=0.0, start=False):
    rng = np.random.default_rng(seed)
    A, B, C = system(order, n_inputs, n_outputs, rng)
    u = rng.standard_normal((n, n_inputs))
    x0 = rng.standard_normal(order) if start else np.zeros(order)
    y = simulate_state_space(A, B, C, np.zeros((n_outputs, n_inputs)), u, x0)
    e = noise * y.std(axis=0) * rng.standard_normal(y.shape)
    for k in range(1, n):
        e[k] += colour * e[k - 1]
    return u, y, e


def nearest(found, expected):
    return max(np.abs(found - pole).min() for pole in expected)


@pytest.mark.parametrize("instruments", INSTRUMENTS)
@pytest.mark.parametrize("channels", [(1, 1), (2, 3), (3, 1)])
@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_exact_data_give_the_exact_poles(order, channels, instruments):
    u, y, _ = simulated(order, *channels, n=600)
    factor = factorise([Run(u, y, np.ones(600, dtype=bool))], 8)
    _, sizes = factor.observability(instruments)
    assert sizes[order] < 1e-9 * sizes[0]  # the order is the rank
    found = np.linalg.eigvals(factor.dynamics(instruments, order)[0])
    expected = POLES[:order] if order > 1 else np.array([0.8])
    assert nearest(found, expected) < 1e-7


def test_past_inputs_are_consistent_in_coloured_noise_and_past_outputs_are_not_worse_in_white():
    errors = {kind: [] for kind in INSTRUMENTS}
    for seed in range(12):
        u, y, e = simulated(2, 1, 1, seed=seed, n=8000, noise=0.3, colour=0.9)
        factor = factorise([Run(u, y + e, np.ones(8000, dtype=bool))], 10)
        for kind in INSTRUMENTS:
            found = np.linalg.eigvals(factor.dynamics(kind, 2)[0])
            errors[kind].append(found[np.argmax(found.imag)] - (0.8 + 0.4j))
    mean = {kind: abs(np.mean(values)) for kind, values in errors.items()}
    spread = np.std(errors[PAST_INPUTS]) / np.sqrt(12)
    assert mean[PAST_INPUTS] < 4.0 * spread  # no bias beyond chance
    assert mean[PAST_OUTPUTS] > mean[PAST_INPUTS]  # its instruments hold the noise, which is no innovation


def test_error_falls_with_the_square_root_of_the_record():
    sizes = []
    for n in (1000, 16_000):
        found = []
        for seed in range(8):
            u, y, e = simulated(2, 1, 2, seed=seed, n=n, noise=0.2)
            factor = factorise([Run(u, y + e, np.ones(n, dtype=bool))], 10)
            found.append(nearest(np.linalg.eigvals(factor.dynamics(PAST_INPUTS, 2)[0]), POLES[:2]))
        sizes.append(np.median(found))
    assert 2.0 < sizes[0] / sizes[1] < 8.0  # four, give or take a median of eight


def test_eigenvalues_outside_the_circle_are_mirrored():
    T = np.array([[1.0, 0.3, 0.0], [0.2, 1.0, 0.5], [0.0, 0.1, 1.0]])
    A = T @ np.array([[1.2, 0.5, 0.0], [-0.5, 1.2, 0.0], [0.0, 0.0, 0.7]]) @ np.linalg.inv(T)
    mirrored = (1.2 + 0.5j) / abs(1.2 + 0.5j) ** 2
    assert nearest(np.linalg.eigvals(stabilised(A)), [mirrored, 0.7]) < 1e-12
    assert stabilised(0.5 * np.eye(2)).tolist() == [[0.5, 0.0], [0.0, 0.5]]


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_slopes_are_those_of_differences_and_response_is_that_of_the_matrices(order):
    rng = np.random.default_rng(order)
    A, _, C = system(order, 2, 2, rng)
    run = Run(rng.standard_normal((30, 2)), rng.standard_normal((30, 2)), np.ones(30, dtype=bool))
    model = sections_of(A, C, 2, direct=True, constant=True, free_start=True)
    free = model.free()
    values = model.vector()
    values[free] += 0.1 * rng.standard_normal(int(free.sum()))
    model = model.with_vector(values)
    y, J = model.slopes(run, 0)
    A, B, C, D = model.matrices()
    driven = np.column_stack([B, model.drift]), C, np.column_stack([D, model.offset])
    u = np.column_stack([run.u, np.ones(30)])
    expected = simulate_state_space(A, *driven, u, model.starts[0].ravel()[:order])
    np.testing.assert_allclose(y, expected, atol=1e-12)
    np.testing.assert_allclose(model.response(run.u, model.starts[0]), expected, atol=1e-12)
    for i in np.flatnonzero(free):
        step = np.zeros(values.size)
        step[i] = 1e-6
        sides = [model.with_vector(values + sign * step) for sign in (1.0, -1.0)]
        upper, lower = (side.slopes(run, 0)[0] for side in sides)
        np.testing.assert_allclose(J[:, :, i], (upper - lower) / 2e-6, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("channels", [(1, 1), (2, 2), (1, 3)])
@pytest.mark.parametrize("initial_state", ["rest", "estimate"])
def test_several_inputs_and_outputs_are_fitted_to_the_noise(channels, initial_state):
    u, y, e = simulated(4, *channels, noise=0.1, start=initial_state == "estimate")
    split = np.repeat(["train", "test"], [1500, 500])
    record = make_record(u, y + e, 0.1, split=split)
    fit = fit_state_space(record, 4, initial_state=initial_state)
    assert fit.converged
    # 1500 rows tell the size of the noise within 2 %, and 4 (m + p) unknowns take off less than that.
    np.testing.assert_allclose(fit.rms, 0.1 * y.std(axis=0), rtol=0.08)
    free_run = fit.predict(record).free_run.reshape(y.shape)
    assert np.all(np.std((free_run - y)[1500:], axis=0) < 0.02 * y.std(axis=0))
    assert nearest(fit.poles, POLES) < 0.05


def test_one_output_is_fitted_as_well_as_by_the_search_over_poles():
    u, y, e = simulated(3, 1, 1, noise=0.2, seed=3)
    record = make_record(u, y + e, 0.1)
    fit, other = fit_state_space(record, 3), fit_output_error(record, 3)
    # The offset of the output and the constant of the equation are the same model.
    assert fit.rms[0] == pytest.approx(other.rms, rel=1e-4)
    assert nearest(fit.poles, other.poles) < 1e-3
    assert nearest(fit_state_space(record, 3, direct=True).poles, other.poles) < 0.05


def test_a_double_integrator_with_friction_is_fitted_as_well_as_by_the_search_over_poles():
    # Poles at 1 and next to it, and a constant force: what a position record of a drive looks like.
    rng = np.random.default_rng(11)
    u = np.repeat(rng.choice([-1.0, 1.0], 60), 50)
    A, B = np.array([[1.0, 0.0297], [0.0, 0.98]]), np.array([[0.0], [0.02]])
    y = simulate_state_space(A, B, [[1.0, 0.0]], [[0.0]], u[:, np.newaxis] + 0.1)[:, 0]
    record = make_record(u, y + 1e-3 * y.std() * rng.standard_normal(y.size), 0.01)
    for order in (2, 3):
        fit, other = fit_state_space(record, order), fit_output_error(record, order)
        assert fit.converged
        assert fit.restarts_agree
        assert fit.rms[0] == pytest.approx(other.rms, rel=1e-6)
    assert fit.rms[0] < 1.02e-3 * y.std()


def test_a_start_with_given_poles_is_exact_without_noise():
    u, y, _ = simulated(4, 2, 3, seed=4, start=True)
    run = Run(u, y, np.ones(y.shape[0], dtype=bool))
    A, _, C = system(4, 2, 3, np.random.default_rng(9))  # the same poles, read otherwise
    like = sections_of(A, C, 2, direct=False, constant=True, free_start=True)
    model = with_poles(like, POLES, [run], 1.0 / y.std(axis=0))
    np.testing.assert_allclose(model.response(u, model.starts[0]), y, atol=1e-7 * y.std())


def test_poles_are_changed_within_the_unit_circle_and_stay_pairs():
    rng = np.random.default_rng(1)
    for _ in range(20):
        moved = changed(POLES, rng)
        assert np.all(np.abs(moved) < 1.0)
        assert np.poly(moved).imag == pytest.approx(0.0, abs=1e-12)
        assert moved.size == POLES.size


def test_starts_that_disagree_call_for_more_until_two_agree():
    # A weak resonance beside a strong slow mode: the subspace estimates lead to different ends at order 2.
    u, y, e = simulated(4, 1, 2, noise=0.3, colour=0.95, seed=12, n=500)
    fit = fit_state_space(make_record(u, y + e, 0.1), 2)
    assert "searches from different starts" in fit.status
    assert fit.restarts_agree == ("disagree" not in fit.status)


@pytest.mark.parametrize(("order", "channels"), [(2, (1, 1)), (3, (2, 2))])
def test_the_order_is_found(order, channels):
    u, y, e = simulated(order, *channels, noise=0.05, seed=5)
    fit = fit_state_space(make_record(u, y + e, 0.1))
    assert fit.order == order
    assert set(fit.validation) >= {1, 2, 3}
    assert "order chosen from" in fit.status
    assert f"order {order}" in repr(fit)


def test_the_fit_is_stable_whatever_the_data():
    rng = np.random.default_rng(7)
    u = rng.standard_normal(300)
    growing = np.empty(300)
    growing[0] = 0.0
    for k in range(1, 300):
        growing[k] = 1.02 * growing[k - 1] + u[k - 1]
    fit = fit_state_space(make_record(u, growing, 1.0), 3)
    assert np.abs(fit.poles).max() <= 1.0


def test_experiments_have_their_own_states_and_test_rows_are_not_touched():
    u, y, e = simulated(2, 1, 2, n=900, noise=0.02, start=True, seed=8)
    experiment = np.repeat(["a", "b", "c"], 300)
    split = np.repeat(["train", "train", "test"], 300)
    measured = y + e
    fits = []
    for change in (0.0, np.nan):
        measured[600:, 1] += change
        record = make_record(u, measured, 0.1, experiment=experiment, split=split, skip=30)
        fits.append(fit_state_space(record, 2))
    np.testing.assert_array_equal(fits[0].A, fits[1].A)
    prediction = fits[0].predict(record)
    assert prediction.free_run.shape == (900, 2)
    assert prediction.one_step.shape == (900, 2)
    assert np.isfinite(prediction.free_run).all()
    assert np.std(prediction.free_run[640:, 0] - y[640:, 0]) < 0.02 * y[:, 0].std()


def test_bad_requests_are_refused():
    u, y, _ = simulated(2, 1, 1, n=100)
    record = make_record(u, y, 0.1)
    for action, kind, message in [
        (lambda: fit_state_space(u), UsageError, "record is of type ndarray"),
        (lambda: fit_state_space(record, 0), UsageError, "order is 0"),
        (lambda: fit_state_space(record, 2.5), UsageError, "give a whole number"),
        (lambda: fit_state_space(record, 2, initial_state="zero"), UsageError, "choose estimate or rest"),
        (lambda: fit_state_space(record, 30), IdentifiabilityError, "lower the order"),
        (lambda: fit_state_space(record, 2, rows=np.zeros(100, dtype=bool)), DataError, "no row is chosen"),
    ]:
        with pytest.raises(kind, match=message):
            action()
    wide = make_record(np.column_stack([u, u]), y, 0.1)
    with pytest.raises(UsageError, match="the record has 2 inputs"):
        fit_state_space(record, 2).predict(wide)
