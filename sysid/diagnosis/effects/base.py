"""What an effect is: a mechanism, where it enters, its forms and their parameters."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sysid.errors import ModelError

Floats = NDArray[np.float64]
# A map takes a whole sequence of one experiment, the parameters and the sampling period [s].
Map = Callable[[Floats, Floats, float], Floats]

PORTS = ("input", "output", "force", "gain", "flow", "parallel", "noise")
FAMILIES = ("linear", "physics")
# What the expression of a force or gain may hold beside parameters.
SIGNALS = ("x", "v", "y")
SLOPES = ("pointwise", "linear", "identity")
SCALES = (
    "input quantile",
    "input swing quantile",
    "input deviation",
    "input rise",
    "output quantile",
    "output deviation",
    "output count",
    "speed deviation",
    "period",
    "rate",
    "duration",
    "plain",
)


@dataclass(frozen=True)
class Grid:
    """Values at which a shape parameter is tried first, relative to what was measured.

    Attributes
    ----------
    scale : str
        ``"input quantile"``, ``"output quantile"``: points are quantiles of the absolute value, 0 is zero;
        ``"input swing quantile"``: of the distance from the median, for what only counts how far it moves;
        ``"input deviation"``, ``"output deviation"``, ``"speed deviation"``: multiples of the standard
        deviation (speed is the output's first difference); ``"output count"``: multiples of the output's
        deviation, and the steps at whose multiples its values gather; ``"input rise"``: quantiles of the
        input's absolute change per second, or of one that is mostly held rates between those at which it
        reaches its next level just in time and at once; ``"period"``: multiples of the sampling period;
        ``"rate"``: radians per sampling period; ``"duration"``: share of the time that was measured;
        ``"plain"``: as given.
    points : tuple of float
        In rising order.
    """

    scale: str
    points: tuple[float, ...]

    def values(self, u: Floats, y: Floats, period: float) -> Floats:
        """Return the values for a measured input and output, shape (n_points,).

        Examples
        --------
        >>> import numpy as np
        >>> Grid("input quantile", (0.5, 1.0)).values(np.array([-2.0, 0.0, 1.0]), np.zeros(3), 0.1)
        array([1., 2.])
        """
        points = np.array(self.points)
        kind = self.scale.split()[-1]
        signal = u if self.scale.startswith("input") else y[np.isfinite(y)]
        if self.scale == "input swing quantile":
            signal = u - np.median(u)
        if kind == "quantile":
            # Below all that is not zero: an input of few levels may have nothing near zero.
            return np.where(points > 0.0, np.quantile(np.abs(signal), points), 0.0)
        if kind == "rise":
            return _rises(signal, points) / period
        if kind == "count":
            from sysid.diagnosis.effects.counts import closely, counts_tried

            steps = closely(points * (float(np.std(signal)) or 1.0), signal)
            return np.sort(np.concatenate([steps, counts_tried(signal)]))
        if kind == "deviation":
            moved = np.diff(signal) if self.scale.startswith("speed") else signal
            return points * (float(np.std(moved)) or 1.0)
        factors = {"period": period, "rate": 1.0 / period, "duration": period * u.size, "plain": 1.0}
        return points * factors[self.scale]


def _rises(u: Floats, points: Floats) -> Floats:
    """Return typical changes of an input in a sample.

    Examples
    --------
    >>> staircase = np.repeat([0.0, 3.0, 1.0, 2.0], 10)
    >>> _rises(staircase, np.array([0.1, 0.5, 0.9])).round(2).tolist()
    [0.1, 0.45, 2.0]
    """
    moves = np.abs(np.diff(u))
    found = np.quantile(moves, points)
    if found.size < 2 or found[found.size // 2] > 0.0 or not moves.any():
        return np.asarray(found)
    places = np.flatnonzero(moves)
    held = np.diff(np.append(places, u.size - 1))
    slowest, fastest = np.median(moves[places] / held), np.median(moves[places])
    return np.geomspace(0.5 * slowest, fastest, found.size)


# A divisor or a factor without a unit.
_ONE = re.compile(r"/1(\^\d+)?(?![\w.])|(?<![\w.^/])1(\^\d+)? ")


@dataclass(frozen=True)
class EffectParameter:
    """A parameter of an effect.

    Attributes
    ----------
    name : str
    unit : str
        A rule: ``[u]``, ``[y]``, ``[F]`` (force), ``[x]`` (position), ``[v]`` (speed) stand for the units of
        the model, the rest is literal, for example ``[F]/[v]^2``.
    meaning : str
    grid : Grid or None
        Where a shape parameter is tried first.  Without one the parameter is a strength: the effect
        vanishes where it is zero, and its fit starts there.
    minimum, maximum : float
    """

    name: str
    unit: str
    meaning: str
    grid: Grid | None = None
    minimum: float = -np.inf
    maximum: float = np.inf

    @property
    def is_strength(self) -> bool:
        """Whether the effect vanishes at zero."""
        return self.grid is None

    def unit_with(self, units: dict[str, str]) -> str:
        """Return the unit with the model's units put in.

        Examples
        --------
        >>> EffectParameter("c", "[F]/[v]^2", "drag").unit_with({"F": "N", "v": "m/s"})
        'N/(m/s)^2'
        >>> EffectParameter("c", "[y]/[u]^2", "curvature").unit_with({"y": "m", "u": ""})
        'm'
        """
        text = self.unit
        for symbol, unit in units.items():
            wrapped = f"({unit})" if any(sign in unit for sign in " /*^") and text != f"[{symbol}]" else unit
            text = text.replace(f"[{symbol}]", wrapped or "1")
        text = _ONE.sub("", text)
        return "" if text == "1" else text


@dataclass(frozen=True)
class Form:
    """One way an effect is written: symmetric or two-sided, ramp or step.

    Exactly one of ``apply`` and ``expression`` says what it does, none for noise and for flows that the
    model's family knows by name.

    Attributes
    ----------
    name : str
    parameters : tuple of EffectParameter
    apply : callable, optional
        ``apply(sequence, parameters, period)`` on the whole sequence of one experiment; at port
        ``"input"`` and ``"output"`` it returns the changed sequence, at ``"parallel"`` what the input adds
        to the output.
    expression : str
        Port ``"force"``: the force that opposes the input, in position ``x``, speed ``v``, the parameters and
        ``z``; port ``"gain"``: the factor of the input, in the output ``y`` and the parameters.  Grammar
        of `sysid.physics`.
    state : str
        Rate of an internal state ``z`` of a force, in the same names; empty without one.
    slope : {"pointwise", "linear", "identity"}
        How an output map passes a small change on: by its slope at each sample, as a linear map, or
        unchanged.
    smooth : bool
        Whether the output changes smoothly with the shape parameters.
    lowest : float
        Least value that an output map can show.
    refines : bool
        Whether it is a finer law of an effect that was found in another form, not looked for by itself:
        it reaches from there to the model without the effect, so that it would fit too many things.
    inside : bool
        Port ``"parallel"``: whether forces pass it, too, and see what it adds; its only parameter is a gain.
    behind : bool
        Port ``"parallel"``: whether it is given what the maps of the input make, not the input itself; it is
        linear then.
    equation : str
        Where that of the effect says it of another form.
    families : tuple of str
        Kinds of models it makes sense for, of those of the effect.
    in_motion : bool
        Whether it has a past before the first row that is not zero: for records that may begin in the midst
        of a motion.
    """

    name: str
    parameters: tuple[EffectParameter, ...]
    apply: Map | None = None
    expression: str = ""
    state: str = ""
    slope: str = "pointwise"
    smooth: bool = True
    lowest: float = -np.inf
    refines: bool = False
    inside: bool = False
    behind: bool = False
    equation: str = ""
    families: tuple[str, ...] = FAMILIES
    in_motion: bool = False

    @property
    def jumps(self) -> bool:
        """Whether an output map follows its input on the whole, but by jumps."""
        return not self.smooth and self.slope == "identity"

    @property
    def shapes(self) -> tuple[int, ...]:
        """Positions of the shape parameters."""
        return tuple(i for i, p in enumerate(self.parameters) if not p.is_strength)

    def starts(self, u: Floats, y: Floats, period: float) -> list[Floats]:
        """Return the values of each shape parameter to be tried first, one array a parameter."""
        return [
            np.unique(np.clip(p.grid.values(u, y, period), p.minimum, p.maximum))
            for p in self.parameters
            if p.grid is not None
        ]


@dataclass(frozen=True)
class Effect:
    """A physical effect a model may lack.

    Attributes
    ----------
    name : str
    port : str
        Where it enters: ``"input"``, ``"output"``, ``"force"``, ``"gain"`` (of the input), ``"flow"``,
        ``"parallel"`` (from input to output beside the model) or ``"noise"``.
    mechanism, equation, signature, look_alikes, reference : str
        For an engineer: what happens, as a formula, what to look for, how to tell it from others, where
        to read more.
    forms : tuple of Form
        The simplest first.
    families : tuple of str
        Kinds of models it makes sense for: ``"linear"``, ``"physics"``.
    dry : bool
        Whether a force jumps with the direction of motion, so that the body can stick.
    definition : str
        The TOML table that it was read from, as JSON, by which a saved model knows it.
    """

    name: str
    port: str
    mechanism: str
    equation: str
    signature: str
    look_alikes: str
    reference: str
    forms: tuple[Form, ...]
    families: tuple[str, ...] = FAMILIES
    dry: bool = False
    definition: str = ""

    @property
    def found_by(self) -> tuple[Form, ...]:
        """The forms in which it is looked for."""
        return tuple(form for form in self.forms if not form.refines)

    @property
    def refinements(self) -> tuple[Form, ...]:
        """Finer laws, tried where it was found and something is left."""
        return tuple(form for form in self.forms if form.refines)

    def within(self, family: str, in_motion: bool) -> "Effect":
        """Return the effect with the forms that make sense for a kind of models.

        ``in_motion`` says that the record may begin in the midst of a motion.
        """
        suited = (form for form in self.forms if family in form.families)
        forms = tuple(form for form in suited if in_motion or not form.in_motion)
        return self if len(forms) == len(self.forms) else replace(self, forms=forms)

    def form(self, name: str) -> Form:
        """Return a form by its name."""
        for form in self.forms:
            if form.name == name:
                return form
        names = ", ".join(form.name for form in self.forms)
        raise ModelError(f"effect {self.name!r} has no form {name!r}: choose one of {names}")

    def check(self) -> None:
        """Raise ModelError unless the effect can be used."""
        if not self.name.isidentifier():
            raise ModelError(f"effect {self.name!r}: the name must be letters, digits and underscores")
        _known(self.name, "port", [self.port], PORTS)
        _known(self.name, "family", self.families, FAMILIES)
        if not self.forms:
            raise ModelError(f"effect {self.name!r} has no form: give at least one")
        for form in self.forms:
            _known(self.name, "slope", [form.slope], SLOPES)
            _known(self.name, "family", form.families, FAMILIES)
            _known(self.name, "scale", [p.grid.scale for p in form.parameters if p.grid], SCALES)
            if self.port in ("input", "output", "parallel") and form.apply is None:
                raise ModelError(f"effect {self.name!r}, form {form.name!r}: give apply(sequence, p, period)")
            if self.port in ("force", "gain") and not form.expression:
                raise ModelError(f"effect {self.name!r}, form {form.name!r}: give an expression")
            for p in form.parameters:
                if p.grid and not p.grid.points:
                    raise ModelError(
                        f"effect {self.name!r}, parameter {p.name!r}: its grid is empty: give it points"
                    )
            names = {*SIGNALS, *(p.name for p in form.parameters), *(["z"] if form.state else [])}
            for expression in filter(None, (form.expression, form.state)):
                _parse(self.name, expression, names)


def _parse(effect: str, expression: str, names: set[str]) -> None:
    """Raise ModelError, which names effect and expression, where the grammar does not take it."""
    from sysid.physics.grammar import parse

    try:
        parse(expression, names)
    except ModelError as problem:
        raise ModelError(f"effect {effect!r}, expression {expression!r}: {problem}") from None


def _known(effect: str, what: str, given: Sequence[str], known: Sequence[str]) -> None:
    for value in given:
        if value not in known:
            raise ModelError(
                f"effect {effect!r}: {what} {value!r} is not known: choose one of {', '.join(known)}"
            )
