"""Physical models with effects: parameters recovered, the hidden effect first, real records."""

from dataclasses import replace

import numpy as np
import pytest

from sysid.data import make_record, read_record
from sysid.demonstration.effects import Hidden, inside, map_input, map_output
from sysid.demonstration.plants import Plant
from sysid.diagnosis.effects import catalogue, find_effects
from sysid.diagnosis.physics import structure as physics_structure
from sysid.diagnosis.physics.free_run import runs
from sysid.diagnosis.physics.hold import band_limited
from sysid.diagnosis.physics.parameters import slopes_of_both_sides
from sysid.diagnosis.physics.problem import Problem, problem_of
from sysid.diagnosis.physics.search import shape_values
from sysid.diagnosis.physics.structure import PhysicsStructure
from sysid.diagnosis.structures.structure import Choice, Effort, filtered
from sysid.errors import IdentifiabilityError, ModelError
from sysid.physics import load_model
from sysid.physics.reading import read_model

WHITE = np.ones(1)
PLANTS = {
    "dc-motor": ({"J": 0.35, "b": 0.2, "K": 1.0, "L": 0.1, "R": 1.2}, 0.06, ("L", "R")),
    "mass-spring-damper": ({"m": 1.0, "c": 0.8, "k": 4.0}, 0.15, ()),
    "two-mass": ({"m1": 1.0, "c1": 0.5, "k1": 4.0, "m2": 0.6, "c2": 0.2, "k2": 5.0}, 0.15, ()),
    "two-tanks": ({"a1": 0.05, "a2": 0.04, "b": 0.05}, 6.0, ()),
}
ROWS = np.array(["est"] * 700 + ["val"] * 250 + ["test"] * 150)


def structure(family, name, parameters, seed=0, snr=30.0, record_of=None):
    """Return the structure of a record with a hidden effect, its parameters known within some 15 %."""
    rng = np.random.default_rng(seed)
    values, period, known = PLANTS[family]
    u = np.repeat(rng.uniform(-2.0, 2.0, ROWS.size), 5)[: ROWS.size]
    u = np.abs(u) if family == "two-tanks" else u
    hidden = (Hidden(name, parameters),) if name else ()
    clean = Plant(family, values, period).response(map_input(u, hidden), inside(hidden))
    clean = map_output(clean, u, hidden)
    y = clean + clean.std() * 10 ** (-snr / 20) * rng.standard_normal(u.size)
    start = {k: v * np.exp(rng.uniform(-0.15, 0.15)) for k, v in values.items() if k not in known}
    model = load_model(family).with_parameters(start=start, fixed={k: values[k] for k in known})
    return PhysicsStructure(make_record(u, y, period=period, split=ROWS), model, "rest"), np.var(y - clean)


def choice(name, form=0):
    (effect,) = find_effects([name])
    return Choice(effect, effect.forms[form])


def test_steps_become_as_fine_as_the_noise_asks():
    # At 60 dB the coarse steps of a search move parameters by many standard errors.
    model = structure("mass-spring-damper", "quad_drag", {"drag": 25.0}, seed=3, snr=60.0)[0]
    drag, rows = choice("quad_drag"), model.record.learning
    coarse = model.fit([drag], rows, WHITE, model.baseline(rows), effort=Effort.COARSE)
    coarse = model.fit([drag], rows, WHITE, coarse, effort=Effort.REFIT)
    fine = model.with_fine_steps(coarse, WHITE)
    assert fine.cost < 0.9 * coarse.cost
    truth = {**PLANTS["mass-spring-damper"][0], "drag": 25.0}
    for p in model.finish(fine, WHITE).parameters:
        value = truth["drag"] if p.owner else truth[p.name]
        assert abs(p.value - value) < 3.5 * p.std_error
    noisy = structure("mass-spring-damper", "quad_drag", {"drag": 0.5}, seed=3, snr=20.0)[0]
    loose = noisy.fit([drag], rows, WHITE, noisy.baseline(rows), effort=Effort.COARSE)
    assert noisy.with_fine_steps(loose, WHITE) is loose


