"""The command `sysid compare`."""

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.errors import UsageError

if TYPE_CHECKING:
    from rich.table import Table

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
    group.add_argument("--output", metavar="NAME", action="append", help="output column (default: y)")
    group.add_argument("--period", metavar="SECONDS", type=float, help="sampling period")
    group.add_argument("--time", metavar="NAME", help="time column [s], instead of a period")
    group.add_argument("--resample", metavar="SECONDS", type=float, help="bring the rows to this period")
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


def add_model_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that say which model is fitted, and what is known of it."""
    group = parser.add_argument_group("model")
    group.add_argument(
        "--model",
        metavar="linear|NAME|FILE.toml|MODULE:CLASS",
        default="linear",
        help="linear (default), state-space, hammerstein-<map> (as hammerstein-saturation), local-linear (or "
        "local-linear-3 for three of them), wiener-hammerstein, a physical model that `sysid models` lists, "
        "or one of your own",
    )
    group.add_argument(
        "--order", metavar="N", type=int, help="order of the linear model (default: chosen from the data)"
    )
    group.add_argument(
        "--param",
        metavar="NAME=VALUE[+-STD]",
        action="append",
        help="value of a parameter known within some 20 %%, from which its search starts; with STD, a "
        "standard deviation, a Gaussian prior that weighs in the fit",
    )
    group.add_argument("--fix", metavar="NAME=VALUE", action="append", help="known value of a parameter")


def assigned_values(option: str, texts: Sequence[str] | None) -> dict[str, float]:
    """Return the numbers that NAME=VALUE texts give.

    Examples
    --------
    >>> assigned_values("--fix", ["R=1.2", "L=1e-3"])
    {'R': 1.2, 'L': 0.001}
    """
    values: dict[str, float] = {}
    for text in texts or ():
        name, sign, number = (part.strip() for part in text.partition("="))
        if not (name and sign):
            raise UsageError(f"{option} {text!r} has no value: write {option} NAME=VALUE")
        if name in values:
            raise UsageError(f"{option} gives {name!r} twice: give it once")
        try:
            values[name] = float(number)
        except ValueError:
            raise UsageError(f"{option} {text!r}: {number!r} is no number") from None
        if not isfinite(values[name]):
            raise UsageError(f"{option} {text!r}: {number!r} is not finite: give a number")
    return values


def start_values(texts: Sequence[str] | None) -> dict[str, float | tuple[float, float]]:
    """Return the start values that NAME=VALUE texts give; with a standard deviation behind +- or ±, pairs.

    Examples
    --------
    >>> start_values(["R=1.2+-0.1", "L=1e-3"])
    {'R': (1.2, 0.1), 'L': 0.001}
    """
    parts = [text.replace("±", "+-").partition("+-") for text in texts or ()]
    values = assigned_values("--param", [head for head, _, _ in parts])
    spreads = assigned_values(
        "--param", [f"{head.partition('=')[0]}={spread}" for head, sign, spread in parts if sign]
    )
    return {n: (value, spreads[n]) if n in spreads else value for n, value in values.items()}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sysid compare`."""
    parser.formatter_class = argparse.HelpFormatter  # the defaults worth telling are in the help texts
    add_data_arguments(parser)
    add_model_arguments(parser)
    parser.add_argument(
        "--also",
        metavar="MODEL",
        action="append",
        help="a further model, compared on the same rows; again for each further one",
    )
    group = parser.add_argument_group(
        "results", "With several outputs or models each has files of its own, its name before the suffix."
    )
    group.add_argument(
        "--html", metavar="FILE", type=Path, help="page (default: sysid-out/<record>.compare.html)"
    )
    group.add_argument("--pdf", metavar="FILE", type=Path, help="the same content as a PDF")
    group.add_argument("--json", metavar="FILE", type=Path, help="numbers for other programs")


