"""Effects of the user's own: drafted from a curve, in linear and physical models, saved and taken along."""

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import sysid
from sysid.cli import main
from sysid.data import make_record
from sysid.diagnosis.curve_laws import simplest_law
from sysid.diagnosis.effects.catalogue import effects_in
from sysid.diagnosis.effects.templates import template
from sysid.diagnosis.export.saved import load, save

GRID = np.linspace(-2.0, 2.0, 101)
EVEN = np.ones(101)


def steps(n, hold, size, seed=0):
    return np.repeat(np.random.default_rng(seed).uniform(-size, size, n), hold)


def added(curve):
    """Return what a map adds to its input where the model has taken over a gain of its own."""
    return curve / np.polyfit(GRID, curve, 1)[0] - GRID


def cubic_damping(u, T, d=1.5):
    """A mass-spring-damper whose damper stiffens with the cube of the speed, by scipy."""
    z, y = np.zeros(2), []
    for value in u:
        y.append(z[0])

        def rate(t, z, value=value):
            return [z[1], value - 0.3 * z[1] - 4.0 * z[0] - d * z[1] ** 3]

        z = solve_ivp(rate, (0.0, T), z, rtol=1e-8, atol=1e-10).y[:, -1]
    return np.array(y)


@pytest.fixture(scope="module")
def damped():
    u, T = steps(180, 5, 3.0), 0.12
    y = cubic_damping(u, T) + 0.004 * np.random.default_rng(1).standard_normal(u.size)
    split = np.where(np.arange(u.size) < 600, "est", "val")
    return u, y, T, split


@pytest.mark.parametrize(
    ("curve", "own", "terms", "values"),
    [
        (added(np.clip(GRID, -1.0, 1.2)), 1.0, ("min(s + 1, 0)", "max(s - 1.2, 0)"), (-1.0, -1.0)),
        (added(GRID - np.clip(GRID, -0.4, 0.4)), 1.0, None, None),
        (0.3 * GRID**2 + 0.1 * GRID, 1.0, ("s**2",), (0.3,)),
        (0.2 * GRID**3 - GRID, 0.0, ("s**3",), (0.2,)),
    ],
)
def test_the_simplest_law_of_a_curve(curve, own, terms, values):
    """A dead zone may count from either of its sides."""
    law = simplest_law(GRID, curve, EVEN, "s", own)
    assert law.follows > 0.99
    if terms is None:
        assert sorted(law.values) == pytest.approx([-1.0, 1.0], abs=0.05)
        assert {term[-8:-4].strip() for term in law.terms} == {"0.4"}
        return
    assert law.terms == terms
    assert law.values == pytest.approx(values, rel=0.1)


def test_places_of_kinks_are_fine_beside_a_large_value():
    curve = 0.01 * added(np.clip(GRID, -1.0, 1.0))
    law = simplest_law(293.0 + 0.01 * GRID, curve, EVEN, "s", 1.0)
    assert law.terms == ("min(s - 292.99, 0)", "max(s - 293.01, 0)")


@pytest.mark.parametrize("port", ["input", "output", "force", "gain"])
def test_templates_are_effects(port, capsys):
    assert main(["effects", "--template", port]) == 0
    text = capsys.readouterr().out
    assert text == template(port)
    (effect,) = effects_in(text, "the template")
    assert effect.port == port


def test_a_curve_is_drafted_given_back_and_explains_what_nothing_else_did(damped, tmp_path, capsys):
    """The whole way by the command line, with a physical model."""
    u, y, T, split = damped
    rows = "\n".join(f"{a!r},{b!r},{c}" for a, b, c in zip(u.tolist(), y.tolist(), split, strict=True))
    (tmp_path / "record.csv").write_text(f"u,y,set\n{rows}\n")
    known = ["diagnose", str(tmp_path / "record.csv"), "--period", str(T), "--split-column", "set"]
    known += ["--model", "mass-spring-damper", "--initial-state", "rest"]
    draft, first, second = (tmp_path / name for name in ("mine.toml", "first.json", "second.json"))
    given = ["--effects", "in_saturation,out_offset,coloured_noise"]
    assert main([*known, *given, "--draft", str(draft), "--json", str(first)]) == 0
    found = json.loads(first.read_text())
    assert found["verdict"] == "unexplained"
    (told,) = (sentence for sentence in found["sentences"] if sentence.startswith("By this curve"))
    assert float(told.split()[7]) == pytest.approx(1.5, rel=0.25)  # a smooth curve of a few knots
    assert "v^3, in N, opposes the input, where v is the velocity in m/s" in told
    assert str(draft) in capsys.readouterr().out.splitlines()[-1]
    (effect,) = effects_in(draft.read_text(), "the draft")
    assert (effect.port, effect.name) == ("force", "velocity_curve")
    given = ["--effects", "in_saturation,out_offset,velocity_curve", "--effects-file", str(draft)]
    assert main([*known, *given, "--json", str(second), "--save", str(tmp_path / "model.json")]) == 0
    found = json.loads(second.read_text())
    assert found["accepted"] == ["velocity_curve"]
    error = found["ladder"][-1]["scores"]["validation"]["rmse"]
    assert error < 0.3 * found["ladder"][0]["scores"]["validation"]["rmse"]
    assert np.isfinite(load(tmp_path / "model.json").simulate(u)).all()


