"""Arguments of `sysid diagnose`."""

import argparse
from pathlib import Path

from sysid.commands.model_options import add_model_options
from sysid.commands.record_options import add_record_options


def add(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sysid diagnose`."""
    parser.formatter_class = argparse.HelpFormatter
    add_record_options(parser)
    add_model_options(parser)
    group = parser.add_argument_group("effects")
    group.add_argument("--effects", metavar="A,B,C", help="candidates (default: all of `sysid effects`)")
    group.add_argument("--effects-file", metavar="TOML", type=Path, help="file with effects of your own")
    group.add_argument("--add", metavar="NAME", action="append", help="add this effect whatever the evidence")
    group.add_argument(
        "--max-effects", metavar="K", type=int, default=3, help="most effects to be added (default: 3)"
    )
    group.add_argument(
        "--alpha",
        metavar="P",
        type=float,
        default=0.01,
        help="chance of naming an effect where none is missing (default: 0.01)",
    )
    group.add_argument(
        "--accept",
        choices=("auto", "ask", "none"),
        default="auto",
        help="add what was found, ask first, or only report it (default: auto)",
    )
    group.add_argument("--seed", metavar="S", type=int, default=0, help="seed (default: 0)")
    group.add_argument(
        "--jobs", metavar="J", type=int, default=1, help="most processors to use; the answer is the same"
    )
    group.add_argument(
        "--thorough",
        action="store_true",
        help="try all combinations of effects, however long the simulations take",
    )
    group = parser.add_argument_group("results")
    group.add_argument("--json", metavar="FILE", type=Path, help="numbers for other programs")
    group.add_argument("--predictions", metavar="FILE", type=Path, help="CSV: k, measured, baseline, final")
    group.add_argument("--html", metavar="FILE", type=Path, help="page")
    group.add_argument("--pdf", metavar="FILE", type=Path, help="page as PDF")
    group.add_argument("--save", metavar="FILE", type=Path, help="final model as JSON, TOML or .py function")
    group.add_argument(
        "--draft",
        metavar="FILE",
        type=Path,
        help="where no candidate explains: the curve that explains most, as an effect to edit (TOML)",
    )
