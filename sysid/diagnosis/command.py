"""The command `sysid compare`."""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.errors import UsageError

if TYPE_CHECKING:
    from sysid.data import Record
    from sysid.diagnosis.compare import Comparison
    from sysid.progress import ProgressTask

HELP = "compare a model with measurements on held-out data"
DEFAULT_FOLDER = Path("sysid-out")


def add_data_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what the measurement file holds."""
    group = parser.add_argument_group("measurements")
    group.add_argument(
        "data",
        metavar="DATA",
        type=Path,
        help="CSV (.gz too), Parquet, MATLAB or npz file, or a record that `sysid data list` names",
    )
    group.add_argument(
        "--input",
        metavar="NAME",
        action="append",
        help="input column; again for each further one (default: u)",
    )
    group.add_argument("--output", metavar="NAME", default="y", help="output column (default: y)")
    group.add_argument("--period", metavar="SECONDS", type=float, help="sampling period")
    group.add_argument("--time", metavar="NAME", help="time column [s], instead of a period")
    group.add_argument(
        "--split-column", metavar="NAME", help="column with train or est, val, and names that begin with test"
    )
    group.add_argument(
        "--experiment-column", metavar="NAME", help="column whose value changes with the experiment"
    )
    group.add_argument("--skip", metavar="N", type=int, help="rows not scored at the start of each test set")
    group.add_argument(
        "--initial-state",
        choices=("estimate", "rest"),
        default="estimate",
        help="state at the start of each experiment (default: estimate)",
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sysid compare`."""
    parser.formatter_class = argparse.HelpFormatter  # the defaults worth telling are in the help texts
    add_data_arguments(parser)
    group = parser.add_argument_group("model")
    group.add_argument("--model", default="linear", help="model to compare (default: linear)")
    group.add_argument(
        "--order", metavar="N", type=int, help="order of the model (default: chosen from the data)"
    )
    group = parser.add_argument_group("results")
    group.add_argument(
        "--html", metavar="FILE", type=Path, help="page (default: sysid-out/<record>.compare.html)"
    )
    group.add_argument("--json", metavar="FILE", type=Path, help="numbers for other programs")


def read_data(arguments: argparse.Namespace) -> "Record":
    """Read the record that the options describe."""
    from sysid.data import read_record

    if arguments.skip is not None and arguments.skip < 0:
        raise UsageError(f"--skip is {arguments.skip}: give 0 or more rows")
    return read_record(
        arguments.data,
        inputs=tuple(arguments.input or ("u",)),
        outputs=(arguments.output,),
        period=arguments.period,
        time=arguments.time,
        split=arguments.split_column,
        experiment=arguments.experiment_column,
        skip=arguments.skip,
    )


def run(arguments: argparse.Namespace) -> int:
    """Run `sysid compare`; errors of use and of data are raised as `SysidError`."""
    from sysid.diagnosis.compare import MODELS, compare
    from sysid.progress import progress

    if arguments.model not in MODELS:
        raise UsageError(f"--model {arguments.model!r} is not known: choose one of {', '.join(MODELS)}")
    page = arguments.html or DEFAULT_FOLDER / f"{_stem(arguments.data)}.compare.html"
    _check_results((page, arguments.json), arguments.data)
    record = read_data(arguments)
    with progress() as bars:
        with bars.task(f"models of {record.name}", total=100) as bar:
            comparison = compare(
                record,
                arguments.model,
                arguments.order,
                initial_state=arguments.initial_state,
                progress=_percent_of(bar),
            )
        with bars.task("page", total=None):
            text = comparison.to_html()
    write_text(page, text)
    if arguments.json is not None:
        write_text(arguments.json, to_json_text(comparison.to_json()))
    _print(comparison, page, arguments.json)
    return 0


def _percent_of(bar: "ProgressTask") -> Callable[[int, int], None]:
    """Return a callback that moves a bar of 100 steps to the share that is done."""
    shown = 0

    def move(done: int, total: int) -> None:
        nonlocal shown
        now = 100 * done // max(total, 1)
        bar.advance(now - shown)
        shown = now

    return move


def to_json_text(content: dict[str, Any]) -> str:
    """Return strict JSON: no NaN."""
    import json

    return json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def write_text(path: Path, text: str) -> None:
    """Write a result, with its folder if need be."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as problem:
        raise UsageError(f"{path} cannot be written ({problem.strerror}): choose another place") from None


def _check_results(results: Sequence[Path | None], data: Path) -> None:
    """Refuse to write a result over the measurements or into a folder's name."""
    for path in results:
        if path is None:
            continue
        if path.resolve() == data.resolve():
            raise UsageError(f"{path} is the measurement file: write the result to another place")
        if path.is_dir():
            raise UsageError(f"{path} is a folder: give the name of a file in it")


def _stem(data: Path) -> str:
    return data.name.removesuffix(".gz").rsplit(".", 1)[0]


def _print(comparison: "Comparison", page: Path, numbers: Path | None) -> None:
    from rich.console import Console
    from rich.table import Table

    from sysid.diagnosis.wording import percent, quantity, significant

    console = Console(file=sys.stdout, highlight=False, width=None if sys.stdout.isatty() else 100)
    for sentence in comparison.sentences():
        console.print(sentence, markup=False, soft_wrap=True)
    for warning in comparison.warnings:
        console.print(f"Note: {warning}", markup=False, soft_wrap=True)
    table = Table(box=None, pad_edge=False)
    table.add_column("rows")
    for heading in ("samples", "RMSE", "NRMSE", "95 % interval", "fit", "one-step RMSE"):
        table.add_column(heading, justify="right")
    for entry in comparison.scores:
        free, (low, high) = entry.free_run, entry.interval
        table.add_row(
            entry.name,
            str(entry.n_rows),
            quantity(free.rmse, entry.unit),
            significant(free.nrmse),
            f"{significant(low)} to {significant(high)}",
            percent(free.fit / 100.0),
            quantity(entry.one_step.rmse, entry.unit),
        )
    console.print()
    console.print(table)
    console.print()
    console.print(f"Page: {page}", markup=False, soft_wrap=True)
    if numbers is not None:
        console.print(f"JSON: {numbers}", markup=False, soft_wrap=True)
