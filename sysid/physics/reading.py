"""Read a model from a TOML file; the built-in models are such files too."""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.errors import ModelError
from sysid.physics.expressions import ONE, Expression
from sysid.physics.grammar import parse
from sysid.physics.model import Equation, Model, Output, Parameter, Prior, Term, Variable
from sysid.physics.names import checked_name

if TYPE_CHECKING:
    from sysid.physics.classes import PhysicsModel

LARGEST_FILE = 100_000
ENTRY_POINTS = "sysid.models"
_KEYS = {
    "model": ("name", "title", "states", "inputs", "outputs", "equations", "parameters"),
    "states": ("unit", "meaning", "rest"),
    "inputs": ("unit", "meaning", "delay"),
    "outputs": ("unit", "meaning", "terms"),
    "equations": ("state", "factor", "unit", "terms"),
    "parameters": ("unit", "start", "std", "minimum", "maximum", "status", "meaning"),
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


def load_model(source: "str | Path | type[PhysicsModel]") -> Model:
    """Return a model by its name, from a TOML file or from a Python class.

    Parameters
    ----------
    source : str, Path or class
        A name that ``sysid models`` lists; a path that ends with ``.toml``; a class derived from
        `PhysicsModel`, or its address as ``package.module:Class`` or ``file.py:Class`` (the module is
        imported, so that its code runs).

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
    from sysid.physics.classes import PhysicsModel, load_class

    if isinstance(source, type) and issubclass(source, PhysicsModel):
        return source.model()
    if not isinstance(source, str | Path):
        raise ModelError(f"model is {source!r}: give the name of a model, a .toml file or a class")
    name = str(source)
    if name in model_names():
        return _built_in(name)
    if name in (others := _registered()):
        return _from_entry(others[name])
    path = Path(source)
    if path.suffix == ".toml":
        return _from_file(path, name)
    if ":" in name:
        return load_class(name)
    raise ModelError(
        f"model {name!r} is not known: choose one of {', '.join(all_model_names())}, or give a .toml file or "
        "a class as module:Class"
    )


def is_known(source: str | Path) -> bool:
    """Return whether `load_model` knows what is meant: a listed name, a TOML file or a class's address."""
    name = str(source)
    return name in all_model_names() or Path(source).suffix == ".toml" or ":" in name


def all_model_names() -> tuple[str, ...]:
    """Return the names of the built-in models, and of those that installed packages add.

    A package adds a model by an entry point of the group ``sysid.models`` that names a class derived from
    `PhysicsModel` or a `Model`.
    """
    return (*model_names(), *sorted(set(_registered()) - set(model_names())))


def _registered() -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=ENTRY_POINTS)}


def _from_entry(entry: EntryPoint) -> Model:
    try:
        found = entry.load()
    except Exception as problem:
        raise ModelError(
            f"model {entry.name!r} of the entry point {entry.value} cannot be imported "
            f"({type(problem).__name__}): repair or remove the package that adds it"
        ) from None
    return found if isinstance(found, Model) else load_model(found)


def _from_file(path: Path, name: str) -> Model:
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
        outputs=tuple(Output(checked_name(n, "outputs"), "", ()) for n, _ in outputs),
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
    place = f"{kind}.{checked_name(name, kind)}"
    rest = _real(table, "rest", place, 0.0)
    if not abs(rest) < float("inf"):
        raise ModelError(f"{place}: rest is {rest}: give a finite number")
    meaning, delay = _text(table, "meaning", place, ""), _text(table, "delay", place, "")
    return Variable(name, _text(table, "unit", place), meaning, rest, delay)


def _parameter(name: str, table: Table) -> Parameter:
    place = f"parameters.{checked_name(name, 'parameters')}"
    start = _real(table, "start", place)
    prior = Prior(start, _real(table, "std", place)) if "std" in table else None
    parameter = Parameter(
        name=name,
        unit=_text(table, "unit", place),
        start=start,
        minimum=_real(table, "minimum", place, float("-inf")),
        maximum=_real(table, "maximum", place, float("inf")),
        status=_text(table, "status", place, "free" if prior is None else "uncertain"),
        meaning=_text(table, "meaning", place, ""),
        prior=prior,
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