def test_steps_follow_a_law_that_is_faster_than_its_slow_plant():
    # A slide in a thick fluid: the linear friction is slow, one step a sample would do without the drag.
    rng = np.random.default_rng(5)
    mass, friction, drag, period = 90.0, 160.0, 1500.0, 0.06
    u = 470.0 * rng.standard_normal(ROWS.size)
    y, x, v, h = np.zeros(u.size), 0.0, 0.0, period / 200
    for k in range(u.size):
        y[k] = x
        for _ in range(200):
            middle = v + 0.5 * h * (u[k] - friction * v - drag * v * abs(v)) / mass
            v += h * (u[k] - friction * middle - drag * middle * abs(middle)) / mass
            x += h * middle
    noisy = y + 0.01 * rng.standard_normal(u.size)
    values = {"M": 80.0, "F_v": 180.0}
    model = load_model("positioning-stage").with_parameters(start=values, fixed={"gain": 1.0, "offset": 0.0})
    model = PhysicsStructure(make_record(u, noisy, period=period, split=ROWS), model, "rest")
    rows = model.record.learning
    coarse = model.fit([choice("quad_drag")], rows, WHITE, model.baseline(rows), effort=Effort.COARSE)
    fine = model.with_fine_steps(coarse, WHITE)
    assert fine.cost < 0.97 * coarse.cost
    (found,) = model.finish(fine, WHITE).parameters[-1:]
    assert abs(found.value - drag) < 3.5 * found.std_error


def test_of_models_with_the_same_output_the_one_near_the_start_values_is_taken():
    # Tanks whose outflows change places, and the gain with them, have the same response.
    model, _ = structure("two-tanks", "", {}, seed=5)
    rows = model.record.learning
    start, truth = model.setting.nominal, PLANTS["two-tanks"][0]
    found = model.baseline(rows)
    swapped = replace(found, point=found.point + [1.0, -1.0, -1.0] * np.diff(found.point[:2]))
    swapped = model.fit((), rows, WHITE, swapped, effort=Effort.REFIT)
    assert swapped.cost == pytest.approx(found.cost, rel=1e-6)
    ahead = np.sign(start[0] - start[1])
    for fit in (found, model.with_fine_steps(swapped, WHITE)):
        assert np.sign(fit.point[0] - fit.point[1]) == ahead
    other = load_model("two-tanks").with_parameters(
        start={"a1": 0.7 * truth["a2"], "a2": 1.4 * truth["a1"], "b": 1.4 * truth["b"]}
    )
    point = PhysicsStructure(model.record, other, "rest").baseline(rows).point
    assert point[0] < point[1]


def test_what_counts_only_relative_to_the_level_of_a_relay_has_no_interval():
    # All of mass, damping and stiffness scale with the force when it is on; their ratios are known.
    hidden = {"level": 1.4, "threshold": 0.5}
    relay = choice("in_relay")
    model, _ = structure("mass-spring-damper", "in_relay", hidden, seed=2)
    rows = model.record.learning
    fit = model.fit([relay], rows, WHITE, model.baseline(rows), effort=Effort.COARSE)
    finished = model.finish(fit, WHITE)
    assert all(np.isinf(p.std_error) for p in finished.parameters if not p.owner)
    # Beside a known mass the level is a parameter of its own.
    free = load_model("mass-spring-damper").with_parameters(start={"c": 0.8, "k": 4.0}, fixed={"m": 1.0})
    model = PhysicsStructure(model.record, free, "rest")
    (offered,) = model.offered([relay.effect])
    fit = model.fit(
        [Choice(offered, offered.forms[0])], rows, WHITE, model.baseline(rows), effort=Effort.FINE
    )
    assert all(np.isfinite(p.std_error) for p in model.finish(fit, WHITE).parameters if p.name != "threshold")


