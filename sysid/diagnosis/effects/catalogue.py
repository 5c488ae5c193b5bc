"""The list of effects: built in, installed by entry point, read from TOML, or added in Python."""

import json
import tomllib
from collections.abc import Collection, Sequence
from difflib import get_close_matches
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import numpy as np

from sysid.diagnosis.effects import forces, input_maps, linear_parts, output_maps
from sysid.diagnosis.effects.base import Effect, EffectParameter, Form, Grid, Map
from sysid.errors import ModelError

GROUP = "sysid.effects"
BUILT_IN: tuple[Effect, ...] = (
    *input_maps.EFFECTS,
    *output_maps.EFFECTS,
    *forces.EFFECTS,
    *linear_parts.EFFECTS,
)
_TEXTS = ("mechanism", "equation", "signature", "look_alikes", "reference")


@lru_cache(maxsize=1)
def catalogue() -> tuple[Effect, ...]:
    """Return all effects: the built-in ones, then those of the entry-point group ``sysid.effects``.

    An entry point names an `Effect`, a sequence of them, or the path of a TOML file.
    """
    found = list(BUILT_IN)
    for entry in entry_points(group=GROUP):
        found += _installed(entry)
    return checked(found)


def _installed(entry: EntryPoint) -> list[Effect]:
    """Return the effects that an installed package brings; what it raises is no error of this one."""
    place = f"the entry point {entry.name!r} of {GROUP}, {entry.value}"
    try:
        loaded = entry.load()
    except Exception as problem:
        raise ModelError(
            f"{place}, cannot be loaded ({problem}): repair the package that brings it, or uninstall it"
        ) from None
    if isinstance(loaded, str | Path):
        return list(read_effects(Path(loaded)))
    effects = [loaded] if isinstance(loaded, Effect) else loaded
    if not isinstance(effects, Sequence) or not all(isinstance(effect, Effect) for effect in effects):
        raise ModelError(
            f"{place}, is of type {type(loaded).__name__}: name an Effect, a list of them or a TOML file"
        )
    return list(effects)


