"""The linear model with effects: free run, derivatives, fit."""

import numpy as np
import pytest

from sysid.data import make_record
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.kernels import chosen_filtered, is_stable
from sysid.diagnosis.linear.levenberg import minimise
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.linear.triangles import damped_step, scaled_triangle
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort, filtered
from sysid.diagnosis.structures.whitening import opening

A, B = np.array([-1.4, 0.6]), np.array([0.3, -0.1])


def make_data(n=300, seed=0, experiments=1):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, n // 3), 3)
    begin = np.linspace(0, n, experiments + 1).astype(int)
    return Data(u, rng.standard_normal(n), np.ones(n, dtype=bool), begin, 0.5)


def choice(name, form=0):
    (effect,) = find_effects([name])
    return Choice(effect, effect.forms[form])


def named(text):
    """Return an effect by its name, and where it lies."""
    name, *form = text.split()
    (effect,) = find_effects([name])
    wanted = [each for each in effect.forms if all(getattr(each, word) for word in form)]
    return Choice(effect, wanted[0])


def test_the_free_run_is_the_difference_equation_with_forces():
    data = make_data(experiments=2)
    chain = Chain(2, [choice("quad_drag"), choice("op_gain"), choice("out_quadratic")], True, True)
    starts = np.array([0.1, -0.2, 0.3, 0.05])
    own = [0.4, 0.3, 0.8, 0.1]
    run = chain.run(data, np.concatenate([A, B, [0.02], starts, own]))
    for e, (i, j) in enumerate(zip(data.begin[:-1], data.begin[1:], strict=True)):
        z, v = [], []
        for k in range(j - i):
            value = 0.02 + (starts[2 * e + k] if k < 2 else 0.0)
            for lag in (1, 2):
                if k >= lag:
                    value += B[lag - 1] * v[k - lag] - A[lag - 1] * z[k - lag]
            speed = value - z[-1] if k else 0.0
            acting = data.u[i + k] - 0.4 * speed * abs(speed)
            z.append(value)
            v.append(acting * (1.0 + 0.3 * np.tanh(value / 0.8)))
        z = np.array(z)
        assert np.allclose(run.y[i:j], z + 0.1 * z**2, rtol=1e-12, atol=1e-13)