def read_data(arguments: argparse.Namespace) -> "Record":
    """Read the record that the options describe."""
    from sysid.data import read_record

    if arguments.skip is not None and arguments.skip < 0:
        raise UsageError(f"--skip is {arguments.skip}: give 0 or more rows")
    outputs = tuple(arguments.output or ("y",))
    if len(outputs) > 1:
        raise UsageError(f"--output is given {len(outputs)} times ({', '.join(outputs)}): take one at a time")
    return read_record(
        arguments.data,
        inputs=tuple(arguments.input or ("u",)),
        outputs=outputs,
        period=arguments.period,
        time=arguments.time,
        split=arguments.split_column,
        experiment=arguments.experiment_column,
        skip=arguments.skip,
        resample=arguments.resample,
    )


def run(arguments: argparse.Namespace) -> int:
    """Run `sysid compare`; errors of use and of data are raised as `SysidError`."""
    from sysid.diagnosis.models import resolve_model

    cases = _cases(arguments)
    for number, case in enumerate(cases):  # before a long file is read
        start, fixed = start_values(case.param), assigned_values("--fix", case.fix)
        resolve_model(case.model, case.order, start, fixed)
        earlier = [path for other in cases[:number] for path in _results(other)]
        check_results([*earlier, *_results(case)], case.data)
    comparisons: list[Comparison] = []
    for case in cases:
        if len(cases) > 1:
            print("\n" * bool(comparisons) + f"== {case.output[0]}, model {case.model}")
        comparisons.append(_run_one(case))
    if len(cases) > 1:
        _print_side_by_side(comparisons)
    return 0


def _cases(arguments: argparse.Namespace) -> list[argparse.Namespace]:
    """Return the arguments of each output and model, their results in files of their own."""
    outputs, models = arguments.output or ["y"], [arguments.model, *(arguments.also or [])]
    for option, names in (("--output", outputs), ("a model", models)):
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise UsageError(f"{option} is given {twice[0]!r} twice: give it once")
    page = arguments.html or DEFAULT_FOLDER / f"{stem_of(arguments.data)}.compare.html"
    cases = []
    for output in outputs:
        for number, model in enumerate(models):
            names = [output] * (len(outputs) > 1) + [str(model)] * (len(models) > 1)
            case = argparse.Namespace(**vars(arguments))
            case.output, case.model = [output], model
            if number > 0:  # what is known of the first model is not of the others
                case.order, case.param, case.fix = None, None, None
            case.html = _named(page, names)
            case.pdf, case.json = (path and _named(path, names) for path in (arguments.pdf, arguments.json))
            cases.append(case)
    return cases


def _named(path: Path, names: Sequence[str]) -> Path:
    """Return a path with names before its suffix.

    Examples
    --------
    >>> _named(Path("page.html"), ["speed", "plant.toml"]).name
    'page.speed.plant.toml.html'
    """
    plain = ["".join(sign if sign.isalnum() or sign in "-_." else "_" for sign in name) for name in names]
    return path.with_name(".".join([path.stem, *plain]) + path.suffix) if names else path


def _results(case: argparse.Namespace) -> list[Path]:
    return [path for path in (case.html, case.pdf, case.json) if path is not None]


def _run_one(arguments: argparse.Namespace) -> "Comparison":
    """Compare one model with one output, and write and print what was found."""
    from threadpoolctl import threadpool_limits

    from sysid.diagnosis.compare import compare
    from sysid.progress import progress

    record = read_data(arguments)
    # All products are of one long row: a second thread would only wait, and take the time of others.
    with threadpool_limits(1), progress() as bars:
        with bars.task(f"models of {record.name}", total=100) as bar:
            comparison = compare(
                record,
                arguments.model,
                arguments.order,
                start=start_values(arguments.param),
                fixed=assigned_values("--fix", arguments.fix),
                initial_state=arguments.initial_state,
                progress=percent_of(bar),
            )
        with bars.task("page", total=None):
            text = comparison.to_html()
            document = comparison.to_pdf() if arguments.pdf is not None else b""
    write_text(arguments.html, text)
    if arguments.pdf is not None:
        write_result(arguments.pdf, document)
    if arguments.json is not None:
        write_text(arguments.json, to_json_text(comparison.to_json()))
    print_comparison(comparison, {"Page": arguments.html, "PDF": arguments.pdf, "JSON": arguments.json})
    return comparison


