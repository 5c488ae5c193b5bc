"""Arguments of `sysid compare`."""

import argparse
from pathlib import Path

from sysid.commands.model_options import add_model_options
from sysid.commands.record_options import add_record_options


def add(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sysid compare`."""
    parser.formatter_class = argparse.HelpFormatter  # the defaults worth telling are in the help texts
    add_record_options(parser)
    add_model_options(parser)
    parser.add_argument(
        "--constant",
        choices=("auto", "yes", "no"),
        default="auto",
        help="whether the linear model has a constant, or the sensor of a physical one a zero of its own "
        "(default: chosen on validation rows; none if experiments start at rest)",
    )
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