def test_forces_pass_a_direct_path_inside_the_equation_and_see_what_it_adds():
    """Each sample is the root of an equation, found by bisection here and by secants there."""
    from scipy.optimize import brentq

    data = make_data(experiments=2)
    chain = Chain(2, [choice("feedthrough", 1), choice("cubic_stiffness"), choice("quad_drag")], True, True)
    starts = np.array([0.1, -0.2, 0.3, 0.05])
    run = chain.run(data, np.concatenate([A, B, [0.02], starts, [0.4, 0.5, 0.3]]))
    for e, (i, j) in enumerate(zip(data.begin[:-1], data.begin[1:], strict=True)):
        y, z, v = [], [], []
        for k in range(j - i):
            value = 0.02 + (starts[2 * e + k] if k < 2 else 0.0)
            for lag in (1, 2):
                if k >= lag:
                    value += B[lag - 1] * v[k - lag] - A[lag - 1] * z[k - lag]

            def force(position, k=k, y=y):
                speed = position - y[-1] if k else 0.0
                return 0.5 * position**3 + 0.3 * speed * abs(speed)

            def apart(position, u=data.u[i + k], value=value, force=force):
                return value + 0.4 * (u - force(position)) - position

            y_now = brentq(apart, -10.0, 10.0, xtol=1e-15, rtol=1e-14)
            v.append(data.u[i + k] - force(y_now))
            z.append(value)
            y.append(y_now)
        # The equations amplify the bisection's rounding some ten times.
        assert np.allclose(run.y[i:j], y, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("behind", [False, True])
def test_a_path_beside_the_plant_begins_before_or_behind_the_actuator(behind):
    data = make_data(experiments=2)
    forms = ("feedthrough behind", "extra_mode behind") if behind else ("feedthrough", "extra_mode")
    chain = Chain(2, [named(name) for name in ("in_preload", *forms, "out_quadratic")], False, False)
    run = chain.run(data, np.concatenate([A, B, [0.3], [0.4], [2.0, 0.1, 0.2, 0.1], [0.1]]))
    radius, angle = np.exp(-0.1 * 2.0 * data.period), 2.0 * data.period * np.sqrt(1.0 - 0.01)
    for i, j in zip(data.begin[:-1], data.begin[1:], strict=True):
        u = data.u[i:j]
        x = u + 0.3 * np.sign(u)
        given = x if behind else u
        z, beside = np.zeros(j - i + 2), np.zeros(j - i + 2)  # two rows at rest before the first
        for k in range(j - i):
            past = [x[k - lag] if k >= lag else 0.0 for lag in (1, 2)]
            z[k + 2] = B @ past - A @ z[[k + 1, k]]
            seen = [given[k - lag] if k >= lag else 0.0 for lag in (1, 2)]
            ringing = 2.0 * radius * np.cos(angle) * beside[k + 1] - radius**2 * beside[k]
            beside[k + 2] = 0.2 * seen[0] + 0.1 * seen[1] + ringing
        w = z[2:] + 0.4 * given + beside[2:]
        assert np.allclose(run.y[i:j], w + 0.1 * w**2, rtol=1e-12, atol=1e-13)


def test_without_forces_a_direct_path_inside_is_one_beside():
    data = make_data(experiments=2)
    runs = [
        Chain(2, [choice("feedthrough", form)], False, False).run(data, np.concatenate([A, B, [0.4]]))
        for form in (0, 1)
    ]
    assert np.array_equal(runs[0].y, runs[1].y)


@pytest.mark.parametrize(
    ("names", "values"),
    [
        ([], []),
        (["in_saturation"], [0.61]),
        (["in_preload", "cubic_stiffness"], [0.3, 0.2]),
        (["in_delay", "out_saturation"], [0.63, 0.31]),
        (["quad_drag", "op_gain", "out_quadratic"], [0.4, 0.3, 0.8, 0.1]),
        (["time_variation", "out_drift"], [0.01, 0.02]),
        (["extra_mode", "out_lowpass"], [2.0, 0.1, 0.2, 0.1, 0.7]),
        (["feedthrough", "gravity_sine", "out_offset"], [0.2, 0.1, 0.5, 0.3]),
        (["feedthrough inside", "cubic_stiffness", "out_quadratic"], [0.4, 0.5, 0.1]),
        (["in_saturation", "quad_drag", "feedthrough inside", "op_gain"], [0.61, 0.4, 0.3, 0.3, 0.8]),
        (["feedthrough inside", "extra_mode", "out_offset"], [0.4, 2.0, 0.1, 0.2, 0.1, 0.3]),
        (["in_saturation", "extra_mode behind", "out_quadratic"], [0.61, 2.0, 0.1, 0.2, 0.1, 0.1]),
        (["in_preload", "quad_drag", "feedthrough behind", "op_gain"], [0.3, 0.4, 0.3, 0.3, 0.8]),
        (["time_variation", "in_saturation"], [-2e-4, 0.61]),
        (["in_preload", "in_deadzone", "in_backlash"], [0.3, 0.4, 0.1]),
        (["time_variation", "feedthrough behind", "extra_mode behind"], [0.01, 0.3, 2.0, 0.1, 0.2, 0.1]),
    ],
)
def test_the_jacobian_is_the_slope_of_the_run(names, values):
    data = make_data(experiments=2)
    chain = Chain(2, [named(name) for name in names], True, True)
    point = np.concatenate([A, B, [0.02], [0.1, -0.2, 0.3, 0.05], values])
    J = chain.jacobian(data, point, chain.run(data, point))
    for i in range(point.size):
        step = np.zeros(point.size)
        step[i] = 1e-6
        slope = (chain.run(data, point + step).y - chain.run(data, point - step).y) / 2e-6
        # Difference quotients of 1e-6 have a rounding of 1e-10; near a knee single samples may differ.
        assert np.quantile(np.abs(J[i] - slope), 0.99) < 2e-5 * max(1.0, np.abs(slope).max())


@pytest.mark.parametrize("order", [1, 3, 4, 6])
@pytest.mark.parametrize("force", [[], ["quad_drag"], ["cubic_stiffness", "quad_drag"]])
def test_the_jacobian_is_the_slope_of_the_run_at_any_order(order, force):
    """The last experiment ends before all of its starts are felt."""
    data = make_data(201)
    data = Data(data.u, data.y, data.used, np.array([0, 90, 199, 201]), data.period)
    chain = Chain(order, [choice(name) for name in force], True, True)
    a = np.poly([0.8, 0.5, -0.3, 0.2, 0.6, -0.1][:order])[1:]
    starts = np.random.default_rng(1).uniform(-0.2, 0.2, 3 * order)
    point = np.concatenate([a, np.full(order, 0.2 / order), [0.02], starts, np.full(len(force), 0.02)])
    J = chain.jacobian(data, point, chain.run(data, point))
    for i in range(point.size):
        step = np.zeros(point.size)
        step[i] = 1e-6
        slope = (chain.run(data, point + step).y - chain.run(data, point - step).y) / 2e-6
        # Difference quotients of 1e-6 have a rounding of 1e-10 times what the poles amplify.
        assert np.abs(J[i] - slope).max() < 2e-6 * max(1.0, np.abs(slope).max())


@pytest.mark.parametrize(
    ("names", "values"),
    [
        (["in_preload", "out_quadratic"], [0.3, 0.1]),
        (["extra_mode", "quad_drag"], [2.0, 0.1, 0.2, 0.1, 0.4]),
        (["feedthrough inside", "cubic_stiffness"], [0.4, 0.5]),
        (["in_preload", "feedthrough behind", "op_gain"], [0.3, 0.4, 0.3, 0.8]),
    ],
)
def test_some_lines_of_the_jacobian_are_those_of_all(names, values):
    data = make_data(experiments=2)
    chain = Chain(2, [named(name) for name in names], True, True)
    point = np.concatenate([A, B, [0.02], [0.1, -0.2, 0.3, 0.05], values])
    run = chain.run(data, point)
    J = chain.jacobian(data, point, run)
    rng = np.random.default_rng(0)
    for _ in range(20):
        free = rng.random(point.size) < 0.5
        assert np.array_equal(chain.jacobian(data, point, run, free), J[free])


def test_the_input_after_its_maps_is_that_of_the_point():
    """A run keeps the mapped input of the run before: other parameters and other rows must not see it."""
    data, other = make_data(experiments=2), make_data(seed=1)
    chain = Chain(2, [choice("in_saturation")], False, False)
    points = [np.concatenate([A, B, [level]]) for level in (0.3, 0.6, 0.3)]
    for rows, point in [(data, points[0]), (data, points[1]), (other, points[1]), (data, points[2])]:
        assert np.array_equal(chain.run(rows, point).x, np.clip(rows.u, -point[-1], point[-1]))


def test_a_damped_step_is_that_of_the_stacked_equations():
    rng = np.random.default_rng(0)
    for n in (1, 3, 8):
        # Lines of sizes from 1e-6 to 1e6 that are all but the same: condition 1e5 after scaling.
        lines = rng.standard_normal(50) + 1e-5 * rng.standard_normal((n, 50))
        lines *= 10.0 ** rng.uniform(-6, 6, (n, 1))
        error, no = rng.standard_normal(50), np.zeros(n, dtype=bool)
        R, c, lengths = scaled_triangle(lines.copy(), error, no, no)
        scaled = lines / lengths[:, np.newaxis]
        for damping in (1e-8, 1e-2, 10.0):
            step, lowered = damped_step(R, c, damping)
            stacked = np.vstack([scaled.T, np.sqrt(damping) * np.eye(n)])
            expected = np.linalg.lstsq(stacked, np.concatenate([error, np.zeros(n)]))[0]
            # Rounding times the condition of the damped equations, 1e4 at most.
            assert np.allclose(step, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
            left = error - scaled.T @ step
            assert np.isclose(lowered, error @ error - left @ left, rtol=1e-8)


def test_a_step_leaves_out_what_is_held_at_its_bound_and_what_depends_on_others():
    lines = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    error = np.array([1.0, -1.0, 1.0])
    low, high = np.array([False, True, False, False]), np.zeros(4, dtype=bool)
    R, c, lengths = scaled_triangle(lines.copy(), error, low, high)
    assert np.array_equal(lengths, [1.0, 1.0, 1.0, 1.0])
    assert np.array_equal(np.diag(R), [1.0, 0.0, 0.0, 0.0])
    assert np.array_equal(c, [1.0, 0.0, 0.0, 0.0])
    step, lowered = damped_step(R, c, 1e-12)
    assert np.allclose(step, [0.5, 0.0, 0.5, 0.0])
    assert np.isclose(lowered, 1.0)
    # Upwards the second one is free.
    assert scaled_triangle(lines.copy(), -error, low, high)[0][1, 1] == 1.0


def test_what_forces_do_at_given_motion_is_what_acts_in_a_run():
    data = make_data(experiments=2)
    chain = Chain(2, [choice("quad_drag"), choice("op_gain")], False, False)
    point = np.concatenate([A, B, [0.4, 0.3, 0.8]])
    run = chain.run(data, point)
    # The same law, compiled once for a row and once for all: no more than rounding apart.
    assert np.allclose(chain.felt(data, point, run.x, run.z), run.v, rtol=1e-14, atol=1e-15)


def test_both_filters_are_the_same():
    rng = np.random.default_rng(0)
    values, rows = rng.standard_normal((40, 3)), np.ones(40, dtype=bool)
    rows[[0, 7, 8, 21]] = False
    noise = np.array([1.0, -0.7, 0.2])
    begin = np.array([0, 25, 40])
    runs = Data(values[:, 0], values[:, 0], rows, begin, 1.0).runs
    kernel = chosen_filtered(np.ascontiguousarray(values.T), runs, noise, opening(noise)).T
    first = np.concatenate([filtered(values[i:j], rows[i:j], noise) for i, j in ((0, 25), (25, 40))])
    assert np.allclose(kernel, first)


def test_stability_is_that_of_the_roots():
    rng = np.random.default_rng(1)
    for _ in range(200):
        a = rng.uniform(-2, 2, rng.integers(1, 5))
        assert is_stable(a) == (np.abs(np.roots(np.concatenate([[1.0], a]))).max() < 1.0)
    assert is_stable(np.array([-1.0]))


def test_the_search_finds_the_linear_least_squares_optimum():
    data = make_data(600)
    chain = Chain(2, [], False, False)
    truth = chain.run(data, np.concatenate([A, B])).y
    noisy = Data(data.u, truth + 0.05 * data.y, data.used, data.begin, data.period)
    end = minimise(chain, noisy, np.array([-1.0, 0.3, 0.2, 0.0]), WHITE)
    run = chain.run(noisy, end.point)
    J = chain.jacobian(noisy, end.point, run)
    # At a minimum the error is orthogonal to every derivative.
    error = noisy.y - run.y
    assert np.abs(J @ error / np.linalg.norm(J, axis=1) / np.linalg.norm(error)).max() < 1e-4


CASES = [
    ("in_saturation", "two-sided", [0.3, 0.6]),
    ("in_deadzone", "symmetric", [0.4]),
    ("in_relay", "symmetric", [0.35]),
    ("in_backlash", "symmetric", [0.3]),
    ("in_delay", "delay", [1.3]),
    ("in_rate_limit", "symmetric", [0.5]),
    ("in_rate_limit", "symmetric from rest", [0.5]),
    ("out_lowpass", "straight between samples", [1.7]),
    ("out_saturation", "symmetric", [0.3]),
    ("out_quantisation", "round", [0.4]),
    ("quad_drag", "drag", [3.0]),
    ("cubic_stiffness", "cubic", [1.5]),
    ("op_gain", "tanh", [0.5, 0.4]),
    ("time_variation", "step", [0.5, 100.0]),
    ("extra_mode", "second order", [1.2, 0.03, 0.1, 0.05]),
]


@pytest.mark.parametrize(("name", "form", "values"), CASES)
def test_a_fit_finds_the_effect_it_is_given(name, form, values):
    (effect,) = find_effects([name])
    picked = Choice(effect, effect.form(form))
    data, chain = make_data(900, seed=3), Chain(2, [picked], False, False)
    truth = np.concatenate([A, B, values])
    noise_free = chain.run(data, truth).y
    record = make_record(data.u, noise_free + 0.01 * np.std(noise_free) * data.y, period=0.5)
    structure = LinearStructure(record, 2, initial_state="rest")
    fit = structure.fit(
        [picked], record.learning, WHITE, structure.baseline(record.learning), effort=Effort.FINE
    )
    # One percent of noise: the error left must be that noise, not a local minimum (a factor of at least 2).
    assert np.sqrt(fit.cost / 900) < 1.03 * 0.01 * np.std(noise_free)
    if name == "extra_mode":
        return  # the model may take either mode for its own
    finished = structure.finish(fit, WHITE)
    for parameter, value in zip(finished.parameters_of(name), values, strict=True):
        # Thresholds of maps that jump have no standard error; they are known to within their cell.
        spread = parameter.std_error if np.isfinite(parameter.std_error) else 0.0
        assert abs(parameter.value - value) < max(5.0 * spread, 0.02 * abs(value))


def test_standard_errors_are_those_of_repeated_records():
    """Of thirty records the mean square deviation in standard errors lies within 0.5 and 1.7 (p = 1e-3)."""
    picked, deviations = choice("in_deadzone"), []
    for seed in range(30):
        data = make_data(399, seed=seed)
        chain = Chain(2, [picked], False, False)
        y = chain.run(data, np.concatenate([A, B, [0.3]])).y + 0.02 * data.y
        record = make_record(data.u, y, period=0.5)
        structure = LinearStructure(record, 2, initial_state="rest")
        rows = record.learning
        fit = structure.fit([picked], rows, WHITE, structure.baseline(rows), effort=Effort.COARSE)
        (width,) = structure.finish(fit, WHITE).parameters_of("in_deadzone")
        deviations.append((width.value - 0.3) / width.std_error)
    assert 0.5 < np.mean(np.square(deviations)) < 1.7
