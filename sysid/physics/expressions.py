"""Expressions as trees: evaluated, differentiated, printed, turned into code."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

FUNCTIONS: dict[str, int] = {
    "abs": 1,
    "sign": 1,
    "sqrt": 1,
    "exp": 1,
    "log": 1,
    "sin": 1,
    "cos": 1,
    "tanh": 1,
    "min": 2,
    "max": 2,
    "where": 3,
}
COMPARISONS = ("<", "<=", ">", ">=")

Condition = Callable[[float, float], bool]
_COMPARE: dict[str, Condition] = {
    "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b,
    ">": lambda a, b: a > b,
    ">=": lambda a, b: a >= b,
}
_UNARY: dict[str, Callable[[float], float]] = {
    "neg": lambda a: -a,
    "abs": np.abs,
    "sign": np.sign,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "sin": np.sin,
    "cos": np.cos,
    "tanh": np.tanh,
}
_PRECEDENCE = {"+": 1, "-": 1, "*": 2, "/": 2, "neg": 3, "**": 4, **dict.fromkeys(COMPARISONS, 0)}


@dataclass(frozen=True)
class Number:
    """A constant."""

    value: float


@dataclass(frozen=True)
class Symbol:
    """A state, input or parameter."""

    name: str


@dataclass(frozen=True)
class Operation:
    """An operator or a function of the list above, with its arguments."""

    name: str
    arguments: tuple["Expression", ...]


Expression = Number | Symbol | Operation
ZERO, ONE = Number(0.0), Number(1.0)


def operation(name: str, *arguments: Expression) -> Expression:
    """Return an operation, reduced where a zero, a one or constants allow it."""
    if all(isinstance(argument, Number) for argument in arguments):
        value = evaluate(Operation(name, arguments), {})
        if np.isfinite(value):
            return Number(value)
    if name in ("+", "-", "*", "/", "**"):
        return _reduced(name, *arguments)
    return Operation(name, arguments)


def _reduced(name: str, a: Expression, b: Expression) -> Expression:
    if name == "+" and ZERO in (a, b):
        return b if a == ZERO else a
    if name == "-" and ZERO in (a, b):
        return a if b == ZERO else Operation("neg", (b,))
    if name == "*" and ZERO in (a, b):
        return ZERO
    if name == "*" and ONE in (a, b):
        return b if a == ONE else a
    if name == "/" and a == ZERO:
        return ZERO
    if name in ("/", "**") and b == ONE:
        return a
    if name == "**" and b == ZERO:
        return ONE
    return Operation(name, (a, b))


def total(terms: tuple[Expression, ...]) -> Expression:
    """Return the sum of terms."""
    result: Expression = ZERO
    for term in terms:
        result = operation("+", result, term)
    return result


def symbols(expression: Expression) -> frozenset[str]:
    """Return the names an expression holds."""
    if isinstance(expression, Symbol):
        return frozenset({expression.name})
    if isinstance(expression, Number):
        return frozenset()
    return frozenset().union(*(symbols(argument) for argument in expression.arguments))


def evaluate(expression: Expression, values: Mapping[str, float]) -> float:
    """Return the value of an expression; NaN or infinity where it is not defined.

    Examples
    --------
    >>> evaluate(Operation("*", (Number(2.0), Symbol("k"))), {"k": 3.0})
    6.0
    """
    with np.errstate(all="ignore"):
        return float(_evaluate(expression, values))


def _evaluate(expression: Expression, values: Mapping[str, float]) -> float:
    if isinstance(expression, Number):
        return expression.value
    if isinstance(expression, Symbol):
        return values[expression.name]
    name = expression.name
    a, *rest = (np.float64(_evaluate(argument, values)) for argument in expression.arguments)
    if not rest:
        return _UNARY[name](a)
    if name == "where":
        return rest[0] if a != 0.0 else rest[1]
    if name in _COMPARE:
        return float(_COMPARE[name](a, rest[0]))
    if name in ("min", "max"):
        return min(a, rest[0]) if name == "min" else max(a, rest[0])
    return _arithmetic(name, a, rest[0])


def _arithmetic(name: str, a: np.float64, b: np.float64) -> float:
    if name == "+":
        return a + b
    if name == "-":
        return a - b
    if name == "*":
        return a * b
    return a / b if name == "/" else np.power(a, b)


def substitute(expression: Expression, values: Mapping[str, Expression]) -> Expression:
    """Return the expression with names replaced, reduced."""
    if isinstance(expression, Symbol):
        return values.get(expression.name, expression)
    if isinstance(expression, Number):
        return expression
    return operation(expression.name, *(substitute(argument, values) for argument in expression.arguments))


def derivative(expression: Expression, name: str) -> Expression:
    """Return the partial derivative; at a kink the value of one side, on a jump zero.

    Examples
    --------
    >>> text(derivative(Operation("**", (Symbol("x"), Number(3.0))), "x"))
    '3*x**2'
    """
    if name not in symbols(expression):
        return ZERO
    if isinstance(expression, Symbol):
        return ONE
    assert isinstance(expression, Operation)
    if expression.name in COMPARISONS or expression.name == "sign":
        return ZERO
    arguments = expression.arguments
    inner = [derivative(argument, name) for argument in arguments]
    if len(arguments) == 1:
        return _chain(expression, arguments[0], inner[0])
    if expression.name == "where":
        return _choice(arguments[0], inner[1], inner[2])
    a, b = arguments
    da, db = inner
    match expression.name:
        case "+" | "-":
            return operation(expression.name, da, db)
        case "*":
            return operation("+", operation("*", da, b), operation("*", a, db))
        case "/":
            slope = operation("-", da, operation("*", expression, db))
            return operation("/", slope, b)
        case "**":
            return _power(expression, a, b, da, db)
        case "min":
            return _choice(operation("<=", a, b), da, db)
    return _choice(operation(">=", a, b), da, db)


def _choice(condition: Expression, a: Expression, b: Expression) -> Expression:
    return a if a == b else operation("where", condition, a, b)


def _power(
    expression: Expression, a: Expression, b: Expression, da: Expression, db: Expression
) -> Expression:
    by_base = operation("*", operation("*", b, operation("**", a, operation("-", b, ONE))), da)
    if db == ZERO:
        return by_base
    by_exponent = operation("*", operation("*", expression, operation("log", a)), db)
    return operation("+", by_base, by_exponent)


def _chain(expression: Operation, a: Expression, da: Expression) -> Expression:
    half = Number(0.5)
    match expression.name:
        case "neg":
            return operation("neg", da)
        case "abs":
            slope = operation("sign", a)
        case "sqrt":  # its infinite slope at zero would spoil every sensitivity
            slope = operation("where", operation(">", a, ZERO), operation("/", half, expression), ZERO)
        case "exp":
            slope = expression
        case "log":
            slope = operation("/", ONE, a)
        case "sin":
            slope = operation("cos", a)
        case "cos":
            slope = operation("neg", operation("sin", a))
        case _:  # tanh
            slope = operation("-", ONE, operation("**", expression, Number(2.0)))
    return operation("*", slope, da)


def text(expression: Expression) -> str:
    """Return an expression as a reader writes it.

    Examples
    --------
    >>> zeta, w = Symbol("zeta"), Symbol("w")
    >>> text(Operation("*", (Operation("*", (Number(-2.0), zeta)), w)))
    '-2*zeta*w'
    >>> text(Operation("-", (w, Operation("*", (Number(-2.0), zeta)))))
    'w - (-2*zeta)'
    """
    if isinstance(expression, Number):
        return f"{expression.value:.12g}"
    if isinstance(expression, Symbol):
        return expression.name
    name, arguments = expression.name, expression.arguments
    if name not in _PRECEDENCE:
        return f"{name}({', '.join(text(argument) for argument in arguments)})"
    level = _PRECEDENCE[name]
    if name == "neg":
        return f"-{_wrapped(arguments[0], level)}"
    left = _wrapped(arguments[0], level + (name == "**"))
    right = _wrapped(arguments[1], level + (name in ("-", "/", "*")))
    right = f"({right})" if right.startswith("-") else right
    gap = "" if name in ("*", "/", "**") else " "
    return f"{left}{gap}{name}{gap}{right}"


def _wrapped(expression: Expression, level: int) -> str:
    own = _PRECEDENCE.get(expression.name, 9) if isinstance(expression, Operation) else 9
    if isinstance(expression, Number) and expression.value < 0:
        own = _PRECEDENCE["neg"]
    return f"({text(expression)})" if own < level else text(expression)


def code(expression: Expression, names: Mapping[str, str]) -> str:
    """Return Python source; every name in it is one of the values of ``names``, never the user's text."""
    if isinstance(expression, Number):
        return f"({expression.value!r})"
    if isinstance(expression, Symbol):
        return names[expression.name]
    name = expression.name
    if name == "**" and isinstance(expression.arguments[1], Number):
        exponent = expression.arguments[1].value
        if exponent == int(exponent) and abs(exponent) <= 16:
            return f"({code(expression.arguments[0], names)} ** {int(exponent)})"
    parts = [code(argument, names) for argument in expression.arguments]
    if name == "neg":
        return f"(-{parts[0]})"
    if name == "where":
        return f"({parts[1]} if {parts[0]} != 0.0 else {parts[2]})"
    if name in COMPARISONS:
        return f"(1.0 if {parts[0]} {name} {parts[1]} else 0.0)"
    if name in ("min", "max"):
        return f"{name}({', '.join(parts)})"
    if name in FUNCTIONS:
        return f"np.{name}({parts[0]})"
    return f"({parts[0]} {name} {parts[1]})"


