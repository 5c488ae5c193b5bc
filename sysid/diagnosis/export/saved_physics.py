"""A diagnosed physical model apart from its record: saved, simulated, taken elsewhere."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.export.saved_effects import DIVERGES, SavedEffect, saved_effects
from sysid.diagnosis.ladder import DiagnosedModel
from sysid.diagnosis.physics.equation import equation_text
from sysid.diagnosis.physics.laws import INNER, coefficients, own_law
from sysid.diagnosis.physics.problem import problem_of
from sysid.diagnosis.physics.setting import Plant
from sysid.diagnosis.physics.steps import enough_steps
from sysid.diagnosis.physics.structure import PhysicsStructure
from sysid.diagnosis.structures.structure import Choice
from sysid.errors import ModelError
from sysid.physics.forced import ForcedPlant
from sysid.physics.general import GeneralPlant, is_general
from sysid.physics.model import Model
from sysid.physics.own_laws import OwnLaw
from sysid.physics.reading import read_model
from sysid.physics.writing import model_text

SCHEMA = 1
KIND = "sysid-physical-model"


@dataclass(frozen=True)
class SavedPhysicalModel:
    """A physical model with effects, apart from the record it was fitted to.

    Attributes
    ----------
    definition : str
        The model as TOML text, its parameters at the fitted values.
    period : float
        Sampling period [s].
    hold : {"zero", "smooth"}
        How the input goes on between samples.
    substeps : int
        Runge-Kutta steps in a sample.
    effects : tuple of SavedEffect
    """

    definition: str
    period: float
    hold: str
    substeps: int
    effects: tuple[SavedEffect, ...]

    @cached_property
    def model(self) -> Model:
        """The model without effects."""
        return read_model(self.definition, "the saved model")

    @cached_property
    def plant(self) -> Plant:
        """What simulates it."""
        if is_general(self.model):
            return GeneralPlant(self.model, self.period)
        return ForcedPlant(self.model, self.period, self.hold)

    @cached_property
    def choices(self) -> tuple[Choice, ...]:
        """The effects in their forms."""
        return tuple(effect.choice for effect in self.effects)

    @cached_property
    def own(self) -> tuple[Floats, ...]:
        """Parameters of each effect, in the order of its form."""
        return tuple(np.array(effect.values) for effect in self.effects)

    @cached_property
    def law(self) -> Floats:
        """Coefficients of the effects inside the dynamics."""
        return coefficients(self.choices, self.own)

    @cached_property
    def own_law(self) -> OwnLaw:
        """Forces and gains of the user's own."""
        return own_law(self.choices)

    @property
    def values(self) -> Floats:
        """Parameters of the model."""
        return np.array([parameter.start for parameter in self.model.parameters])

    @property
    def exact(self) -> bool:
        """Whether no effect acts inside the dynamics."""
        return all(choice.effect.port not in INNER for choice in self.choices)

    @property
    def order(self) -> int:
        """Number of states."""
        return self.model.order

    @property
    def rest(self) -> Floats:
        """Initial state of a run from rest, shape (order,)."""
        return np.array([state.rest for state in self.model.states])

    def parameters(self) -> list[tuple[str, float, str]]:
        """Return name, value and unit of each parameter of the model."""
        return [(p.name, p.start, p.unit) for p in self.model.parameters]

    def equation(self) -> str:
        """Return the equations of motion with their effects, for a reader."""
        return equation_text(
            self.model, [(effect.choice.written, effect.parameters) for effect in self.effects]
        )

    def visited(self, u: ArrayLike) -> Floats:
        """Return the states that a run from rest passes, shape (n_samples, order).

        From one of them a search for an initial state may begin: an empty or a full tank does not feel a
        small change of its level.
        """
        states = np.empty((1, len(np.asarray(u)), self.order))
        with np.errstate(all="ignore"):
            self._run(np.array(u, dtype=np.float64), None, states)
        return np.asarray(states[0])

    def simulate(self, u: ArrayLike, start: ArrayLike | None = None) -> Floats:
        """Return the free run for an input, shape (n_samples,) or (n_samples, n_inputs).

        It begins from rest or from a state of shape (order,).
        """
        y = self._run(np.array(u, dtype=np.float64), start)
        if not np.isfinite(y).all():
            raise ModelError(DIVERGES)
        return y

    def _run(self, signal: Floats, start: ArrayLike | None, passed: Floats | None = None) -> Floats:
        driven = signal[:, np.newaxis] if signal.ndim == 1 else signal
        first = np.ascontiguousarray(driven[:, 0])
        acting = self.applied("input", first)
        driven = np.column_stack([acting, driven[:, 1:]])
        laws = self.law[np.newaxis]
        states = None if start is None else np.array(start, dtype=np.float64)[np.newaxis]
        y = self.plant.run(
            self.values[np.newaxis], laws, driven, states, self.substeps, passed, self.exact, self.own_law
        )[0]
        for choice, p in zip(self.choices, self.own, strict=True):
            if choice.effect.port == "parallel" and choice.form.apply is not None:
                y = y + choice.form.apply(acting if choice.form.behind else first, p, self.period)
        return self.applied("output", y)

    def applied(self, port: str, signal: Floats) -> Floats:
        """Send a sequence through the effects at the input or at the output."""
        for choice, p in zip(self.choices, self.own, strict=True):
            if choice.effect.port == port and choice.form.apply is not None:
                signal = choice.form.apply(np.ascontiguousarray(signal), p, self.period)
        return signal

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "kind": KIND,
            "schema": SCHEMA,
            "model": self.definition,
            "period": self.period,
            "hold": self.hold,
            "substeps": self.substeps,
            "effects": [effect.to_json() for effect in self.effects],
        }


def saved_physical_model(model: DiagnosedModel) -> SavedPhysicalModel:
    """Return a diagnosed physical model apart from its record."""
    structure, fit = model.structure, model.fitted
    assert isinstance(structure, PhysicsStructure)
    setting, plant = structure.setting, structure.plant
    problem, values = problem_of(setting, fit), setting.values_of(fit.point)
    named = dict(zip(plant.names, values.tolist(), strict=True))
    effects = saved_effects(problem.choices, [fit.point[place].tolist() for place in problem.effect_places])
    stepped = plant.always_steps or not problem.exact
    steps = plant.substeps(values, enough_steps(problem, fit.point))[0] if stepped else 1
    text = model_text(structure.model.with_values(named))
    return SavedPhysicalModel(text, structure.record.period, plant.hold, steps, effects)
