"""Whether effects stand in for one that nobody listed: at an end of theirs where they are something else."""

from dataclasses import replace

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.decide.evidence import chance_of
from sysid.diagnosis.decide.modes import MODE, is_the_plant_again, rings, settles, swings
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.effects.base import EffectParameter, Floats
from sysid.diagnosis.effects.input_maps import SWITCHES
from sysid.diagnosis.structures.structure import Choice, Effort, Oscillating, Structure, StructureFit

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
        _is_another_path(evidence.structure, fit, composed, coloured)
        or _is_only_a_switch(record, fit)
        or _is_hysteresis(record, fit)
        or _asks_for_more(evidence, fit)
    )


def _is_another_path(structure: Structure, fit: StructureFit, composed: bool, coloured: bool) -> bool:
    """Tell whether an added mode or a slow sensor is but a path that takes up what nobody listed.

    A mode that does not ring may be a slow path of the plant; beside another effect, or beside noise that has
    a memory, it is more likely to follow what these leave.
    """
    longest = structure.record.longest
    if not (swings(fit, longest) and settles(fit, longest)):
        return True
    if MODE not in fit.names:
        return False
    if composed and isinstance(structure, Oscillating) and is_the_plant_again(fit, structure.poles(fit)):
        return True
    return (composed or coloured) and not rings(fit)


def _is_only_a_switch(record: Record, fit: StructureFit) -> bool:
    """Tell whether maps of the input leave no more of it than a switch does, which is none of them.

    A limit below all that comes in, or a jump beside which the slope is lost, is a relay.
    """
    if any(choice.name in SWITCHES for choice in fit.choices):
        return False
    return _is_switched(_mapped(record, fit)) and not _is_switched(record.u[record.learning, 0])


def _is_hysteresis(record: Record, fit: StructureFit) -> bool:
    """Tell whether a relay and a backlash are one switch: on at one level, off at another, never at rest.

    Play behind a relay holds its last level while the relay is at rest, and a relay behind play turns where
    the play is used up.
    """
    if not {"in_relay", "in_backlash"} <= set(fit.names):
        return False
    mapped = _mapped(record, fit)
    return _is_switched(mapped) and bool(np.mean(_moved(mapped)) >= NEARLY_ALL)


def _mapped(record: Record, fit: StructureFit) -> Floats:
    """Return what the maps of a fit make of the input, on the rows that may be learnt from."""
    maps = [choice for choice in fit.choices if choice.effect.port == "input" and choice.form.apply]
    u = [_through(record.u[part, 0], maps, fit, record.period) for part in record.slices]
    return np.concatenate(u)[record.learning]


def _through(u: Floats, maps: list[Choice], fit: StructureFit, period: float) -> Floats:
    """Return what maps make of the input of one experiment."""
    for choice in maps:
        assert choice.form.apply is not None
        values = np.array([parameter.value for parameter in fit.parameters_of(choice.name)])
        u = choice.form.apply(np.ascontiguousarray(u), values, period)
    return u


def _is_switched(signal: Floats) -> bool:
    """Tell whether a signal is at its least or its largest value nearly always when it is not at rest."""
    moved = signal[_moved(signal)]
    away = np.minimum(moved - signal.min(), signal.max() - moved)
    return bool(moved.size and np.mean(away <= SAME_LEVEL * np.ptp(signal)) >= NEARLY_ALL)


def _moved(signal: Floats) -> Mask:
    """Return where a signal is not at rest."""
    return np.abs(signal) > SAME_LEVEL * np.ptp(signal)


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