def test_errors_at_a_kink_hold_unknowns_that_move_together():
    # The highest level is the limit: slopes that are taken to one side disagree about the tanks' outflows.
    model, _ = structure("two-tanks", "overflow", {"rim": 1.2}, seed=1)
    rows = model.record.learning
    fit = model.fit([choice("overflow")], rows, WHITE, model.baseline(rows), effort=Effort.FINE)
    problem = problem_of(model.setting, fit)
    peak, low, high = fit.point.copy(), 0.5 * fit.point[-1], 10.0 * fit.point[-1]
    peak[-1] = high
    free = problem.residual(peak)
    for _ in range(60):
        peak[-1] = 0.5 * (low + high)
        reached = np.any(problem.residual(peak) != free)
        low, high = (peak[-1], high) if reached else (low, peak[-1])
    J = slopes_of_both_sides(problem, peak)
    # Moves in which the highest level and the limit rise alike, and any other to both sides.
    for d in np.random.default_rng(0).standard_normal((5, peak.size)) * np.array([1.0, 1.0, 1.0, peak[-1]]):
        h = 1e-4
        moved = [problem.residual(peak + side * h * d) for side in (1.0, -1.0)]
        direct = (moved[0] - moved[1]) / (2 * h)
        assert np.linalg.norm(J @ d - direct) < 1e-3 * np.linalg.norm(direct)


CASES = [
    ("dc-motor", "coulomb", {"friction": 0.3}),
    ("dc-motor", "in_relay", {"level": 1.4, "threshold": 0.5}),
    ("mass-spring-damper", "stribeck", {"friction": 0.25, "excess": 0.8, "velocity": 0.2}),
    ("mass-spring-damper", "cubic_stiffness", {"stiffness": 4.0}),
    ("two-mass", "quad_drag", {"drag": 2.0}),
    ("two-tanks", "sqrt_outflow", {}),
    ("two-tanks", "overflow", {"rim": 1.2}),
]


def test_what_only_the_sensor_sees_leaves_the_run_as_it_is():
    """Lanes that share a run are as those that are simulated each for itself, and cost as much as one."""
    found, _ = structure("mass-spring-damper", "", {})
    choices = [
        choice("cubic_stiffness"),
        choice("out_saturation"),
        choice("extra_mode"),
        choice("out_offset"),
    ]
    problem = Problem(found.setting, choices, found.record.estimation, WHITE, 0.35)
    point = np.concatenate([found.setting.nominal, 0.3 * problem.sizes[problem.n_model :]])
    points, _ = problem.shifted(point, range(problem.size))
    together = problem.outputs(points)
    alone = np.array([problem.outputs(p[np.newaxis])[0] for p in points])
    # A lane alone takes another order of sums than eight side by side.
    np.testing.assert_allclose(together, alone, rtol=0, atol=1e-12 * np.abs(alone).max())
    problem.budget.left = 0.0
    problem.outputs(points)
    steps = problem.steps_at(point) / (1 + problem.size)
    assert -problem.budget.left == pytest.approx((1 + problem.n_model + 1) * steps)


def test_a_fine_search_ends_no_higher_than_the_coarse_one():
    found, _ = structure("mass-spring-damper", "stribeck", {"friction": 0.25, "excess": 0.8, "velocity": 0.2})
    rows = found.record.estimation
    baseline = found.baseline(rows)
    for name in ("stribeck", "extra_mode", "in_deadzone"):
        coarse, fine = (
            found.fit([choice(name)], rows, WHITE, baseline, effort=effort)
            for effort in (Effort.COARSE, Effort.FINE)
        )
        # The finer steps of the simulation move the cost, too.
        assert fine.cost < 1.001 * coarse.cost


@pytest.mark.parametrize(("family", "name", "parameters"), CASES, ids=[f"{f}-{n}" for f, n, _ in CASES])
def test_the_hidden_effect_fits_to_the_noise_and_best(family, name, parameters):
    found, noise = structure(family, name, parameters)
    rows = found.record.estimation
    baseline = found.baseline(rows)
    assert baseline.restarts_agree
    rivals = find_effects(["in_saturation", "in_deadzone", "out_saturation", "out_offset", "op_gain", name])
    costs = {}
    for effect in found.offered(rivals):
        fits = [
            found.fit([Choice(effect, f)], rows, WHITE, baseline, effort=Effort.COARSE) for f in effect.forms
        ]
        costs[effect.name] = min(fit.cost for fit in fits)
    assert min(costs, key=costs.get) == name
    # 700 rows: the mean square of the noise lies within 5.4 % of its variance with one chance in 20.
    assert costs[name] / rows.sum() == pytest.approx(noise, rel=0.12)


