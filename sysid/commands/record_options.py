"""The options that say what a measurement file holds, and the record they describe."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from sysid.errors import UsageError

if TYPE_CHECKING:
    from sysid.data import Record


def add_record_options(parser: argparse.ArgumentParser) -> None:
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


def read_described(arguments: argparse.Namespace, *, several: bool = False) -> "Record":
    """Read the record that the options describe, with one output unless it may have several."""
    from sysid.data import read_record

    if arguments.skip is not None and arguments.skip < 0:
        raise UsageError(f"--skip is {arguments.skip}: give 0 or more rows")
    outputs = tuple(arguments.output or ("y",))
    if len(outputs) > 1 and not several:
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
