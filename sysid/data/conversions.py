"""Units of one quantity: how many of one make one of another."""

import re
from collections.abc import Mapping
from math import pi

PREFIXES = {"µ": 1e6, "m": 1e3, "c": 1e2, "k": 1e-3, "M": 1e-6}
# Prefixes with which a unit is in use.
PREFIXED = {
    "m": "mcµk",
    "m/s": "mc",
    "rad": "m",
    "s": "mµ",
    "g": "mk",
    "V": "mk",
    "A": "mµ",
    "N": "mkM",
    "N m": "mk",
    "W": "mkM",
    "J": "kM",
    "Pa": "kM",
    "Hz": "kM",
}
# How many of other units make one of the first.
OTHERS: tuple[Mapping[str, float], ...] = (
    {"m": 1.0, "in": 1 / 0.0254, "ft": 1 / 0.3048},
    {"rad": 1.0, "deg": 180 / pi, "rev": 0.5 / pi},
    {"rad/s": 1.0, "rpm": 30 / pi, "deg/s": 180 / pi, "rev/s": 0.5 / pi},
    {"m/s": 1.0, "km/h": 3.6, "mph": 3600 / 1609.344},
    {"Pa": 1.0, "bar": 1e-5},
    {"1": 1.0, "%": 100.0},
)
# Ways in which the same unit is written.
ALIASES = {
    "°": "deg",
    "degree": "deg",
    "degrees": "deg",
    "°/s": "deg/s",
    "dps": "deg/s",
    "r/min": "rpm",
    "1/min": "rpm",
    "U/min": "rpm",
    "RPM": "rpm",
    "kmh": "km/h",
    "kph": "km/h",
    "mps": "m/s",
    "inch": "in",
    "metre": "m",
    "meter": "m",
    "volt": "V",
    "volts": "V",
    "percent": "%",
    "Nm": "N m",
}


# What is hardly met where nothing is said.
RARE = frozenset(
    {
        "in",
        "ft",
        "rev",
        "rev/s",
        "mph",
        "MN",
        "kJ",
        "MJ",
        "mW",
        "mN",
        "mN m",
        "kN m",
        "kV",
        "MW",
        "MPa",
        "km",
    }
)
# The same in rotation: a model of a mass on a spring may be that of a shaft.
ROTARY = {"m": "rad", "m/s": "rad/s", "N": "N m"}


def _families() -> tuple[dict[str, float], ...]:
    """Return the units of each quantity, those with prefixes too."""
    bases = [dict(family) for family in OTHERS]
    bases += [{unit: 1.0} for unit in PREFIXED if all(unit not in family for family in bases)]
    for family in bases:
        first = next(iter(family))
        family |= {prefix + first: PREFIXES[prefix] for prefix in PREFIXED.get(first, "")}
    return tuple(bases)


FAMILIES = _families()


def conversion(given: str, wanted: str, *, may_turn: bool = True) -> float | None:
    """Return how many of a given unit make one of the wanted unit; None if they measure different things.

    What moves in metres may turn in radians, unless it is said that it does not: the equations are the same.

    Examples
    --------
    >>> conversion("mm", "m"), conversion("kN", "N"), conversion("km/h", "m/s"), conversion("V", "m")
    (1000.0, 0.001, 3.6, None)
    >>> round(conversion("rpm", "rad/s"), 3), round(conversion("deg", "m"), 3)
    (9.549, 57.296)
    """
    one, other = _plain(given), _plain(wanted)
    for meant in (other, ROTARY.get(other, other) if may_turn else other):
        for family in FAMILIES:
            if one in family and meant in family:
                return family[one] / family[meant]
    return None


def other_units(unit: str, *, may_turn: bool = True) -> dict[str, float]:
    """Return units in which the same is often measured instead, and how many of each make one.

    ``may_turn`` tells whether what moves in metres may turn in radians.

    Examples
    --------
    >>> other_units("V"), other_units("K")
    ({'mV': 1000.0}, {})
    """
    plain = _plain(unit)
    names = [name for family in FAMILIES for name in family if name not in RARE]
    sizes = {name: conversion(name, plain, may_turn=may_turn) for name in names}
    return {name: size for name, size in sizes.items() if size is not None and size != 1.0}


def unit_at_end(name: str) -> str:
    """Return the last part of a column's name, which may be its unit.

    Examples
    --------
    >>> unit_at_end("speed_kmh"), unit_at_end("x_mm"), unit_at_end("mm")
    ('kmh', 'mm', '')
    """
    parts = re.split(r"[\W_]+", name.strip())
    return parts[-1] if len(parts) > 1 else ""


def _plain(unit: str) -> str:
    """Return a unit in the one way in which it is looked up."""
    text = unit.strip().replace("μ", "µ").replace("·", " ").replace("*", " ")
    text = f"µ{text[1:]}" if text in ("um", "us", "uA", "uV") else text
    return ALIASES.get(text, text)
