"""What an effect means on a record: the data show its law, the mechanism follows from what was measured."""

from typing import TYPE_CHECKING

from sysid.data.conversions import conversion, unit_at_end
from sysid.diagnosis.decide.modes import MODE, rings, swings

if TYPE_CHECKING:
    from sysid.data import Record
    from sysid.diagnosis.effects.base import Effect
    from sysid.diagnosis.outcome import Outcome

SLOW_PATH = (
    "Further dynamics beside the modelled ones that do not ring, such as a slow heat store or a second "
    "time constant: the model's order is too low, so try a higher one before you believe in a vibration."
)
BETWEEN_SAMPLES = (
    "A delay of less than a sample beside a force is no transport: the plant feels its force at once and the "
    "input held from sample to sample, the difference equation both of them alike."
)
# Forces of a moving body, and what the same law is where the output is no position.
ELSEWHERE = {
    "gravity_sine": "a loss that is not in proportion to the output (drag of a vehicle, radiation of a hot "
    "body, flow through a valve)",
    "cubic_stiffness": "a loss that grows more, or less, than in proportion to the output (drag of a "
    "vehicle, radiation of a hot body)",
    "quad_drag": "a load that grows with the square of the output's rate of change",
    "constant_force": "a constant load at the input",
}


def mechanism(effect: "Effect", diagnosis: "Outcome") -> str:
    """Return what happens, at least as a formula.

    A difference equation does not say what its output is: a sine of it is a force of gravity only if it is an
    angle.  Its unit can tell; otherwise both are said.
    """
    if effect.name == MODE and not _vibrates(diagnosis):
        return SLOW_PATH
    if effect.name == "in_delay" and _between_samples(diagnosis):
        return BETWEEN_SAMPLES
    physical = getattr(diagnosis.structure, "plant", None) is not None
    other = "" if physical else ELSEWHERE.get(effect.name, "")
    moves = _moves(diagnosis.record)
    if not other or moves:
        return effect.mechanism or effect.equation
    law = effect.equation.replace("(x /", "(y /").replace("x^3", "y^3")
    if moves is None:
        return f"{effect.mechanism[:-1]}, if the output is a position or an angle; otherwise {other}: {law}."
    return f"{other[0].upper()}{other[1:]}: {law}."


def _vibrates(diagnosis: "Outcome") -> bool:
    """Tell whether an added mode rings, and swings at least once in the longest experiment."""
    fitted = diagnosis.final.fitted
    return rings(fitted) and swings(fitted, diagnosis.record.longest)


def _between_samples(diagnosis: "Outcome") -> bool:
    """Tell whether a delay stands for what a difference equation does wrong with a force."""
    fitted = diagnosis.final.fitted
    forced = any(choice.effect.port == "force" for choice in fitted.choices)
    linear = getattr(diagnosis.structure, "plant", None) is None
    delays = [p.value for p in fitted.parameters_of("in_delay") if p.name == "delay"]
    return linear and forced and any(delay < diagnosis.record.period for delay in delays)


def _moves(record: "Record") -> bool | None:
    """Tell whether the output is a position or an angle; None if its name says no unit."""
    name = record.outputs[0]
    unit = record.unit(name) or unit_at_end(name)
    if conversion(unit, "m") is not None or conversion(unit, "rad") is not None:
        return True
    return False if record.unit(name) else None
