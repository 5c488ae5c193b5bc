"""Effects inside the dynamics as coefficients of the one law the fast simulation knows."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from sysid.diagnosis.effects.base import Effect, EffectParameter, Floats, Grid, Map
from sysid.diagnosis.effects.input_maps import SWITCHES
from sysid.diagnosis.structures.structure import Choice
from sysid.physics.forced import law
from sysid.physics.own_laws import OwnLaw

Coefficients = dict[str, float]
_LARGEST_WAVES = 1e9


def _sine(p: Floats) -> Coefficients:
    return {"gravity": p[0], "wave_number": 1.0 / max(p[1], 1.0 / _LARGEST_WAVES)}


# Parameters in the order of the catalogue; forces of the catalogue oppose the input.
_LAWS: Mapping[str, Callable[[Floats], Coefficients]] = {
    "coulomb": lambda p: {"friction_forward": p[0], "friction_back": p[0]},
    "stribeck": lambda p: {
        "friction_forward": p[0],
        "friction_back": p[0],
        "breakaway": p[1],
        "stribeck_speed": max(p[2], 1e-300),
    },
    "asymmetric_friction": lambda p: {"friction_forward": p[0], "friction_back": p[1]},
    "hysteresis_force": lambda p: {"elastic": p[0], "yield": p[1], "loop_bend": sum(p[2:])},
    "quad_drag": lambda p: {"drag": p[0]},
    "cubic_stiffness": lambda p: {"cubic": p[0]},
    "gravity_sine": _sine,
    "constant_force": lambda p: {"constant": -p[0]},
    "op_gain": lambda p: {"gain": p[0], "gain_scale": max(p[1], 1e-300)},
    "sqrt_outflow": lambda p: {
        "first_power": p[0] if p.size else 0.5,
        "second_power": p[-1] if p.size else 0.5,
    },
    "overflow": lambda p: {"first_cap": p[0], "second_cap": p[min(1, p.size - 1)], "caught": sum(p[2:])},
}
# Coefficients of two effects that add up; one of the others cannot be in a law twice.
_SUMS = ("friction_forward", "friction_back", "breakaway", "drag", "cubic", "constant")
# Forces that a model which is not linear can take, too.
SMOOTH_LAWS = ("quad_drag", "cubic_stiffness", "gravity_sine", "constant_force")
# Name of the value that a switch takes when it is on.
LEVEL = "level"
INNER = ("force", "gain", "flow")
# A speed, scale or stiffness much below this share of what occurs makes a law a jump.
SMALLEST_SHAPE = 1e-3


def has_law(effect: Effect) -> bool:
    """Tell whether the fast simulation knows an effect of a force, flow or gain."""
    from sysid.diagnosis.effects.catalogue import BUILT_IN

    return effect.name in _LAWS and effect in BUILT_IN


def is_own(effect: Effect) -> bool:
    """Tell whether a force or gain is a law of the user's own, without a memory."""
    inside = effect.port in ("force", "gain") and not has_law(effect)
    return inside and not any(form.state for form in effect.forms)


def own_law(choices: Sequence[Choice]) -> OwnLaw:
    """Return the laws of the user's own among some effects."""
    return OwnLaw(
        tuple(
            (choice.effect.port, choice.form.expression, tuple(p.name for p in choice.form.parameters))
            for choice in choices
            if is_own(choice.effect)
        )
    )


def coefficients(choices: Sequence[Choice], parameters: Sequence[Floats]) -> Floats:
    """Return the law of a sum of effects, then the parameters of the user's own, shape (19 or more,).

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.diagnosis.effects import find_effects
    >>> coulomb, constant = (Choice(e, e.forms[0]) for e in find_effects(["coulomb", "constant_force"]))
    >>> coefficients([coulomb, constant], [np.array([2.0]), np.array([0.5])])[[0, 1, 8]]
    array([ 2. ,  2. , -0.5])
    """
    total: Coefficients = {}
    own: list[float] = []
    for choice, p in zip(choices, parameters, strict=True):
        if is_own(choice.effect):
            own += p.tolist()
            continue
        if choice.name not in _LAWS:
            continue
        for name, value in _LAWS[choice.name](p).items():
            total[name] = total.get(name, 0.0) + value if name in _SUMS else value
    return np.concatenate([law(**total), own])


def lower_bound(effect: Effect, parameter: EffectParameter, sizes: Mapping[str, float]) -> float:
    """Return the smallest value of a parameter: dry friction cannot drive the body, nor fall at rest."""
    if effect.dry and parameter.is_strength:
        return max(parameter.minimum, 0.0)
    if effect.port in INNER and not parameter.is_strength and parameter.minimum == 0.0:
        return SMALLEST_SHAPE * typical_size(parameter.unit, sizes)
    return parameter.minimum


@lru_cache(maxsize=16)
def with_level(effect: Effect) -> Effect:
    """Return a switch with the level between which it switches as a parameter of its own.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.diagnosis.effects import find_effects
    >>> relay = with_level(find_effects(["in_relay"])[0]).forms[0]
    >>> relay.apply(np.array([-2.0, 0.1, 2.0]), np.array([1.0, 5.0]), 0.1)
    array([-5.,  0.,  5.])
    """
    level = EffectParameter(LEVEL, "[u]", "value when on", Grid("input deviation", (1.0,)), minimum=0.0)
    forms = tuple(
        replace(form, parameters=(*form.parameters, level), apply=_levelled(form.apply))
        for form in effect.forms
        if form.apply is not None
    )
    return replace(effect, forms=forms)


def is_switch_without_level(choice: Choice) -> bool:
    """Tell whether an effect switches between values whose size is left to the model's gain."""
    return choice.name in SWITCHES and not has_level(choice)


def has_level(choice: Choice) -> bool:
    """Tell whether an effect switches between values whose size is a parameter of its own, the last one."""
    return choice.name in SWITCHES and choice.form.parameters[-1].name == LEVEL


def _levelled(apply: Map) -> Map:
    def scaled(sequence: Floats, p: Floats, period: float) -> Floats:
        return np.asarray(p[-1] * apply(sequence, p[:-1], period))

    return scaled


def typical_size(unit: str, sizes: Mapping[str, float]) -> float:
    """Return the size of a quantity from its unit rule and typical sizes of what the rule names.

    Examples
    --------
    >>> typical_size("[F]/[v]^2", {"F": 8.0, "v": 2.0})
    2.0
    """
    size = 1.0
    for number, part in enumerate(unit.split("/")):
        for factor in part.split("*"):
            name, _, power = factor.partition("^")
            value = sizes.get(name.strip("[] "), 1.0) ** float(power or 1.0)
            size = size / value if number else size * value
    return size
