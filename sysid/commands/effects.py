"""The command `sysid effects`: what a model may lack, listed and explained."""

import argparse
import sys
from typing import TYPE_CHECKING

from sysid.diagnosis.effects.base import Effect, EffectParameter
from sysid.diagnosis.effects.catalogue import catalogue, checked, find_effects, read_effects

if TYPE_CHECKING:
    from rich.console import Console

UNITS = "[u], [y], [F], [x] and [v] stand for the units of input, output, force, position and speed."


def run(arguments: argparse.Namespace) -> int:
    """Print the list of effects, or explain those that are named."""
    if arguments.template is not None:
        from sysid.diagnosis.effects.templates import template

        print(template(arguments.template), end="")
        return 0
    from rich.console import Console

    console = Console(file=sys.stdout, highlight=False, width=None if sys.stdout.isatty() else 120)
    known = catalogue()
    if arguments.file is not None:
        known = checked([*known, *read_effects(arguments.file)])
    if arguments.effects:
        for effect in find_effects(arguments.effects, known):
            _explain(console, effect)
        console.print(UNITS, markup=False, soft_wrap=True)
        return 0
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading in ("effect", "port", "models", "mechanism"):
        table.add_column(heading)
    for effect in known:
        table.add_row(effect.name, effect.port, ", ".join(effect.families), effect.mechanism)
    console.print(table)
    return 0


def _explain(console: "Console", effect: Effect) -> None:
    console.print(effect.name, style="bold", markup=False)
    lines = {
        "mechanism": effect.mechanism,
        "equation": effect.equation,
        "port": effect.port,
        "models": ", ".join(effect.families),
        "signature": effect.signature,
        "look-alikes": effect.look_alikes,
        "reference": effect.reference,
    }
    for title, text in lines.items():
        console.print(f"    {title:12s} {text}", markup=False, soft_wrap=True)
    for form in effect.forms:
        console.print(f"    form         {form.name}", markup=False)
        for parameter in form.parameters:
            unit = f" in {parameter.unit}" if parameter.unit != "1" else ""
            kind = "strength" if parameter.is_strength else _grid(parameter)
            console.print(
                f"                 {parameter.name}{unit}: {parameter.meaning} ({kind})",
                markup=False,
                soft_wrap=True,
            )
    console.print()


def _grid(parameter: EffectParameter) -> str:
    assert parameter.grid is not None
    points = parameter.grid.points
    scale = parameter.grid.scale
    by = {"plain": "", "input swing quantile": " x the input's swing", "output count": " x output deviation"}
    return f"tried from {points[0]:.3g} to {points[-1]:.3g}{by.get(scale, f' x {scale}')}"
