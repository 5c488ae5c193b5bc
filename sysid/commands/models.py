"""The command `sysid models`: equations and parameters of physical models."""

import argparse
import math
import sys
from typing import TYPE_CHECKING

from sysid.physics.model import Model, Parameter
from sysid.physics.reading import all_model_names, load_model

if TYPE_CHECKING:
    from rich.table import Table


# What `sysid compare` fits besides; their orders are chosen from the record.
BLACK_BOXES = {
    "linear": "A(q) y = B(q) u + constant",
    "state-space": "x(k+1) = A x(k) + B u(k), y(k) = C x(k) + D u(k) + offset",
    "hammerstein-<map>": "A(q) y = B(q) N(u) + constant, N a saturation, dead-zone, preload, relay, ...",
    "hammerstein": "A(q) y = B(q) f(u) + constant, f a map of free form",
    "wiener": "y = f(w), A(q) w = B(q) u, f a map of free form",
    "wiener-hammerstein": "y = G2(q) f(G1(q) u), f a spline",
    "lft": "A(q) y = B(q) u + G(q) f(z) + e, f a spline of lagged inputs and outputs z",
    "piecewise-affine": "A(q) y = B(q) u + G(q) f(z) + e, f affine in each of several regions",
    "local-linear": "x(k+1) = sum of p_i(u(k)) (A_i x(k) + B_i u(k) + O_i), y(k) = C x(k)",
}


def run(arguments: argparse.Namespace) -> int:
    """Print the models asked for."""
    from rich.console import Console

    models = [load_model(name) for name in arguments.models or all_model_names()]
    console = Console(file=sys.stdout, highlight=False, width=None if sys.stdout.isatty() else 120)
    for model in models:
        console.print(f"{model.name}: {model.title}", style="bold", markup=False, soft_wrap=True)
        for line in str(model).splitlines():
            console.print(f"    {line}", markup=False, soft_wrap=True)
        console.print(_variables(model))
        console.print(_parameters(model))
        console.print()
    if not arguments.models:
        for name, equation in BLACK_BOXES.items():
            console.print(f"{name}: {equation}", markup=False, soft_wrap=True)
    return 0


def _variables(model: Model) -> "Table":
    table = _table(("", "unit", "what it is"))
    for kind, variables in (("state", model.states), ("input", model.inputs)):
        for variable in variables:
            table.add_row(f"{kind} {variable.name}", variable.unit, variable.meaning)
    for output in model.outputs:
        table.add_row(
            f"output {output.name}", output.unit, output.meaning or ", ".join(t.name for t in output.terms)
        )
    return table


def _parameters(model: Model) -> "Table":
    table = _table(("parameter", "unit", "start", "range", "status", "what it is"))
    for p in model.parameters:
        table.add_row(p.name, p.unit, _start(p), _range(p), p.status, p.meaning)
    return table


def _table(headings: tuple[str, ...]) -> "Table":
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 4))
    for heading in headings:
        table.add_column(heading)
    return table


def _start(parameter: Parameter) -> str:
    prior = parameter.prior
    return f"{parameter.start:g}" if prior is None else f"{prior.mean:g} ± {prior.std:g}"


def _range(parameter: Parameter) -> str:
    low, high = parameter.minimum, parameter.maximum
    if math.isinf(low) and math.isinf(high):
        return "any"
    if low == 0.0 and math.isinf(high):
        return "positive"
    return f"{low:g} to {high:g}"
