"""Standard errors over other minima; modes that ring; probes through the model with its effects."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from sysid.data import make_record
from sysid.diagnosis.decide.modes import is_the_plant_again, least_damping, rings
from sysid.diagnosis.diagnose import structure_of
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.linear.modes import errors_over_minima
from sysid.diagnosis.linear.parameters import standard_errors
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.physics.descents import agree, nearly_agree
from sysid.diagnosis.physics.structure import PhysicsStructure
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort, FittedParameter, StructureFit
from sysid.physics import load_model
from sysid.separable.descent import Minimum, Residual, Status


def choice(name):
    (effect,) = find_effects([name])
    return Choice(effect, effect.forms[0])


def first_order(u, delay, second=0.0):
    whole = int(delay)
    part = delay - whole
    late = np.concatenate([np.zeros(whole), u[: u.size - whole]])
    later = np.concatenate([np.zeros(whole + 1), u[: u.size - whole - 1]])
    x = (1.0 - part) * late + part * later
    y = np.zeros(u.size)
    for k in range(2, u.size):
        y[k] = 1.2 * y[k - 1] - 0.4 * y[k - 2] + 0.3 * x[k - 1] + second * x[k - 2]
    return y


def test_a_delay_that_a_tap_can_stand_for_is_as_uncertain_as_the_sample():
    rng = np.random.default_rng(3)
    u = rng.uniform(-1.0, 1.0, 600)
    y = first_order(u, 3.5) + 0.03 * rng.standard_normal(600)
    record = make_record(u, y, period=1.0, split=np.repeat(["est", "test"], [500, 100]))
    structure = structure_of(record, "linear", 2, "rest")
    rows = record.learning
    fit = structure.fit([choice("in_delay")], rows, WHITE, structure.baseline(rows), effort=Effort.FINE)
    (found,) = structure.finish(fit, WHITE).parameters_of("in_delay")
    # Two equal taps are a delay of 3.5 with b2 = 0, one of 2.5 with b1 = 0, and one of 3 with b1 = b2.
    assert min(abs(found.value - place) for place in (2.5, 3.0, 3.5)) < 0.1
    assert 0.25 < found.std_error < 1.1
    assert abs(found.value - 3.5) < 3.0 * found.std_error


def test_one_minimum_keeps_its_standard_errors():
    rng = np.random.default_rng(4)
    u = rng.uniform(-1.0, 1.0, 600)
    y = first_order(np.clip(u, -0.5, 0.5), 0.0) + 0.02 * rng.standard_normal(600)
    record = make_record(u, y, period=1.0, split=np.repeat(["est", "test"], [500, 100]))
    structure = structure_of(record, "linear", 2, "rest")
    rows = record.learning
    fit = structure.fit([choice("in_saturation")], rows, WHITE, structure.baseline(rows), effort=Effort.FINE)
    chain, data = structure.chain(fit.choices), structure.data(rows)
    errors, _ = standard_errors(chain, data, fit.point, WHITE, fit.cost)
    again = errors_over_minima(chain, data, fit.point, WHITE, fit.cost, fit.cost / 495.0, errors)
    assert np.allclose(errors, again, rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "values"),
    [("in_delay", (2.6, 2.0 + 0.5 / 1.5)), ("out_lowpass", (-1.0 / np.log(0.5), -1.0 / np.log(0.8)))],
)
def test_an_effect_that_may_have_changed_places_with_the_plant_is_uncertain(name, values):
    """A zero at -0.5 is that of a delay by a third of a sample, a pole at 0.8 that of a lag."""
    rng = np.random.default_rng(6)
    u = rng.uniform(-1.0, 1.0, 600)
    late = np.concatenate([np.zeros(2), u[:-2]])
    delayed = lfilter([0.4, 0.6], [1.0], late) if name == "in_delay" else lfilter([0.5], [1.0, -0.5], u)
    y = lfilter([0.0, 0.4, 0.2], np.convolve([1.0, -0.8], [1.0, 0.3]), delayed)
    record = make_record(u, y + 0.01 * rng.standard_normal(600), period=1.0)
    structure = structure_of(record, "linear", 2, "rest")
    rows = record.learning
    fit = structure.fit([choice(name)], rows, WHITE, structure.baseline(rows), effort=Effort.FINE)
    (found,) = structure.finish(fit, WHITE).parameters_of(name)
    assert min(abs(found.value - value) for value in values) < 0.1
    assert all(abs(found.value - value) < 2.0 * found.std_error < 2.0 * np.ptp(values) for value in values)


def test_an_effect_without_parameters_has_nothing_to_trade():
    u = np.random.default_rng(7).uniform(-1.0, 1.0, 400)
    y = np.abs(lfilter([0.0, 0.5], [1.0, -0.8], u + 0.5))
    structure = structure_of(make_record(u, y, period=1.0), "linear", 1, "rest")
    rows = structure.record.learning
    fit = structure.fit([choice("out_rectify")], rows, WHITE, structure.baseline(rows), effort=Effort.FINE)
    assert structure.finish(fit, WHITE).parameters_of("out_rectify") == ()


def fit_with(damping, own, frequency=0.5):
    parameters = [FittedParameter(name, value, 0.0, "") for name, value in own.items()]
    parameters.append(FittedParameter("frequency", frequency, 0.0, "rad/s", "extra_mode"))
    parameters.append(FittedParameter("damping", damping, 0.0, "1", "extra_mode"))
    empty = np.zeros(0)
    return StructureFit(
        (choice("extra_mode"),), empty, tuple(parameters), empty, empty.astype(bool), 0.0, 1, True, True, ""
    )


def test_a_damped_path_is_no_mode_unless_it_has_changed_places_with_the_models_own():
    ringing = {"a1": -2.0 * 0.95 * np.cos(0.6), "a2": 0.95**2, "b1": 1.0, "b2": 0.0}
    damped = {"a1": -1.0, "a2": 0.24, "b1": 1.0, "b2": 0.0}
    assert rings(fit_with(0.05, damped))
    assert not rings(fit_with(0.7, damped))
    assert rings(fit_with(0.7, ringing))
    assert not rings(fit_with(0.7, {"m": 1.0, "c": 0.2, "k": 3.0}))


def test_a_mode_at_the_place_of_the_models_own_is_the_model_again():
    frequency, damping = 4.0, 0.3
    pole = frequency * (-damping + 1j * np.sqrt(1.0 - damping**2))
    own = np.array([pole, pole.conjugate(), -5.0])
    assert is_the_plant_again(fit_with(damping, {}, frequency), own)
    assert is_the_plant_again(fit_with(1.05 * damping, {}, 0.97 * frequency), own)
    assert not is_the_plant_again(fit_with(damping, {}, 1.3 * frequency), own)
    assert not is_the_plant_again(fit_with(damping, {}, frequency), np.array([-4.0 + 0.0j]))


def test_structures_tell_their_poles():
    # m x'' + c x' + k x = u, and its difference equation under a held input.
    m, c, k, period = 2.0, 0.8, 50.0, 0.05
    poles = np.roots([m, c, k])
    rng = np.random.default_rng(3)
    record = make_record(rng.standard_normal(300), rng.standard_normal(300), period=period)
    spring = load_model("mass-spring-damper").with_parameters({}, {"m": m, "c": c, "k": k})
    physical = PhysicsStructure(record, spring, "rest")
    fit = replace(fit_with(0.1, {}), point=np.zeros(0))
    assert np.allclose(np.sort_complex(physical.poles(fit)), np.sort_complex(poles))
    denominator = np.real(np.poly(np.exp(period * poles)))[1:]
    linear = LinearStructure(record, 2, initial_state="rest")
    fit = replace(fit, point=np.array([*denominator, 0.0, 1.0]))
    assert np.allclose(np.sort_complex(linear.poles(fit)), np.sort_complex(poles))


def test_least_damping_is_that_of_the_continuous_mode():
    frequency, damping, period = 3.0, 0.15, 0.1
    pole = np.exp(period * frequency * (-damping + 1j * np.sqrt(1.0 - damping**2)))
    denominator = np.real(np.poly([pole, pole.conjugate(), 0.4]))[1:]
    assert least_damping(denominator.tolist()) == pytest.approx(damping, rel=1e-9)


def test_searches_that_end_next_to_each_other_nearly_agree():
    rng = np.random.default_rng(0)
    error = rng.standard_normal(1000)
    aside = rng.standard_normal(1000)
    aside -= error * (error @ aside) / (error @ error)

    def end(share):
        residual = error + share * aside
        point = Residual(residual, lambda: np.zeros((1000, 1)))
        return Minimum(np.zeros(1), point, Status.STEP, (float(residual @ residual),), 1)

    same, near, far = end(0.01), end(0.08), end(0.2)
    assert agree([end(0.0), same], error)
    assert nearly_agree([end(0.0), near])
    assert not agree([end(0.0), near], error)
    assert not nearly_agree([end(0.0), far])


@pytest.mark.parametrize("effect", ["quad_drag", "out_rectify"])
def test_probes_pass_through_the_model_with_its_effects(effect):
    """A probe at the input is the difference of two runs, and the effect makes a difference to it."""
    rng = np.random.default_rng(9)
    u = np.repeat(rng.uniform(-1.0, 1.0, 80), 5)
    y = first_order(u, 0.0)
    record = make_record(u, y + 0.01 * rng.standard_normal(400), period=1.0)
    structure = structure_of(record, "linear", 2, "rest")
    rows = record.learning
    fit = structure.baseline(rows)
    chain, data = structure.chain([choice(effect)]), structure.data(rows)
    own = [0.8] if effect == "quad_drag" else []
    point = np.concatenate([[-1.2, 0.4, 0.3, 0.0], own])
    fit = StructureFit(chain.choices, point, (), np.zeros(400), rows, 1.0, point.size, True, True, "")
    run = chain.run(data, point)
    probes = structure.probes(fit)
    n_functions = (probes.shape[1] - 13) // 2
    at_output, through = probes[:, :n_functions], probes[:, n_functions : 2 * n_functions]
    tiny = 1e-6
    for number in (0, 5, 12):
        moved = data.u + tiny * at_output[:, number]
        again = chain.run(type(data)(moved, data.y, data.used, data.begin, data.period), point)
        expected = (again.y - run.y) / tiny
        # Rows at the kink of a rectifier have no slope.
        smooth = np.abs(run.z) > 1e-3
        assert np.allclose(through[smooth, number], expected[smooth], rtol=1e-3, atol=1e-3)