def checked(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Return effects whose names are unique and that can be used."""
    names = [effect.name for effect in effects]
    for effect in effects:
        effect.check()
        if names.count(effect.name) > 1:
            raise ModelError(f"effect {effect.name!r} is given twice: rename one of them")
    return tuple(effects)


def find_effects(names: Sequence[str | Effect], known: Sequence[Effect] | None = None) -> tuple[Effect, ...]:
    """Return effects by name, a name that comes again once; an `Effect` stands for itself.

    Examples
    --------
    >>> [effect.port for effect in find_effects(["coulomb", "out_drift"])]
    ['force', 'output']
    """
    every = {effect.name: effect for effect in (catalogue() if known is None else known)}
    chosen: list[Effect] = []
    for name in names:
        if isinstance(name, Effect):
            name.check()
            chosen.append(name)
        elif name in every:
            chosen += [every[name]] if name not in [effect.name for effect in chosen] else []
        else:
            raise ModelError(f"effect {name!r} is not known{_nearest(name, every)}")
    return checked(chosen)


def _nearest(name: object, known: Collection[str]) -> str:
    """Name the effects that were perhaps meant, or all of them."""
    near = get_close_matches(str(name).casefold(), known, n=3)
    if near:
        return f": did you mean {' or '.join(near)}? `sysid effects` lists all"
    return f": choose one of {', '.join(known)}"


def read_effects(path: Path) -> tuple[Effect, ...]:
    """Read effects of one's own from a TOML file.

    Each table gives ``port``, ``expression`` and ``parameters``.  Port ``force``: the opposing force in
    ``x``, ``v``; ``gain``: the factor of the input in ``y``; ``input`` and ``output``: the new value, in
    the old one ``s``.

    Examples
    --------
    >>> import tempfile
    >>> text = '''
    ... [soft_spring]
    ... port = "force"
    ... expression = "k*tanh(x/scale)"
    ... [soft_spring.parameters]
    ... k = { unit = "[F]" }
    ... scale = { unit = "[x]", grid = { scale = "output deviation", points = [0.5, 1, 2] }, minimum = 0 }
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "mine.toml")
    ...     _ = file.write_text(text)
    ...     read_effects(file)[0].forms[0].parameters[1].grid
    Grid(scale='output deviation', points=(0.5, 1.0, 2.0))
    """
    try:
        return effects_in(path.read_text(encoding="utf-8"), str(path))
    except OSError as problem:
        raise ModelError(f"{path} cannot be read ({problem.strerror}): give a TOML file of effects") from None
    except UnicodeDecodeError as problem:
        raise ModelError(f"{path} is not TOML ({problem}): see `sysid effects --template input`") from None


def effects_in(text: str, source: str) -> tuple[Effect, ...]:
    """Return the effects in the text of a TOML file; ``source`` is named in errors."""
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as problem:
        raise ModelError(f"{source} is not TOML ({problem}): see `sysid effects --template input`") from None
    try:
        return checked([effect_of_table(name, table) for name, table in content.items()])
    except ModelError as problem:
        raise ModelError(f"{source}: {problem}") from None


def effect_of_table(name: str, table: Any) -> Effect:
    """Return the effect that a table of a TOML file defines."""
    if not isinstance(table, dict) or not isinstance(table.get("expression"), str):
        raise ModelError(f"effect {name!r}: give a table with port, expression and parameters")
    known = {"port", "expression", "parameters", "families", "smooth", *_TEXTS}
    unknown = sorted(set(table) - known)
    if unknown:
        raise ModelError(
            f"effect {name!r}: key {unknown[0]!r} is not known: choose {', '.join(sorted(known))}"
        )
    parameters = tuple(_parameter(name, key, entry) for key, entry in table.get("parameters", {}).items())
    port, expression = str(table.get("port", "force")), table["expression"]
    apply = _map_of(name, expression, parameters) if port in ("input", "output") else None
    form = Form(name, parameters, apply, "" if apply else expression, smooth=bool(table.get("smooth", True)))
    mechanism, equation, signature, look_alikes, reference = (
        str(table.get(key, expression if key == "equation" else "")) for key in _TEXTS
    )
    families = tuple(table.get("families", ("linear", "physics")))
    return Effect(
        name, port, mechanism, equation, signature, look_alikes, reference, (form,), families,
        definition=json.dumps(table),
    )  # fmt: skip


def _parameter(effect: str, name: str, entry: Any) -> EffectParameter:
    known = ("unit", "meaning", "grid", "minimum", "maximum")
    unknown = [key for key in entry if key not in known] if isinstance(entry, dict) else []
    if unknown:
        raise ModelError(
            f"effect {effect!r}, parameter {name!r}: key {unknown[0]!r} is not known: choose "
            f"{', '.join(known)}"
        )
    try:
        grid = entry.get("grid")
        return EffectParameter(
            name,
            str(entry.get("unit", "1")),
            str(entry.get("meaning", "")),
            None
            if grid is None
            else Grid(str(grid["scale"]), tuple(sorted(float(p) for p in grid["points"]))),
            float(entry.get("minimum", -np.inf)),
            float(entry.get("maximum", np.inf)),
        )
    except (AttributeError, KeyError, TypeError, ValueError) as problem:
        raise ModelError(f"effect {effect!r}, parameter {name!r}: {problem!r} in its table") from None


def _map_of(effect: str, expression: str, parameters: Sequence[EffectParameter]) -> Map:
    """Return the map of an expression in the sample ``s`` and the parameters."""
    from sysid.diagnosis.effects.laws import pointwise

    try:
        return pointwise(expression, ("s",), tuple(p.name for p in parameters))
    except ModelError as problem:
        raise ModelError(f"effect {effect!r}, expression {expression!r}: {problem}") from None
