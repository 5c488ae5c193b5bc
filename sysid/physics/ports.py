"""Where a force or a flow enters a physical model: found from its equations."""

from dataclasses import dataclass

from sysid.physics.expressions import Symbol, symbols
from sysid.physics.model import Model

SPEED_UNITS = ("m/s", "rad/s")
LEVEL_UNITS = ("m", "cm", "mm")


@dataclass(frozen=True)
class Port:
    """Where effects act inside a model.

    Attributes
    ----------
    velocity : int or None
        State on whose equation a force acts; None if the model has no moving body.
    position : int or None
        State that is the integral of the velocity; the velocity itself where there is none.
    levels : tuple of int
        States that are levels of tanks, the first in the direction of the flow first.
    constant : str
        Parameter of the model that is a constant force of its own, or empty.
    """

    velocity: int | None = None
    position: int | None = None
    levels: tuple[int, ...] = ()
    constant: str = ""


def find_port(model: Model) -> Port:
    """Return the port of a model with one output.

    A force acts on the body whose position or speed is measured: the equation of the speed whose
    integral is the first output or, without an integral, of that output itself.  States in a unit of
    length whose equations are not integrals of a state are levels.

    Examples
    --------
    >>> from sysid.physics import load_model
    >>> find_port(load_model("two-mass"))
    Port(velocity=1, position=0, levels=(), constant='')
    >>> find_port(load_model("dc-motor"))
    Port(velocity=0, position=0, levels=(), constant='')
    >>> find_port(load_model("two-tanks")).levels
    (0, 1)
    """
    names = [state.name for state in model.states]
    units = [state.unit for state in model.states]
    integrals = {
        i: names.index(equation.rate.name)
        for i, equation in enumerate(model.equations)
        if isinstance(equation.rate, Symbol) and equation.rate.name in names
    }
    measured = [i for i, name in enumerate(names) if name in symbols(model.outputs[0].expression)]
    for state in measured:
        if state in integrals:
            velocity = integrals[state]
            return Port(velocity, state, constant=_constant(model, velocity))
        if units[state] in SPEED_UNITS:
            positions = [i for i, v in integrals.items() if v == state]
            position = positions[0] if positions else state
            return Port(state, position, constant=_constant(model, state))
    if measured and all(unit in LEVEL_UNITS for unit in units) and not integrals:
        return Port(levels=tuple(range(len(names)))[:2])
    return Port()


def _constant(model: Model, velocity: int) -> str:
    """Return the parameter that is alone a term of the force balance."""
    names = {p.name for p in model.parameters}
    for term in model.equations[velocity].terms:
        inside = symbols(term.expression)
        if len(inside) == 1 and inside <= names:
            return next(iter(inside))
    return ""
