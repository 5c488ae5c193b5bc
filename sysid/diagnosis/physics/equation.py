"""A physical model with effects as equations for a reader."""

from collections.abc import Iterable, Mapping

from sysid.diagnosis.effects.base import Effect
from sysid.diagnosis.structures.equation_words import Signals, effect_line
from sysid.physics.model import Model
from sysid.physics.ports import find_port


def equation_text(model: Model, effects: Iterable[tuple[Effect, Mapping[str, float]]]) -> str:
    """Return the equations of motion and below them a line for each effect.

    Parameters
    ----------
    model : Model
    effects : iterable of (Effect, mapping of str to float)
        With their parameters.

    Returns
    -------
    str

    Examples
    --------
    >>> from sysid.diagnosis.effects.catalogue import find_effects
    >>> from sysid.physics import load_model
    >>> (spring,) = find_effects(["cubic_stiffness"])
    >>> print(equation_text(load_model("positioning-stage"), [(spring, {"k3": 5.0})]))
    x' = v
    M v' = gain*u - F_v*v - offset
    y = x
    cubic_stiffness: F = k3 x^3 (k3 = 5), in M v' = gain*u - F_v*v - offset - F
    """
    signals = _signals(model)
    return "\n".join([str(model), *(effect_line(effect, values, signals) for effect, values in effects)])


def _signals(model: Model) -> Signals:
    """Return what an effect meets in a physical model with one output."""
    port, states = find_port(model), [state.name for state in model.states]
    force, position, speed = "", "", ""
    if port.velocity is not None and port.position is not None:
        force = f"in {model.equations[port.velocity]} - F"
        position, speed = states[port.position], states[port.velocity]
    output = str(model.outputs[0]).partition(" = ")[2]
    return Signals(model.inputs[0].name, output, position, speed, force)
