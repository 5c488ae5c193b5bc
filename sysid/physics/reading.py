"""Read a model from a TOML file; the built-in models are such files too."""

import re
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from sysid.errors import ModelError
from sysid.physics.expressions import FUNCTIONS, ONE, Expression
from sysid.physics.grammar import parse
from sysid.physics.model import Equation, Model, Output, Parameter, Term, Variable

LARGEST_FILE = 100_000
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_KEYS = {
    "model": ("name", "title", "states", "inputs", "outputs", "equations", "parameters"),
    "states": ("unit", "meaning", "rest"),
    "inputs": ("unit", "meaning", "delay"),
    "outputs": ("unit", "meaning", "terms"),
    "equations": ("state", "factor", "unit", "terms"),
    "parameters": ("unit", "start", "minimum", "maximum", "status", "meaning"),
}
Table = Mapping[str, Any]


def model_names() -> tuple[str, ...]:
    """Return the names of the built-in models.

    Examples
    --------
    >>> "dc-motor" in model_names()
    True
    """
    folder = files("sysid.physics") / "models"
    return tuple(sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml")))


def load_model(name_or_file: str | Path) -> Model:
    """Return a built-in model by its name, or one from a TOML file.

    Parameters
    ----------
    name_or_file : str or Path
        A name of `model_names`, or a path that ends with ``.toml``.

    Returns
    -------
    Model

    Raises
    ------
    ModelError
        If there is no such model or the file is wrong: one sentence naming file, key and value.

    Examples
    --------
    >>> print(load_model("dc-motor"))
    J w' = K*i - b*w
    L i' = u - R*i - K*w
    y = w
    """
    if not isinstance(name_or_file, str | Path):
        raise ModelError(f"model is {name_or_file!r}: give the name of a model or a .toml file")
    name = str(name_or_file)
    if name in model_names():
        return _built_in(name)
    path = Path(name_or_file)
    if path.suffix != ".toml":
        raise ModelError(
            f"model {name!r} is not known: choose one of {', '.join(model_names())}, or give a .toml file"
        )
    try:
        raw = path.read_bytes()
    except OSError as problem:
        raise ModelError(f"{name}: cannot be read ({problem.strerror}): check the path") from None
    if len(raw) > LARGEST_FILE:
        raise ModelError(f"{name}: has {len(raw)} bytes, a model has at most {LARGEST_FILE}: check the file")
    try:
        return read_model(raw.decode("utf-8-sig"), name)
    except UnicodeDecodeError:
        raise ModelError(f"{name}: is not UTF-8 text: save it as UTF-8") from None


@cache
def _built_in(name: str) -> Model:
    return read_model((files("sysid.physics") / "models" / f"{name}.toml").read_text("utf-8"), name)


def read_model(content: str, source: str) -> Model:
    """Return the model that a TOML text describes.

    Parameters
    ----------
    content : str
        Tables states, inputs, outputs, equations, parameters.
    source : str
        Name of the file, for messages.

    Returns
    -------
    Model
    """
    try:
        table = tomllib.loads(content)
    except (tomllib.TOMLDecodeError, RecursionError) as problem:
        raise ModelError(f"{source}: is not TOML: {problem}") from None
    try:
        return _model(table, source)
    except ModelError as problem:
        raise ModelError(f"{source}: {problem}") from None


def _model(table: Table, source: str) -> Model:
    _check_keys(table, "model", "the file")
    states = tuple(_variable(n, t, "states") for n, t in _tables(table, "states"))
    inputs = tuple(_variable(n, t, "inputs") for n, t in _tables(table, "inputs"))
    parameters = tuple(_parameter(n, t) for n, t in _tables(table, "parameters"))
    outputs = _tables(table, "outputs")
    model = Model(
        name=_text(table, "name", "name"),
        title=_text(table, "title", "title"),
        states=states,
        inputs=inputs,
        outputs=tuple(Output(_checked_name(n, "outputs"), "", ()) for n, _ in outputs),
        parameters=parameters,
        equations=(),
        source=source,
    )
    model.check_names()
    _check_delays(model)
    finished = Model(
        name=model.name,
        title=model.title,
        states=states,
        inputs=inputs,
        outputs=tuple(_output(n, t, model) for n, t in outputs),
        parameters=parameters,
        equations=_equations(table, model),
        source=source,
    )
    for name in finished.unused():
        raise ModelError(f"parameters.{name}: occurs in no equation: use it or leave it out")
    return finished


def _check_keys(table: Table, kind: str, place: str) -> None:
    for key in table:
        if key not in _KEYS[kind]:
            raise ModelError(f"{place}: key {key!r} is not known: choose one of {', '.join(_KEYS[kind])}")


def _tables(table: Table, key: str) -> list[tuple[str, Table]]:
    content = table.get(key)
    if not isinstance(content, dict) or (not content and key != "parameters"):
        raise ModelError(f"{key}: is {content!r}: give a table with at least one entry")
    for name, entry in content.items():
        if not isinstance(entry, dict):
            raise ModelError(f'{key}.{name}: is {entry!r}: give a table such as {{ unit = "m" }}')
        _check_keys(entry, key, f"{key}.{name}")
    return list(content.items())


def _checked_name(name: str, kind: str) -> str:
    if not _NAME.fullmatch(name) or len(name) > 40:
        raise ModelError(f"{kind}.{name}: a name is a letter followed by letters, digits and _, at most 40")
    if name in FUNCTIONS:
        raise ModelError(f"{kind}.{name}: is the name of a function: rename it")
    return name


def _text(table: Table, key: str, place: str, default: str | None = None) -> str:
    value = table.get(key, default)
    if not isinstance(value, str) or (default is None and not value.strip()):
        missing = "is missing" if value is None else f"is {value!r}"
        example = " such as m/s (1 if it has none)" if key == "unit" else ""
        raise ModelError(f"{place}: {key} {missing}: give a text{example}")
    return value


def _real(table: Table, key: str, place: str, default: float | None = None) -> float:
    value = table.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        missing = "is missing" if value is None else f"is {value!r}"
        raise ModelError(f"{place}: {key} {missing}: give a number")
    try:
        return float(value)
    except OverflowError:
        raise ModelError(f"{place}: {key} is too large: give a finite number") from None


def _variable(name: str, table: Table, kind: str) -> Variable:
    place = f"{kind}.{_checked_name(name, kind)}"
    rest = _real(table, "rest", place, 0.0)
    if not abs(rest) < float("inf"):
        raise ModelError(f"{place}: rest is {rest}: give a finite number")
    meaning, delay = _text(table, "meaning", place, ""), _text(table, "delay", place, "")
    return Variable(name, _text(table, "unit", place), meaning, rest, delay)


def _parameter(name: str, table: Table) -> Parameter:
    place = f"parameters.{_checked_name(name, 'parameters')}"
    parameter = Parameter(
        name=name,
        unit=_text(table, "unit", place),
        start=_real(table, "start", place),
        minimum=_real(table, "minimum", place, float("-inf")),
        maximum=_real(table, "maximum", place, float("inf")),
        status=_text(table, "status", place, "free"),
        meaning=_text(table, "meaning", place, ""),
    )
    try:
        parameter.check()
    except ModelError as problem:
        raise ModelError(f"{place}: {problem}") from None
    return parameter


def _check_delays(model: Model) -> None:
    names = [parameter.name for parameter in model.parameters]
    for variable in model.inputs:
        if not variable.delay:
            continue
        if variable.delay not in names:
            raise ModelError(
                f"inputs.{variable.name}: delay is {variable.delay!r}: name one of the parameters"
            )
        if model.parameter(variable.delay).minimum < 0.0:
            raise ModelError(f"parameters.{variable.delay}: a delay cannot be negative: give minimum = 0.0")


def _terms(table: Table, place: str, model: Model) -> tuple[Term, ...]:
    content = table.get("terms")
    if not isinstance(content, dict) or not content:
        raise ModelError(f"{place}: terms is {content!r}: give a table of names and expressions")
    return tuple(
        Term(name, _expression(entry, f"{place}: term {name!r}", model)) for name, entry in content.items()
    )


def _expression(entry: object, place: str, model: Model) -> Expression:
    if not isinstance(entry, str):
        raise ModelError(f"{place} is {entry!r}: give an expression as a text")
    try:
        return parse(entry, model.names)
    except ModelError as problem:
        raise ModelError(f"{place} = {entry[:80]!r}: {problem}") from None


def _output(name: str, table: Table, model: Model) -> Output:
    place = f"outputs.{name}"
    unit, meaning = _text(table, "unit", place), _text(table, "meaning", place, "")
    return Output(name, unit, _terms(table, place, model), meaning)


def _equations(table: Table, model: Model) -> tuple[Equation, ...]:
    content = table.get("equations")
    if not isinstance(content, list) or not all(isinstance(entry, dict) for entry in content):
        raise ModelError("equations: give one [[equations]] for each state")
    found: dict[str, Equation] = {}
    names = [variable.name for variable in model.states]
    for number, entry in enumerate(content, start=1):
        place = f"equations {number}"
        _check_keys(entry, "equations", place)
        state = _text(entry, "state", place)
        if state not in names or state in found:
            reason = "has an equation already" if state in found else f"is none of {', '.join(names)}"
            raise ModelError(f"{place}: state {state!r} {reason}")
        factor = _expression(entry["factor"], f"{place}: factor", model) if "factor" in entry else ONE
        found[state] = Equation(state, factor, _text(entry, "unit", place), _terms(entry, place, model))
    for name in names:
        if name not in found:
            raise ModelError(f"equations: state {name!r} has none: give one [[equations]] for it")
    return tuple(found[name] for name in names)
