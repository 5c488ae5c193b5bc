"""Numbers that remember how they were computed."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sysid.errors import ModelError
from sysid.physics.expressions import Expression, Number, Operation, Symbol, operation

UFUNCS: dict[Any, str] = {
    np.add: "+",
    np.subtract: "-",
    np.multiply: "*",
    np.divide: "/",
    np.power: "**",
    np.negative: "neg",
    np.absolute: "abs",
    np.sign: "sign",
    np.sqrt: "sqrt",
    np.exp: "exp",
    np.log: "log",
    np.sin: "sin",
    np.cos: "cos",
    np.tanh: "tanh",
    np.minimum: "min",
    np.maximum: "max",
    np.less: "<",
    np.less_equal: "<=",
    np.greater: ">",
    np.greater_equal: ">=",
}
# Longer chains would overflow the recursions over the tree, and the nesting of the generated source.
DEEPEST_TREE, LARGEST_TREE = 80, 800
USABLE = "abs, sign, sqrt, exp, log, sin, cos, tanh, minimum, maximum, where"


class Symbolic:
    """A state, input or parameter, or what was computed from them."""

    __array_priority__ = 1000

    def __init__(self, expression: Expression, depth: int = 0, size: int = 1) -> None:
        self.expression = expression
        self.depth, self.size = depth, size
        if size > LARGEST_TREE:
            raise ModelError(f"an equation has more than {LARGEST_TREE} operations: split it into states")
        if depth > DEEPEST_TREE:
            raise ModelError(f"an equation has more than {DEEPEST_TREE} steps in a row: split it into states")

    @classmethod
    def named(cls, name: str) -> "Symbolic":
        """Return a symbol."""
        return cls(Symbol(name))

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **keywords: Any) -> "Symbolic":
        if method != "__call__" or keywords or ufunc not in UFUNCS:
            if ufunc is np.square:
                return _operation("**", inputs[0], 2.0)
            raise ModelError(f"numpy.{ufunc.__name__} cannot stand in an equation: use {USABLE}")
        return _operation(UFUNCS[ufunc], *inputs)

    def __array_function__(self, function: Any, types: Any, inputs: Any, keywords: Any) -> "Symbolic":
        if function is np.where and len(inputs) == 3 and not keywords:
            return _operation("where", *inputs)
        raise ModelError(f"numpy.{function.__name__} cannot stand in an equation: use {USABLE}")

    def __bool__(self) -> bool:
        raise ModelError("a choice depends on a state, an input or a parameter: write numpy.where, not if")

    def __float__(self) -> float:
        raise ModelError(f"a symbol is no number: use functions of numpy ({USABLE}), not of math")

    def __pos__(self) -> "Symbolic":
        return self

    def __neg__(self) -> "Symbolic":
        return _operation("neg", self)

    def __abs__(self) -> "Symbolic":
        return _operation("abs", self)

    def __repr__(self) -> str:
        from sysid.physics.expressions import text

        return text(self.expression)


def _operation(name: str, *parts: Any) -> Symbolic:
    found = [expression_of(part) for part in parts]
    for part, expression in zip(parts, found, strict=True):
        if expression is None:
            raise ModelError(f"{part!r} cannot stand in an equation: use numbers and expressions of x, u, p")
    result = operation(name, *(expression for expression in found if expression is not None))
    if isinstance(result, Operation) and all(isinstance(part, Number) for part in result.arguments):
        raise ModelError("a part made of numbers alone has no finite value: check it")
    symbolic = [part for part in parts if isinstance(part, Symbolic)]
    depth = 1 + max((part.depth for part in symbolic), default=0)
    return Symbolic(result, depth, 1 + sum(part.size for part in symbolic))


def expression_of(value: Any) -> Expression | None:
    """Return the expression of a symbolic or plain number; None if it is neither."""
    if isinstance(value, Symbolic):
        return value.expression
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    if isinstance(value, bool | int | float | np.integer | np.floating | np.bool_) and np.isfinite(value):
        return Number(float(value))
    return None


def _binary(name: str, *, swapped: bool) -> Callable[[Symbolic, Any], Symbolic]:
    def method(self: Symbolic, other: Any) -> Symbolic:
        return _operation(name, other, self) if swapped else _operation(name, self, other)

    return method


for _sign, _method in {"+": "add", "-": "sub", "*": "mul", "/": "truediv", "**": "pow"}.items():
    setattr(Symbolic, f"__{_method}__", _binary(_sign, swapped=False))
    setattr(Symbolic, f"__r{_method}__", _binary(_sign, swapped=True))
for _sign, _method in {"<": "lt", "<=": "le", ">": "gt", ">=": "ge"}.items():
    setattr(Symbolic, f"__{_method}__", _binary(_sign, swapped=False))
