"""The grammar of equations: a short list of what is allowed, everything else refused.

The text is parsed, never evaluated; what leaves here is a tree of numbers, known names and known
operations.
"""

import ast
import math
from collections.abc import Collection

from sysid.errors import ModelError
from sysid.physics.expressions import FUNCTIONS, Expression, Number, Operation, Symbol, operation

LONGEST_TEXT = 2000
DEEPEST_TREE = 60

_BINARY: dict[type[ast.operator], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Pow: "**",
}
_COMPARE: dict[type[ast.cmpop], str] = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="}


def parse(text: str, known: Collection[str]) -> Expression:
    """Return the tree of an expression.

    Parameters
    ----------
    text : str
        ``+ - * / **``, comparisons, and the functions abs, sign, sqrt, exp, log, sin, cos, tanh,
        min, max, where(condition, a, b).
    known : collection of str
        Names that may occur.

    Returns
    -------
    Number, Symbol or Operation

    Raises
    ------
    ModelError
        If anything else occurs in the text.

    Examples
    --------
    >>> parse("-k * x", {"k", "x"})
    Operation(name='*', arguments=(Operation(name='neg', arguments=(Symbol(name='k'),)), Symbol(name='x')))
    >>> parse("__import__('os')", {"x"})
    Traceback (most recent call last):
    sysid.errors.ModelError: function '__import__' is not known: choose one of abs, cos, exp, ...
    """
    if len(text) > LONGEST_TEXT:
        raise ModelError(
            f"the expression has {len(text)} characters: split it into terms below {LONGEST_TEXT}"
        )
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ModelError("it is not an expression: check brackets and operators") from None
    return _checked(tree, known, 0)


def _checked(node: ast.expr, known: Collection[str], depth: int) -> Expression:
    if depth > DEEPEST_TREE:
        raise ModelError(f"it is nested deeper than {DEEPEST_TREE} brackets: split it into terms")
    match node:
        case ast.Constant(value=value) if type(value) in (int, float):
            return _number(node)
        case ast.Name(id=name):
            if name not in known:
                raise ModelError(f"symbol {name!r} is not known: choose one of {', '.join(sorted(known))}")
            return Symbol(name)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return _finite("neg", _checked(operand, known, depth + 1))
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _checked(operand, known, depth + 1)
        case ast.BinOp(left=left, op=operator, right=right) if type(operator) in _BINARY:
            parts = _checked(left, known, depth + 1), _checked(right, known, depth + 1)
            return _finite(_BINARY[type(operator)], *parts)
        case ast.Compare(left=left, ops=[relation], comparators=[right]) if type(relation) in _COMPARE:
            parts = _checked(left, known, depth + 1), _checked(right, known, depth + 1)
            return _finite(_COMPARE[type(relation)], *parts)
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
            return _call(name, arguments, known, depth)
    raise ModelError(f"{ast.unparse(node)!r} is not allowed: use numbers, names, + - * / ** and functions")


def _number(node: ast.Constant) -> Number:
    try:
        value = float(node.value)  # type: ignore[arg-type]
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise ModelError("a number is too large: it must be finite")
    return Number(value)


def _call(name: str, arguments: list[ast.expr], known: Collection[str], depth: int) -> Expression:
    if name not in FUNCTIONS:
        raise ModelError(f"function {name!r} is not known: choose one of {', '.join(sorted(FUNCTIONS))}")
    if len(arguments) != FUNCTIONS[name]:
        raise ModelError(f"function {name!r} has {len(arguments)} arguments: it takes {FUNCTIONS[name]}")
    return _finite(name, *(_checked(argument, known, depth + 1) for argument in arguments))


def _finite(name: str, *arguments: Expression) -> Expression:
    """Return the operation; one of constants alone must have a value."""
    result = operation(name, *arguments)
    if isinstance(result, Operation) and all(isinstance(argument, Number) for argument in arguments):
        raise ModelError("a part made of numbers alone has no finite value: check it")
    return result
