"""The catalogue of effects a model may lack."""

from sysid.diagnosis.effects.base import Effect, EffectParameter, Form, Grid
from sysid.diagnosis.effects.catalogue import catalogue, find_effects, read_effects

__all__ = ["Effect", "EffectParameter", "Form", "Grid", "catalogue", "find_effects", "read_effects"]
