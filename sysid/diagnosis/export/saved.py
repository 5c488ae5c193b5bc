"""Save a diagnosed model, read it again, and take it elsewhere: JSON, TOML, plain Python, python-control."""

import json
import tomllib
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from sysid.diagnosis.export.saved_effects import SavedEffect, read_saved_effects, saved_effects
from sysid.diagnosis.export.saved_linear import KIND, SCHEMA, SavedModel
from sysid.diagnosis.export.saved_physics import KIND as PHYSICAL
from sysid.diagnosis.export.saved_physics import SavedPhysicalModel, saved_physical_model
from sysid.diagnosis.ladder import DiagnosedModel
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.physics.structure import PhysicsStructure
from sysid.errors import DataError, SysidError, UsageError
from sysid.physics.hold import HOLDS

if TYPE_CHECKING:
    import control

Saved = SavedModel | SavedPhysicalModel
# With which the kinds of saved models begin.
MARK = "sysid-"
ENDINGS = (".json", ".toml", ".py")


@runtime_checkable
class Diagnosed(Protocol):
    """A diagnosis, whose model is the last of its ladder."""

    @property
    def final(self) -> DiagnosedModel: ...  # noqa: D102


def to_control(model: DiagnosedModel | Diagnosed | Saved) -> "control.NonlinearIOSystem":
    """Return a diagnosed or saved model as a system of python-control.

    A linear difference equation becomes one in discrete time, a physical model one in continuous time.

    Raises
    ------
    ModelError
        If an effect has a memory of its own, which is no state of the model, or a physical model is not
        linear in its states.
    """
    from sysid.diagnosis.export import control_linear, control_physics

    saved = saved_model(model)
    if isinstance(saved, SavedModel):
        return control_linear.control_system(saved)
    return control_physics.control_system(saved)


def to_python(model: DiagnosedModel | Diagnosed | Saved) -> str:
    """Return the source of a function ``simulate(u)`` that needs NumPy alone.

    Raises
    ------
    ModelError
        If the model cannot be written so: an effect in Python of the user's own, states that act nonlinearly.
    """
    from sysid.diagnosis.export import standalone, standalone_physics

    saved = saved_model(model)
    if isinstance(saved, SavedModel):
        return standalone.source(saved)
    return standalone_physics.source(saved)


def saved_model(model: DiagnosedModel | Diagnosed | Saved) -> Saved:
    """Return a diagnosed model apart from its record, of a diagnosis the last one; a saved one as it is."""
    if isinstance(model, Saved):
        return model
    model = model.final if isinstance(model, Diagnosed) else model
    if not isinstance(model, DiagnosedModel):
        kind = type(model).__name__
        raise UsageError(f"the model is of type {kind}: give that of a diagnosis, or one that was loaded")
    structure, fit = model.structure, model.fitted
    if isinstance(structure, PhysicsStructure):
        return saved_physical_model(model)
    if not isinstance(structure, LinearStructure):
        raise UsageError(f"the model {structure.name!r} is of your own class: save it by its own means")
    n = structure.order
    chain, data = structure.chain(fit.choices), structure.data(fit.rows)
    effects = saved_effects(chain.choices, [fit.point[place].tolist() for place in chain.places(data)])
    return SavedModel(
        tuple(fit.point[:n].tolist()),
        tuple(fit.point[n : 2 * n].tolist()),
        float(fit.point[2 * n]) if chain.constant else 0.0,
        structure.record.period,
        effects,
    )


def save(model: DiagnosedModel | Diagnosed | Saved, path: Path | str) -> None:
    """Save a model by the ending of the file: ``.json``, ``.toml``, or ``.py`` (NumPy alone).

    The first two are read again by `load`, and taken by `compare` and `diagnose` in place of a model's name.

    Raises
    ------
    UsageError
        If the ending is another one, or the model of a class of the user's own.
    ModelError
        If the model cannot be written as Python.
    """
    from sysid.result_files import write_text

    path = Path(path)
    check_ending(path)
    kinds = {".json": _json_text, ".toml": _toml_text, ".py": to_python}
    write_text(path, kinds[path.suffix](saved_model(model)))