def test_without_a_curve_no_draft_is_written(tmp_path, capsys):
    u = steps(120, 5, 1.0)
    y = np.convolve(u, np.append(0.0, 0.3 * 0.7 ** np.arange(40)))[: u.size]  # without a direct path
    y += 0.01 * np.random.default_rng(2).standard_normal(u.size)
    np.savetxt(tmp_path / "r.csv", np.column_stack([u, y]), delimiter=",", header="u,y", comments="")
    draft = tmp_path / "mine.toml"
    arguments = ["diagnose", str(tmp_path / "r.csv"), "--period", "0.1", "--model", "linear", "--order", "1"]
    assert main([*arguments, "--effects", "in_saturation", "--draft", str(draft)]) == 0
    assert "No draft was written" in capsys.readouterr().out
    assert not draft.exists()


@pytest.mark.parametrize("model", ["linear", "mass-spring-damper"])
@pytest.mark.parametrize("ending", [".json", ".toml", ".py"])
def test_a_model_with_effects_of_ones_own_is_saved(damped, model, ending, tmp_path):
    """Whole again without the file they were read from; the Python function needs NumPy alone."""
    u, y, T, split = damped
    text = """
[soft_limit]
port = "input"
expression = "limit*tanh(s/limit)"
parameters.limit = { unit = "[u]", minimum = 0, grid = { scale = "input deviation", points = [1, 2, 4] } }
[cubic_damper]
port = "force"
expression = "d*v**3"
parameters.d = { unit = "[F]/[v]^3" }
[weaker]
port = "gain"
expression = "where(y > 0, 1 - w, 1)"
parameters.w = { unit = "1" }
"""
    record = make_record(u, y, period=T, split=split)
    order = 2 if model == "linear" else None
    found = sysid.diagnose(
        record, model, order, initial_state="rest", effects=[], add=effects_in(text, "the test")
    )
    path = tmp_path / f"model{ending}"
    save(found.final, path)
    expected = found.final.output
    if ending == ".py":
        names: dict[str, object] = {}
        exec(path.read_text(), names)
        simulated = names["simulate"](u)
    else:
        simulated = load(path).simulate(u)
    # The same equations; the last fit of a physical model may have been simulated in finer steps.
    assert np.abs(simulated - expected).max() < 1e-3 * np.ptp(y)


def test_a_force_of_ones_own_goes_with_dry_friction():
    """Both are found, from records in which the damper and the friction act together."""
    from sysid.physics.forced import ForcedPlant, law
    from sysid.physics.own_laws import OwnLaw
    from sysid.physics.reading import load_model

    u, T = steps(240, 5, 3.0, seed=4), 0.12
    plant = ForcedPlant(load_model("mass-spring-damper"), T)
    own = OwnLaw((("force", "d*v**3", ("d",)),))
    laws = np.array([[*law(friction_forward=0.4, friction_back=0.4), 1.5]])
    y = plant.run(np.array([[1.0, 0.3, 4.0]]), laws, u, substeps=20, own=own)[0]
    y += 0.003 * np.random.default_rng(3).standard_normal(u.size)
    text = '[cubic_damper]\nport = "force"\nexpression = "d*v**3"\nparameters.d.unit = "[F]/[v]^3"\n'
    found = sysid.diagnose(
        make_record(u, y, period=T, split=np.where(np.arange(u.size) < 800, "est", "val")),
        "mass-spring-damper", initial_state="rest", start={"m": 1.1, "c": 0.28, "k": 4.2},
        effects=[*effects_in(text, "the test"), "coulomb", "in_saturation", "out_offset"],
    )  # fmt: skip
    assert set(found.accepted) == {"cubic_damper", "coulomb"}
    assert "cubic_damper: d*v**3" in found.sentences()
    for name, value in (("cubic_damper", 1.5), ("coulomb", 0.4)):
        (parameter,) = found.final.fitted.parameters_of(name)
        assert abs(parameter.value - value) < 4.0 * parameter.std_error
