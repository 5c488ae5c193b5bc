"""Bounds and typical sizes of what a search in a physical model looks for."""

from collections.abc import Sequence

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.laws import lower_bound, typical_size
from sysid.diagnosis.physics.setting import LARGEST_LOGARITHM, Setting
from sysid.diagnosis.structures.structure import Choice
from sysid.physics.model import Parameter

# A value known within some 20 % stays within a factor of exp(3) = 20, whatever the effects do to it.
FURTHEST = 3.0


def bounds_of(setting: Setting, choices: Sequence[Choice], n_starts: int) -> tuple[Floats, Floats]:
    """Return the bounds of [model parameters, effect parameters, initial states]."""
    low = [_logarithm(p, p.minimum, -LARGEST_LOGARITHM) for p in setting.searched]
    high = [_logarithm(p, p.maximum, LARGEST_LOGARITHM) for p in setting.searched]
    for choice in choices:
        low += [lower_bound(choice.effect, p, setting.sizes) for p in choice.form.parameters]
        high += [p.maximum for p in choice.form.parameters]
    near = np.array([p.positive and p.status == "uncertain" for p in setting.searched], dtype=bool)
    n, nominal = len(setting.searched), setting.nominal
    low[:n] = np.where(near, np.maximum(low[:n], nominal - FURTHEST), low[:n]).tolist()
    high[:n] = np.where(near, np.minimum(high[:n], nominal + FURTHEST), high[:n]).tolist()
    unbounded = np.full(n_starts, np.inf)
    return np.concatenate([low, -unbounded]), np.concatenate([high, unbounded])


def sizes_of(setting: Setting, choices: Sequence[Choice], n_experiments: int) -> Floats:
    """Return the typical size of each unknown, 1 for logarithms; initial states of so many experiments."""
    own = [1.0 if p.positive else max(abs(p.start), setting.sizes["F"]) for p in setting.searched]
    for choice in choices:
        own += [typical_size(p.unit, setting.sizes) for p in choice.form.parameters]
    return np.concatenate([own, np.tile(setting.state_sizes, n_experiments)])


def _logarithm(parameter: Parameter, value: float, unbounded: float) -> float:
    if not parameter.positive:
        return value
    with np.errstate(divide="ignore"):
        return float(np.clip(np.log(value), -LARGEST_LOGARITHM, LARGEST_LOGARITHM)) if value else unbounded