class Evaluator:
    """The values of several expressions at once, many times: they are written as Python first.

    Parameters
    ----------
    expressions : sequence of Expression

    Examples
    --------
    >>> Evaluator([Operation("/", (Symbol("k"), Symbol("m"))), Number(2.0)])({"k": 3.0, "m": 0.0})
    [inf, 2.0]
    """

    def __init__(self, expressions: Sequence[Expression]) -> None:
        self._expressions = tuple(expressions)
        self._names = sorted(frozenset().union(*map(symbols, self._expressions)))
        inside = {name: f"p[{i}]" for i, name in enumerate(self._names)}
        text = "".join(f"{code(expression, inside)}, " for expression in self._expressions)
        namespace: dict[str, Any] = {"np": np}
        exec(compile(f"def values(p):\n    return ({text})\n", "<expressions>", "exec"), namespace)
        self._written: Callable[[Sequence[float]], Sequence[float]] = namespace["values"]

    def __call__(self, values: Mapping[str, float]) -> list[float]:
        """Return the values; NaN or infinity where one is not defined."""
        try:
            with np.errstate(all="ignore"):
                return [float(value) for value in self._written([np.float64(values[n]) for n in self._names])]
        except (ZeroDivisionError, OverflowError):  # of numbers in the expressions alone
            return [evaluate(expression, values) for expression in self._expressions]
