"""A comparison on the terminal: sentences, scores, parameters, and several side by side."""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sysid.diagnosis.wording import interval_text, percent, quantity, significant

if TYPE_CHECKING:
    from sysid.diagnosis.compared import Comparison

# Of a table that is written to a file or a pipe.
WIDTH = 100


def print_comparison(
    comparison: "Comparison", results: Mapping[str, Path | None], *, parameters: bool = False
) -> None:
    """Print sentences, scores and where the results are; parameters with their intervals if wished."""
    console = _console()
    for sentence in comparison.sentences():
        console.print(sentence, markup=False, soft_wrap=True)
    for warning in comparison.warnings:
        console.print(f"Note: {warning}", markup=False, soft_wrap=True)
    if parameters:
        console.print()
        console.print(_parameter_table(comparison))
    console.print()
    console.print(_score_table(comparison))
    console.print()
    for name, path in results.items():
        if path is not None:
            console.print(f"{name}: {path}", markup=False, soft_wrap=True)


def _parameter_table(comparison: "Comparison") -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("parameter")
    table.add_column("value", justify="right")
    table.add_column("95 % interval", justify="right")
    table.add_column("unit")
    for name, entry in comparison.model.parameters.items():
        interval = interval_text(entry.value, entry.std_error)
        table.add_row(escape(name), f"{entry.value:.4g}", interval, escape(entry.unit))
    return table


def print_side_by_side(comparisons: Sequence["Comparison"]) -> None:
    """Print the free-run errors of all models and outputs, row by row."""
    console = _console()
    table = Table(box=None, pad_edge=False)
    for heading in ("output", "model", "rows"):
        table.add_column(heading)
    for heading in ("RMSE", "NRMSE", "95 % interval"):
        table.add_column(heading, justify="right")
    for comparison in comparisons:
        entry = comparison.score_of(comparison.judged)
        low, high = entry.interval
        table.add_row(
            escape(comparison.record.outputs[0]),
            escape(comparison.model.title),
            escape(entry.name),
            escape(quantity(entry.free_run.rmse, entry.unit)),
            significant(entry.free_run.nrmse),
            f"{significant(low)} to {significant(high)}",
        )
    console.print("\nSide by side, free run:")
    console.print(table)


def _score_table(comparison: "Comparison") -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("rows")
    for heading in ("samples", "RMSE", "NRMSE", "95 % interval", "fit", "one-step RMSE"):
        table.add_column(heading, justify="right")
    for entry in comparison.scores:
        free, (low, high) = entry.free_run, entry.interval
        table.add_row(
            escape(entry.name),
            str(entry.n_rows),
            escape(quantity(free.rmse, entry.unit)),
            significant(free.nrmse),
            f"{significant(low)} to {significant(high)}",
            percent(free.fit / 100.0),
            escape(quantity(entry.one_step.rmse, entry.unit)),
        )
    return table


def _console() -> Console:
    return Console(file=sys.stdout, highlight=False, width=None if sys.stdout.isatty() else WIDTH)
