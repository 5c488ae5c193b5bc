"""Effects of a saved model, those of the user's own with their definition."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from sysid.diagnosis.effects.base import Effect
from sysid.diagnosis.effects.catalogue import effect_of_table, find_effects
from sysid.diagnosis.effects.input_maps import SWITCHES
from sysid.diagnosis.physics.laws import with_level
from sysid.diagnosis.structures.structure import Choice
from sysid.errors import ModelError

DIVERGES = "the model diverges for this input: keep it within the range it was fitted on"


@dataclass(frozen=True)
class SavedEffect:
    """An effect apart from the catalogue.

    Attributes
    ----------
    name, form : str
    parameters : dict of str to float
    definition : str
        Of an effect that was read from TOML: its table as JSON.
    """

    name: str
    form: str
    parameters: dict[str, float]
    definition: str = ""

    @cached_property
    def effect(self) -> Effect:
        """The effect from its definition or from the catalogue."""
        if self.definition:
            return effect_of_table(self.name, json.loads(self.definition))
        try:
            (effect,) = find_effects([self.name])
        except ModelError:
            raise ModelError(
                f"the model has an effect {self.name!r} that is not installed here: install the package "
                "that brings it, or diagnose and save the model again without it"
            ) from None
        return effect

    @cached_property
    def choice(self) -> Choice:
        """The effect in its form."""
        effect = self.effect
        if self.name in SWITCHES and "level" in self.parameters:
            effect = with_level(effect)
        return Choice(effect, effect.form(self.form))

    @property
    def values(self) -> list[float]:
        """Parameters in the order of the form."""
        return [self.parameters[p.name] for p in self.choice.form.parameters]

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        own = {"definition": self.definition} if self.definition else {}
        return {"name": self.name, "form": self.form, "parameters": self.parameters, **own}


def saved_effects(choices: Sequence[Choice], values: Iterable[Sequence[float]]) -> tuple[SavedEffect, ...]:
    """Return effects with the values of their parameters, to be saved."""
    return tuple(
        SavedEffect(
            choice.name,
            choice.form.name,
            {p.name: float(value) for p, value in zip(choice.form.parameters, own, strict=True)},
            choice.effect.definition,
        )
        for choice, own in zip(choices, values, strict=True)
    )


def read_saved_effects(content: Any) -> tuple[SavedEffect, ...]:
    """Return the effects of a saved model from its file."""
    return tuple(
        SavedEffect(
            str(e["name"]),
            str(e["form"]),
            {str(k): float(v) for k, v in e["parameters"].items()},
            str(e.get("definition", "")),
        )
        for e in content
    )