def test_intervals_cover_the_true_parameters():
    truth = {"J": 0.35, "b": 0.2, "K": 1.0, "Fc": 0.3}
    covered = []
    for seed in range(12):
        found, _ = structure("dc-motor", "coulomb", {"friction": 0.3}, seed=seed)
        rows = found.record.learning
        fit = found.fit([choice("coulomb")], rows, WHITE, found.baseline(rows), effort=Effort.COARSE)
        for p in found.finish(fit, WHITE).parameters:
            covered.append(abs(p.value - truth[p.name]) < 1.96 * p.std_error)
    # Of 48 intervals of 95 % fewer than 40 cover with a chance near 1e-3.
    assert np.sum(covered) >= 40


def test_difference_quotients_agree_with_finer_ones():
    found, _ = structure("mass-spring-damper", "coulomb", {"friction": 0.4})
    rows = found.record.estimation
    noise = np.array([1.0, -0.6])
    problem = Problem(found.setting, [choice("coulomb"), choice("in_saturation")], rows, noise, 0.2)
    point = np.concatenate([found.setting.nominal, [0.4, 1.5]])
    J = problem.jacobian(point)
    for column, size in enumerate([1.0, 1.0, 1.0, 0.4, 1.5]):
        step = np.zeros(point.size)
        step[column] = 2e-5 * size
        central = (problem.residual(point + step) - problem.residual(point - step)) / (4e-5 * size)
        # Stick and slip bend the response where an event moves past a sample: a few rows in a thousand.
        close = np.isclose(J[:, column], central, rtol=1e-3, atol=1e-4 * np.abs(central).max())
        assert close.mean() > 0.98


def test_the_residual_is_filtered_as_the_protocol_says():
    found, _ = structure("mass-spring-damper", "", {})
    rows = found.record.estimation.copy()
    rows[100:140] = False
    noise = np.array([1.0, -0.5, 0.2])
    problem = Problem(found.setting, (), rows, noise, 0.3)
    point = found.setting.nominal
    run = problem.run(slice(0, rows.size), point[np.newaxis], None)[0]
    expected = filtered(run - found.record.y[:, 0], rows, noise)
    assert np.allclose(problem.residual(point), expected, atol=1e-12)


@pytest.mark.parametrize("name", ["in_saturation", "cubic_stiffness", "out_quantisation"])
def test_one_simulation_gives_residual_and_derivative(name):
    """They are those of two simulations, to the bit: the same steps, other neighbours."""
    found, _ = structure("two-mass", "", {})
    problem = Problem(found.setting, [choice(name)], found.record.estimation, np.array([1.0, -0.4]), 0.3)
    point = np.append(found.setting.nominal, 0.3)
    assert problem.jumps == (name == "out_quantisation")
    if not problem.jumps:
        residual, J = problem.with_derivative(point)
        np.testing.assert_array_equal(residual, problem.residual(point))
        np.testing.assert_array_equal(J, problem.jacobian(point))


def test_a_fit_whose_steps_are_spent_stops_and_says_so(monkeypatch):
    found, _ = structure("two-mass", "quad_drag", {"drag": 2.0})
    rows = found.record.estimation
    base = found.baseline(rows)
    monkeypatch.setattr(physics_structure, "BUDGETS", (1.0, 1.0, 1.0))
    short = found.fit([choice("quad_drag")], rows, WHITE, base, effort=Effort.COARSE)
    assert short.status == physics_structure.SPENT
    monkeypatch.undo()
    found, _ = structure("two-mass", "quad_drag", {"drag": 2.0})  # the first one remembers its fits
    whole = found.fit([choice("quad_drag")], rows, WHITE, base, effort=Effort.COARSE)
    assert whole.status != physics_structure.SPENT


