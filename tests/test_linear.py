"""Linear models against peers: scipy's filters and optimiser, finite differences, python-control."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy import signal
from scipy.optimize import least_squares

from benchmarks.hidden_effects.plan import assign
from sysid.data import make_record, read_record
from sysid.errors import DataError, IdentifiabilityError, ModelError, UsageError
from sysid.linear import (
    choose_output_error,
    fit_output_error,
    predict,
    simulate_polynomial,
    simulate_state_space,
)
from sysid.linear.forms import (
    denominator,
    kautz_numerators,
    poles_of,
    reflections_from_poles,
    section_coefficients,
)
from sysid.linear.output_error import make_segments
from sysid.linear.reduction import BLOCK_ROWS, Reduction, Structure
from sysid.linear.responses import responses
from sysid.linear.restarts import same_error, same_output
from sysid.linear.uncertainty import autoregression

A2, B2 = [1.0, -1.5, 0.7], [0.0, 1.0, 0.5]


def simulated(n=1000, noise=0.05, seed=0, a=A2, b=B2, **keywords):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(n)
    y = signal.lfilter(b, a, u) + noise * rng.standard_normal(n)
    return make_record(u, y, period=0.1, **keywords)


# Simulation


@pytest.mark.parametrize("order", [0, 1, 2, 5])
def test_polynomial_simulation_is_that_of_lfilter(order):
    rng = np.random.default_rng(order)
    a = np.poly(rng.uniform(-0.9, 0.9, order)) if order else np.ones(1)
    b, u, state = rng.standard_normal(order + 1), rng.standard_normal(300), rng.standard_normal(order)
    expected = signal.lfilter(b, a, u, zi=state)[0]
    # The same recursion in the same precision: rounding only.
    np.testing.assert_allclose(simulate_polynomial(b, a, u, state), expected, rtol=1e-12, atol=1e-12)


def test_state_space_simulation_is_that_of_dlsim():
    rng = np.random.default_rng(1)
    A, B, C, D = (
        0.3 * rng.standard_normal((3, 3)),
        rng.standard_normal((3, 2)),
        rng.standard_normal((2, 3)),
        np.eye(2),
    )
    u, start = rng.standard_normal((200, 2)), rng.standard_normal(3)
    expected = signal.dlsim((A, B, C, D, 1.0), u, x0=start)[1]
    np.testing.assert_allclose(simulate_state_space(A, B, C, D, u, start), expected, rtol=1e-11, atol=1e-11)


def test_simulation_refuses_what_does_not_fit():
    with pytest.raises(ModelError, match="it must be 1"):
        simulate_polynomial([1.0], [2.0, 1.0], np.ones(3))
    with pytest.raises(ModelError, match="1 are needed"):
        simulate_polynomial([1.0], [1.0, 1.0], np.ones(3), [0.0, 0.0])
    with pytest.raises(ModelError, match="shapes"):
        simulate_state_space(np.eye(2), np.ones((3, 1)), np.ones((1, 2)), np.ones((1, 1)), np.ones((4, 1)))


# Forms of the denominator


@pytest.mark.parametrize("order", range(1, 9))
def test_reflections_and_poles_go_back_and_forth(order):
    rng = np.random.default_rng(order)
    pairs = rng.uniform(0.2, 0.95, order // 2) * np.exp(1j * rng.uniform(0.1, 3.0, order // 2))
    poles = np.concatenate([pairs, pairs.conj(), rng.uniform(-0.9, 0.9, order % 2)])
    reflections = reflections_from_poles(poles)
    assert np.abs(reflections).max() < 1.0
    np.testing.assert_allclose(denominator(reflections), np.poly(poles).real, atol=1e-13)
    np.testing.assert_allclose(np.poly(poles_of(reflections)).real, np.poly(poles).real, atol=1e-12)


def test_unstable_poles_are_mirrored():
    poles = np.array([1.25, 0.8 + 1.2j, 0.8 - 1.2j])
    assert np.abs(poles_of(reflections_from_poles(poles))).max() < 1.0
    np.testing.assert_allclose(np.abs(poles_of(reflections_from_poles(np.array([1.25 + 0j])))), 0.8)


def test_box_of_reflections_is_the_set_of_stable_sections():
    rng = np.random.default_rng(0)
    for k1, k2 in rng.uniform(-1.5, 1.5, (500, 2)):
        a1, a2 = section_coefficients(np.array([k1, k2]))
        stable = np.abs(np.roots([1.0, a1[0], a2[0]])).max() < 1.0
        assert stable == (abs(k1) < 1.0 and abs(k2) < 1.0)


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_columns_are_their_numerators_over_a_and_orthogonal(order):
    rng = np.random.default_rng(order)
    pairs = 0.9 * np.exp(1j * rng.uniform(0.3, 2.5, order // 2))
    reflections = reflections_from_poles(np.concatenate([pairs, pairs.conj(), [0.7] * (order % 2)]))
    structure = Structure(order, 1, False, True)
    u = rng.standard_normal((2000, 1))
    columns = np.vstack([responses(u, structure, reflections, row)[0] for row in np.eye(order)])
    delayed = np.concatenate([u[:1, 0], u[:-1, 0]])
    for column, numerator in zip(columns, kautz_numerators(reflections), strict=True):
        expected = signal.lfilter(numerator, denominator(reflections), delayed)
        np.testing.assert_allclose(column, expected, rtol=1e-9, atol=1e-9)
    impulse = responses(np.zeros((2000, 1)), structure, reflections, np.zeros(order))[1]
    gram = impulse @ impulse.T
    # Kautz functions are orthogonal; 0.9^2000 is left out by cutting the sum.
    np.testing.assert_allclose(gram - np.diag(np.diag(gram)), 0.0, atol=1e-9 * np.diag(gram).max())


# Elimination of the linear parameters


def dense_problem(record, structure, reflections, rows):
    """Return the dense regressors and outputs of all experiments."""
    blocks, outputs = [], []
    segments = make_segments(record, rows)
    n_shared = structure.n_shared(record.u.shape[1])
    for number, segment in enumerate(segments):
        shared = np.vstack([responses(segment.u, structure, reflections, row)[0] for row in np.eye(n_shared)])
        starts = responses(segment.u, structure, reflections, np.zeros(n_shared))[1]
        block = np.zeros((n_shared + len(segments) * structure.order * structure.free_start, segment.y.size))
        block[:n_shared] = shared
        if structure.free_start:
            first = n_shared + number * structure.order
            block[first : first + structure.order] = starts
        blocks.append(block[:, segment.used])
        outputs.append(segment.y[segment.used])
    return np.hstack(blocks).T, np.concatenate(outputs)


STRUCTURES = [
    Structure(1, 1, False, True),
    Structure(2, 1, True, True),
    Structure(3, 0, True, True),
    Structure(2, 4, False, False),
]


@pytest.mark.parametrize("structure", STRUCTURES)
def test_projection_is_that_of_dense_least_squares(structure):
    record = simulated(
        2 * BLOCK_ROWS + 700, experiment=np.repeat(["a", "b"], [BLOCK_ROWS + 300, BLOCK_ROWS + 400])
    )
    reflections = reflections_from_poles(np.linspace(0.5, 0.9, structure.order) + 0j)
    projection = Reduction(make_segments(record, record.estimation), structure, reflections).projection
    X, y = dense_problem(record, structure, reflections, record.estimation)
    weights = np.linalg.lstsq(X, y, rcond=None)[0]
    residual = y - X @ weights
    # Two orthogonal factorisations of the same well-conditioned problem.
    assert projection.cost == pytest.approx(residual @ residual, rel=1e-10)
    np.testing.assert_allclose(projection.shared, weights[: projection.shared.size], rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("structure", STRUCTURES)
def test_gradient_is_that_of_finite_differences(structure):
    record = simulated(900, experiment=np.repeat(["a", "b"], [500, 400]))
    segments = make_segments(record, record.estimation)
    reflections = reflections_from_poles(np.linspace(0.4, 0.9, structure.order) + 0j)
    J, r = Reduction(segments, structure, reflections).linearise()

    def cost(k):
        return Reduction(segments, structure, k).cost

    step = 1e-6
    numeric = [
        (cost(reflections + step * e) - cost(reflections - step * e)) / (2 * step)
        for e in np.eye(structure.order)
    ]
    # The gradient of the eliminated problem is exact; central differences are good to step^2.
    np.testing.assert_allclose(2.0 * J.T @ r, numeric, rtol=2e-5, atol=1e-5 * np.abs(numeric).max())


def test_rows_far_from_the_start_leave_no_trace_of_it():
    record = simulated(3000, split=np.repeat(["test", "train"], [2500, 500]))
    fit = fit_output_error(record, 2)
    np.testing.assert_allclose(fit.a, A2, atol=0.05)
    assert np.isfinite(predict(fit, record).free_run).all()


# Fits


def test_fit_is_that_of_scipy_started_at_the_truth():
    record = simulated(800, noise=0.3, split=["train"] * 800)
    fit = fit_output_error(record, 2, initial_state="rest")
    u, y = record.u[:, 0], record.y[:, 0]

    def residual(p):
        return y - signal.lfilter([0.0, p[2], p[3]], [1.0, p[0], p[1]], u)

    peer = least_squares(residual, [-1.5, 0.7, 1.0, 0.5], xtol=1e-14, ftol=1e-14, gtol=1e-14)
    # Ours stops a thousandth of a standard error from the minimum; the errors are about 1e-2.
    np.testing.assert_allclose([*fit.a[1:], *fit.b[0]], peer.x, atol=1e-5)
    assert fit.rms == pytest.approx(np.sqrt(2 * peer.cost / 800), rel=1e-8)
    sigma = np.sqrt(2 * peer.cost / (800 - 4))
    errors = sigma * np.sqrt(np.diag(np.linalg.inv(peer.jac.T @ peer.jac)))
    # The residual is white, so that the usual formula holds (the autoregression may find order 1 by chance).
    np.testing.assert_allclose(fit.uncertainty.standard_errors, errors, rtol=0.1)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("delay", [0, 1, 3])
def test_noise_free_data_give_the_exact_model(order, delay):
    rng = np.random.default_rng(10 * order + delay)
    pairs = 0.85 * np.exp(1j * rng.uniform(0.2, 2.0, order // 2))
    a = np.poly(np.concatenate([pairs, pairs.conj(), [0.6] * (order % 2)])).real
    b = rng.standard_normal(order + (delay == 0)) + 2.0
    u = rng.standard_normal(500)
    y = signal.lfilter(np.concatenate([np.zeros(delay), b]), a, u)
    fit = fit_output_error(make_record(u, y, 1.0), order, delay=delay, initial_state="rest")
    np.testing.assert_allclose(fit.a, a, atol=1e-6)
    np.testing.assert_allclose(fit.b[0], b, atol=1e-5)


def test_integrator_is_found_at_the_unit_circle():
    rng = np.random.default_rng(3)
    u = np.repeat(rng.standard_normal(200), 50)
    y = signal.lfilter([0.0, 1e-4], np.convolve([1.0, -1.0], [1.0, -0.995]), u) + 1e-3 * rng.standard_normal(
        u.size
    )
    fit = fit_output_error(make_record(u, y, 0.001), 2)
    # The second pole has a standard error of about 1e-5 here.
    np.testing.assert_allclose(np.sort(fit.poles.real), [0.995, 1.0], atol=1e-4)
    assert np.abs(fit.poles).max() <= 1.0


def test_unstable_data_never_give_an_unstable_model():
    rng = np.random.default_rng(0)
    u = rng.standard_normal(400)
    y = signal.lfilter([0.0, 1.0], [1.0, -1.02], u)
    for order in (1, 2, 3):
        fit = fit_output_error(make_record(u, y, 1.0), order)
        assert np.abs(fit.poles).max() <= 1.0 + 1e-12


def test_two_inputs_share_the_poles():
    rng = np.random.default_rng(4)
    u = rng.standard_normal((1500, 2))
    y = signal.lfilter([0.0, 1.0], [1.0, -0.8], u[:, 0]) + signal.lfilter([0.0, -2.0], [1.0, -0.8], u[:, 1])
    fit = fit_output_error(make_record(u, y + 0.01 * rng.standard_normal(1500), 1.0), 1)
    np.testing.assert_allclose(fit.b[:, 0], [1.0, -2.0], atol=0.005)
    assert list(fit.parameters()) == ["a1", "b1_1", "b1_2", "constant"]


def test_initial_states_and_constant_are_estimated():
    rng = np.random.default_rng(5)
    u, pieces = rng.standard_normal(1200), []
    for part, start in zip(np.split(u, 3), (5.0, -3.0, 0.0), strict=True):
        zi = signal.lfiltic(B2, A2, [start, start], [0.0, 0.0])
        pieces.append(signal.lfilter(B2, A2, part, zi=zi)[0] + 2.0)
    y = np.concatenate(pieces) + 0.01 * rng.standard_normal(1200)
    fit = fit_output_error(make_record(u, y, 1.0, experiment=np.repeat([1, 2, 3], 400)), 2)
    np.testing.assert_allclose(fit.a, A2, atol=1e-3)
    assert fit.constant / fit.a.sum() == pytest.approx(2.0, abs=0.01)
    free = predict(fit, make_record(u, y, 1.0, experiment=np.repeat([1, 2, 3], 400))).free_run
    assert np.sqrt(np.mean((y - free) ** 2)) == pytest.approx(0.01, rel=0.1)


def test_estimates_are_consistent_and_standard_errors_calibrated():
    """The spread over 60 records is the stated error, for white and for coloured noise."""
    colour = signal.lfilter([1.0], [1.0, -0.9], np.random.default_rng(9).standard_normal((60, 700)), axis=1)[
        :, 100:
    ]
    for noises in (0.3 * np.random.default_rng(8).standard_normal((60, 600)), 0.2 * colour):
        estimates, errors = [], []
        u = np.random.default_rng(7).standard_normal(600)
        clean = signal.lfilter(B2, A2, u)
        for noise in noises:
            record = make_record(u, clean + noise, 1.0, split=["train"] * 600)
            fit = fit_output_error(record, 2, start=np.roots(A2), constant=False)
            estimates.append([value for value, _ in fit.parameters().values()])
            errors.append(fit.uncertainty.standard_errors)
        spread, stated = np.std(estimates, axis=0, ddof=1), np.mean(errors, axis=0)
        # The standard deviation of 60 draws is known to 1/sqrt(118) = 9 %; four parameters at 3 sigma.
        np.testing.assert_allclose(stated, spread, rtol=0.28)
        bias = np.abs(np.mean(estimates, axis=0) - [-1.5, 0.7, 1.0, 0.5])
        assert (bias < 4.0 * spread / np.sqrt(60)).all()


def test_error_falls_with_the_square_root_of_the_record():
    deviations = [
        np.sqrt(
            np.mean(
                [
                    (fit_output_error(simulated(n, 0.5, seed), 2, start=np.roots(A2)).a - A2) ** 2
                    for seed in range(20)
                ]
            )
        )
        for n in (400, 6400)
    ]
    # A factor 4 is expected; the ratio of two such means over 20 records is known to about 20 %.
    assert 2.2 < deviations[0] / deviations[1] < 7.0


def test_autoregression_recovers_the_colour():
    rng = np.random.default_rng(2)
    runs = [signal.lfilter([1.0], [1.0, -0.5, 0.8], rng.standard_normal(4000)) for _ in range(2)]
    d, std = autoregression(runs)
    np.testing.assert_allclose(d[:3], [1.0, -0.5, 0.8], atol=0.03)  # standard error 0.007
    assert std == pytest.approx(1.0, rel=0.03)
    assert autoregression([rng.standard_normal(4000)])[0].size == 1


def test_restarts_are_reported_and_the_result_reads_well():
    fit = fit_output_error(simulated(), 2)
    assert fit.restarts_agree
    assert "agree" in fit.status
    text = repr(fit)
    assert "order 2, delay 1" in text
    assert "a1" in text
    assert "±" in text


def test_searches_agree_in_output_and_not_in_error_alone():
    # Equal errors of different outputs: two models may miss different halves of what they cannot follow.
    y = np.array([1.0, 1.0, -1.0, -1.0])
    outputs = [np.array([1.0, 1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0, -1.0])]
    costs = [float(np.sum((y - output) ** 2)) for output in outputs]
    assert same_error(*costs, size=2.0)
    assert not same_output(*outputs, costs[0], size=2.0)
    assert same_output(outputs[0], outputs[0] + 0.01, costs[0], size=2.0)
    assert not same_error(1.0, 1.01, size=2.0)
    assert same_error(0.0, 1e-22, size=2.0)  # both exact


def test_output_of_a_reduction_is_that_of_the_fitted_model():
    record = simulated(noise=0.3, seed=5)
    fit = fit_output_error(record, 2)
    reduction = Reduction(make_segments(record, None), fit.structure, fit.reflections)
    output = reduction.output(reduction.projection)
    assert np.sum((record.y[:, 0] - output) ** 2) == pytest.approx(reduction.cost, rel=1e-9)
    # The prediction holds the initial state to the size of the output, a little.
    np.testing.assert_allclose(output, predict(fit, record).free_run, atol=1e-4)


def test_frequency_response_and_poles_are_those_of_python_control():
    control = pytest.importorskip("control")
    fit = fit_output_error(simulated(), 2, constant=False, initial_state="rest")
    peer = control.TransferFunction(fit.b[0], fit.a, 0.1)
    # By imaginary part: the real parts of a pair are equal only up to rounding.
    np.testing.assert_allclose(sorted(peer.poles(), key=np.imag), sorted(fit.poles, key=np.imag), atol=1e-10)
    omega = np.array([1.0, 5.0, 20.0])
    n = 4000
    for frequency in omega:
        # The settled response to a sine is the frequency response.
        t = 0.1 * np.arange(n)
        y = simulate_polynomial([0.0, *fit.b[0]], fit.a, np.cos(frequency * t))
        basis = np.column_stack([np.cos(frequency * t), -np.sin(frequency * t)])[n // 2 :]
        real, imaginary = np.linalg.lstsq(basis, y[n // 2 :], rcond=None)[0]
        assert real + 1j * imaginary == pytest.approx(peer(np.exp(0.1j * frequency)), abs=1e-8)


# Prediction


def test_run_is_continuous_over_all_rows_of_an_experiment():
    record = simulated(600, noise=0.0, split=np.repeat(["train", "val", "test"], 200))
    fit = fit_output_error(record, 2, rows=record.estimation, initial_state="rest")
    np.testing.assert_allclose(predict(fit, record).free_run, record.y[:, 0], atol=1e-5)


def test_fresh_test_experiment_starts_from_its_first_rows_or_from_rest():
    rng = np.random.default_rng(6)
    u = rng.standard_normal(800)
    zi = signal.lfiltic(B2, A2, [8.0, 9.0], [0.0, 0.0])
    y = np.concatenate([signal.lfilter(B2, A2, u[:400]), signal.lfilter(B2, A2, u[400:], zi=zi)[0]])
    y += 0.01 * rng.standard_normal(800)
    how = {"split": np.repeat(["train", "test"], 400), "experiment": np.repeat(["a", "b"], 400)}
    record = make_record(u, y, 1.0, **how)
    prediction = predict(fit_output_error(record, 2), record)
    assert prediction.starts == ("estimated on the rows of the fit", "estimated on the first 20 rows")
    assert np.abs(prediction.free_run[420:] - y[420:]).max() < 0.1
    rest = predict(fit_output_error(record, 2, initial_state="rest"), record)
    assert rest.starts == ("at rest", "at rest")
    assert rest.free_run[400] == 0.0
    hidden = make_record(u, np.where(np.arange(800) < 400, y, np.nan), 1.0, **how)
    assert "no output" in predict(fit_output_error(hidden, 2), hidden).starts[1]


def test_one_step_prediction_uses_the_colour_of_the_residual():
    rng = np.random.default_rng(8)
    record = simulated(4000, noise=0.0)
    noise = signal.lfilter([1.0], [1.0, -0.95], 0.1 * rng.standard_normal(4000))
    record = make_record(record.u, record.y[:, 0] + noise, 1.0)
    prediction = predict(fit_output_error(record, 2), record)
    one_step = np.std(record.y[:, 0] - prediction.one_step)
    assert one_step == pytest.approx(0.1, rel=0.05)
    assert np.std(record.y[:, 0] - prediction.free_run) > 2.0 * one_step


# Choice of structure


@pytest.mark.parametrize(("order", "delay"), [(1, 1), (2, 1), (2, 4), (3, 1), (2, 0)])
def test_structure_is_found(order, delay):
    rng = np.random.default_rng(100 + order + 10 * delay)
    poles = {1: [0.8], 2: [0.75 + 0.4j, 0.75 - 0.4j], 3: [0.7 + 0.5j, 0.7 - 0.5j, 0.5]}[order]
    b = [0.0] * delay + [1.0] + [0.4, 0.3, 0.2][: order - 1 + (delay == 0)]
    u = rng.standard_normal(2000)
    y = signal.lfilter(b, np.poly(poles).real, u)
    y += 0.1 * np.std(y) * rng.standard_normal(2000) + 1.0
    choice = choose_output_error(make_record(u, y, 1.0))
    assert (choice.fit.order, choice.fit.delay) == (order, delay)
    assert f"order {order}" in choice.reason
    assert choice.fit.n_rows == 2000
    assert choice.accepted.n_rows == 1500


def test_test_rows_do_not_touch_the_choice():
    record = simulated(900, split=np.repeat(["train", "test"], [600, 300]))
    y = record.y[:, 0].copy()
    y[600:] = 1e3
    spoiled = make_record(record.u, y, 0.1, split=record.split)
    first, second = choose_output_error(record), choose_output_error(spoiled)
    np.testing.assert_array_equal(first.fit.a, second.fit.a)
    assert first.candidates == second.candidates


def test_given_structure_is_kept():
    choice = choose_output_error(simulated(), order=3, delay=2, constant=False)
    assert (choice.fit.order, choice.fit.delay, choice.fit.structure.constant) == (3, 2, False)
    rest = choose_output_error(simulated(), order=2, delay=1, initial_state="rest")
    assert not rest.fit.structure.constant


def test_bad_requests_are_refused():
    record = simulated(60)
    for keywords, message in [
        ({"order": 0}, "order is 0"),
        ({"order": 2, "delay": -1}, "delay is -1"),
        ({"order": 2, "initial_state": "zero"}, "choose estimate or rest"),
    ]:
        with pytest.raises(UsageError, match=message):
            fit_output_error(record, **keywords)
    with pytest.raises(IdentifiabilityError, match="60 rows cannot determine"):
        fit_output_error(record, 15)
    two = make_record(record.u, np.column_stack([record.y, record.y]), 1.0)
    with pytest.raises(UsageError, match="2 outputs"):
        fit_output_error(two, 1)
    split = np.repeat(["train", "test"], [40, 20])
    holes = make_record(record.u, np.where(np.arange(60) < 50, record.y[:, 0], np.nan), 1.0, split=split)
    with pytest.raises(DataError, match="row 51: the output is missing"):
        fit_output_error(holes, 1, rows=np.ones(60, dtype=bool))


def test_what_is_no_record_order_or_start_is_told():
    record = simulated(60)
    for action, message in [
        (lambda: fit_output_error(record.u, 1), "record is of type ndarray"),
        (lambda: choose_output_error(record.u), "record is of type ndarray"),
        (lambda: fit_output_error(record, "2"), "order is '2': give a whole number"),
        (lambda: fit_output_error(record, 2.5), "order is 2.5: give a whole number"),
        (lambda: choose_output_error(record, order="a"), "order is 'a'"),
        (lambda: fit_output_error(record, 2, constant="no"), "constant is 'no'"),
        (lambda: fit_output_error(record, 2, start=np.array([0.5 + 0j])), "give 2 finite ones"),
        (lambda: fit_output_error(record, 2, rows=np.ones(9, dtype=bool)), "give one True or False for each"),
    ]:
        with pytest.raises(UsageError, match=message):
            action()


def test_a_record_with_other_channels_or_period_is_not_predicted():
    record = simulated(60)
    fit = fit_output_error(record, 1)
    wide = make_record(np.column_stack([record.u, record.u]), record.y, record.period)
    with pytest.raises(UsageError, match="the record has 2 inputs and 1 outputs, the model was fitted to 1"):
        predict(fit, wide)
    slow = make_record(record.u, record.y, 2.0 * record.period)
    with pytest.raises(UsageError, match="resample the record"):
        predict(fit, slow)


@pytest.mark.skipif("SYSID_DATA" not in os.environ, reason="SYSID_DATA names no folder of real records")
@pytest.mark.parametrize(
    ("name", "test_set", "largest"),
    [
        # Free-run test errors of linear baselines measured elsewhere, with 5 % for another order or delay.
        ("emps", "test", 20e-3 * 1.05),
        ("cascaded_tanks", "test", 0.61 * 1.05),
        ("hair_dryer", "test", 0.15 * 0.819 * 1.05),
        ("silverbox", "test_multisine", 6.97e-3 * 1.05),
        ("wiener_hammerstein", "test", 43.3e-3 * 1.05),
    ],
)
def test_real_records_reach_the_known_baselines(name, test_set, largest):
    (path,) = (Path(os.environ["SYSID_DATA"]) / name).glob(f"{name}.csv*")
    record = read_record(path, split="split", experiment="experiment")
    free_run = predict(choose_output_error(record).fit, record).free_run
    rows = record.scored_rows(test_set)
    assert np.sqrt(np.mean((record.y[rows, 0] - free_run[rows]) ** 2)) < largest


def test_a_search_that_ends_at_an_alternating_pole_tries_its_mirror_image():
    # All starts of this third-order record lead to a pole near -1, 1.4 % above the least error.
    case = assign(9002, 100, kind="null").case
    rows = case.sets == "est"
    fit = fit_output_error(make_record(case.u[rows], case.y[rows], period=1.0), 3, initial_state="rest")
    noise = (case.y - case.noise_free)[rows]
    assert np.all(fit.poles.real > 0.0)
    assert rows.sum() * fit.rms**2 < 1.005 * (noise @ noise)
