"""The law of an effect as a line below a model's equation: its values, and where it acts."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from sysid.diagnosis.effects.base import Effect


@dataclass(frozen=True)
class Signals:
    """What the symbols of an effect's law are in a model's equation.

    Attributes
    ----------
    input, output : str
        What an input effect changes (its u), and what an output effect does (its w).
    position, speed : str
        What a force depends on (its x and v).
    force : str
        Where the force F acts.
    """

    input: str
    output: str
    position: str
    speed: str
    force: str


def effect_line(effect: Effect, values: Mapping[str, float], signals: Signals) -> str:
    """Return the law of an effect in a model, for a reader.

    Parameters
    ----------
    effect : Effect
    values : mapping of str to float
        Its parameters.
    signals : Signals

    Returns
    -------
    str

    Examples
    --------
    >>> from sysid.diagnosis.effects.catalogue import find_effects
    >>> signals = Signals("u", "x", "x", "x'", "in m x'' = u - k*x - F")
    >>> drag, bend = find_effects(["quad_drag", "out_quadratic"])
    >>> print(effect_line(drag, {"c": 0.2}, signals))
    quad_drag: F = c v |v| (c = 0.2), in m x'' = u - k*x - F, where v is x'
    >>> print(effect_line(bend, {"c": 0.1}, signals))
    out_quadratic: y = w + c w^2 (c = 0.1), where w is x
    """
    shown = ", ".join(f"{name} = {value:.4g}" for name, value in values.items())
    acts = {
        "force": f", {signals.force}",
        "input": f", which drives the model in place of {signals.input}",
        "gain": f", which drives the model in place of {signals.input}",
    }.get(effect.port, "")
    named = {"w": signals.output} if effect.port in ("output", "parallel") else {}
    if effect.port == "force":
        named = {"x": signals.position, "v": signals.speed}
    alike = [
        f"{symbol} is {signal}"
        for symbol, signal in named.items()
        if symbol != signal and re.search(rf"\b{symbol}\b", effect.equation)
    ]
    where = f", where {' and '.join(alike)}" if alike else ""
    return f"{effect.name}: {effect.equation}{f' ({shown})' if shown else ''}{acts}{where}"
