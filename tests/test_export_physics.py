"""Physical models with effects, saved and taken elsewhere: every copy simulates alike."""

from dataclasses import replace

import numpy as np
import pytest

from sysid.data import make_record
from sysid.diagnosis.diagnose import structure_of
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.export.saved import load, save, saved_model, to_control, to_python
from sysid.diagnosis.export.saved_effects import SavedEffect
from sysid.diagnosis.export.saved_physics import SavedPhysicalModel
from sysid.diagnosis.ladder import DiagnosedModel
from sysid.diagnosis.structures.structure import Choice, Effort
from sysid.errors import DataError, ModelError
from sysid.physics import load_model
from sysid.physics.reading import model_names, read_model
from sysid.physics.writing import model_text

CASES = {
    "mass-spring-damper": [("coulomb", "coulomb", [0.3]), ("in_deadzone", "symmetric", [0.2])],
    "dc-motor": [("in_relay", "symmetric", [0.4, 1.5]), ("op_gain", "", [0.3, 0.5])],
    "two-tanks": [("sqrt_outflow", "", []), ("overflow", "cascade", [3.0, 2.0, 0.4])],
    "positioning-stage": [("hysteresis_force", "", [4.0, 0.5]), ("out_lowpass", "", [0.15])],
    "two-mass": [("extra_mode", "", [2.0, 0.1, 0.2, -0.1]), ("out_offset", "", [0.3])],
}


def by_hand(name, effects=None):
    found = []
    for effect, form, values in CASES[name] if effects is None else effects:
        (known,) = find_effects([effect])
        form = known.form(form) if form in [f.name for f in known.forms] else known.forms[0]
        names = [p.name for p in form.parameters]
        names += ["level"] if len(values) > len(names) else []
        found.append(SavedEffect(effect, form.name, dict(zip(names, values, strict=True))))
    return SavedPhysicalModel(model_text(load_model(name)), 0.1, "zero", 2, tuple(found))


