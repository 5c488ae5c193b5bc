"""A model's equation as it grows: each law with its values, and where it acts."""

from pathlib import Path

import numpy as np
import pytest

from sysid import diagnose, load, save
from sysid.data import make_record
from sysid.diagnosis.effects.catalogue import find_effects
from sysid.diagnosis.linear.parameters import equation_text as of_differences
from sysid.diagnosis.physics.equation import equation_text
from sysid.errors import UsageError
from sysid.physics import load_model

PLANT = np.array([-1.5, 0.7, 0.2, 0.1])


def test_names_of_signals_are_those_of_the_effects_that_are_there() -> None:
    saturation, drag, bend = find_effects(["in_saturation", "quad_drag", "out_quadratic"])
    plain = of_differences(2, False, PLANT, [])
    assert plain == "y(k) - 1.5 y(k-1) + 0.7 y(k-2) = 0.2 u(k-1) + 0.1 u(k-2)"
    laws = [(saturation, {"level": 1.0}), (drag, {"c": 0.2}), (bend, {"c": 0.1})]
    equation, *lines = of_differences(2, False, PLANT, laws).split("\n")
    assert equation == "z(k) - 1.5 z(k-1) + 0.7 z(k-2) = 0.2 x(k-1) + 0.1 x(k-2)"
    assert lines[0].endswith("(level = 1), which drives the model in place of u")
    assert lines[1].endswith("(c = 0.2), taken off x, where v is the change of z in a sample")
    assert lines[2] == "out_quadratic: y = w + c w^2 (c = 0.1), where w is z"


@pytest.mark.parametrize(
    ("model", "name", "line"),
    [
        ("dc-motor", "coulomb", ", in J w' = K*i - b*w - F, where v is w"),
        ("two-mass", "cubic_stiffness", ", in m1 v1' = u - k1*x1 - c1*v1 + k2*(x2 - x1) + c2*(v2 - v1) - F"),
        ("two-mass", "cubic_stiffness", ", where x is x1"),
        ("two-tanks", "out_quadratic", ", where w is x2"),
        ("oscillator", "op_gain", ", which drives the model in place of u"),
    ],
)
def test_a_law_says_where_it_acts_in_a_physical_model(model: str, name: str, line: str) -> None:
    (effect,) = find_effects([name])
    last = equation_text(load_model(model), [(effect, {})]).split("\n")[-1]
    assert last.startswith(f"{name}: {effect.equation}, ")
    assert line in last


@pytest.mark.parametrize("model", ["linear", "dc-motor"])
def test_a_saved_model_shows_the_equations_of_the_diagnosis(model: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    u = np.repeat(rng.uniform(-2, 2, 150), 4)
    y = np.zeros(u.size)
    for k in range(1, u.size):
        y[k] = 0.8 * y[k - 1] + 0.2 * min(max(u[k - 1], -1.0), 1.0)
    record = make_record(u, y + 0.01 * rng.standard_normal(u.size), period=0.1)
    given = {"order": 1} if model == "linear" else {"fixed": {"L": 1e-3, "R": 1.0}}
    found = diagnose(record, model, add=["in_saturation"], effects=["in_saturation"], max_effects=0, **given)
    save(found, tmp_path / "model.json")
    shown = found.final.equation().split("\n")
    assert shown[-1].startswith("in_saturation: x = min(max(u, -level), level) (level = ")
    # A saved linear model always has its constant.
    assert list(load(tmp_path / "model.json").equation().split("\n"))[1:] == shown[1:]


def test_what_is_no_model_is_not_saved(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="of type int: give that of a diagnosis"):
        save(3, tmp_path / "model.json")
    assert not list(tmp_path.iterdir())
