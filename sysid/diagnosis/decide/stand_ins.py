"""Whether effects stand in for one that nobody listed: at an end of theirs where they are something else."""

from dataclasses import replace

import numpy as np

from sysid.data import Record
from sysid.diagnosis.decide.evidence import chance_of
from sysid.diagnosis.decide.modes import MODE, is_the_plant_again, rings, settles, swings
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.effects.base import EffectParameter, Floats
from sysid.diagnosis.structures.structure import Choice, Effort, StructureFit

SWITCHES = ("in_relay", "in_hysteresis")
# An input is at one of two levels, or at rest, within this share of what is between them; so many of the rows
# in which it is not at rest are at a level.
SAME_LEVEL, NEARLY_ALL = 0.05, 0.98
# A strength that a record asks to be larger than it can be, with less than this chance if it is not.
BEYOND_P_VALUE = 1e-3
AT_BOUND = 1e-6


def stand_in(evidence: Evidence, fit: StructureFit, composed: bool, coloured: bool) -> bool:
    """Tell whether effects are at an end of their parameters where they are something else.

    Parameters
    ----------
    evidence : Evidence
    fit : StructureFit
    composed : bool
        Whether there are two or more that were not given.
    coloured : bool
        Whether the noise beside them has a memory.
    """
    record = evidence.structure.record
    return (
        _is_another_path(record, fit, composed, coloured)
        or only_switch(record, fit)
        or _asks_for_more(evidence, fit)
    )


def _is_another_path(record: Record, fit: StructureFit, composed: bool, coloured: bool) -> bool:
    """Tell whether an added mode or a slow sensor is but a path that takes up what nobody listed.

    A mode that does not ring may be a slow path of the plant; beside another effect, or beside noise that has
    a memory, it is more likely to follow what these leave.
    """
    if not (swings(fit, record.longest) and settles(fit, record.longest)):
        return True
    if MODE not in fit.names:
        return False
    again = composed and is_the_plant_again(fit, record.period)
    return again or ((composed or coloured) and not rings(fit))


def only_switch(record: Record, fit: StructureFit) -> bool:
    """Tell whether maps of the input leave no more of it than a switch does, which is none of them.

    A limit below all that comes in, or a jump beside which the slope is lost, is a relay.
    """
    maps = [choice for choice in fit.choices if choice.effect.port == "input" and choice.form.apply]
    if not maps or any(choice.name in SWITCHES for choice in fit.choices):
        return False
    u = record.u[:, 0]
    mapped = np.concatenate([_mapped(u[part], maps, fit, record.period) for part in record.slices])
    return _is_switched(mapped[record.learning]) and not _is_switched(u[record.learning])


def _mapped(u: Floats, maps: list[Choice], fit: StructureFit, period: float) -> Floats:
    """Return what maps make of the input of one experiment."""
    for choice in maps:
        assert choice.form.apply is not None
        values = np.array([parameter.value for parameter in fit.parameters_of(choice.name)])
        u = choice.form.apply(np.ascontiguousarray(u), values, period)
    return u


def _is_switched(signal: Floats) -> bool:
    """Tell whether a signal is at its least or its largest value nearly always when it is not at rest."""
    same = SAME_LEVEL * float(np.ptp(signal))
    moved = signal[np.abs(signal) > same]
    away = np.minimum(moved - signal.min(), signal.max() - moved)
    return bool(moved.size and np.mean(away <= same) >= NEARLY_ALL)


def _asks_for_more(evidence: Evidence, fit: StructureFit) -> bool:
    """Tell whether a strength is at a bound beyond which it would explain more than chance does.

    A gain that depends on the output cannot change its sign, so that one in proportion to it, without
    the bend of the law, ends there.
    """
    freed, count = [], 0
    for choice in fit.choices:
        values = [parameter.value for parameter in fit.parameters_of(choice.name)]
        parameters = tuple(map(_unbound, choice.form.parameters, values))
        count += sum(p is not q for p, q in zip(parameters, choice.form.parameters, strict=True))
        freed.append(replace(choice, form=replace(choice.form, parameters=parameters)))
    if count == 0:
        return False
    noise = evidence.noise(fit)
    within = evidence.structure.fit(fit.choices, evidence.rows, noise.polynomial, fit, effort=Effort.REFIT)
    start = replace(within, choices=tuple(freed))
    beyond = evidence.structure.fit(freed, evidence.rows, noise.polynomial, start, effort=Effort.REFIT)
    if not (within.usable and beyond.usable):
        return False
    before, after = evidence.cost(within, noise), evidence.cost(beyond, noise)
    ratio = (before - after) / max(after, 1e-300) * int(evidence.rows.sum())
    return chance_of(ratio, count, 1) < BEYOND_P_VALUE


def _unbound(parameter: EffectParameter, value: float) -> EffectParameter:
    """Return a strength without the bound that it is at; the parameter itself elsewhere."""
    if not parameter.is_strength:
        return parameter
    if parameter.maximum < np.inf and value >= parameter.maximum - AT_BOUND * abs(parameter.maximum):
        return replace(parameter, maximum=np.inf)
    if -np.inf < parameter.minimum < 0.0 and value <= parameter.minimum * (1.0 - AT_BOUND):
        return replace(parameter, minimum=-np.inf)
    return parameter
