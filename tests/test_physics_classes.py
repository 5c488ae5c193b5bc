"""Models as Python classes: read off by symbols, equal to the TOML ones, one sentence for each mistake."""

# ruff: noqa: RUF012 (attributes are written as a user writes them)
import math
import re
from functools import reduce
from importlib.metadata import EntryPoint

import numpy as np
import pytest

import sysid
from sysid.cli import main
from sysid.data import make_record
from sysid.errors import ModelError, UsageError
from sysid.physics import Parameter, PhysicsModel, Prior, fit_physics, load_model
from sysid.physics import reading as model_reading
from sysid.physics.expressions import evaluate
from sysid.physics.simulation import Simulator


class MassOnSpring(PhysicsModel):
    """Mass on a spring and a damper, as a class."""

    states = {"x": "m", "v": "m/s"}
    inputs = {"u": "N"}
    outputs = {"y": "m"}
    parameters = (
        Parameter("m", "kg", 1.0, minimum=0.0),
        Parameter("c", "N s/m", 1.0, minimum=0.0),
        Parameter("k", "N/m", 1.0, minimum=0.0),
    )

    def rates(self, x, u, p):
        return x.v, (u.u - p.c * x.v - p.k * x.x) / p.m

    def measured(self, x, u, p):
        return x.x


class Loop(PhysicsModel):
    """A chain of lags, written with a loop, helpers and every function."""

    states = {f"x{i}": "1" for i in range(3)}
    inputs = {"u": "1"}
    outputs = {"y": "1"}
    parameters = (Parameter("a", "1/s", 1.0, 0.0), Parameter("b", "1", 0.5))
    rest = {"x0": 0.1}

    @staticmethod
    def bent(z, b):
        smooth = np.tanh(z) + np.sin(z) * np.cos(z) + np.exp(-np.abs(z)) - np.sqrt(1.0 + z**2) + np.square(z)
        return np.where(z > b, np.maximum(smooth, np.minimum(z, 2)), np.sign(z) * np.log(1 + abs(z)))

    def rates(self, x, u, p):
        before = [u[0], *x[:2]]
        bent = [self.bent(z, p.b) for z in before]
        return {name: p.a * (f - z) for name, f, z in zip(self.states, bent, x, strict=True)}