def _print_side_by_side(comparisons: Sequence["Comparison"]) -> None:
    """Print the free-run errors of all models and outputs, row by row."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from sysid.diagnosis.wording import quantity, significant

    console = Console(file=sys.stdout, highlight=False, width=None if sys.stdout.isatty() else 100)
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


def percent_of(bar: "ProgressTask") -> Callable[[int, int], None]:
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
    """Write a text, with its folder if need be."""
    write_result(path, text.encode("utf-8", errors="backslashreplace"))  # a name may be no Unicode


def write_result(path: Path, content: bytes) -> None:
    """Write a result, with its folder if need be."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    except OSError as problem:
        raise _unwritable(path, problem.strerror) from None


def check_results(results: Sequence[Path], data: Path) -> None:
    """Refuse to write over the measurements, their notes or another result, or where nothing can be."""
    for index, path in enumerate(results):
        try:
            if path.resolve() == data.resolve():
                raise UsageError(f"{path} is the measurement file: write the result to another place")
            if path.is_dir():
                raise UsageError(f"{path} is a folder: give the name of a file in it")
            if _is_notes(path, data):
                raise UsageError(f"{path} holds notes on the measurements: write the result to another place")
            if path.resolve() in [other.resolve() for other in results[:index]]:
                raise UsageError(f"{path} is named for two results: give each a file of its own")
            folder = next(place for place in path.absolute().parents if place.exists())
        except OSError as problem:
            raise _unwritable(path, problem.strerror) from None
        if not (folder.is_dir() and os.access(folder, os.W_OK)):
            raise _unwritable(path, f"{folder} is {'a file' if folder.is_file() else 'not to be written in'}")


def _unwritable(path: Path, reason: str | None) -> UsageError:
    return UsageError(f"{path} cannot be written ({reason}): choose another place")


def _is_notes(path: Path, data: Path) -> bool:
    """Tell whether a file stands where notes are read and is not an earlier result."""
    import json

    from sysid.data.notes import notes_path

    if path.resolve() != notes_path(data).resolve() or not path.exists():
        return False
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError):
        return True
    return not (isinstance(content, dict) and {"schema", "model", "scores"} <= content.keys())


def stem_of(data: Path) -> str:
    """Return the name of a record without the ending of its file."""
    return data.name.removesuffix(".gz").rsplit(".", 1)[0]


def print_comparison(
    comparison: "Comparison", results: Mapping[str, Path | None], *, parameters: bool = False
) -> None:
    """Print sentences, scores and where the results are; parameters with their intervals if wished."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from sysid.diagnosis.wording import percent, quantity, significant

    console = Console(file=sys.stdout, highlight=False, width=None if sys.stdout.isatty() else 100)
    for sentence in comparison.sentences():
        console.print(sentence, markup=False, soft_wrap=True)
    for warning in comparison.warnings:
        console.print(f"Note: {warning}", markup=False, soft_wrap=True)
    if parameters:
        console.print()
        console.print(_parameter_table(comparison))
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
    console.print()
    console.print(table)
    console.print()
    for name, path in results.items():
        if path is not None:
            console.print(f"{name}: {path}", markup=False, soft_wrap=True)


def _parameter_table(comparison: "Comparison") -> "Table":
    from rich.markup import escape
    from rich.table import Table

    from sysid.diagnosis.content import interval_text

    table = Table(box=None, pad_edge=False)
    table.add_column("parameter")
    table.add_column("value", justify="right")
    table.add_column("95 % interval", justify="right")
    table.add_column("unit")
    for name, entry in comparison.model.parameters.items():
        interval = interval_text(entry.value, entry.std_error)
        table.add_row(escape(name), f"{entry.value:.4g}", interval, escape(entry.unit))
    return table