def test_a_pair_of_effects_and_the_refit_on_more_rows():
    found, noise = structure("dc-motor", "out_saturation", {"upper": 0.9, "lower": 0.9})
    rows, all_rows = found.record.estimation, found.record.learning
    baseline = found.baseline(rows)
    one = found.fit([choice("out_saturation")], rows, WHITE, baseline, effort=Effort.FINE)
    two = found.fit([choice("out_saturation"), choice("out_offset")], rows, WHITE, one, effort=Effort.COARSE)
    assert one.cost >= two.cost > 0.97 * one.cost
    refitted = found.fit(one.choices, all_rows, WHITE, one, effort=Effort.REFIT)
    assert refitted.cost / all_rows.sum() == pytest.approx(noise, rel=0.12)
    assert refitted.parameters_of("out_saturation")[0].value == pytest.approx(0.9, rel=0.02)
    assert "out_saturation" in found.equation(refitted)


def test_what_diverges_without_another_effect_is_no_error():
    found, _ = structure("mass-spring-damper", "quad_drag", {"drag": 1.0})
    rows, drag = found.record.estimation, choice("quad_drag")
    pair = found.fit([drag, choice("out_offset")], rows, WHITE, found.baseline(rows), effort=Effort.COARSE)
    place = [p.owner for p in pair.parameters].index("quad_drag")
    point = pair.point.copy()
    point[place] = -100.0  # a drag that drives: held by nothing once the other effect is gone
    fit = found.fit([drag], rows, WHITE, replace(pair, point=point), effort=Effort.REFIT)
    assert fit.cost == np.inf
    assert not fit.converged


def test_effects_are_offered_where_they_make_sense():
    effects = catalogue()
    motor, _ = structure("dc-motor", "", {})
    tanks, _ = structure("two-tanks", "", {})
    names = [effect.name for effect in motor.offered(effects)]
    assert {"coulomb", "stribeck", "in_relay", "coloured_noise"} < set(names)
    assert not {"sqrt_outflow", "overflow"} & set(names)
    # With L and R known J, b and K scale the speed by any factor, so the level of the relay is theirs; with K
    # known not, nor with values that are known to within a factor.
    free = load_model("dc-motor").with_parameters(fixed={"L": 0.1, "R": 1.2})
    models = (free, free.with_parameters(fixed={"K": 1.0}), motor.model)
    for model, last in zip(models, ("threshold", "level", "level"), strict=True):
        offered = PhysicsStructure(motor.record, model, "rest").offered(effects)
        relay = next(e for e in offered if e.name == "in_relay")
        assert relay.forms[0].parameters[-1].name == last
    names = [effect.name for effect in tanks.offered(effects)]
    assert {"sqrt_outflow", "overflow"} < set(names)
    assert not {"coulomb", "cubic_stiffness"} & set(names)


def test_directions_tangent_and_probes_have_a_row_for_each_sample():
    found, _ = structure("mass-spring-damper", "cubic_stiffness", {"stiffness": 3.0})
    baseline = found.baseline(found.record.estimation)
    (direction,) = found.directions(baseline, find_effects(["cubic_stiffness"])[0])
    small = baseline.point.copy()
    problem = problem_of(found.setting, baseline, [choice("cubic_stiffness")])
    points = np.array([np.append(small, 0.0), np.append(small, 1e-4)])
    first, second = runs(problem, points)
    # The direction is the derivative by the strength: a difference quotient of another step.
    change = (second - first) / 1e-4
    assert np.allclose(direction[:, 0], change, atol=2e-3 * np.abs(change).max())
    assert found.tangent(baseline).shape == (ROWS.size, 3)
    assert np.isfinite(found.probes(baseline)).all()


