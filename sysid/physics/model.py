"""Continuous-time models made of named terms: states, inputs, outputs, parameters, equations."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from sysid.errors import ModelError
from sysid.physics.expressions import (
    ZERO,
    Evaluator,
    Expression,
    Number,
    derivative,
    operation,
    substitute,
    symbols,
    text,
    total,
)
from sysid.physics.grammar import parse

STATUSES = ("free", "uncertain", "fixed")
# A start value of a parameter, or its value and standard deviation.
Starts = Mapping[str, float | tuple[float, float]]


@dataclass(frozen=True)
class Variable:
    """A state or an input.

    Attributes
    ----------
    name, unit, meaning : str
    rest : float
        Value at rest, for a state.
    delay : str
        Parameter by which an input is delayed, or empty.
    """

    name: str
    unit: str
    meaning: str = ""
    rest: float = 0.0
    delay: str = ""


@dataclass(frozen=True)
class Prior:
    """What is known of a parameter before the record: a Gaussian distribution.

    Attributes
    ----------
    mean, std : float
        In the unit of the parameter.
    """

    mean: float
    std: float


@dataclass(frozen=True)
class Parameter:
    """A parameter with its unit, start value and bounds.

    Attributes
    ----------
    name, unit, meaning : str
    start : float
    minimum, maximum : float
    status : {"free", "uncertain", "fixed"}
        Free: the start says little.  Uncertain: the start is known within some 20 %.  Fixed: known.
    prior : Prior or None
        Weighs in the fit as one more measurement.
    """

    name: str
    unit: str
    start: float
    minimum: float = -math.inf
    maximum: float = math.inf
    status: str = "free"
    meaning: str = ""
    prior: Prior | None = None

    @property
    def positive(self) -> bool:
        """Whether it can only be positive, so that its logarithm is searched."""
        return self.minimum >= 0.0 and self.status != "fixed"

    def check(self) -> None:
        """Raise ModelError unless start and bounds fit together."""
        if self.status not in STATUSES:
            raise ModelError(f"status is {self.status!r}: choose one of {', '.join(STATUSES)}")
        if math.isnan(self.minimum) or math.isnan(self.maximum) or not self.minimum < self.maximum:
            raise ModelError(
                f"minimum is {self.minimum:g} and maximum {self.maximum:g}: the minimum must be smaller"
            )
        if not math.isfinite(self.start) or not self.minimum <= self.start <= self.maximum:
            raise ModelError(
                f"start is {self.start:g}: give a number from {self.minimum:g} to {self.maximum:g}"
            )
        if self.positive and self.start == 0.0:
            raise ModelError("start is 0 and the parameter can only be positive: give a positive start")
        if self.prior is not None and not (
            math.isfinite(self.prior.mean) and 0.0 < self.prior.std < math.inf
        ):
            raise ModelError(
                f"its prior is {self.prior.mean:g} ± {self.prior.std:g}: give a positive standard deviation"
            )


@dataclass(frozen=True)
class Term:
    """One physical term of an equation."""

    name: str
    expression: Expression


@dataclass(frozen=True)
class Equation:
    """Factor times the derivative of a state equals a sum of terms.

    Attributes
    ----------
    state : str
    factor : Expression
        For example the mass.
    unit : str
        Unit of the terms.
    terms : tuple of Term
    """

    state: str
    factor: Expression
    unit: str
    terms: tuple[Term, ...]

    @property
    def rate(self) -> Expression:
        """Derivative of the state."""
        return operation("/", total(tuple(term.expression for term in self.terms)), self.factor)

    def __str__(self) -> str:
        factor = text(self.factor)
        left = f"{self.state}'" if factor == "1" else f"{factor} {self.state}'"
        return f"{left} = {_sum_text(self.terms)}"


@dataclass(frozen=True)
class Output:
    """A measured quantity: a sum of terms of states, inputs and parameters."""

    name: str
    unit: str
    terms: tuple[Term, ...]
    meaning: str = ""

    @property
    def expression(self) -> Expression:
        """The sum."""
        return total(tuple(term.expression for term in self.terms))

    def __str__(self) -> str:
        return f"{self.name} = {_sum_text(self.terms)}"


@dataclass(frozen=True)
class Model:
    """A continuous-time model in state space, input held between samples.

    Attributes
    ----------
    name, title : str
    states, inputs : tuple of Variable
    outputs : tuple of Output
    parameters : tuple of Parameter
    equations : tuple of Equation
        One a state, in the order of the states.
    source : str
        Where it was read.
    """

    name: str
    title: str
    states: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Output, ...]
    parameters: tuple[Parameter, ...]
    equations: tuple[Equation, ...]
    source: str = field(default="", compare=False)

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.states)

    def parameter(self, name: str) -> Parameter:
        """Return a parameter by its name; ModelError if there is none."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        names = ", ".join(parameter.name for parameter in self.parameters)
        raise ModelError(f"model {self.name!r} has no parameter {name!r}: choose one of {names}")

    def with_parameters(
        self, start: Starts | None = None, fixed: Mapping[str, float] | None = None
    ) -> "Model":
        """Return the model with other start values (uncertain) and known values (fixed).

        A start may be a pair of value and standard deviation: a Gaussian prior.

        Examples
        --------
        >>> from sysid.physics import load_model
        >>> motor = load_model("dc-motor").with_parameters(start={"J": 0.4}, fixed={"R": 1.2})
        >>> [(p.name, p.start, p.status) for p in motor.parameters if p.name in "JR"]
        [('J', 0.4, 'uncertain'), ('R', 1.2, 'fixed')]
        """
        changes: dict[str, Parameter] = {}
        both = set(start or {}) & set(fixed or {})
        if both:
            raise ModelError(f"parameter {min(both)!r} has a start and a fixed value: give one of them")
        for status, values in (("uncertain", start), ("fixed", fixed)):
            for name, value in (values or {}).items():
                changed = _changed(self.parameter(name), value, status)
                try:
                    changed.check()
                except ModelError as problem:
                    raise ModelError(f"model {self.name!r}, parameter {name!r}: {problem}") from None
                changes[name] = changed
        return replace(self, parameters=tuple(changes.get(p.name, p) for p in self.parameters))

    def with_values(self, values: Mapping[str, float]) -> "Model":
        """Return the model with other start values, each parameter as free or fixed as before."""
        return replace(self, parameters=tuple(replace(p, start=values[p.name]) for p in self.parameters))

    def with_term(
        self, place: str, name: str, expression: str, parameters: tuple[Parameter, ...] = ()
    ) -> "Model":
        """Return the model with one more term in the equation of a state or of an output.

        Parameters
        ----------
        place : str
            The state whose derivative the equation gives, or the output.
        name : str
            What the term is, for a reader.
        expression : str
            In the grammar of the equations, with its sign.
        parameters : tuple of Parameter
            Parameters the term brings.

        Examples
        --------
        >>> from sysid.physics import load_model
        >>> stiffer = load_model("mass-spring-damper").with_term(
        ...     "v", "cubic stiffness", "-k3*x**3", (Parameter("k3", "N/m^3", 1.0),))
        >>> print(stiffer.equations[1])
        m v' = u - c*v - k*x - k3*x**3
        """
        for parameter in parameters:
            parameter.check()
        extended = replace(self, parameters=(*self.parameters, *parameters))
        extended.check_names()
        term = Term(name, parse(expression, extended.names))
        if not any(
            place == item for item in [*(s.name for s in self.states), *(o.name for o in self.outputs)]
        ):
            raise ModelError(
                f"model {self.name!r} has no state or output {place!r} to which a term can be added"
            )
        equations = [replace(e, terms=(*e.terms, term)) if e.state == place else e for e in self.equations]
        outputs = [replace(o, terms=(*o.terms, term)) if o.name == place else o for o in self.outputs]
        return replace(extended, equations=tuple(equations), outputs=tuple(outputs))

    @property
    def names(self) -> tuple[str, ...]:
        """Names that may occur in an equation."""
        variables = tuple(variable.name for variable in (*self.states, *self.inputs))
        return variables + tuple(parameter.name for parameter in self.parameters)

    def check_names(self) -> None:
        """Raise ModelError if a name occurs twice."""
        names = [*self.names, *(output.name for output in self.outputs)]
        for name in names:
            if names.count(name) > 1:
                raise ModelError(f"the name {name!r} is given twice: rename one of them")

    def reduced_rates(self) -> tuple[Expression, ...]:
        """Return the derivative of each state, parameters fixed at zero left out."""
        zeros = self._zeros()
        return tuple(substitute(equation.rate, zeros) for equation in self.equations)

    @cached_property
    def rate_slopes(self) -> Evaluator:
        """Derivatives of the rate of each state by each state, one state's after the other's."""
        names = [state.name for state in self.states]
        return Evaluator([derivative(rate, name) for rate in self.reduced_rates() for name in names])

    def reduced_outputs(self) -> tuple[Expression, ...]:
        """Return the expression of each output, parameters fixed at zero left out."""
        zeros = self._zeros()
        return tuple(substitute(output.expression, zeros) for output in self.outputs)

    def _zeros(self) -> dict[str, Number]:
        return {p.name: ZERO for p in self.parameters if p.status == "fixed" and p.start == 0.0}

    def unused(self) -> tuple[str, ...]:
        """Return the parameters that occur nowhere."""
        used = {variable.delay for variable in self.inputs}
        for equation in self.equations:
            used |= symbols(equation.factor)
            used |= frozenset().union(*(symbols(term.expression) for term in equation.terms))
        for output in self.outputs:
            used |= symbols(output.expression)
        return tuple(p.name for p in self.parameters if p.name not in used)

    def __str__(self) -> str:
        return "\n".join([*(str(e) for e in self.equations), *(str(o) for o in self.outputs)])


def _changed(parameter: Parameter, value: float | tuple[float, float], status: str) -> Parameter:
    """Return a parameter with another start; a prior stays unless a new one is given or it becomes fixed."""
    if isinstance(value, tuple) and len(value) == 2 and status != "fixed":
        mean, std = (_real(parameter.name, part) for part in value)
        return replace(parameter, start=mean, status=status, prior=Prior(mean, std))
    known = _real(parameter.name, value)
    return replace(
        parameter, start=known, status=status, prior=None if status == "fixed" else parameter.prior
    )


def _real(name: str, value: object) -> float:
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise ModelError(
            f"parameter {name!r} is {value!r}: give a number, or a start as (value, standard deviation)"
        ) from None


def _sum_text(terms: tuple[Term, ...]) -> str:
    shown = ""
    for term in terms:
        part = text(term.expression)
        if not shown:
            shown = part
        elif part.startswith("-"):
            shown += f" - {part[1:]}"
        else:
            shown += f" + {part}"
    return shown or "0"
