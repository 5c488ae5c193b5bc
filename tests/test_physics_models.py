"""Descriptions of models: grammar, derivatives against finite differences, messages on wrong files."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sysid.errors import ModelError
from sysid.physics import load_model, model_names, read_model
from sysid.physics.expressions import (
    FUNCTIONS,
    Evaluator,
    Number,
    Operation,
    code,
    derivative,
    evaluate,
    symbols,
    text,
)
from sysid.physics.grammar import parse

NAMES = ("x", "v", "k")
GOOD = """
name = "spring"
title = "A spring"
[states]
x = { unit = "m" }
v = { unit = "m/s" }
[inputs]
u = { unit = "N" }
[outputs.y]
unit = "m"
terms = { "position" = "x" }
[[equations]]
state = "x"
unit = "m/s"
terms = { "velocity" = "v" }
[[equations]]
state = "v"
factor = "m"
unit = "N"
terms = { "force" = "u", "spring" = "-k*x" }
[parameters]
m = { unit = "kg", start = 1.0, minimum = 0.0 }
k = { unit = "N/m", start = 2.0, minimum = 0.0, maximum = 9.0 }
"""
EQUATIONS = {
    "mass-spring-damper": ["x' = v", "m v' = u - c*v - k*x", "y = x"],
    "dc-motor": ["J w' = K*i - b*w", "L i' = u - R*i - K*w", "y = w"],
    "two-mass": [
        "x1' = v1",
        "m1 v1' = u - k1*x1 - c1*v1 + k2*(x2 - x1) + c2*(v2 - v1)",
        "x2' = v2",
        "m2 v2' = -k2*(x2 - x1) - c2*(v2 - v1)",
        "y = x1",
    ],
    "two-tanks": ["x1' = b*u - a1*x1", "x2' = a1*x1 - a2*x2", "y = x2"],
    "positioning-stage": ["x' = v", "M v' = gain*u - F_v*v - offset", "y = x"],
}
PARAMETERS = {
    "mass-spring-damper": "m c k",
    "dc-motor": "J b K L R",
    "two-mass": "m1 c1 k1 m2 c2 k2",
    "two-tanks": "a1 a2 b",
    "positioning-stage": "M F_v gain offset",
}


# Built-in models


@pytest.mark.parametrize("name", EQUATIONS)
def test_built_in_models_are_those_of_the_contract(name):
    model = load_model(name)
    assert str(model).splitlines() == EQUATIONS[name]
    assert {p.name for p in model.parameters} == set(PARAMETERS[name].split())


def test_only_the_gain_of_the_stage_is_fixed():
    assert [p.name for p in load_model("positioning-stage").parameters if p.status == "fixed"] == ["gain"]


@pytest.mark.parametrize("name", model_names())
def test_every_built_in_model_can_be_read_and_names_its_units(name):
    model = load_model(name)
    assert model.name == name
    assert all(item.unit and item.meaning for item in (*model.states, *model.inputs, *model.parameters))


# Grammar


@pytest.mark.parametrize(
    "expression",
    [
        "__import__('os').system('true')",
        "x.__class__",
        "(lambda: 1)()",
        "[x for x in (1, 2)]",
        "x if x else v",
        "'x'",
        "x @ v",
        "x // v",
        "x % 2",
        "x and v",
        "x == v",
        "0 < x < 1",
        "x[0]",
        "sin(x, v)",
        "sin(x=1)",
        "sin(*x)",
        "eval(x)",
        "open(x)",
        "True",
        "1j",
        "f'{x}'",
        "(y := x)",
        "x; v",
        "",
        "x +",
        "x\x00",
        "9**9**9**9",
        "1/0",
        "log(0)",
        "1e400",
        "9" * 500,
        "(" * 300 + "x" + ")" * 300,
        "-" * 500 + "x",
        "x" * 3000,
        "sin",
        "print",
    ],
)
def test_the_grammar_refuses_what_is_not_on_its_list(expression):
    with pytest.raises(ModelError):
        parse(expression, NAMES)


@given(st.text(alphabet="xvk0123456789.+-*/()<>=, sincotaheprgmwlq_'\"[]:@", max_size=40))
@settings(max_examples=300, deadline=None)
def test_any_text_is_a_tree_of_known_names_or_a_model_error(raw):
    try:
        tree = parse(raw, NAMES)
    except ModelError:
        return
    assert symbols(tree) <= set(NAMES)
    source = code(tree, {"x": "s0", "v": "s1", "k": "p0"})
    assert set(re.findall(r"[A-Za-z_]\w*", re.sub(r"\d[\d.]*e[-+]?\d+", "", source))) <= {
        *("s0", "s1", "p0", "np", "if", "else"),
        *FUNCTIONS,
    }


EXPRESSIONS = [
    "-k*x - 3*v**2 + x/(1 + k**2)",
    "k*abs(v)*v + sign(v)*tanh(x/k)",
    "sqrt(x**2 + 1)*exp(-k*v) - log(x**2 + 0.5)",
    "sin(k*x)*cos(v)",
    "min(x, v) + max(k*x, 2*v)",
    "where(x > v, x**2, k*v)",
    "(x**2 + 1)**(k*v)",
    "x - (v - k) - (x - v)/(k/2)",
    "2**-x*(-v)**2 - -k",
]
points = st.tuples(*[st.floats(0.2, 2.0)] * 3).filter(
    # Away from the kinks of the expressions above.
    lambda p: abs(p[0] - p[1]) > 0.01 and abs(p[2] * p[0] - 2 * p[1]) > 0.01
)


@pytest.mark.parametrize("expression", EXPRESSIONS)
@given(point=points)
@settings(max_examples=25, deadline=None)
def test_derivatives_are_finite_differences_and_code_is_the_value(expression, point):
    tree = parse(expression, NAMES)
    values = dict(zip(NAMES, point, strict=True))
    python = {"abs": abs, "sign": np.sign, "sqrt": np.sqrt, "exp": np.exp, "log": np.log, "sin": np.sin}
    python |= {"cos": np.cos, "tanh": np.tanh, "min": min, "max": max, "where": lambda c, a, b: a if c else b}
    expected = eval(expression, python, values)  # the independent reading of the same text
    assert evaluate(tree, values) == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert evaluate(parse(text(tree), NAMES), values) == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert eval(code(tree, {n: n for n in NAMES}), {"np": np}, values) == pytest.approx(expected, rel=1e-12)
    for name in NAMES:
        step = 1e-6
        ahead, behind = ({**values, name: values[name] + s} for s in (step, -step))
        difference = (evaluate(tree, ahead) - evaluate(tree, behind)) / (2 * step)
        # Central differences lose half the digits.
        assert evaluate(derivative(tree, name), values) == pytest.approx(difference, rel=1e-6, abs=1e-6)


# Files


def test_a_file_of_the_user_is_a_model(tmp_path):
    path = tmp_path / "spring.toml"
    path.write_text(GOOD)
    assert str(load_model(path)) == "x' = v\nm v' = u - k*x\ny = x"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"-k*x"', '"-q*x"', r"spring\.toml: equations 2: term 'spring' = '-q\*x': symbol 'q' is not known"),
        ('"-k*x"', '"-cosh(x)*k"', "function 'cosh' is not known: choose one of abs, cos"),
        ('"-k*x"', "3", "term 'spring' is 3: give an expression"),
        ('unit = "kg", ', "", r"parameters\.m: unit is missing: give a text such as m/s"),
        ('unit = "kg"', 'unit = " "', r"parameters\.m: unit is ' '"),
        ("start = 2.0", "start = 20.0", r"parameters\.k: start is 20: give a number from 0 to 9"),
        ("start = 2.0", "start = nan", r"parameters\.k: start is nan"),
        ("start = 2.0", "start = 0.0", r"parameters\.k: start is 0"),
        ("start = 2.0, ", "", r"parameters\.k: start is missing"),
        ("start = 2.0", 'start = "2"', r"parameters\.k: start is '2': give a number"),
        ("maximum = 9.0", "maximum = -9.0", r"parameters\.k: minimum is 0 and maximum -9"),
        ("maximum = 9.0", "upper = 9.0", r"parameters\.k: key 'upper' is not known"),
        ("maximum = 9.0", 'status = "loose"', r"parameters\.k: status is 'loose'"),
        ('state = "v"', 'state = "w"', "equations 2: state 'w' is none of x, v"),
        ('state = "v"', 'state = "x"', "equations 2: state 'x' has an equation already"),
        ('u = { unit = "N" }', 'u = "N"', r"inputs\.u: is 'N': give a table"),
        ('u = { unit = "N" }', 'u = { unit = "N", delay = "d" }', r"inputs\.u: delay is 'd'"),
        ('u = { unit = "N" }', 'x = { unit = "N" }', "the name 'x' is given twice"),
        ("[parameters]", '[parameters]\n"a b" = {}', r"parameters\.a b: a name is a letter"),
        ("[parameters]", "[parameters]\nsin = {}", r"parameters\.sin: is the name of a function"),
        (
            "[parameters]",
            '[parameters]\nc = { unit = "1", start = 1 }',
            r"parameters\.c: occurs in no equation",
        ),
        ("[parameters]", "[parameters", "is not TOML"),
        ("[parameters]", "[constants]", "key 'constants' is not known"),
        ('title = "A spring"', "", "title: title is missing"),
    ],
)
def test_a_wrong_file_is_named_with_key_and_value(tmp_path, old, new, message):
    path = tmp_path / "spring.toml"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(ModelError, match=message) as caught:
        load_model(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_model_that_is_not_there_is_named():
    with pytest.raises(ModelError, match="choose one of dc-motor"):
        load_model("dc-moter")
    with pytest.raises(ModelError, match=r"nowhere\.toml: cannot be read"):
        load_model("nowhere.toml")


def test_an_equation_for_each_state():
    with pytest.raises(ModelError, match="state 'v' has none"):
        read_model(GOOD[: GOOD.rindex("[[equations]]")] + "[parameters]\n", "spring.toml")


# Changes


def test_start_and_fixed_values_are_checked():
    motor = load_model("dc-motor")
    with pytest.raises(ModelError, match="no parameter 'q'"):
        motor.with_parameters(start={"q": 1.0})
    with pytest.raises(ModelError, match="'J' has a start and a fixed value"):
        motor.with_parameters(start={"J": 1.0}, fixed={"J": 1.0})
    with pytest.raises(ModelError, match="parameter 'J': start is -1"):
        motor.with_parameters(start={"J": -1.0})


def test_a_term_goes_to_an_equation_or_an_output():
    motor = load_model("dc-motor").with_term("w", "drag", "-b*w*abs(w)").with_term("y", "offset", "b")
    assert str(motor).splitlines()[0] == "J w' = K*i - b*w - b*w*abs(w)"
    assert str(motor).splitlines()[2] == "y = w + b"
    with pytest.raises(ModelError, match="no state or output 'q'"):
        motor.with_term("q", "drag", "b")


@pytest.mark.parametrize("mass", [0.7, 0.0])
def test_expressions_that_were_written_out_have_the_values_of_their_trees(mass):
    names = {"x", "m"}
    trees = [
        parse(text, names)
        for text in (
            "x/m",
            "min(x, m)**3",
            "where(x > m, sqrt(-x), x)",
            "abs(x)**m",
            "-x*tanh(m)",
        )
    ]
    values = {"x": 1.3, "m": mass}
    nowhere = Operation("/", (Number(1.0), Number(0.0)))
    assert Evaluator([nowhere, trees[0]])(values) == [np.inf, evaluate(trees[0], values)]
    np.testing.assert_array_equal(Evaluator(trees)(values), [evaluate(tree, values) for tree in trees])
