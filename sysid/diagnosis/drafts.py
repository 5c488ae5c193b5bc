"""A free-form curve as an effect in TOML, for the user to edit where no candidate explains."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from sysid.data import Record
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.effects.catalogue import effects_in
from sysid.diagnosis.ports.curves import NOTHING
from sysid.diagnosis.structures.structure import Structure
from sysid.diagnosis.wording import percent, significant

if TYPE_CHECKING:
    from sysid.diagnosis.ports import PortCurve

# A law is simple enough if it follows this share of what the curve has beyond a straight line.
ENOUGH = 0.95
MOST_KINKS = 4
# How often the places of the kinks are searched one after another.
SWEEPS = 3
# The segment from which slopes are counted holds at least this share of the data.
LEAST_DATA = 0.05
# Powers of a polynomial: lines are the model's own.
POWERS = (2, 3)
# A law is told in a sentence if its curve removes this share of the error and it has so few parameters.
TOLD, MOST_TOLD = 0.5, 3
# So much data lies on either side of a kink.
LEAST_BESIDE = 0.02
# Points of the curve that are written beside the law.
SHOWN = 9
# Where an effect of each port enters, the name of its signal in expressions, and the rule of its unit.
_ENTERS = {
    "input": ("input", "s", "[u]"),
    "output": ("output", "s", "[y]"),
    "position": ("force", "x", "[x]"),
    "velocity": ("force", "v", "[v]"),
}


@dataclass(frozen=True)
class Law:
    """A law with few parameters that follows a curve.

    Attributes
    ----------
    terms : tuple of str
        Factors of the parameters, in the signal.
    values : tuple of float
        The curve's own values of the parameters.
    units : tuple of int
        By which power of the signal's unit each parameter is divided, beside the unit of what it gives.
    follows : float
        Share of what the curve has beyond a straight line.
    """

    terms: tuple[str, ...]
    values: tuple[float, ...]
    units: tuple[int, ...]
    follows: float


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
        f"# min, max, where(condition, a, b).  {_MEANS[port]}",
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


def template(port: str) -> str:
    """Return a TOML file with an effect at a port, as an example to be edited.

    Examples
    --------
    >>> effects_in(template("gain"), "the template")[0].name
    'fading_gain'
    """
    name, mechanism, lines = _EXAMPLES[port]
    return "\n".join(
        [
            f"# {_MEANS[port]}",
            "# In expressions: + - * / **, abs, sign, sqrt, exp, log, sin, cos, tanh, min, max,",
            "# where(condition, a, b), and the parameters below.",
            f"[{name}]",
            f'port = "{port}"',
            f'mechanism = "{mechanism}"',
            *lines,
            "",
        ]
    )


_GIVES = {"input": "[u]", "output": "[y]", "force": "[F]"}
_MEANS = {
    "input": "s is the input; the expression is what reaches the model.",
    "output": "s is the model's output; the expression is what the sensor shows.",
    "force": "x is the position, v the speed; the expression is the force that opposes the input.",
    "gain": "y is the model's output; the expression is the factor of the input.",
}
_SCALES = {"s": "input deviation", "x": "output deviation", "v": "speed deviation"}
_STRENGTH = "# without a grid: a strength; at zero the effect is gone, and the search starts there"
_SHAPE = "# with a grid: a shape, tried at multiples of"
_EXAMPLES = {
    "input": (
        "soft_limit",
        "The amplifier saturates softly.",
        (
            'expression = "limit*tanh(s/limit)"',
            "[soft_limit.parameters]",
            'limit = { unit = "[u]", minimum = 0, grid = { scale = "input deviation", points = [1, 2] } }',
            f"{_SHAPE} the input's standard deviation",
        ),
    ),
    "output": (
        "bent_sensor",
        "The sensor's characteristic is bent.",
        (
            'expression = "s + c3*s**3"',
            "[bent_sensor.parameters]",
            'c3 = { unit = "1/[y]^2", meaning = "bend" }',
            _STRENGTH,
        ),
    ),
    "force": (
        "soft_stop",
        "A soft stop beyond a gap.",
        (
            'expression = "k*(max(x - gap, 0) + min(x + gap, 0))"',
            "[soft_stop.parameters]",
            'k = { unit = "[F]/[x]", minimum = 0 }',
            _STRENGTH,
            'gap = { unit = "[x]", minimum = 0, grid = { scale = "output deviation", points = [0.5, 1] } }',
            f"{_SHAPE} the output's standard deviation",
        ),
    ),
    "gain": (
        "fading_gain",
        "The drive gets weaker away from zero.",
        (
            'expression = "exp(-(y/width)**2)"',
            "[fading_gain.parameters]",
            'width = { unit = "[y]", minimum = 0, grid = { scale = "output deviation", points = [2, 4] } }',
            f"{_SHAPE} the output's standard deviation",
        ),
    ),
}


def simplest_law(value: Floats, centre: Floats, density: Floats, signal: str, own: float) -> Law:
    """Return the law with the fewest parameters that follows a curve, else the one that follows it best.

    Parameters
    ----------
    value, centre, density : ndarray, shape (n_points,)
        The curve and the data it rests on.
    signal : str
        Name of what it depends on.
    own : float
        Slope that the law has without the curve: 1 where the curve is added to the signal.
    """
    weight = np.sqrt(density + 0.01 * density.mean())
    lines = np.column_stack([np.ones(value.size), value])
    laws: list[Law] = []
    for count in range(1, MOST_KINKS + 1):
        for powers in combinations(POWERS, count):
            laws.append(_polynomial(value, centre, weight, lines, signal, powers))
        laws.append(_kinked(value, centre, weight, lines, signal, own, count))
        best = max(laws, key=lambda law: law.follows)
        if best.follows >= ENOUGH:
            break
    return best


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
    does = (
        f"a force of nearly {text} opposes the input" if port == "force" else f"{what} becomes nearly {text}"
    )
    return f"By this curve {does}, where {signal} is {what}: --draft FILE writes it as an effect."


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


def _polynomial(
    value: Floats, centre: Floats, weight: Floats, lines: Floats, signal: str, powers: Sequence[int]
) -> Law:
    basis = np.column_stack([value**power for power in powers])
    weights, follows = _fitted(centre, weight, lines, basis)
    terms = tuple(f"{signal}**{power}" for power in powers)
    return Law(terms, tuple(weights[2:].tolist()), tuple(powers), follows)


def _fitted(centre: Floats, weight: Floats, lines: Floats, basis: Floats) -> tuple[Floats, float]:
    """Return the weights of lines and basis, and the share of what is beyond the lines that it follows."""
    columns = np.hstack([lines, basis]) * weight[:, np.newaxis]
    weights = np.asarray(np.linalg.lstsq(columns, weight * centre, rcond=None)[0], dtype=np.float64)
    alone = np.asarray(np.linalg.lstsq(columns[:, :2], weight * centre, rcond=None)[0], dtype=np.float64)
    left, all_of_it = (
        float(np.sum((weight * centre - columns[:, : w.size] @ w) ** 2)) for w in (weights, alone)
    )
    return weights, 1.0 - left / all_of_it if all_of_it > 0.0 else 1.0


def _kinked(
    value: Floats, centre: Floats, weight: Floats, lines: Floats, signal: str, own: float, count: int
) -> Law:
    """Return the line with so many kinks that follows a curve best, each place searched in turn."""
    passed = np.cumsum(weight**2) / np.sum(weight**2)
    inner = value[(passed > LEAST_BESIDE) & (passed < 1.0 - LEAST_BESIDE)]
    places: list[float] = []

    def follows(chosen: Sequence[float]) -> float:
        return _fitted(centre, weight, lines, _kinks(value, chosen))[1]

    for _ in range(count):
        places.append(max(inner, key=lambda place: follows([*places, place])))
        for _ in range(SWEEPS):
            for i in range(len(places)):
                others = places[:i] + places[i + 1 :]
                places[i] = max(inner, key=lambda place: follows([*others, place]))
    decimals = 2 - int(np.floor(np.log10(np.ptp(value))))
    places = sorted({round(float(place), decimals) for place in places})
    weights, share = _fitted(centre, weight, lines, _kinks(value, places))
    slopes = own + weights[1] + np.concatenate([[0.0], np.cumsum(weights[2:])])
    return _from_segments(places, slopes, _data_in(value, weight**2, places), signal, own, share)


def _kinks(value: Floats, places: Sequence[float]) -> Floats:
    kinks: Floats = np.maximum(value[:, np.newaxis] - np.asarray(places), 0.0)
    return kinks


def _data_in(value: Floats, density: Floats, places: Sequence[float]) -> Floats:
    """Return the share of the data in each segment between kinks."""
    segment = np.searchsorted(places, value)
    counts = np.bincount(segment, weights=density, minlength=len(places) + 1)
    return np.asarray(counts / counts.sum())


def _from_segments(
    places: Sequence[float], slopes: Floats, data: Floats, signal: str, own: float, follows: float
) -> Law:
    """Write a line with kinks outwards from one of its segments, whose slope the model takes over.

    For a map that is the steepest one with data: the other slopes are shares of it, of which a dead zone has
    zero.  For a force it is the one with most data.
    """
    steep = np.where(data >= LEAST_DATA, np.abs(slopes), 0.0) if own else data
    start = int(np.argmax(steep))
    reference = slopes[start] if own else 1.0
    terms, values = [], []
    for i, place in enumerate(places):
        upwards = i >= start
        step = slopes[i + 1] - slopes[i] if upwards else slopes[i] - slopes[i + 1]
        shifted = f"{signal} {'-' if place >= 0.0 else '+'} {abs(place):g}"
        terms.append(f"{'max' if upwards else 'min'}({shifted}, 0)")
        values.append(float(step / reference))
    return Law(tuple(terms), tuple(values), (1,) * len(terms), follows)


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
