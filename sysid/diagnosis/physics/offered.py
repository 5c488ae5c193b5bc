"""Which effects make sense for a physical model."""

from collections.abc import Sequence

import numpy as np

from sysid.diagnosis.effects.base import Effect
from sysid.diagnosis.effects.input_maps import SWITCHES
from sysid.diagnosis.physics.laws import SMOOTH_LAWS, has_law, has_level, is_own, with_level
from sysid.diagnosis.physics.problem import COARSE_STEP, Problem
from sysid.diagnosis.physics.search import Tangent
from sysid.diagnosis.physics.setting import Setting
from sysid.diagnosis.structures.exercised import shows
from sysid.diagnosis.structures.rows import first_rows_of
from sysid.diagnosis.structures.structure import WHITE, Choice

# A gain is free when the parameters can follow a scaled output on so many rows up to this share.
GAIN_ROWS, SAME_DIRECTION = 1_000, 1e-4
# The start values are moved by so much of themselves, each by another share.
OFF = 0.1


def with_levels(setting: Setting, effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Return effects of which switches have a level of their own where the model leaves none to its gain.

    Values that were given are known to within a factor: they do not make up for the level of a switch.
    """
    if all(effect.name not in SWITCHES for effect in effects):
        return tuple(effects)
    if can_scale(setting) and all(parameter.status != "uncertain" for parameter in setting.searched):
        return tuple(effects)
    return tuple(with_level(effect) if effect.name in SWITCHES else effect for effect in effects)


def idle_levels(setting: Setting, choices: Sequence[Choice]) -> int:
    """Return how many levels of switches are no freedom beside the model's own parameters."""
    levels = sum(map(has_level, choices))
    return levels if levels and can_scale(setting) else 0


def can_scale(setting: Setting) -> bool:
    """Tell whether to scale the output is the same as to change the model's parameters.

    Asked off the start values: where two of them are equal, opposite changes of both may seem to do it.
    """
    rows = first_rows_of(setting.record.learning, GAIN_ROWS)
    problem = Problem(setting, (), rows, WHITE, COARSE_STEP, free_start=False)
    point = setting.nominal + np.where(setting.positive, OFF * np.sin(1.0 + np.arange(problem.size)), 0.0)
    output = problem.outputs(point[np.newaxis])
    with np.errstate(all="ignore"):
        left = Tangent(problem, point).outside(output)
    return bool(np.linalg.norm(left) < SAME_DIRECTION * np.linalg.norm(output))


def makes_sense(setting: Setting, effect: Effect, *, general: bool) -> bool:
    """Tell whether the model has a place for an effect, and the record may show it.

    ``general`` says that only smooth forces can act inside the model.
    """
    port = setting.plant.port
    if "physics" not in effect.families or not shows(setting.record, effect):
        return False
    if effect.port in ("force", "gain", "flow") and not (has_law(effect) or is_own(effect)):
        return False
    if effect.port == "force":
        # With a constant force of the model's own that may change these two would be second names.
        own = any(parameter.name == port.constant for parameter in setting.searched)
        doubled = own and effect.name in ("asymmetric_friction", "constant_force")
        known = not general or effect.name in SMOOTH_LAWS or is_own(effect)
        return port.velocity is not None and known and not doubled
    if general and effect.port == "gain":
        return False
    return effect.port != "flow" or bool(port.levels)
