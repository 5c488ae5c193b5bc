"""Simulation with added forces against independent integrators."""

import numba
import numpy as np
import pytest
from forced_reference import stick_slip
from scipy.integrate import solve_ivp

from sysid._compile import uncounted
from sysid.errors import ModelError
from sysid.physics import Simulator, forced_kernels, forced_steps, load_model
from sysid.physics.forced import NO_LAW, ForcedPlant, law
from sysid.physics.forced_lanes import lane_runs
from sysid.physics.forced_steps import falling, hyperbolic_tangent, sine
from sysid.physics.general import GeneralPlant
from sysid.physics.own_laws import NO_OWN_LAW, OwnLaw, kernel_of
from sysid.physics.ports import Port, find_port

MSD = {"m": 1.3, "c": 0.4, "k": 5.0}
MOTOR = {"J": 0.35, "b": 0.2, "K": 1.0, "L": 0.1, "R": 1.2}


def levels(n, hold, seed=1, size=2.0):
    return np.repeat(np.random.default_rng(seed).uniform(-size, size, -(-n // hold)), hold)[:n]


def run(name, values, coefficients, u, period, substeps, hold="zero"):
    plant = ForcedPlant(load_model(name), period, hold)
    point = np.array([[values[key] for key in plant.names]])
    return plant.run(point, coefficients[np.newaxis], u, substeps=substeps)[0]


@pytest.mark.parametrize(
    ("name", "period"),
    [
        ("mass-spring-damper", 0.1),
        ("dc-motor", 0.05),
        ("two-mass", 0.2),
        ("two-tanks", 2.0),
        ("positioning-stage", 0.05),
        ("oscillator", 0.1),
    ],
)
def test_without_effects_it_is_the_exact_run(name, period):
    model, u = load_model(name), levels(300, 3)
    values = {p.name: p.start for p in model.parameters} | ({"offset": 0.3} if name.startswith("pos") else {})
    exact = Simulator(model, period).run(values, u)[:, 0]
    # Both are exact but for rounding, which 300 steps of an integrator gather.
    assert np.allclose(run(name, values, NO_LAW, u, period, 1), exact, rtol=0, atol=1e-11 * np.ptp(exact))


SMOOTH = {
    "drag": ({"drag": 0.7}, lambda x, v: -0.7 * v * abs(v)),
    "cubic": ({"cubic": 2.0}, lambda x, v: -2.0 * x**3),
    "gravity": ({"gravity": 3.0, "wave_number": 1.5}, lambda x, v: -3.0 * np.sin(1.5 * x)),
    "constant": ({"constant": -0.8}, lambda x, v: -0.8),
    "sum": ({"drag": 0.2, "cubic": 1.0, "constant": 0.3}, lambda x, v: -0.2 * v * abs(v) - x**3 + 0.3),
}


@pytest.mark.parametrize("kind", SMOOTH)
def test_smooth_forces_converge_with_fourth_order_to_scipy(kind):
    coefficients, force = SMOOTH[kind]
    u, period = levels(80, 4), 0.2
    x, expected = np.zeros(2), []
    for value in u:
        expected.append(x[0])
        x = solve_ivp(
            lambda t, z, value=value: [
                z[1],
                (value - MSD["c"] * z[1] - MSD["k"] * z[0] + force(*z)) / MSD["m"],
            ],
            (0, period),
            x,
            rtol=1e-11,
            atol=1e-13,
            method="DOP853",
        ).y[:, -1]
    errors = [
        np.abs(run("mass-spring-damper", MSD, law(**coefficients), u, period, n) - expected).max()
        for n in (2, 4, 16)
    ]
    # Fourth order is a factor of 16 for half the step; |v| v has a kink that costs some of it.
    assert errors[1] < errors[0] / 6
    assert errors[2] < 2e-7


def test_gain_that_follows_the_output_agrees_with_scipy():
    u, period = levels(60, 3, size=3.0), 0.1
    x, expected = np.zeros(2), []
    for value in u:
        expected.append(x[0])

        def rate(_, z, value=value):
            driven = value * (1 + 0.6 * np.tanh(z[0] / 0.8))
            torque = MOTOR["K"] * z[1] - MOTOR["b"] * z[0]
            return [torque / MOTOR["J"], (driven - MOTOR["R"] * z[1] - MOTOR["K"] * z[0]) / MOTOR["L"]]

        x = solve_ivp(rate, (0, period), x, rtol=1e-11, atol=1e-13).y[:, -1]
    found = run("dc-motor", MOTOR, law(gain=0.6, gain_scale=0.8), u, period, 16)
    assert np.allclose(found, expected, atol=1e-6)


def mechanics():
    A = np.array([[0.0, 1.0], [-MSD["k"] / MSD["m"], -MSD["c"] / MSD["m"]]])
    return A, np.array([0.0, 1 / MSD["m"]]), 1, 1 / MSD["m"]


FRICTIONS = {
    "coulomb": ({"friction_forward": 0.6, "friction_back": 0.6}, lambda v: 0.6),
    "stribeck": (
        {"friction_forward": 0.4, "friction_back": 0.4, "breakaway": 0.4, "stribeck_speed": 0.3},
        lambda v: 0.4 + 0.4 * np.exp(-((v / 0.3) ** 2)),
    ),
}


@pytest.mark.parametrize("kind", FRICTIONS)
def test_stick_and_slip_are_exact_up_to_the_order_of_the_step(kind):
    coefficients, sliding = FRICTIONS[kind]
    u, period = levels(80, 4), 0.2
    expected = stick_slip(*mechanics(), sliding, u, period)
    stuck = np.mean((expected[:, 1] == 0.0)[1:])
    assert 0.05 < stuck < 0.9  # the case shows both
    errors = [
        np.abs(run("mass-spring-damper", MSD, law(**coefficients), u, period, n) - expected[:, 0]).max()
        for n in (2, 4, 16)
    ]
    assert errors[1] < errors[0] / 6
    # A regularised sign would be wrong by the width of its slope times the time stuck, about 1e-3 here.
    assert errors[2] < 2e-6


def test_a_stuck_shaft_slips_when_its_current_has_grown():
    period, u = 0.15, np.repeat([0.9, -0.4, 1.5, 0.0], 8)
    A = np.array([[-MOTOR["b"], MOTOR["K"]], [0.0, 0.0]]) / MOTOR["J"]
    A[1] = np.array([-MOTOR["K"], -MOTOR["R"]]) / MOTOR["L"]
    B = np.array([0.0, 1 / MOTOR["L"]])
    expected = stick_slip(A, B, 0, 1 / MOTOR["J"], lambda v: 0.5, u, period)
    found = run("dc-motor", MOTOR, law(friction_forward=0.5, friction_back=0.5), u, period, 32)
    assert np.abs(found - expected[:, 0]).max() < 1e-6


def test_friction_differs_by_direction():
    u = np.full(400, 1.0)
    coefficients = law(friction_forward=0.7, friction_back=0.1)
    # With viscous friction 1 the speed settles where the force balances it.
    stage = {"M": 0.5, "F_v": 1.0, "gain": 1.0, "offset": 0.0}
    forward = np.diff(run("positioning-stage", stage, coefficients, u, 0.05, 2))[-1] / 0.05
    back = np.diff(run("positioning-stage", stage, coefficients, -u, 0.05, 2))[-1] / 0.05
    assert forward == pytest.approx(0.3, rel=1e-9)
    assert back == pytest.approx(-0.9, rel=1e-9)


def test_a_stuck_shaft_is_let_go_to_the_side_where_nothing_holds_it():
    """At the edge the holding force is zero but for rounding, so that its sign says nothing."""
    plant = ForcedPlant(load_model("dc-motor"), 0.18)
    values = np.array([[0.16, 0.0055, 0.75, 0.16, 3.8]])
    u = 2.0 * np.random.default_rng(1).standard_normal(80)
    one_sided = law(friction_forward=0.5)[np.newaxis]
    coarse, fine = (plant.run(values, one_sided, u, substeps=steps)[0] for steps in (15, 150))
    assert np.abs(coarse - fine).max() < 1e-4 * np.std(fine)


def test_a_step_may_end_next_to_a_stop_while_the_speed_rises_again():
    """A contact too stiff for its steps shakes a body; the run ends in not a number, not in an error."""
    plant = ForcedPlant(load_model("positioning-stage"), 0.00921)
    values = np.array([[44.7, 388.0, 1.0, 0.0]])
    stiff = {"elastic": 2.06e5, "yield": 2.65}
    for seed in range(20):
        draws = np.random.default_rng(seed)
        u = 80.0 * draws.standard_normal(300)
        cubic = 3.1e7 * np.exp(draws.standard_normal())
        laws = law(friction_forward=43.7, friction_back=43.7, cubic=cubic, **stiff)[np.newaxis]
        assert np.isfinite(plant.run(values, laws, u)[0, :2]).all()


@pytest.mark.parametrize("bend", [0.0, -1.4, 0.6])
def test_a_presliding_contact_agrees_with_scipy(bend):
    u, period = levels(50, 5), 0.1
    contact = law(**{"elastic": 20.0, "yield": 0.5, "loop_bend": bend})
    x, expected = np.zeros(3), []
    for value in u:
        expected.append(x[0])

        def rate(_, z, value=value):
            resisting = value - MSD["c"] * z[1] - MSD["k"] * z[0] - z[2]
            loop = z[1] * (1.0 - bend * abs(z[2]) / 0.5) - abs(z[1]) * z[2] / 0.5
            return [z[1], resisting / MSD["m"], 20.0 * loop]

        x = solve_ivp(rate, (0, period), x, rtol=1e-9, atol=1e-11, max_step=0.01).y[:, -1]
    found = run("mass-spring-damper", MSD, contact, u, period, 32)
    assert np.abs(found - expected).max() < 1e-5


def tanks(u, period, caps, caught, powers):
    """Simulate two tanks by tiny Euler steps, levels cut at their rims."""
    one, two, y, steps = 0.0, 0.0, [], 1500
    for value in u:
        y.append(two)
        for _ in range(steps):
            q1, q2 = 0.05 * max(one, 0.0) ** powers[0], 0.04 * max(two, 0.0) ** powers[1]
            net = 0.06 * value - q1
            over = net if one >= caps[0] and net > 0 else 0.0
            one = min(one + period / steps * net, caps[0])
            two = min(two + period / steps * (q1 - q2 + caught * over), caps[1])
    return np.array(y)


@pytest.mark.parametrize(
    ("caught", "powers"), [(0.0, (1.0, 1.0)), (0.7, (0.5, 0.5)), (0.7, (1.5, 0.35)), (0.4, (0.5, 1.0))]
)
def test_overflowing_tanks_agree_with_tiny_steps(caught, powers):
    u, period = np.abs(levels(40, 5, size=3.0)), 4.0
    caps = (1.2, 1.0) if powers == (1.0, 1.0) else (1.6, 1.4)
    values = {"a1": 0.05, "a2": 0.04, "b": 0.06}
    coefficients = law(
        first_power=powers[0], second_power=powers[1], first_cap=caps[0], second_cap=caps[1], caught=caught
    )
    expected = tanks(u, period, caps, caught, powers)
    assert (expected > 0.999 * caps[1]).any()
    # Both are of first order where a tank runs full: 1500 steps a sample leave about 3e-4 each time, and so
    # do ours of 1/8 s, in which a tank that is full to the rim flows out as if it were fuller.
    assert np.abs(run("two-tanks", values, coefficients, u, period, 32) - expected).max() < 1e-3
    # In steps as long as the samples no water is lost either, but it comes up to a sample, or 0.6, late; most
    # of that is evened out by the end of the sample.
    assert np.abs(run("two-tanks", values, coefficients, u, period, 1) - expected).max() < 4e-2


def test_a_smooth_input_is_followed_between_samples():
    period, n = 0.1, 900
    t = period * np.arange(n)
    u = np.sin(6.0 * t)
    y = run("mass-spring-damper", MSD, NO_LAW, u, period, 1, "smooth")
    w = 6.0
    gain = 1 / (MSD["k"] - MSD["m"] * w**2 + 1j * MSD["c"] * w)
    settled = np.abs(y - np.imag(gain * np.exp(1j * w * t)))[700:880].max()
    held = run("mass-spring-damper", MSD, NO_LAW, u, period, 1)
    # exp(-0.15 * 70) of the start is left.  The staircase of four pieces loses (6 * 0.025)**2 / 24 = 0.1 % of
    # the sine and its spline 0.1 %; a hold lags by half a sample, 0.3 rad.
    assert settled < 0.01 * np.abs(gain)
    assert np.abs(held - y)[700:880].max() > 0.2 * np.abs(gain)


def test_a_run_that_diverges_ends_in_not_a_number():
    y = run("mass-spring-damper", MSD, law(cubic=-50.0), np.full(300, 5.0), 0.2, 1)
    assert np.isnan(y[-1])


def test_models_that_do_not_fit_are_refused():
    model = load_model("mass-spring-damper").with_term("v", "spring", "-k*x**3")
    with pytest.raises(ModelError, match="must be linear"):
        ForcedPlant(model, 0.1)


def test_ports_follow_from_the_equations():
    assert find_port(load_model("positioning-stage")) == Port(1, 0, constant="offset")
    assert find_port(load_model("thermal-first-order")) == Port()
    assert find_port(load_model("oscillator")) == Port(1, 0)


def forced_runs(*arguments):
    """Run one after another, without a law of the user's own."""
    forced_kernels.forced_runs(*arguments, kernel_of(NO_OWN_LAW))


LAWS = {
    "smooth": law(cubic=0.1, drag=0.5, constant=0.2),
    "dry": law(friction_forward=0.5, friction_back=0.3),
    "stribeck": law(friction_forward=0.5, friction_back=0.5, breakaway=0.4, stribeck_speed=0.1),
    "gain": law(gain=0.3, gain_scale=0.5),
    "gravity": law(gravity=0.4, wave_number=30.0),
    "contact": law(**{"elastic": 5.0, "yield": 0.5}),
    "contact bent": law(**{"elastic": 5.0, "yield": 0.5, "loop_bend": 0.4}),
    "nothing": law(),
}


FLOWS = {
    "roots": law(first_power=0.5, second_power=0.5, first_cap=1.6, second_cap=1.4, caught=0.7),
    "one root": law(second_power=0.5, first_cap=1.2),
    "gain": law(gain=0.3, gain_scale=0.5),
}


@pytest.mark.parametrize("model", ["two-mass", "mass-spring-damper", "dc-motor", "two-tanks"])
def test_runs_side_by_side_are_the_same_as_one_by_one(model: str) -> None:
    """Every law at once, more lanes than fit side by side; the order of sums differs, so rounding does."""
    plant = ForcedPlant(load_model(model), 0.05)
    some = FLOWS if model == "two-tanks" else LAWS
    laws = np.array([*some.values()] * 3)
    generator = np.random.default_rng(0)
    start = np.array([parameter.start for parameter in plant.model.parameters])
    values = start * np.exp(0.1 * generator.standard_normal((laws.shape[0], start.size)))
    u = np.repeat(generator.uniform(-3.0, 3.0, 60), 8)[np.newaxis, :, np.newaxis]
    plants, by_input, direct = plant.coefficients(values, laws)
    found = []
    for runs in (forced_runs, lane_runs):
        y = np.empty((laws.shape[0], u.shape[1]))
        states = np.empty((laws.shape[0], u.shape[1], 4))
        at_start = np.zeros((laws.shape[0], 4))
        arguments = (plant.order, plant.same, by_input, direct, u, at_start, 0.05 / 3, 3, y, states)
        runs(plants.copy(), *arguments)
        found.append((y, states))
    np.testing.assert_allclose(found[1][0], found[0][0], rtol=0, atol=1e-12 * np.abs(found[0][0]).max())
    n = plant.order
    np.testing.assert_allclose(found[1][1][:, :, :n], found[0][1][:, :, :n], rtol=0, atol=1e-11)


@pytest.mark.parametrize("lanes", [1, 3, 8, 9, 16, 17])
@pytest.mark.parametrize("name", [*LAWS, "roots"])
def test_as_many_lanes_as_there_are_run_as_one_by_one(name: str, lanes: int) -> None:
    """Full and part vectors, inputs shared or of each lane, and one lane that diverges from some row on."""
    plant = ForcedPlant(load_model("two-tanks" if name == "roots" else "mass-spring-damper"), 0.05)
    generator = np.random.default_rng(lanes)
    start = np.array([parameter.start for parameter in plant.model.parameters])
    values = start * np.exp(0.1 * generator.standard_normal((lanes, start.size)))
    laws = np.tile(FLOWS["roots"] if name == "roots" else LAWS[name], (lanes, 1))
    plants, by_input, direct = plant.coefficients(values, laws)
    plants[lanes // 2, 0] = 30.0  # the first state grows by e in a thirtieth of a second
    u = generator.uniform(-3.0, 3.0, (lanes if lanes % 2 else 1, 600, 1))
    found = []
    for runs in (forced_runs, lane_runs):
        y, states, at_start = np.empty((lanes, 600)), np.empty((lanes, 0, 4)), np.zeros((lanes, 4))
        runs(plants.copy(), plant.order, plant.same, by_input, direct, u, at_start, 0.025, 2, y, states)
        found.append(y)
    with np.errstate(over="ignore"):
        one, side = (np.where(np.abs(y) < 1e3, y, np.nan) for y in found)
    # Half a wave of a steep sine amplifies rounding.
    np.testing.assert_allclose(side, one, rtol=1e-9, atol=1e-9)
    assert np.array_equal(np.isnan(found[0][:, -1]), np.isnan(found[1][:, -1]))


def test_curves_without_calls_are_those_of_the_library() -> None:
    """Rounding of 30 operations, six squarings among them: some 100 units in the last place beside 1."""
    x = np.concatenate([np.linspace(-60.0, 60.0, 1001), [0.0, 1e-9, 1e3]])

    @numba.njit
    def found(x):
        return [(sine(v), hyperbolic_tangent(v), falling(abs(v))) for v in x]

    waves, limited, falls = np.array(found(x)).T
    np.testing.assert_allclose(waves, np.sin(x), rtol=0, atol=2e-13)
    np.testing.assert_allclose(limited, np.tanh(x), rtol=0, atol=2e-14)
    np.testing.assert_allclose(falls, np.exp(-np.abs(x)), rtol=2e-14, atol=1e-17)


def test_rows_are_read_and_written_without_counting_who_refers_to_them():
    @numba.njit
    def doubled(x):
        rows = uncounted(x)
        for i in range(x.shape[0]):
            rows[i, 0] *= 2.0
        return rows[1]

    x = np.ones((3, 2))
    row = doubled(x)
    np.testing.assert_array_equal(x[:, 0], 2.0)
    assert np.shares_memory(row, x)
    assert row.base is None  # which is why it must not outlive what the caller holds


def test_the_first_run_compiles_each_part_of_a_kernel_once():
    """A plain integer would be a type of its own, and functions for Python a third of the work."""
    for mode in (forced_kernels.STUCK, forced_kernels.SMOOTH):
        assert numba.types.maybe_literal(mode) is None
    for part in (forced_kernels.rates, forced_kernels.cut_step, forced_steps.linear_rates):
        assert part.targetoptions["no_cpython_wrapper"]
        assert part.targetoptions["no_cfunc_wrapper"]
    for curve in (forced_steps.PLAIN, forced_steps.SWINGS):
        forced_steps.step_of_all.__wrapped__(2, curve)
    signatures = forced_steps.linear_rates.signatures
    assert len(signatures) == len({signature[2] for signature in signatures})  # one for each number of states


@pytest.mark.parametrize(
    ("term", "coefficients", "values"),
    [
        (("force", "c*v*abs(v)", ("c",)), {"drag": 0.7}, [0.7]),
        (("force", "c*x**3", ("c",)), {"cubic": 0.8}, [0.8]),
        (("force", "c*sin(x/s)", ("c", "s")), {"gravity": 2.0, "wave_number": 2.5}, [2.0, 0.4]),
        (("gain", "1 + g*tanh(y/s)", ("g", "s")), {"gain": 0.4, "gain_scale": 0.3}, [0.4, 0.3]),
    ],
)
@pytest.mark.parametrize("friction", [0.0, 0.6])
@pytest.mark.parametrize("name", ["mass-spring-damper", "two-mass", "dc-motor"])
def test_a_law_of_ones_own_runs_as_the_same_law_of_the_catalogue(name, friction, term, coefficients, values):
    """Beside dry friction, too, whose events it moves; what differs is rounding."""
    plant, u = ForcedPlant(load_model(name), 0.05), levels(60, 8, size=3.0)
    start = np.array([[parameter.start for parameter in plant.model.parameters]] * 2)
    dry = {"friction_forward": friction, "friction_back": 0.5 * friction}
    known = np.array([law(**dry, **coefficients)] * 2)
    own = np.array([[*law(**dry), *values]] * 2)
    expected = plant.run(start, known, u, substeps=4, exact=False)
    found = plant.run(start, own, u, substeps=4, own=OwnLaw((term,)))
    assert np.isfinite(expected).all()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_several_laws_of_ones_own_agree_with_scipy():
    """The parameters of one law follow those of the other; the step leaves 2e-7 of its fourth order."""
    own = OwnLaw((("force", "c*v**3", ("c",)), ("gain", "1 + g*y", ("g",)), ("force", "k*x**5", ("k",))))
    plant, u, T = ForcedPlant(load_model("mass-spring-damper"), 0.05), levels(30, 8), 0.05
    values = np.array([[MSD[p.name] for p in plant.model.parameters]])
    y = plant.run(values, np.array([[*NO_LAW, 0.3, 0.2, 0.9]]), u, substeps=16, own=own)[0]
    z, expected = np.zeros(2), []
    for value in u:
        expected.append(z[0])

        def rate(t, z, value=value):
            force = value * (1.0 + 0.2 * z[0]) - 0.3 * z[1] ** 3 - 0.9 * z[0] ** 5
            return [z[1], (force - MSD["c"] * z[1] - MSD["k"] * z[0]) / MSD["m"]]

        z = solve_ivp(rate, (0.0, T), z, rtol=1e-11, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_a_law_of_ones_own_in_a_model_that_is_not_linear():
    """The oscillator's own cubic spring, and the same spring as a force of one's own."""
    model, u = load_model("oscillator"), levels(60, 8)
    known = np.array([[1.0, 0.2, 1.0, 0.5]])
    names = [parameter.name for parameter in model.parameters]
    stiff = model.with_parameters(start=dict(zip(names, known[0].tolist(), strict=True)))
    plant = GeneralPlant(stiff, 0.1)
    softer = known.copy()
    softer[0, names.index("cubic")] = 0.2
    own = OwnLaw((("force", "k*x**3", ("k",)),))
    expected = plant.run(known, NO_LAW[np.newaxis], u, substeps=8, exact=False)
    found = plant.run(softer, np.array([[*NO_LAW, 0.3]]), u, substeps=8, exact=False, own=own)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_an_event_that_is_found_to_the_last_digit_ends_the_search_for_it():
    """Of a law so stiff that steps cannot follow it the place where sliding ends jumps by rounding alone."""
    plant = np.zeros((1, forced_kernels.SIZE))
    plant[0, [0, 1, 4, 5]] = -0.08242408041007475, 6.585789574396411, -6.885137029140996, -21.477116902130117
    plant[0, [forced_kernels.FRICTION_FORWARD, forced_kernels.FRICTION_BACK]] = 0.13103814506075254
    plant[0, forced_kernels.GRAVITY] = -3027.2645768880543
    plant[0, forced_kernels.WAVE_NUMBER] = 270.73679336145733
    plant[0, [forced_kernels.PUSH, forced_kernels.READ]] = 21.803712557884356, 1.0
    plant[0, [forced_kernels.FIRST_POWER, forced_kernels.SECOND_POWER, forced_kernels.GAIN_SCALE]] = 1.0
    plant[0, [forced_kernels.FIRST_CAP, forced_kernels.SECOND_CAP]] = np.inf
    by_input = np.array([0.0, 22.794768494982584, 0.0, 0.0]).reshape(1, 4, 1)
    u = np.array([1.37829748, 1.39945849]).reshape(1, 2, 1)
    start = np.array([[683.0901035567488, -96.83206991837375, 0.0, 0.0]])
    y, states = np.zeros((1, 2)), np.zeros((1, 0, 4))
    lane_runs(plant, 2, True, by_input, np.zeros((1, 1)), u, start, 0.014, 1, y, states)
    assert np.isfinite(y).all()