def test_initial_states_and_several_experiments():
    values, period, _ = PLANTS["mass-spring-damper"]
    rng = np.random.default_rng(3)
    from sysid.physics import Simulator

    simulator = Simulator(load_model("mass-spring-damper"), period)
    parts = [np.repeat(rng.uniform(-1, 1, 80), 5) for _ in range(3)]
    starts = [[0.5, 0.0], [-0.4, 0.3], [0.2, -0.5]]
    y = np.concatenate([simulator.run(values, u, s)[:, 0] for u, s in zip(parts, starts, strict=True)])
    y += 1e-4 * rng.standard_normal(y.size)
    split = np.repeat(["est", "val", "test"], 400)
    record = make_record(
        np.concatenate(parts), y, period=period, split=split, experiment=np.repeat(["a", "b", "c"], 400)
    )
    found = PhysicsStructure(record, load_model("mass-spring-damper"))
    fit = found.finish(found.baseline(record.estimation), WHITE)
    for parameter in fit.parameters:
        assert parameter.value == pytest.approx(values[parameter.name], rel=2e-3)
    # The last experiment starts from a state estimated on its first 20 rows, uncertain by some 1e-4.
    assert np.abs(fit.output - y)[800:].max() < 1.5e-3


def test_an_input_counts_as_smooth_only_where_the_record_says_so():
    rng = np.random.default_rng(5)
    n, period = 1200, 0.1
    f = rng.choice(np.arange(5, 160), 40, replace=False)
    phase = rng.uniform(0, 2 * np.pi, 40)

    def wave(t):
        return np.cos(2 * np.pi * f * t[:, np.newaxis] / (n * period) + phase).sum(axis=1)

    fine = np.arange(n * 20) / 20 * period
    model = load_model("mass-spring-damper")
    values = {"m": 0.05, "c": 0.1, "k": 5.0}
    from sysid.physics import Simulator

    smooth = Simulator(model, period / 20).run(values, wave(fine + period / 40))[::20, 0]
    held = Simulator(model, period).run(values, wave(fine[::20]))[:, 0]
    for y, hold in ((smooth, "smooth"), (held, "zero")):
        record = make_record(wave(fine[::20]), y + 1e-4 * rng.standard_normal(n), period=period)
        assert band_limited(record, record.estimation)
        found = PhysicsStructure(record, model.with_parameters(start={"m": 0.06, "c": 0.09, "k": 5.5}))
        fit = found.baseline(record.estimation)
        assert found.plant.hold == hold
        assert fit.parameters[2].value == pytest.approx(5.0, rel=0.01)


def test_a_nonlinear_model_takes_effects_at_input_and_output():
    rng = np.random.default_rng(2)
    u = np.repeat(rng.uniform(-1.5, 1.5, 120), 5)
    model = load_model("oscillator").with_parameters(
        start={"w0": 1.1, "zeta": 0.2, "gain": 0.9, "cubic": 1.2}
    )
    from sysid.physics import Simulator

    y = Simulator(model, 0.2, substeps=8).run(
        {"w0": 1.0, "zeta": 0.25, "gain": 1.0, "cubic": 1.0}, np.clip(u, -1, 1)
    )
    y = y[:, 0] + 1e-3 * rng.standard_normal(u.size)
    found = PhysicsStructure(make_record(u, y, period=0.2), model, "rest")
    rows = found.record.estimation
    offered = {effect.name for effect in found.offered(catalogue())}
    assert "in_saturation" in offered
    assert not {"coulomb", "op_gain", "overflow"} & offered
    fit = found.fit([choice("in_saturation")], rows, WHITE, found.baseline(rows), effort=Effort.COARSE)
    assert fit.parameters_of("in_saturation")[0].value == pytest.approx(1.0, abs=0.02)
    assert np.isfinite(found.probes(fit)).all()


