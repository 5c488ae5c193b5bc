"""The command `sysid fit`: a block-structured model of a measured record."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.commands.comparison_tables import print_comparison
from sysid.commands.fit_arguments import destination, structure_options
from sysid.commands.fit_structures import find_structure
from sysid.commands.record_options import read_described
from sysid.result_files import (
    DEFAULT_FOLDER,
    check_results,
    stem_of,
    to_csv_text,
    to_json_text,
    write_result,
    write_text,
)

if TYPE_CHECKING:
    from sysid.diagnosis.comparison.judgement import Judgement


def run(arguments: argparse.Namespace) -> int:
    """Run `sysid fit`; errors of use and of data are raised as `SysidError`."""
    from threadpoolctl import threadpool_limits

    from sysid.diagnosis.compared import Comparison
    from sysid.diagnosis.comparison.judge import FITTING_SHARE, judge
    from sysid.progress import part_of, percent_of, progress

    structure = find_structure(arguments.structure)
    options = structure.read_options(_given(arguments))  # before a long file is read
    page = arguments.html or DEFAULT_FOLDER / f"{stem_of(arguments.data)}.fit.html"
    results: dict[str, Path | None] = {
        "Page": page,
        "PDF": arguments.pdf,
        "JSON": arguments.json,
        "Model": arguments.save,
        "Predictions": arguments.predictions,
    }
    check_results([path for path in results.values() if path is not None], arguments.data)
    record = read_described(arguments)
    # All products are of one long row: a second thread would only wait, and take the time of others.
    with threadpool_limits(1), progress() as bars:
        with bars.task(f"{structure.name} model of {record.name}", total=100) as bar:
            advance = percent_of(bar)
            model = structure.load()(
                record,
                options,
                initial_state=arguments.initial_state,
                progress=part_of(advance, 0, FITTING_SHARE),
            )
            comparison = Comparison.of(judge(record, model, ports=False, progress=advance))
        with bars.task("page", total=None):
            write_text(page, comparison.to_html())
            if arguments.pdf is not None:
                write_result(arguments.pdf, comparison.to_pdf())
    if arguments.json is not None:
        write_text(arguments.json, to_json_text(comparison.to_json()))
    if arguments.save is not None:
        write_text(arguments.save, to_json_text(model.saved()))
    if arguments.predictions is not None:
        write_text(arguments.predictions, _predictions(comparison))
    print_comparison(comparison, results, parameters=True)
    return 0


def _given(arguments: argparse.Namespace) -> dict[str, Any]:
    values = {option.flag: getattr(arguments, destination(option.flag)) for option in structure_options()}
    return {flag: text for flag, text in values.items() if text is not None}


def _predictions(comparison: "Judgement") -> str:
    """Return a CSV with one row for each row of the file, in its order."""
    record, prediction = comparison.record, comparison.prediction
    columns = {
        "measured": record.y[:, 0].tolist(),
        "one_step": prediction.one_step.tolist(),
        "free_run": prediction.free_run.tolist(),
    }
    return to_csv_text(columns, record.left_out)
