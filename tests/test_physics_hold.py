"""Inputs between samples: held or smooth; modes above half the sampling rate; refits from one start."""

import numpy as np
import pytest
from physics_cases import VALUES, free_model
from scipy import signal
from scipy.interpolate import CubicSpline

from sysid.data import make_record
from sysid.diagnosis import ports
from sysid.diagnosis.diagnose import diagnose
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.models.resolution import fit_model, resolve_model
from sysid.diagnosis.physics.structure import PhysicsStructure
from sysid.diagnosis.ports import explore_ports
from sysid.diagnosis.shortfall import curves_at_ports
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort
from sysid.errors import UsageError
from sysid.physics import fit_physics, load_model, refit_physics
from sysid.physics.hold import PIECES, refined
from sysid.physics.problem import Problem
from sysid.physics.simulation import Simulator

PERIOD = 0.05
RINGING = {"m": 1.0, "c": 0.8, "k": 400.0}  # 3.2 Hz at 20 Hz
STIFF = load_model("mass-spring-damper").with_parameters(start={"m": 1.0, "c": 0.8, "k": 300.0})


def band_limited(n, seed=0):
    """A multisine without power above 40 % of the sampling rate, and its samples eight times as close."""
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0.0, 2.0 * np.pi, int(0.35 * n))
    spectrum = np.zeros(n // 2 + 1, dtype=complex)
    spectrum[1 : phases.size + 1] = np.exp(1j * phases)
    u = np.fft.irfft(spectrum, n)
    return u / u.std(), signal.resample(u / u.std(), 8 * n)


def smooth_record(n=1200, noise=0.0, seed=0):
    """A plant run on the close samples, so that little depends on what the input does between them."""
    u, close = band_limited(n, seed)
    model = load_model("mass-spring-damper")
    y = Simulator(model, PERIOD / 8).run(RINGING, close)[::8, 0]
    # A piece of 1/8 sample that is held comes late by half of it.
    y = y + noise * y.std() * np.random.default_rng(seed).standard_normal(n)
    split = np.repeat(["train", "test"], [2 * n // 3, n - 2 * n // 3])
    return make_record(u, y, PERIOD, split=split)


@pytest.mark.parametrize(
    "name", ["dc-motor", "two-mass", "two-tanks", "thermal-second-order", "positioning-stage"]
)
def test_a_smooth_run_is_the_run_over_its_pieces(name):
    rng = np.random.default_rng(1)
    model, u = free_model(name), rng.standard_normal(60)
    start = rng.standard_normal(model.order)
    smooth = Simulator(model, 0.4, hold="smooth")
    expected = Simulator(model, 0.1).run(VALUES[name], refined(u), start)[::4]
    y, J = smooth.sensitivities(VALUES[name], u, start)
    if any(variable.delay for variable in model.inputs):
        expected = y  # the delay comes before the spline, whose pieces are then others
    np.testing.assert_allclose(
        smooth.run(VALUES[name], u, start), expected, atol=1e-9 * np.abs(expected).max()
    )
    np.testing.assert_allclose(y, smooth.run(VALUES[name], u, start), atol=1e-12 * np.abs(y).max())
    for place, parameter in enumerate(smooth.searched):
        step = 1e-6 * max(abs(VALUES[name][parameter]), 1e-3)
        sides = [
            smooth.run({**VALUES[name], parameter: VALUES[name][parameter] + sign * step}, u, start)
            for sign in (1.0, -1.0)
        ]
        slope = (sides[0] - sides[1]) / (2.0 * step)
        np.testing.assert_allclose(J[:, :, place], slope, atol=2e-5 * max(np.abs(slope).max(), 1e-9))


def test_a_smooth_run_of_a_nonlinear_model_is_the_run_over_its_pieces():
    model = load_model("oscillator").with_parameters(start={"cubic": 2.0})
    u = np.random.default_rng(2).standard_normal(60)
    values = {"w0": 2.0, "zeta": 0.1, "gain": 1.0, "cubic": 2.0}
    smooth = Simulator(model, 0.4, substeps=4, hold="smooth").run(values, u)
    pieces = Simulator(model, 0.1, substeps=4).run(values, refined(u))[::4]
    np.testing.assert_allclose(smooth, pieces, atol=1e-14)


def test_parameters_come_back_from_an_input_that_was_not_held():
    record = smooth_record()
    found = fit_model(record, resolve_model("mass-spring-damper"), initial_state="rest")
    assert found.fit.hold == "smooth"
    assert "follow a smooth curve" in found.notes[1]
    assert found.details()["hold"] == "smooth"
    # The spline is not the sum of sines, and the close samples are held: some per cent each.
    for name, value in RINGING.items():
        assert found.fit.values[name] == pytest.approx(value, rel=0.05)
    held = fit_physics(record, STIFF, initial_state="rest")
    assert found.fit.rms < 0.3 * held.rms


def test_a_held_input_stays_held():
    rng = np.random.default_rng(3)
    u = rng.standard_normal(600)
    y = Simulator(load_model("mass-spring-damper"), PERIOD).run(RINGING, u)[:, 0]
    found = fit_model(make_record(u, y, PERIOD), resolve_model(STIFF), initial_state="rest")
    assert found.fit.hold == "zero"
    assert len(found.notes) == 1


@pytest.mark.parametrize(
    ("shape", "axis"), [((300,), 0), ((3, 200, 2), 1), ((200, 2), 0), ((2,), 0), ((1, 1), 0)]
)
def test_the_smooth_curve_is_the_natural_cubic_spline(shape, axis):
    samples = np.random.default_rng(0).standard_normal(shape)
    n = shape[axis]
    if n > 1:
        times = np.minimum((np.arange(n * PIECES) + 0.5) / PIECES, n - 1.0)
        expected = CubicSpline(np.arange(n), samples, axis=axis, bc_type="natural")(times)
    else:
        expected = np.repeat(samples, PIECES, axis=axis)
    # Tridiagonal systems with 1, 4, 1 in each row are well conditioned: rounding alone.
    np.testing.assert_allclose(refined(samples, axis), expected, rtol=0.0, atol=1e-13)


def test_a_limited_reading_is_found_although_the_input_was_not_held():
    """Under a held input the limit leaves something, so that the input's other course is looked at."""
    n, period, close = 1000, 0.35, 20
    rng = np.random.default_rng(3)
    lines = np.where(np.arange(n * close // 2 + 1) < 0.3 * n, 1.0, 0.0)
    u = np.fft.irfft(lines * np.exp(2j * np.pi * rng.uniform(size=lines.size)), n * close)
    u /= u.std()
    model = load_model("mass-spring-damper")
    y = Simulator(model, period / close).run({"m": 1.0, "c": 0.5, "k": 2.0}, u)[::close, 0]
    y = np.clip(y, -1.3 * y.std(), 1.3 * y.std()) + 0.02 * y.std() * rng.standard_normal(n)
    limited = make_record(u[::close], y, period, split=np.repeat(["est", "val", "test"], [500, 250, 250]))
    near = model.with_parameters(start={"m": 1.15, "c": 0.43, "k": 1.8})
    found = diagnose(
        limited, near, initial_state="rest",
        effects=["out_saturation", "in_saturation", "out_quadratic"],
    )  # fmt: skip
    assert found.verdict == "missing-effect"
    assert found.accepted == ("out_saturation",)
    assert found.structure.plant.hold == "smooth"


def test_a_fit_that_is_asked_for_again_is_not_made_again():
    record = smooth_record(300, noise=0.01)
    structure = PhysicsStructure(record, STIFF, "rest")
    rows = record.learning
    baseline = structure.baseline(rows)
    (effect,) = structure.offered(find_effects(["out_offset"]))
    choice = Choice(effect, effect.forms[0])
    fit = structure.fit([choice], rows, WHITE, baseline, effort=Effort.COARSE)
    assert structure.fit([choice], rows, WHITE, baseline, effort=Effort.COARSE) is fit
    assert structure.fit([choice], rows, np.array([1.0, -0.5]), baseline, effort=Effort.COARSE) is not fit
    assert structure.fit([choice], rows, WHITE, baseline, effort=Effort.FINE) is not fit
    assert structure.held_or_smooth()  # from now on another model
    assert structure.fit([choice], rows, WHITE, baseline, effort=Effort.COARSE).cost != fit.cost


def test_a_band_limited_input_that_was_held_stays_held():
    u, _ = band_limited(900, seed=4)
    y = Simulator(load_model("mass-spring-damper"), PERIOD).run(RINGING, u)[:, 0]
    found = fit_model(make_record(u, y, PERIOD), resolve_model(STIFF), initial_state="rest")
    assert found.fit.hold == "zero"


def test_curves_at_ports_use_the_smooth_input():
    record = smooth_record(900, noise=0.01)
    fit = refit_physics(record, fit_physics(record, STIFF, initial_state="rest"), hold="smooth")
    for curve in explore_ports(record, fit):
        # Nothing is missing: what remains is noise, and what the spline leaves out.
        assert curve.explains_at_most < 0.35, curve.sentence


def test_curves_at_ports_stand_on_the_model_that_was_diagnosed(monkeypatch):
    record, found = smooth_record(900, noise=0.01), []
    structure = PhysicsStructure(record, STIFF, "rest")
    baseline = structure.baseline(record.estimation)
    monkeypatch.setattr(ports, "explore_ports", lambda record, fit, ports: found.append(fit))
    curves_at_ports(structure, baseline)
    (fit,) = found
    assert fit.hold == structure.plant.hold == "smooth"
    assert fit.values == pytest.approx(RINGING, rel=0.05)
    assert fit.status.endswith("refitted from one start")


def test_no_mode_above_half_the_sampling_rate_unless_asked_for():
    u, _ = band_limited(900, seed=5)
    y = Simulator(load_model("oscillator"), PERIOD).run({"w0": 20.0, "zeta": 0.02, "gain": 1.0}, u)[:, 0]
    record = make_record(u, y, PERIOD)
    fit = fit_physics(record, "oscillator", initial_state="rest")
    assert fit.values["w0"] == pytest.approx(20.0, rel=1e-4)
    problem = Problem(load_model("oscillator"), (), PERIOD, free_start=False)
    for w0, folded in ((20.0, False), (2.0 * np.pi / PERIOD - 20.0, True)):
        assert problem.folded(problem.coordinates({"w0": w0, "zeta": 0.02, "gain": 1.0})) is folded


def test_a_refit_goes_on_from_where_the_fit_ended():
    record = smooth_record(900, noise=0.02)
    rows = record.estimation
    fit = fit_physics(record, STIFF, initial_state="rest", rows=rows)
    again = refit_physics(record, fit, rows=rows)
    assert again.rms == pytest.approx(fit.rms, rel=1e-6)
    assert again.status.endswith("refitted from one start")
    more = refit_physics(record, fit)
    assert more.n_rows == record.learning.sum()
    assert [p.status for p in more.model.parameters] == [p.status for p in fit.model.parameters]


def test_an_unknown_hold_is_refused():
    with pytest.raises(UsageError, match="hold is 'linear': choose zero or smooth"):
        fit_physics(smooth_record(300), "mass-spring-damper", hold="linear")