def check_ending(path: Path) -> None:
    """Raise UsageError unless the ending names a format."""
    if path.suffix not in ENDINGS:
        raise UsageError(f"{path}: the ending {path.suffix!r} is not known: choose .json, .toml or .py")


def is_saved(path: Path | str) -> bool:
    """Tell whether a file is of the kind that `load` reads, rather than the description of a model."""
    path = Path(path)
    if path.suffix == ".json":
        return True
    try:
        return path.suffix == ".toml" and path.read_text(encoding="utf-8").startswith(f'kind = "{MARK}')
    except (OSError, ValueError):
        return False


def load(path: Path | str) -> Saved:
    """Read a model that `save` wrote as JSON or TOML.

    Raises
    ------
    DataError
        If the file cannot be read or holds something else.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        content = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
        if content["kind"] not in (KIND, PHYSICAL):
            raise DataError(
                f"{path} is no model that `sysid diagnose --save` wrote: it holds {content['kind']!r}"
            )
        if content["schema"] != SCHEMA:
            raise DataError(f"{path} is no model of this version: save it again")
        effects = read_saved_effects(content["effects"])
        own = [value for effect in effects for value in effect.values]
        _check_numbers(path, "parameters of its effects", own)
        _check_ranges(path, effects)
        _check_numbers(path, "period", [content["period"]], positive=True)
        if content["kind"] == PHYSICAL:
            period, steps, hold = float(content["period"]), int(content["substeps"]), str(content["hold"])
            _check_numbers(path, "substeps", [steps], positive=True)
            if hold not in HOLDS:
                raise DataError(f"{path}: hold is {hold!r}, choose one of {', '.join(HOLDS)}")
            found = SavedPhysicalModel(str(content["model"]), period, hold, steps, effects)
            found.simulate(np.zeros((1, len(found.model.inputs))))
            return found
        a, b = (tuple(float(v) for v in content[key]) for key in ("a", "b"))
        if not a or len(a) != len(b):
            raise DataError(f"{path} has {len(a)} coefficients a and {len(b)} b: give as many of each")
        _check_numbers(path, "coefficients", [*a, *b, content["constant"]])
        return SavedModel(a, b, float(content["constant"]), float(content["period"]), effects)
    except OSError as problem:
        raise DataError(f"{path} cannot be read ({problem.strerror}): give a saved model") from None
    except (ValueError, KeyError, TypeError, AttributeError) as problem:
        if isinstance(problem, SysidError):
            raise
        raise DataError(f"{path} is no saved model ({problem!r}): write one with --save") from None


def _check_numbers(path: Path, what: str, values: Sequence[float], *, positive: bool = False) -> None:
    """Raise DataError unless all values are finite, and positive if asked."""
    for value in map(float, values):
        if not isfinite(value) or (positive and value <= 0.0):
            rule = "positive" if positive else "finite"
            raise DataError(f"{path}: {what}: {value:g} is no {rule} number, save the model again")


def _check_ranges(path: Path, effects: Sequence[SavedEffect]) -> None:
    """Raise DataError where a parameter of an effect is none that a fit can give."""
    for effect in effects:
        for parameter, value in zip(effect.choice.form.parameters, effect.values, strict=True):
            if not parameter.minimum <= value <= parameter.maximum:
                raise DataError(
                    f"{path}: {effect.name}.{parameter.name} is {value:g}, and must be between "
                    f"{parameter.minimum:g} and {parameter.maximum:g}: save the model again"
                )


def _json_text(saved: Saved) -> str:
    return json.dumps(saved.to_json(), indent=1) + "\n"


def _toml_text(saved: Saved) -> str:
    content = saved.to_json()
    plain = {key: value for key, value in content.items() if key != "effects"}
    lines = [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in plain.items()]
    if not saved.effects:
        lines.append("effects = []")
    for effect in saved.effects:
        lines += ["", "[[effects]]", f'name = "{effect.name}"', f'form = "{effect.form}"']
        inner = ", ".join(f"{key} = {value!r}" for key, value in effect.parameters.items())
        lines.append(f"parameters = {{ {inner} }}" if inner else "parameters = {}")
        if effect.definition:
            lines.append(f"definition = {json.dumps(effect.definition)}")
    return "\n".join(lines) + "\n"
