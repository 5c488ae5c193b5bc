"""Save a diagnosed model, read it again, and take it elsewhere: JSON, TOML, plain Python, python-control."""

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.export.saved_effects import SavedEffect, read_saved_effects, saved_effects
from sysid.diagnosis.export.saved_physics import KIND as PHYSICAL
from sysid.diagnosis.export.saved_physics import SavedPhysicalModel, saved_physical_model
from sysid.diagnosis.ladder import DiagnosedModel
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.physics.structure import PhysicsStructure
from sysid.diagnosis.structures.pointwise import check_pointwise
from sysid.errors import DataError, ModelError, SysidError, UsageError

SCHEMA = 1
KIND = "sysid-linear-model"
ENDINGS = (".json", ".toml", ".py")


@dataclass(frozen=True)
class SavedModel:
    """A linear model with effects, apart from the record it was fitted to.

    Attributes
    ----------
    a, b : tuple of float
        Coefficients a1, ..., an and b1, ..., bn.
    constant : float
    period : float
        Sampling period [s].
    effects : tuple of SavedEffect
    """

    a: tuple[float, ...]
    b: tuple[float, ...]
    constant: float
    period: float
    effects: tuple[SavedEffect, ...]

    def simulate(self, u: ArrayLike) -> Floats:
        """Return the free run from rest for an input, shape (n_samples,)."""
        signal = np.array(u, dtype=np.float64)
        chain, point = self._chain()
        begin = np.array([0, signal.size])
        data = Data(signal, np.zeros(signal.size), np.ones(signal.size, dtype=bool), begin, self.period)
        run = chain.run(data, point)
        if run is None:
            raise ModelError("the model diverges for this input: keep it within the range it was fitted on")
        return run.y

    def _chain(self) -> tuple[Chain, Floats]:
        choices = [effect.choice for effect in self.effects]
        own = [value for effect in self.effects for value in effect.values]
        chain = Chain(len(self.a), choices, constant=True, free_start=False)
        return chain, np.array([*self.a, *self.b, self.constant, *own])

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "kind": KIND,
            "schema": SCHEMA,
            "period": self.period,
            "a": list(self.a),
            "b": list(self.b),
            "constant": self.constant,
            "effects": [effect.to_json() for effect in self.effects],
        }

    def to_control(self) -> Any:
        """Return the model as a `control.NonlinearIOSystem` in discrete time.

        Its state is the memory of the difference equation and the whole past of the input is not kept, so
        effects with a memory of their own cannot be taken along.
        """
        import control

        chain, point = self._chain()
        n = chain.order
        check_pointwise(chain.choices)

        def mapped(port: str, value: float) -> float:
            for i in chain.at[port]:
                apply = chain.choices[i].form.apply
                assert apply is not None
                own = point[2 * n + 1 :][_place(chain, i)]
                value = float(apply(np.array([value]), own, self.period)[0])
            return value

        def drive(z: float, speed: float, u: float) -> float:
            from sysid.diagnosis.effects.laws import drive_of

            value = mapped("input", u)
            for i in chain.drives:
                law = drive_of(chain.choices[i].effect, chain.choices[i].form)
                value = law(value, z, speed, np.ascontiguousarray(point[2 * n + 1 :][_place(chain, i)]))
            return value

        def output(x: Floats) -> float:
            # The state holds z(k-1), ..., z(k-n), v(k-1), ..., v(k-n).
            return float(point[n : 2 * n] @ x[n:] - point[:n] @ x[:n] + point[2 * n])

        def update(t: float, x: Floats, u: Floats, params: Any) -> Floats:
            z = output(x)
            v = drive(z, z - x[0], float(u[0]))
            return np.concatenate([[z], x[: n - 1], [v], x[n : 2 * n - 1]])

        def measured(t: float, x: Floats, u: Floats, params: Any) -> Floats:
            return np.array([mapped("output", output(x))])

        return control.NonlinearIOSystem(
            update, measured, states=2 * n, inputs=["u"], outputs=["y"], dt=self.period, name="diagnosed"
        )

    def to_python(self) -> str:
        """Return the source of a function ``simulate(u)`` that needs NumPy alone."""
        from sysid.diagnosis.export.standalone import source

        return source(self)


def _place(chain: Chain, i: int) -> slice:
    before = sum(len(c.form.parameters) for c in chain.choices[:i])
    return slice(before, before + len(chain.choices[i].form.parameters))


def saved_model(model: DiagnosedModel) -> SavedModel | SavedPhysicalModel:
    """Return a diagnosed model apart from its record."""
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


def save(model: DiagnosedModel, path: Path) -> None:
    """Save a model by the ending of the file: ``.json``, ``.toml``, or ``.py`` (NumPy alone)."""
    from sysid.result_files import write_text

    check_ending(path)
    saved = saved_model(model)
    kinds = {".json": _json_text, ".toml": _toml_text}
    write_text(path, saved.to_python() if path.suffix == ".py" else kinds[path.suffix](saved))


def check_ending(path: Path) -> None:
    """Raise UsageError unless the ending names a format."""
    if path.suffix not in ENDINGS:
        raise UsageError(f"{path}: the ending {path.suffix!r} is not known: choose .json, .toml or .py")


def load(path: Path) -> SavedModel | SavedPhysicalModel:
    """Read a model that `save` wrote as JSON or TOML."""
    try:
        text = path.read_text(encoding="utf-8")
        content = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
        if content["kind"] not in (KIND, PHYSICAL) or content["schema"] != SCHEMA:
            raise DataError(f"{path} is no model of this version: save it again")
        effects = read_saved_effects(content["effects"])
        if content["kind"] == PHYSICAL:
            period, steps = float(content["period"]), int(content["substeps"])
            found = SavedPhysicalModel(str(content["model"]), period, str(content["hold"]), steps, effects)
            found.simulate(np.zeros((1, len(found.model.inputs))))
            return found
        a, b = (tuple(float(v) for v in content[key]) for key in ("a", "b"))
        return SavedModel(a, b, float(content["constant"]), float(content["period"]), effects)
    except OSError as problem:
        raise DataError(f"{path} cannot be read ({problem.strerror}): give a saved model") from None
    except (ValueError, KeyError, TypeError, AttributeError) as problem:
        if isinstance(problem, SysidError):
            raise
        raise DataError(f"{path} is no saved model ({problem!r}): write one with --save") from None


def _json_text(saved: SavedModel | SavedPhysicalModel) -> str:
    return json.dumps(saved.to_json(), indent=1) + "\n"


def _toml_text(saved: SavedModel | SavedPhysicalModel) -> str:
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
