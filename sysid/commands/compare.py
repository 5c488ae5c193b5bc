"""The command `sysid compare`: a model beside the measurements it was not fitted to."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sysid.commands.comparison_tables import print_comparison, print_side_by_side
from sysid.commands.model_options import assigned_values, start_values
from sysid.commands.record_options import read_described
from sysid.errors import UsageError
from sysid.result_files import (
    DEFAULT_FOLDER,
    check_results,
    stem_of,
    to_json_text,
    write_result,
    write_text,
)

if TYPE_CHECKING:
    from sysid.diagnosis.compared import Comparison


def run(arguments: argparse.Namespace) -> int:
    """Run `sysid compare`; errors of use and of data are raised as `SysidError`."""
    from sysid.diagnosis.models.resolution import resolve_model
    from sysid.physics import Model

    cases = _cases(arguments)
    for number, case in enumerate(cases):  # before a long file is read
        start, fixed = start_values(case.param), assigned_values("--fix", case.fix)
        model = resolve_model(case.model, case.order, start, fixed)
        # A physical model with several outputs is fitted to them together.
        case.together = case.output
        if isinstance(model, Model) and len(model.outputs) > 1:
            case.together = arguments.output or case.output
        earlier = [path for other in cases[:number] for path in _results(other)]
        check_results([*earlier, *_results(case)], case.data)
    comparisons: list[Comparison] = []
    known: dict[tuple[str, str], Comparison] = {}
    for case in cases:
        if len(cases) > 1:
            print("\n" * bool(comparisons) + f"== {case.output[0]}, model {case.model}")
        place = (case.output[0], str(case.model))
        if place not in known:
            found = _compared(case)
            known |= {(name, str(case.model)): one for name, one in zip(case.together, found, strict=True)}
        _tell(known[place], case)
        comparisons.append(known[place])
    if len(cases) > 1:
        print_side_by_side(comparisons)
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
                case.order, case.param, case.fix, case.constant = None, None, None, "auto"
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


def _compared(arguments: argparse.Namespace) -> "tuple[Comparison, ...]":
    """Compare one model with the outputs that it is fitted to together."""
    from threadpoolctl import threadpool_limits

    from sysid.diagnosis.compare import compare_outputs
    from sysid.progress import percent_of, progress

    described = argparse.Namespace(**{**vars(arguments), "output": arguments.together})
    record = read_described(described, several=True)
    # All products are of one long row: a second thread would only wait, and take the time of others.
    with threadpool_limits(1), progress() as bars, bars.task(f"models of {record.name}", total=100) as bar:
        return compare_outputs(
            record,
            arguments.model,
            arguments.order,
            start=start_values(arguments.param),
            fixed=assigned_values("--fix", arguments.fix),
            initial_state=arguments.initial_state,
            constant={"auto": None, "yes": True, "no": False}[arguments.constant],
            progress=percent_of(bar),
        )


def _tell(comparison: "Comparison", arguments: argparse.Namespace) -> None:
    """Write and print what was found."""
    from threadpoolctl import threadpool_limits

    from sysid.progress import progress

    with threadpool_limits(1), progress() as bars, bars.task("page", total=None):
        text = comparison.to_html()
        document = comparison.to_pdf() if arguments.pdf is not None else b""
    write_text(arguments.html, text)
    if arguments.pdf is not None:
        write_result(arguments.pdf, document)
    if arguments.json is not None:
        write_text(arguments.json, to_json_text(comparison.to_json()))
    print_comparison(comparison, {"Page": arguments.html, "PDF": arguments.pdf, "JSON": arguments.json})
