"""Write a model as the text of a TOML file, which `sysid.physics.reading` reads again."""

import json
from collections.abc import Sequence
from math import isfinite

from sysid.physics.expressions import text
from sysid.physics.model import Equation, Model, Parameter, Term, Variable


def model_text(model: Model) -> str:
    """Return the TOML text of a model; priors of its parameters are left out.

    Examples
    --------
    >>> from sysid.physics import load_model
    >>> from sysid.physics.reading import read_model
    >>> motor = load_model("dc-motor")
    >>> read_model(model_text(motor), "a file") == motor
    True
    """
    lines = [f"name = {_quoted(model.name)}", f"title = {_quoted(model.title)}", "", "[states]"]
    lines += [_variable(state) for state in model.states]
    lines += ["", "[inputs]", *(_variable(variable) for variable in model.inputs)]
    for output in model.outputs:
        lines += ["", f"[outputs.{output.name}]", f"unit = {_quoted(output.unit)}"]
        lines += [f"meaning = {_quoted(output.meaning)}"] if output.meaning else []
        lines.append(f"terms = {_terms(output.terms)}")
    for equation in model.equations:
        lines += ["", *_equation(equation)]
    return "\n".join([*lines, "", "[parameters]", *map(_parameter, model.parameters)]) + "\n"


def _quoted(string: str) -> str:
    return json.dumps(string, ensure_ascii=False)


def _table(name: str, entries: Sequence[tuple[str, str]]) -> str:
    return f"{name} = {{ {', '.join(f'{key} = {value}' for key, value in entries)} }}"


def _variable(variable: Variable) -> str:
    entries = [("unit", _quoted(variable.unit))]
    entries += [("rest", repr(variable.rest))] if variable.rest else []
    entries += [("delay", _quoted(variable.delay))] if variable.delay else []
    entries += [("meaning", _quoted(variable.meaning))] if variable.meaning else []
    return _table(variable.name, entries)


def _terms(terms: Sequence[Term]) -> str:
    inside = ", ".join(f"{_quoted(term.name)} = {_quoted(text(term.expression))}" for term in terms)
    return f"{{ {inside} }}"


def _equation(equation: Equation) -> list[str]:
    lines = ["[[equations]]", f"state = {_quoted(equation.state)}"]
    factor = text(equation.factor)
    lines += [f"factor = {_quoted(factor)}"] if factor != "1" else []
    return [*lines, f"unit = {_quoted(equation.unit)}", f"terms = {_terms(equation.terms)}"]


def _parameter(parameter: Parameter) -> str:
    entries = [("unit", _quoted(parameter.unit)), ("start", repr(float(parameter.start)))]
    for key, value in (("minimum", parameter.minimum), ("maximum", parameter.maximum)):
        entries += [(key, repr(float(value)))] if isfinite(value) else []
    entries += [("status", _quoted(parameter.status))] if parameter.status != "free" else []
    entries += [("meaning", _quoted(parameter.meaning))] if parameter.meaning else []
    return _table(parameter.name, entries)
