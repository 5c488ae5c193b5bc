"""A free-form curve as an effect in TOML, for the user to edit where no candidate explains."""

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from sysid.data import Record
from sysid.diagnosis.curve_laws import ENOUGH, Law, simplest_law
from sysid.diagnosis.effects.catalogue import effects_in
from sysid.diagnosis.effects.templates import MEANS
from sysid.diagnosis.ports.curves import NOTHING
from sysid.diagnosis.structures.structure import Structure
from sysid.diagnosis.wording import percent, significant

if TYPE_CHECKING:
    from sysid.diagnosis.ports import PortCurve

# A law is told in a sentence if its curve removes this share of the error and it has so few parameters.
TOLD, MOST_TOLD = 0.5, 3
# Points of the curve that are written beside the law.
SHOWN = 9
# Where an effect of each port enters, the name of its signal in expressions, and the rule of its unit.
_ENTERS = {
    "input": ("input", "s", "[u]"),
    "output": ("output", "s", "[y]"),
    "position": ("force", "x", "[x]"),
    "velocity": ("force", "v", "[v]"),
}


def draft_effect(curve: "PortCurve", *, per_second: float = 1.0) -> str:
    r"""Return a TOML file with one effect that does what a free-form curve does.

    The law is a polynomial or a line with kinks, whichever follows the curve with fewer parameters; straight
    lines are the model's own.  `read_effects` reads the file.

    Parameters
    ----------
    curve : PortCurve
    per_second : float
        What an effect takes for a speed of 1 per second: the sampling period where the speed is a difference
        of samples.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.diagnosis.ports import PortCurve
    >>> u = np.linspace(-2, 2, 41)
    >>> curve = PortCurve("input", "u", "u", "V", "added to u", "V", 0.9, (0.8, 1.0), u,
    ...     np.clip(u, -1, 1) - 0.5 * u, u, u, np.ones(41), u[::4], "the fit converged", "")
    >>> print("\n".join(line for line in draft_effect(curve).splitlines() if line.startswith("expression")))
    expression = "s + c1*min(s + 1, 0) + c2*max(s - 1, 0)"
    """
    port, signal, unit = _ENTERS[curve.port]
    name, law = f"{curve.port}_curve", _law_of(curve, per_second if curve.port == "velocity" else 1.0)
    parameters = [f"c{i + 1}" for i in range(len(law.terms))]
    parts = [f"{parameter}*{term}" for parameter, term in zip(parameters, law.terms, strict=True)]
    share = percent(curve.explains_at_most)
    depends = _with_unit(curve.quantity, curve.unit)
    gives = _with_unit(curve.result, curve.result_unit)
    lines = [
        f"# A curve that removes at most {share} of the squared error, as an effect",
        "# to edit: put the law that you recognise in its place, give it the name of what happens, and see",
        f"# with `sysid diagnose ... --effects-file THIS_FILE --add {name}` how much it explains.",
        f"# {depends}; the curve, {gives}; and its 95 % band:",
        *_table(curve),
        f"# The law follows {percent(law.follows)} of what the curve has beyond a straight line,",
        "# which is the model's own.  In expressions: + - * / **, abs, sign, sqrt, exp, log, sin, cos, tanh,",
        f"# min, max, where(condition, a, b).  {MEANS[port]}",
        f"[{name}]",
        f'port = "{port}"',
        f'mechanism = "Follows a free-form curve: {share} of the error."',
        f'expression = "{" + ".join(parts if port == "force" else [signal, *parts])}"',
        f"[{name}.parameters]  # without a grid: strengths, at zero the effect is gone",
    ]
    for parameter, value, power in zip(parameters, law.values, law.units, strict=True):
        rule = _unit_rule(_GIVES[port], unit, power)
        lines.append(f'{parameter} = {{ unit = "{rule}" }}  # the curve has {significant(value)}')
    grid = f'{{ scale = "{_SCALES[signal]}", points = [0.5, 1, 2] }}'
    lines += [
        "# A threshold or scale is tried from a grid, here at half, one and two standard deviations:",
        f'# limit = {{ unit = "{unit}", minimum = 0, grid = {grid} }}',
    ]
    return "\n".join(lines) + "\n"


_GIVES = {"input": "[u]", "output": "[y]", "force": "[F]"}
_SCALES = {"s": "input deviation", "x": "output deviation", "v": "speed deviation"}


@lru_cache(maxsize=16)
def _law_of(curve: "PortCurve", scale: float = 1.0) -> Law:
    """Return the simplest law of a curve whose places are taken so many times as large."""
    port, signal, _ = _ENTERS[curve.port]
    own = 0.0 if port == "force" else 1.0
    return simplest_law(curve.value * scale, curve.centre, curve.density, signal, own)


def law_in_words(curve: "PortCurve") -> str:
    """Return a sentence on the law that a curve which explains much nearly follows, if there is one."""
    if not curve.value.size or curve.explains_at_most < TOLD:
        return ""
    (port, signal, _), law = _ENTERS[curve.port], _law_of(curve)
    if law.follows < ENOUGH or len(law.terms) > MOST_TOLD:
        return ""
    parts = [f"{significant(value)} {term}" for term, value in zip(law.terms, law.values, strict=True)]
    text = " + ".join(parts if port == "force" else [signal, *parts]).replace("+ -", "- ").replace("**", "^")
    what = {"input": "the input", "output": "the model's output"}.get(curve.port, f"the {curve.port}")
    gives, of = (f" in {' '.join(unit.split())}" if unit else "" for unit in (curve.result_unit, curve.unit))
    gives = f",{gives}," if gives else ""
    does = (
        f"a force of nearly {text}{gives} opposes the input"
        if port == "force"
        else f"{what} becomes nearly {text}"
    )
    return f"By this curve {does}, where {signal} is {what}{of}: --draft FILE writes it as an effect."


def draft_of(curves: "Sequence[PortCurve]", record: Record, structure: Structure) -> str:
    """Return the free-form curve that explains most of what no candidate does as an effect in TOML.

    Empty where there is no such curve, or none that an effect can take the place of.
    """
    from sysid.diagnosis.linear.structure import LinearStructure

    for curve in curves:
        seen = curve.port != "input" or curve.channel == record.inputs[0]
        if curve.value.size and seen and curve.explains_at_most >= NOTHING:
            differs = isinstance(structure, LinearStructure)
            draft = draft_effect(curve, per_second=record.period if differs else 1.0)
            if structure.offered(effects_in(draft, "the draft")):
                return draft
    return ""


def _with_unit(name: str, unit: str) -> str:
    """Return a name with its unit, on one line whatever the file called them."""
    return " ".join((f"{name} [{unit}]" if unit else name).split())


def _unit_rule(gives: str, unit: str, power: int) -> str:
    """Return the rule of a parameter's unit: what it gives over a power of the signal's unit."""
    if gives == unit:
        return "1" if power == 1 else f"1/{unit}" + (f"^{power - 1}" if power > 2 else "")
    return f"{gives}/{unit}" + (f"^{power}" if power > 1 else "")


def _table(curve: "PortCurve") -> list[str]:
    """Return some points of the curve with their 95 % bands, as comments."""
    chosen = np.linspace(0, curve.value.size - 1, SHOWN).round().astype(int)
    return [
        f"#   {significant(float(curve.value[i])):>9s}  {significant(float(curve.centre[i])):>9s}"
        f"  ({significant(float(curve.lower[i]))} to {significant(float(curve.upper[i]))})"
        for i in chosen
    ]