PENDULUM = """
name = "pendulum"
title = "Pendulum driven by a torque"
[states]
angle = { unit = "rad" }
speed = { unit = "rad/s" }
[inputs]
torque = { unit = "N m" }
[outputs.y]
unit = "rad"
terms = { "angle" = "angle" }
[[equations]]
state = "angle"
unit = "rad/s"
terms = { "speed" = "speed" }
[[equations]]
state = "speed"
factor = "J"
unit = "N m"
terms = { "drive" = "torque", "bearing" = "-b*speed", "gravity" = "-W*sin(angle)" }
[parameters]
J = { unit = "kg m^2", start = 1.1, minimum = 0.0, status = "uncertain" }
b = { unit = "N m s", start = 0.2, minimum = 0.0, status = "uncertain" }
W = { unit = "N m", start = 3.5, minimum = 0.0, status = "uncertain" }
"""


@pytest.mark.parametrize(
    ("name", "value", "torque"),
    [
        ("quad_drag", 0.5, lambda angle, speed: -0.5 * speed * abs(speed)),
        ("cubic_stiffness", 0.8, lambda angle, speed: -0.8 * angle**3),
        ("constant_force", 0.6, lambda angle, speed: -0.6),
    ],
)
def test_a_nonlinear_model_takes_smooth_forces(name, value, torque):
    from scipy.integrate import solve_ivp

    rng = np.random.default_rng(4)
    u, state, y = np.repeat(rng.uniform(-3.0, 3.0, 60), 6), np.zeros(2), []
    for pushed in u:
        y.append(state[0])

        def rates(t, z, pushed=pushed):
            return [z[1], pushed - 0.25 * z[1] - 4.0 * np.sin(z[0]) + torque(z[0], z[1])]

        state = solve_ivp(rates, (0.0, 0.1), state, rtol=1e-8, atol=1e-10).y[:, -1]
    model = read_model(PENDULUM, "pendulum")
    found = PhysicsStructure(
        make_record(u, np.array(y) + 1e-3 * rng.standard_normal(u.size), period=0.1), model, "rest"
    )
    assert name in {effect.name for effect in found.offered(catalogue())}
    rows = found.record.learning
    fit = found.fit([choice(name)], rows, WHITE, found.baseline(rows), effort=Effort.COARSE)
    # Noise of 1e-3 in 360 rows; Runge-Kutta steps of a tenth of the fastest rate are finer than that.
    assert np.sqrt(fit.cost / rows.sum()) == pytest.approx(1e-3, rel=0.12)
    assert fit.parameters_of(name)[0].value == pytest.approx(value, rel=0.02)
    assert [p.value for p in fit.parameters[:3]] == pytest.approx([1.0, 0.25, 4.0], rel=0.03)
    assert np.isfinite(found.probes(fit)).all()
    assert found.directions(fit, choice("gravity_sine").effect)


def test_what_cannot_be_fitted_is_refused():
    u = np.random.default_rng(0).uniform(size=60)
    record = make_record(u, np.cumsum(u), period=0.1)
    found = PhysicsStructure(record, load_model("two-mass"))
    few = np.arange(60) < 15
    with pytest.raises(IdentifiabilityError, match="15 rows cannot determine 10"):
        found.baseline(few)


def rms(fit, record, name):
    rows = record.scored_rows(name)
    return float(np.sqrt(np.mean((fit.output - record.y[:, 0])[rows] ** 2)))


def refitted(found, choices):
    """Add effects one after the other on the estimation rows, refit on all learning rows."""
    fit = found.baseline(found.record.estimation)
    for count in range(1, len(choices) + 1):
        fit = found.fit(choices[:count], found.record.estimation, WHITE, fit, effort=Effort.COARSE)
    return found.fit(choices, found.record.learning, WHITE, fit, effort=Effort.REFIT)


@pytest.mark.slow
def test_silverbox(records):
    record = read_record(records / "silverbox" / "silverbox.csv.gz", split="split", experiment="experiment")
    found = PhysicsStructure(record, load_model("oscillator"))
    fit = refitted(found, [choice("cubic_stiffness"), choice("constant_force")])
    assert found.plant.hold == "smooth"
    assert rms(fit, record, "test_multisine") < 0.36e-3
    assert rms(fit, record, "test_arrow") < 0.55e-3