def a_signal(name, n=150):
    u = np.repeat(np.random.default_rng(5).uniform(-2, 2, n // 10), 10)
    return np.abs(u) if name == "two-tanks" else u


@pytest.mark.parametrize("name", sorted(model_names()))
def test_the_text_of_a_model_reads_as_the_model(name):
    model = load_model(name)
    assert read_model(model_text(model), "text") == model


@pytest.mark.parametrize("name", CASES)
def test_a_saved_model_simulates_alike_everywhere(tmp_path, name):
    saved, u = by_hand(name), a_signal(name)
    expected = saved.simulate(u)
    assert np.std(expected) > 0.0
    for ending in ("json", "toml"):
        file = tmp_path / f"model.{ending}"
        save_text(saved, file)
        assert load(file) == saved
    names: dict[str, object] = {}
    exec(to_python(saved), names)
    # The same operations, compiled and not: only how sums are contracted differs.
    assert np.allclose(names["simulate"](u), expected, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("behind", [False, True])
def test_a_path_beside_a_physical_model_begins_before_or_behind_the_actuator(behind):
    """Against the held input's exact solution of a resonance, one row after the other."""
    from scipy.linalg import expm

    mode = {"frequency": 3.0, "damping": 0.1, "gain_1": 0.2, "gain_2": -0.1}
    saved = by_hand("mass-spring-damper", [])
    effects = (
        SavedEffect("feedthrough", "behind" if behind else "direct", {"d": 0.4}),
        SavedEffect("in_deadzone", "symmetric", {"width": 0.5}),
        SavedEffect("extra_mode", "second order behind" if behind else "second order", mode),
    )
    saved, u = replace(saved, effects=effects), a_signal("")
    m, c, k = (value for _, value, _ in saved.parameters())
    A = np.array([[0.0, 1.0, 0.0], [-k / m, -c / m, 1.0 / m], [0.0, 0.0, 0.0]])
    step, state = expm(0.1 * A), np.zeros(2)
    x = np.where(np.abs(u) > 0.5, u - 0.5 * np.sign(u), 0.0)
    given = x if behind else u
    radius, angle = np.exp(-0.1 * 3.0 * 0.1), 3.0 * 0.1 * np.sqrt(1.0 - 0.01)
    w, beside = np.zeros(u.size), np.zeros(u.size)
    for row in range(u.size):
        for lag, weight in ((1, 0.2), (2, -0.1)):
            beside[row] += weight * given[row - lag] if row >= lag else 0.0
        beside[row] += 2.0 * radius * np.cos(angle) * beside[row - 1] if row else 0.0
        beside[row] -= radius**2 * beside[row - 2] if row > 1 else 0.0
        w[row] = state[0]
        state = (step @ [*state, x[row]])[:2]
    expected = w + 0.4 * given + beside
    names: dict[str, object] = {}
    exec(to_python(saved), names)
    for found in (saved.simulate(u), names["simulate"](u)):
        assert np.allclose(found, expected, rtol=1e-10, atol=1e-11)
    assert ("where x drives the model (d = 0.4)" in saved.equation()) == behind


def save_text(saved, file):
    """Write what `save` writes of a model that was fitted."""
    from sysid.diagnosis.export import saved as export

    kinds = {".json": export._json_text, ".toml": export._toml_text}
    file.write_text(kinds[file.suffix](saved), encoding="utf-8")


def test_a_fitted_model_is_saved_as_it_simulates(tmp_path):
    u = a_signal("", 300)
    y = by_hand("mass-spring-damper", [("coulomb", "coulomb", [0.3])]).simulate(u)
    y += 0.01 * np.random.default_rng(1).standard_normal(y.size)
    record = make_record(u, y, period=0.1)
    structure = structure_of(record, "mass-spring-damper", None, "rest", {"m": 1.2, "c": 1.1, "k": 0.9})
    rows = record.learning
    (effect,) = find_effects(["coulomb"])
    baseline = structure.baseline(rows)
    fit = structure.fit([Choice(effect, effect.forms[0])], rows, np.ones(1), baseline, effort=Effort.COARSE)
    model = DiagnosedModel(structure, fit)
    file = tmp_path / "model.toml"
    save(model, file)
    assert load(file) == saved_model(model)
    # The file holds every digit, and the run has the same steps.
    assert np.allclose(load(file).simulate(u), model.output, rtol=1e-12, atol=1e-14)
    save(model, tmp_path / "model.py")
    assert "def simulate(u):" in (tmp_path / "model.py").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "effects"),
    [
        ("mass-spring-damper", [("coulomb", "coulomb", [0.3]), ("out_quadratic", "", [0.1])]),
        ("two-tanks", [("sqrt_outflow", "", []), ("overflow", "limit", [1.5])]),
        ("positioning-stage", [("hysteresis_force", "", [4.0, 0.5]), ("cubic_stiffness", "", [0.5])]),
    ],
)
def test_a_saved_model_runs_in_python_control(name, effects):
    import control

    saved = by_hand(name, effects)
    system = to_control(saved)
    n = 80
    times = 0.1 * np.arange(n)
    found = control.input_output_response(
        system, times, np.ones(n), np.zeros(system.nstates), solve_ivp_kwargs={"max_step": 0.02}
    )
    expected = saved.simulate(np.ones(n))
    # The other solver steps over an event: friction that changes sides or a tank that runs over.
    assert np.allclose(found.outputs, expected, atol=2e-3 * np.abs(expected).max())


def test_what_cannot_be_taken_along_is_said():
    saved = by_hand("two-mass")
    with pytest.raises(ModelError, match="'extra_mode' has a memory"):
        to_control(saved)
    hard = load_model("oscillator").with_parameters(start={"cubic": 2.0})
    bent = SavedPhysicalModel(model_text(hard), 0.1, "zero", 2, ())
    with pytest.raises(ModelError, match="not linear in its states: save it as JSON"):
        to_python(bent)
    with pytest.raises(ModelError, match="not linear in its states: use"):
        to_control(bent)
    assert bent.simulate(np.ones(20)).shape == (20,)


def test_a_file_with_another_model_in_it_is_refused(tmp_path):
    file = tmp_path / "model.json"
    save_text(by_hand("two-mass"), file)
    file.write_text(file.read_text().replace("[states]", "[things]"))
    with pytest.raises((DataError, ModelError), match="things"):
        load(file)
