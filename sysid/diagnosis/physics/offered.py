"""Which effects make sense for a physical model."""

import numpy as np

from sysid.diagnosis.effects.base import Effect
from sysid.diagnosis.physics.laws import SMOOTH_LAWS, has_law, is_own
from sysid.diagnosis.physics.problem import COARSE_STEP, Problem
from sysid.diagnosis.physics.search import Tangent
from sysid.diagnosis.physics.setting import Setting
from sysid.diagnosis.structures.exercised import shows
from sysid.diagnosis.structures.rows import first_rows_of
from sysid.diagnosis.structures.structure import WHITE

# A gain is free when the parameters can follow a scaled output on so many rows up to this share.
GAIN_ROWS, SAME_DIRECTION = 1_000, 1e-4


def has_free_gain(setting: Setting) -> bool:
    """Tell whether a change of the model's parameters can scale its output by any factor.

    Values that were given are known to within a factor: they do not make up for the level of a switch.
    """
    if any(parameter.status == "uncertain" for parameter in setting.searched):
        return False
    rows = first_rows_of(setting.record.learning, GAIN_ROWS)
    problem = Problem(setting, (), rows, WHITE, COARSE_STEP, free_start=False)
    point = setting.nominal
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