@pytest.mark.slow
def test_cascaded_tanks(records):
    record = read_record(
        records / "cascaded_tanks" / "cascaded_tanks.csv", split="split", experiment="experiment"
    )
    found = PhysicsStructure(record, load_model("two-tanks"))
    choices = [choice("sqrt_outflow"), choice("overflow", 1), choice("in_deadzone")]
    fit = found.fit(choices, record.estimation, WHITE, found.baseline(record.estimation), effort=Effort.FINE)
    fit = found.fit(choices, record.learning, WHITE, fit, effort=Effort.REFIT)
    # A linear model has 0.61 V; the square root alone is no better.
    assert rms(fit, record, "test") < 0.40


@pytest.mark.slow
def test_positioning_system(records):
    record = read_record(records / "emps" / "emps.csv.gz", split="split", experiment="experiment")
    found = PhysicsStructure(record, load_model("positioning-stage"))
    fit = refitted(found, [choice("coulomb")])
    # A linear model has 20 mm; dry friction has a minimum near 6 mm and one near 9 mm.
    assert rms(fit, record, "test") < 10e-3
    values = {p.name: p.value for p in fit.parameters}
    assert values["offset"] == pytest.approx(-0.093, abs=0.01)
    assert values["Fc"] == pytest.approx(0.56, abs=0.1)


def test_a_change_of_gain_is_looked_for_in_rows_that_are_held_out_between_others():
    """Every second block of 100 rows is held out: the times to be tried span the experiment, not the rows."""
    found, _ = structure("mass-spring-damper", "", {})
    rows = found.record.learning & (np.arange(ROWS.size) // 100 % 2 == 0)
    problem = Problem(found.setting, [choice("time_variation", 1)], rows, WHITE, 1.0)
    (times,) = shape_values(problem, 0)
    last = np.flatnonzero(rows)[-1] * found.record.period
    assert 0.9 * last < max(times) <= last + found.record.period


def test_a_search_that_strays_to_a_plant_faster_than_any_step_goes_on():
    u = np.repeat(np.random.default_rng(9).uniform(-0.5, 0.5, 20), 10)
    model = read_model(PENDULUM, "pendulum")
    found = PhysicsStructure(make_record(u, 0.1 * u, period=0.01), model, "rest")
    problem = Problem(found.setting, (), np.ones(u.size, dtype=bool), WHITE, 0.35)
    nominal = found.setting.nominal
    assert np.isfinite(problem.cost(nominal))
    before = problem.budget.work
    light = nominal + np.array(
        [-14.0, 0.0, 0.0]
    )  # a millionth of the inertia: thousands of steps in a sample
    assert problem.cost(light) == np.inf
    assert problem.budget.work == before  # nothing was simulated
    # Every step of such a model is taken one run at a time, which costs several of those of others.
    problem.cost(nominal)
    steps = found.plant.substeps(found.setting.values_of(nominal), 0.35)[0]
    assert problem.budget.work - before >= 5 * steps * u.size
    # And as few of them are taken as the search asks for: a stiff plant's would be many.
    slow = found.setting.values_of(nominal - np.array([5.0, 0.0, 0.0]))
    fine, coarse = (found.plant.substeps(slow, largest)[0] for largest in (0.175, 0.35))
    assert fine == pytest.approx(2 * coarse, abs=1)
    fast = PhysicsStructure(found.record, model.with_parameters(start={"J": 1e-8}), "rest")
    with pytest.raises(ModelError, match="too fast for the sampling period"):
        fast.baseline(np.ones(u.size, dtype=bool))


def test_a_switch_has_a_level_of_its_own_beside_values_that_are_about_known():
    """In the gain of the model its level would be beyond what values known within some 20 % allow."""
    model, noise = structure("mass-spring-damper", "in_hysteresis", {"level": 30.0, "threshold": 0.5}, seed=4)
    (effect,) = model.offered(find_effects(["in_hysteresis"]))
    rows = model.record.learning
    picked = Choice(effect, effect.forms[0])
    fit = model.fit([picked], rows, WHITE, model.baseline(rows), effort=Effort.FINE)
    assert fit.cost < 1.1 * rows.sum() * noise
