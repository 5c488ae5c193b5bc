"""Which case is drawn for a seed and a number: what is hidden, in what, and what the user asks about."""

import zlib
from dataclasses import dataclass

import numpy as np

from sysid.demonstration import CANDIDATES, FOREIGN, FURTHER, MODELS, Case, Difficulty, draw_case
from sysid.errors import UsageError

TIERS = {
    "normal": Difficulty(share=(0.03, 0.30), snr=(20.0, 40.0), coloured=False),
    "hard": Difficulty(share=(0.01, 0.08), snr=(10.0, 20.0), coloured=True),
}
KINDS = {"single": 0.64, "null": 0.14, "two": 0.10, "outside": 0.12}
FAMILIES = {
    "difference-equation": 0.5,
    "dc-motor": 0.16,
    "mass-spring-damper": 0.14,
    "two-mass": 0.06,
    "two-tanks": 0.07,
    "positioning-stage": 0.07,
}
TWINS = (
    {"coulomb", "stribeck", "asymmetric_friction"},
    {"in_relay", "in_hysteresis"},
    {"in_relay", "in_preload", "in_deadzone"},
    {"in_relay", "in_saturation"},
    {"in_delay", "out_delay"},
)
"""Effects so alike that withholding one from the candidates withholds the others."""

_WITHHELD = (
    "in_saturation",
    "in_deadzone",
    "in_preload",
    "in_backlash",
    "out_saturation",
    "out_quadratic",
    "op_gain",
    "time_variation",
    "coulomb",
)
# With an input that is never negative these are a constant, or nothing.
_INVISIBLE = {"two-tanks": ("in_deadzone", "in_preload", "in_relay", "in_hysteresis", "out_rectify")}
_FIRST = (
    "in_saturation",
    "in_deadzone",
    "in_preload",
    "in_backlash",
    "in_delay",
    "coulomb",
    "stribeck",
    "quad_drag",
    "cubic_stiffness",
    "op_gain",
    "time_variation",
    "overflow",
)
_SECOND = ("out_saturation", "out_offset", "out_drift", "out_quadratic", "out_quantisation")


@dataclass(frozen=True)
class Assignment:
    """One case of the bench.

    Attributes
    ----------
    identifier : str
    tier, kind : str
        Keys of `TIERS` and `KINDS`.
    case : Case
    candidates : tuple of str
        What the diagnosis is asked about.
    """

    identifier: str
    tier: str
    kind: str
    case: Case
    candidates: tuple[str, ...]

    @property
    def arguments(self) -> list[str]:
        """Arguments of ``sysid diagnose`` after the file, but for the places of its answers."""
        return [
            *("--input", "u", "--output", "y", "--period", repr(self.case.plant.period)),
            *("--split-column", "set", "--effects", ",".join(self.candidates)),
            *("--accept", "auto", "--initial-state", "rest", "--seed", "1", "--jobs", "1"),
            *self.case.model_arguments(),
        ]


def assign(
    seed: int,
    number: int,
    tier: str = "normal",
    family: str | None = None,
    kind: str | None = None,
    effect: str | None = None,
    *,
    full: bool = False,
) -> Assignment:
    """Draw one case; the same arguments give the same case.

    Parameters
    ----------
    seed, number : int
        Of the bench and of the case in it.
    tier : str
        A key of `TIERS`.
    family, kind : str, optional
        Keys of `FAMILIES` and `KINDS`; drawn with their weights when not given.
    effect : str, optional
        The one effect to hide.
    full : bool
        Ask about every effect of the catalogue that applies, not only the usual ones, and hide those, too.

    Raises
    ------
    UsageError
        If a name is unknown, or the effect cannot be hidden in the family.
    """
    for what, name, known in (("tier", tier, TIERS), ("family", family, MODELS), ("kind", kind, KINDS)):
        if name is not None and name not in known:
            raise UsageError(f"the {what} {name!r} is unknown; choose from {', '.join(known)}.")
    rng = np.random.default_rng([seed, number, zlib.crc32(tier.encode())])
    drawn_family, drawn_kind = _one_of(rng, FAMILIES), _one_of(rng, KINDS)
    family, kind = family or drawn_family, "single" if effect else kind or drawn_kind
    usual = CANDIDATES[family] + (FURTHER[family] if full else ())
    for _ in range(20):
        names = (effect,) if effect else _names(rng, family, kind, usual)
        try:
            case = draw_case(rng, family, names, TIERS[tier])
        except UsageError:
            if effect:
                raise
            continue
        asked = tuple(name for name in usual if not (kind == "outside" and _alike(name, names[0])))
        return Assignment(f"{tier}-{seed:05d}-{number:04d}", tier, kind, case, asked)
    raise UsageError(
        f"no {kind} case of the family {family} could be drawn; choose another seed than {seed}."
    )


def _names(rng: np.random.Generator, family: str, kind: str, usual: tuple[str, ...]) -> tuple[str, ...]:
    if kind == "null":
        return ()
    usual = tuple(name for name in usual if name not in _INVISIBLE.get(family, ()))
    if kind == "single":
        return (_pick(rng, usual),)
    if kind == "two":
        return (
            _pick(rng, tuple(name for name in _FIRST if name in usual)),
            _pick(rng, tuple(name for name in _SECOND if name in usual)),
        )
    withheld = tuple(name for name in _WITHHELD if name in usual)
    # Tanks have no speed, and the motor's speed is its position: there it would be cubic stiffness.
    still = family in ("two-tanks", "dc-motor")
    foreign = tuple(name for name in FOREIGN if not (still and name == "cubic_damping"))
    return (_pick(rng, foreign if rng.random() < 0.5 else withheld),)


def _pick(rng: np.random.Generator, names: tuple[str, ...]) -> str:
    return names[int(rng.integers(len(names)))]


def _one_of(rng: np.random.Generator, weights: dict[str, float]) -> str:
    share = np.array(list(weights.values()))
    return list(weights)[int(rng.choice(len(weights), p=share / share.sum()))]


def _alike(one: str, other: str) -> bool:
    return one == other or any(one in twins and other in twins for twins in TWINS)