def test_a_class_is_the_model_of_the_same_equations():
    model = load_model(MassOnSpring)
    assert model.name == "mass-on-spring"
    assert model.title == "Mass on a spring and a damper, as a class."
    assert str(model) == "x' = v\nv' = (u - c*v - k*x)/m\ny = x"
    values = {"m": 1.3, "c": 0.4, "k": 7.0}
    u = np.random.default_rng(0).standard_normal(200)
    ours = Simulator(model, 0.1)
    assert ours.linear  # and so simulated exactly
    theirs = Simulator(load_model("mass-spring-damper"), 0.1)
    for found, expected in zip(ours.sensitivities(values, u), theirs.sensitivities(values, u), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_loops_helpers_and_functions_give_what_numpy_gives():
    model = Loop.model()
    rng = np.random.default_rng(1)
    for _ in range(20):
        values = dict(zip(("x0", "x1", "x2", "u"), 2.0 * rng.standard_normal(4), strict=True))
        values |= {"a": 1.7, "b": 0.3}
        before = (values["u"], values["x0"], values["x1"])
        for equation, z, state in zip(model.equations, before, ("x0", "x1", "x2"), strict=True):
            expected = 1.7 * (float(Loop.bent(np.float64(z), 0.3)) - values[state])
            assert evaluate(equation.rate, values) == pytest.approx(expected, rel=1e-12)
    assert [state.rest for state in model.states] == [0.1, 0.0, 0.0]
    assert str(model.outputs[0]) == "y = x0"


def test_a_class_is_fitted_and_compared():
    rng = np.random.default_rng(2)
    u = np.repeat(rng.uniform(-1.0, 1.0, 80), 5)
    y = Simulator(MassOnSpring.model(), 0.1).run({"m": 1.3, "c": 0.9, "k": 7.0}, u)[:, 0]
    split = np.repeat(["train", "test"], 200)
    record = make_record(u, y + 0.01 * y.std() * rng.standard_normal(400), 0.1, split=split)
    fit = fit_physics(record, MassOnSpring, start={"m": 1.0, "c": 1.0, "k": 8.0})
    assert fit.values["k"] == pytest.approx(7.0, rel=0.03)
    comparison = sysid.compare(record, MassOnSpring, start={"m": (1.2, 0.2), "c": 1.0, "k": 8.0})
    assert comparison.score_of("test").free_run.nrmse < 0.02


MODULE = '''
from sysid.physics import Parameter, PhysicsModel

class Lag(PhysicsModel):
    """First-order lag."""
    states = {"x": "V"}
    inputs = {"u": "V"}
    outputs = {"y": "V"}
    parameters = (Parameter("rate", "1/s", 1.0, minimum=0.0),)

    def rates(self, x, u, p):
        return p.rate * (u.u - x.x)
'''


def test_a_class_is_named_on_the_command_line(tmp_path, monkeypatch, capsys):
    (tmp_path / "plants.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    assert main(["models", "plants.py:Lag"]) == 0
    assert "x' = rate*(u - x)" in capsys.readouterr().out
    monkeypatch.syspath_prepend(tmp_path)
    assert load_model("plants:Lag").name == "lag"
    rng = np.random.default_rng(3)
    u = np.repeat(rng.standard_normal(40), 5)
    y = Simulator(load_model("plants:Lag"), 0.1).run({"rate": 2.0}, u)[:, 0] + 0.01 * rng.standard_normal(200)
    rows = "".join(f"{a:.6f},{b:.6f}\n" for a, b in zip(u, y, strict=True))
    (tmp_path / "lag.csv").write_text("u,y\n" + rows)
    options = ["compare", "lag.csv", "--period", "0.1", "--model", "plants:Lag", "--param", "rate=1.8+-0.5"]
    assert main([*options, "--json", "lag.json"]) == 0
    assert '"rate"' in (tmp_path / "lag.json").read_text()
    assert main([*options[:-1], "rate=1.8+-0"]) == 2
    assert "give a positive standard deviation" in capsys.readouterr().err


def test_installed_packages_add_models(monkeypatch):
    entry = EntryPoint("spring", f"{__name__}:MassOnSpring", "sysid.models")
    broken = EntryPoint("gone", "no_such_package_here:Model", "sysid.models")
    monkeypatch.setattr(model_reading, "entry_points", lambda group: (entry, broken))
    assert model_reading.all_model_names()[-2:] == ("gone", "spring")
    assert load_model("spring").source.endswith(":MassOnSpring")
    with pytest.raises(ModelError, match=r"model 'gone' of the entry point .* cannot be imported"):
        load_model("gone")


def variant(**changes):
    return type("Faulty", (MassOnSpring,), changes)


def with_rates(rates):
    return {"rates": lambda self, x, u, p: rates(x, u, p)}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (with_rates(lambda x, u, p: (x.v, x.v if x.v > 0 else -x.v)), "write numpy.where, not if"),
        (with_rates(lambda x, u, p: (x.v, math.sin(x.x))), "functions of numpy"),
        (with_rates(lambda x, u, p: (x.v, np.arctan(x.x))), "numpy.arctan cannot stand in an equation"),
        (with_rates(lambda x, u, p: (x.v, np.interp(x.x, [0, 1], [0, 1]))), "numpy.interp cannot stand"),
        (with_rates(lambda x, u, p: (x.v, x.speed)), "Faulty.rates fails (AttributeError"),
        (with_rates(lambda x, u, p: x.v), "gives 1 values: return one for each of x, v"),
        (with_rates(lambda x, u, p: None), "gives None"),
        (with_rates(lambda x, u, p: {"x": x.v}), "give exactly x, v"),
        (with_rates(lambda x, u, p: (x.v, "x")), "gives 'x' for 'v'"),
        (with_rates(lambda x, u, p: (x.v, x.v * float("nan"))), "nan cannot stand"),
        (with_rates(lambda x, u, p: (x.v, u.u / p.m - p.k * x.x)), "'c' occurs in no equation"),
        (with_rates(lambda x, u, p: (x.v, sum([x.x] * 100, p.c * p.k * u.u / p.m))), "more than 80 steps"),
        (with_rates(lambda x, u, p: (x.v, reduce(lambda z, _: z * z, range(12), x.x))), "800 operations"),
        ({"rest": {"x": "1"}}, "'x' is '1': give a finite number"),
        ({"states": {}}, "Faulty.states is {}"),
        ({"inputs": {"u": ""}}, "'u' has the unit ''"),
        ({"inputs": {"sin": "N"}}, "is the name of a function"),
        ({"inputs": {"x": "N"}}, "'x' is given twice"),
        ({"parameters": ("m",)}, "give Parameter(name, unit, start)"),
        ({"parameters": (Parameter("m", "kg", -1.0, minimum=0.0),)}, "start is -1"),
    ],
)
def test_mistakes_in_a_class_are_told_in_one_sentence(changes, message):
    with pytest.raises(ModelError, match=re.escape(message)):
        variant(**changes).model()


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("no_such_module_here:Model", "cannot be imported"),
        ("nowhere.py:Model", "there is no file nowhere.py"),
        ("math:Model", "no class derived from PhysicsModel"),
        ("os; import sys:Model", "is no module"),
        ("two-mas", "is not known"),
    ],
)
def test_wrong_addresses_are_told(address, message):
    with pytest.raises(ModelError, match=re.escape(message)):
        load_model(address)
    record = make_record(np.random.default_rng(0).standard_normal(50), np.arange(50.0), 1.0)
    with pytest.raises((ModelError, UsageError), match=re.escape(message)):
        sysid.compare(record, address)


def test_a_prior_is_part_of_a_class():
    parameter = Parameter("m", "kg", 1.0, minimum=0.0, status="uncertain", prior=Prior(1.0, 0.1))
    model = variant(parameters=(parameter, *MassOnSpring.parameters[1:])).model()
    assert model.parameter("m").prior == Prior(1.0, 0.1)
