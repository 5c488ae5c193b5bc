"""Wiener-Hammerstein models: recursions, derivatives, elimination, recovery, intervals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.signal import lfilter
from scipy.stats import chi2

from sysid.data import make_record, read_record
from sysid.errors import IdentifiabilityError, UsageError
from sysid.lft import LinearBlock, WienerHammerstein, choose_wiener_hammerstein, fit_wiener_hammerstein
from sysid.lft.between_samples import interpolation_taps
from sysid.lft.wiener_hammerstein.columns import Columns
from sysid.lft.wiener_hammerstein.reduction import SMOOTHING, Point, Problem, searched_columns
from sysid.linear.reduction import Segment
from sysid.nonlinearities.spline import Spline, spline_basis

FRONT = ([0.2, 0.1, 0.05], [1.0, -1.2, 0.5])
BACK = ([0.0, 0.3, -0.1], [1.0, -1.4, 0.7])


def random_model(rng, orders, oversampling=1, reach=12.0, delay=0):
    def block(order):
        return LinearBlock(rng.uniform(-0.7, 0.7, order), rng.standard_normal(order + 1))

    knots = np.linspace(-reach, reach, 9)
    spline = Spline(knots, rng.standard_normal(knots.size + 2))
    return WienerHammerstein(
        block(orders[0]), spline, block(orders[1]), delay=delay, oversampling=oversampling
    )


def cubic_map(knots=(-8.0, 8.0)):
    """A cubic polynomial: every cubic spline space holds it, so that a fit can be exact."""
    z = np.linspace(knots[0], knots[1], 50)
    return Spline.fitted(z, 0.1 + z - 0.3 * z**2 + 0.02 * z**3, list(knots))


def true_model():
    return WienerHammerstein(
        LinearBlock.from_polynomials(*FRONT), cubic_map(), LinearBlock.from_polynomials(*BACK)
    )


def measured(rng, n_rows, noise, model=None):
    u = rng.standard_normal(n_rows)
    y = (model or true_model()).simulate(u)
    return make_record(u, y + noise * rng.standard_normal(n_rows), period=0.01, units={"u": "V", "y": "V"})


def test_block_is_the_filter_of_its_polynomials():
    block = LinearBlock.from_polynomials(*BACK)
    np.testing.assert_allclose(block.b, BACK[0], atol=1e-14)
    np.testing.assert_allclose(block.a, BACK[1], atol=1e-14)
    w = np.array([0.0, 0.3, 2.0])
    z = np.exp(1j * w)
    np.testing.assert_allclose(block.response(w), np.polyval(BACK[0], z) / np.polyval(BACK[1], z), rtol=1e-13)


@pytest.mark.parametrize("orders", [(3, 3), (2, 4), (1, 0), (0, 2)])
def test_output_is_that_of_scipy_filters(orders):
    # From rest, so that scipy's zero states are right; only rounding differs.
    rng = np.random.default_rng(1)
    model = replace(random_model(rng, orders), resting=True)
    u = rng.standard_normal(500)
    spline = model.map
    clamped = np.concatenate([[spline.knots[0]] * 3, spline.knots, [spline.knots[-1]] * 3])
    static = BSpline(clamped, spline.coefficients, 3)
    z = lfilter(model.front.b, model.front.a, u)
    # The map's value at zero has been there for ever: filter what is beyond it.
    w0 = static(0.0)
    settled = w0 * model.back.b.sum() / model.back.a.sum()
    y = lfilter(model.back.b, model.back.a, static(z) - w0) + settled
    np.testing.assert_allclose(model.map_input(u), z, atol=1e-12)
    np.testing.assert_allclose(model.simulate(u), y, atol=1e-10 * np.abs(y).max())


@pytest.mark.parametrize("oversampling", [1, 2, 3])
@pytest.mark.parametrize("orders", [(3, 3), (2, 4), (1, 0), (0, 2)])
def test_derivatives_are_those_of_finite_differences(orders, oversampling):
    # The knots reach beyond the data: outside the map is smooth once only, and differences see the kink.
    rng = np.random.default_rng(2)
    model = random_model(rng, orders, oversampling, reach=30.0, delay=2)
    u = rng.standard_normal(700)
    problem = Problem((Segment(u[:, np.newaxis], np.zeros(700), np.ones(700, bool)),), model)
    columns = Columns(model, u, derivatives=True)
    rows = np.vstack(
        [columns.next_rows(300), columns.next_rows(400)]
    )  # blocks go on where the last one ended
    exact = rows[:, problem.n_basis :] @ searched_columns(problem, model)
    x, step = problem.start, 1e-5
    differences = np.column_stack(
        [
            (problem.model(x + step * e).simulate(u) - problem.model(x - step * e).simulate(u)) / (2 * step)
            for e in np.eye(x.size)
        ]
    )
    # Truncation (h^2 times a third derivative) and rounding (1e-16/h) are both about 1e-9 of the largest.
    np.testing.assert_allclose(exact, differences, atol=1e-7 * np.abs(exact).max())
    np.testing.assert_allclose(
        rows[:, : problem.n_basis] @ model.map.coefficients, model.simulate(u), atol=1e-12
    )


def test_map_is_eliminated_as_by_dense_least_squares():
    rng = np.random.default_rng(3)
    model = replace(random_model(rng, (2, 2), reach=4.0), resting=True)
    u, y = rng.standard_normal(6000), rng.standard_normal(6000)
    used = rng.random(6000) < 0.9
    problem = Problem((Segment(u[:, np.newaxis], y, used),), model)
    z = lfilter(model.front.b, model.front.a, u)
    at_rest = spline_basis([0.0], model.map.knots)
    settled = at_rest * model.back.b.sum() / model.back.a.sum()
    basis = lfilter(model.back.b, model.back.a, spline_basis(z, model.map.knots) - at_rest, axis=0) + settled
    dense = np.linalg.lstsq(basis[used], y[used], rcond=None)
    point = Point(problem, problem.start)
    # The smoothing of the map shifts coefficients by about its squared weight over their information.
    assert SMOOTHING**2 < 1e-9
    np.testing.assert_allclose(point.cost, dense[1][0], rtol=1e-9)
    np.testing.assert_allclose(point.model.map.coefficients, dense[0], atol=1e-6)


def test_gradient_of_the_eliminated_cost():
    rng = np.random.default_rng(4)
    model = random_model(rng, (2, 1), 2)
    u, y = rng.standard_normal((900, 1)), rng.standard_normal(900)
    problem = Problem((Segment(u, y, np.ones(900, bool)),), model)
    x, step = problem.start, 1e-5
    jacobian, residual = Point(problem, x).linearise()
    differences = [
        (Point(problem, x + step * e).cost - Point(problem, x - step * e).cost) / (2 * step)
        for e in np.eye(x.size)
    ]
    # Kaufman's Jacobian leaves the gradient exact (Kaufman, 1975).
    np.testing.assert_allclose(2.0 * jacobian.T @ residual, differences, rtol=1e-5, atol=1e-6)


def test_interpolation_is_exact_in_its_band():
    taps = interpolation_taps(3)
    k = np.arange(1 - taps.shape[1] // 2, taps.shape[1] // 2 + 1)
    np.testing.assert_allclose(taps.sum(axis=1), 1.0, rtol=1e-14)
    for frequency in (0.1, 1.0, 0.8 * np.pi):
        found = taps @ np.cos(frequency * k + 0.3)
        wanted = np.cos(frequency * np.array([1.0, 2.0]) / 3.0 + 0.3)
        np.testing.assert_allclose(found, wanted, atol=2e-4)  # Kaiser's window, beta = 8: 80 dB


def test_map_between_samples_has_no_aliases():
    # (sin)^3 = 3/4 sin w - 1/4 sin 3w, and 3w lies beyond the Nyquist frequency: sampled values fold it back.
    z = np.linspace(-1.5, 1.5, 50)
    gain = LinearBlock(np.zeros(0), np.ones(1))
    cube = WienerHammerstein(gain, Spline.fitted(z, z**3, [-1.5, 1.5]), gain, oversampling=2)
    wave = np.sin(1.4 * np.arange(400.0))
    inner = slice(40, -40)
    np.testing.assert_allclose(cube.simulate(wave)[inner], 0.75 * wave[inner], atol=2e-4)
    assert np.abs(replace(cube, oversampling=1).simulate(wave) - 0.75 * wave)[inner].max() > 0.2


def test_known_system_is_recovered_without_noise():
    record = measured(np.random.default_rng(5), 3000, 0.0)
    fit = fit_wiener_hammerstein(record, orders=(2, 2), knots=8, oversampling=1)
    truth = true_model().normalised()
    # No noise and a map in the space of the spline: what is left is the smoothing, 1e-10 of the data's
    # weight.
    for found, known in ((fit.front, truth.front), (fit.back, truth.back)):
        np.testing.assert_allclose(found.a, known.a, atol=1e-5)
        np.testing.assert_allclose(found.b, known.b, atol=1e-5)
    z = np.linspace(*np.array(fit.range) * 0.8, 20)
    np.testing.assert_allclose(fit.map(z), truth.map(z), atol=1e-4)
    assert fit.rms < 1e-5
    assert fit.converged
    assert "poles" in repr(fit)


def test_noise_floor_is_reached_and_the_status_is_a_sentence():
    record = measured(np.random.default_rng(6), 4000, 0.05)
    fit = fit_wiener_hammerstein(record, orders=(2, 2), knots=8, oversampling=1)
    # The residual of n rows and p parameters has the variance (1 - p/n) sigma^2, give or take sqrt(2/n).
    expected = 0.05 * np.sqrt(1.0 - fit.n_parameters / fit.n_rows)
    assert abs(fit.rms / expected - 1.0) < 4.0 / np.sqrt(2.0 * fit.n_rows)
    assert fit.restarts_agree
    assert "agree" in fit.status


def test_gain_is_shared_by_convention():
    model = true_model()
    u = np.random.default_rng(7).standard_normal(50)
    for gain in (3.0, -0.5):
        spline = model.map
        order = 1 if gain > 0 else -1
        other = WienerHammerstein(
            model.front.scaled(gain),
            Spline((gain * spline.knots)[::order], spline.coefficients[::order] / gain),
            model.back.scaled(gain),
        )
        np.testing.assert_allclose(other.simulate(u), model.simulate(u), rtol=1e-12)
        same, known = other.normalised(), model.normalised()
        np.testing.assert_allclose(same.front.b, known.front.b, rtol=1e-12)
        np.testing.assert_allclose(same.back.b, known.back.b, rtol=1e-12)
        np.testing.assert_allclose(same.map.coefficients, known.map.coefficients, rtol=1e-12)
    assert known.front.response([0.0])[0] == pytest.approx(1.0)


def test_a_delay_that_either_block_may_hold_is_told():
    fit = fit_wiener_hammerstein(
        measured(np.random.default_rng(8), 3000, 0.02), orders=(2, 2), knots=6, oversampling=1
    )
    assert fit.exchangeable_delay == 1  # of the back block: its b0 is zero
    assert "in which block that delay is" in repr(fit)


def test_wiener_and_hammerstein_are_special_cases():
    gain = LinearBlock(np.zeros(0), np.ones(1))
    for orders in ((2, 0), (0, 2)):
        known = true_model()
        model = replace(known, back=gain) if orders[1] == 0 else replace(known, front=gain)
        record = measured(np.random.default_rng(9), 1500, 0.01, model)
        fit = fit_wiener_hammerstein(record, orders=orders, knots=5, oversampling=1)
        assert fit.rms < 0.0105
        assert fit.orders == orders


def test_intervals_cover_what_the_data_tell():
    # Standard scores of 40 runs: their mean square is chi-squared, correlated ones apart; chance of an alarm
    # 1e-4 each.
    truth = true_model().normalised()
    z = np.array([-0.8, 0.1, 1.0])
    rng = np.random.default_rng(10)
    scores = []
    for _ in range(40):
        record = measured(rng, 900, 0.1)
        fit = fit_wiener_hammerstein(record, start=true_model(), knots=4)
        values = fit.parameters()
        names = ("front_a1", "front_b0", "back_a2", "back_b1")
        known = (truth.front.a[1], truth.front.b[0], truth.back.a[2], truth.back.b[1])
        found = [(values[n][0] - v) / values[n][1] for n, v in zip(names, known, strict=True)]
        centre, error = fit.map_band(z)
        scores.append([*found, *(centre - truth.map(z)) / error])
    mean_square = np.mean(np.square(scores), axis=0)
    low, high = chi2.ppf([0.5e-4, 1 - 0.5e-4], 40) / 40
    assert (mean_square > low).all()
    assert (mean_square < high).all()


def test_gain_errors_follow_from_those_of_the_coefficients():
    fit = fit_wiener_hammerstein(measured(np.random.default_rng(11), 1500, 0.05), start=true_model(), knots=5)
    (front, front_error), (_, back_error) = fit.gains([0.0, 50.0])
    assert front[0] == pytest.approx(1.0)
    assert front_error[0] < 1e-8  # fixed by convention
    assert 0.0 < front_error[1] < 0.1
    assert 0.0 < back_error[1] < 0.1


def test_structure_is_chosen_on_validation_rows():
    lag = LinearBlock.from_polynomials([0.4, 0.0], [1.0, -0.6])
    z = np.linspace(-4.0, 4.0, 200)
    model = WienerHammerstein(lag, Spline.fitted(z, np.tanh(2.0 * z), np.linspace(-4, 4, 30)), lag)
    record = measured(np.random.default_rng(12), 1500, 0.01, model)
    seen = []
    choice = choose_wiener_hammerstein(record, oversampling=1, progress=lambda *pair: seen.append(pair))
    assert choice.fit.orders == (1, 1)
    assert choice.accepted.n_rows < choice.fit.n_rows
    assert choice.fit.rms < 0.0105
    assert seen[-1][0] == seen[-1][1]
    assert "simplest" in choice.reason


def test_rows_left_out_do_not_matter_and_experiments_start_anew():
    rng = np.random.default_rng(13)
    first, second = measured(rng, 900, 0.01), measured(rng, 700, 0.01)
    u = np.concatenate([first.u, second.u])
    y = np.concatenate([first.y, second.y])
    names = np.repeat(["a", "b"], [900, 700])
    record = make_record(u, y, period=0.01, experiment=names)
    rows = np.ones(1600, dtype=bool)
    rows[300:500] = False
    spoiled = y.copy()
    spoiled[300:500] += 100.0
    fits = [
        fit_wiener_hammerstein(r, start=true_model(), knots=5, rows=rows)
        for r in (record, make_record(u, spoiled, period=0.01, experiment=names))
    ]
    assert np.array_equal(fits[0].model.vector, fits[1].model.vector)
    free_run = fits[0].predict(record).free_run
    late = slice(900 + 200, None)  # the initial states have died out
    np.testing.assert_allclose(free_run[late], fits[0].simulate(second.u[:, 0])[200:], atol=1e-9)


@pytest.mark.parametrize("oversampling", [1, 2])
def test_initial_state_of_a_new_experiment_is_estimated_on_its_first_rows(oversampling):
    # The test set begins in the midst of a run: from a steady state the first rows would be wrong.
    rng = np.random.default_rng(15)
    truth = replace(true_model(), oversampling=oversampling)
    u = rng.standard_normal(3000)
    y = truth.simulate(u) + 0.01 * rng.standard_normal(3000)
    kept = np.r_[0:2000, 2500:3000]
    record = make_record(
        u[kept],
        y[kept],
        period=0.01,
        split=np.repeat(["train", "test"], [2000, 500]),
        experiment=np.repeat(["a", "b"], [2000, 500]),
        skip=40,
    )
    fit = fit_wiener_hammerstein(record, start=truth, knots=5)
    prediction = fit.predict(record)
    error = (record.y[:, 0] - prediction.free_run)[2000:]
    steady = record.y[2000:, 0] - fit.simulate(record.u[2000:, 0])
    assert np.sqrt(np.mean(steady[:40] ** 2)) > 0.1
    assert np.sqrt(np.mean(error[:40] ** 2)) < 0.02
    assert np.sqrt(np.mean(error[40:] ** 2)) < 0.0115
    assert prediction.starts[1] == "estimated on the first 40 rows"


def test_bad_use_gets_one_clear_sentence():
    record = measured(np.random.default_rng(14), 300, 0.1)
    cases = {
        "orders are 0 and 0": {"orders": (0, 0)},
        "two whole numbers": {"orders": (1, 2, 3)},
        "oversampling is 0": {"orders": (1, 1), "oversampling": 0},
        "knots is 1": {"orders": (1, 1), "knots": 1},
        "choose estimate or rest": {"orders": (1, 1), "initial_state": "zero"},
        "delay is -1": {"orders": (1, 1), "delay": -1},
    }
    for words, options in cases.items():
        with pytest.raises(UsageError, match=words):
            fit_wiener_hammerstein(record, **{"knots": 5, "oversampling": 1, **options})
    with pytest.raises(IdentifiabilityError, match="lower orders or knots"):
        fit_wiener_hammerstein(record, orders=(2, 2), knots=100, oversampling=1)
    two = make_record(np.random.default_rng(0).standard_normal((300, 2)), record.y, period=1.0)
    with pytest.raises(UsageError, match="choose one"):
        fit_wiener_hammerstein(two, orders=(1, 1), knots=5, oversampling=1)


def test_measured_circuit_on_a_tenth_of_its_rows(records):
    record = read_record(records / "wiener_hammerstein" / "wiener_hammerstein.csv.gz", split="split")
    rows = np.zeros(record.n_samples, dtype=bool)
    rows[:10_000] = True
    fit = fit_wiener_hammerstein(record, orders=(3, 3), knots=41, oversampling=2, rows=rows)
    error = record.y[10_000:20_000, 0] - fit.simulate(record.u[:20_000, 0])[10_000:]
    # The noise of the record is about 0.2 mV: its spectrum is flat at that level where nothing is excited.
    assert 1e3 * np.sqrt(np.mean(error**2)) < 0.6


def test_short_coloured_records_do_not_lead_astray():
    """500 rows with a coloured input: from the linear approximation alone the search ended at 0.119."""
    rng = np.random.default_rng([6, 3, 3])

    def block():
        poles = []
        while len(poles) < 3:
            if len(poles) < 2 and rng.uniform() < 0.6:
                radius, angle = rng.uniform(0.5, 0.9), rng.uniform(0.1, 1.5)
                poles += [radius * np.exp(1j * angle), radius * np.exp(-1j * angle)]
            else:
                poles.append(rng.uniform(-0.3, 0.9))
        b = rng.standard_normal(4)
        return b / np.abs(b).sum(), np.real(np.poly(poles))

    (b1, a1), (b2, a2) = block(), block()
    u = lfilter([0.7], [1.0, -0.7], rng.standard_normal(500))
    z = lfilter(b1, a1, u)
    y = lfilter(b2, a2, np.tanh(z / z.std()))
    y = y / y.std() + 0.02 * rng.standard_normal(500)
    record = make_record(u, y, 1.0, split=np.repeat(["train"], 500))
    fit = fit_wiener_hammerstein(record, orders=(3, 3), knots=12, oversampling=1)
    assert fit.rms == pytest.approx(0.02, rel=0.15)
