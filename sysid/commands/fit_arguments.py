"""Arguments of `sysid fit`."""

import argparse
from pathlib import Path

from sysid.commands.fit_structures import STRUCTURES, Option
from sysid.commands.record_options import add_record_options


def add(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sysid fit`; those of several structures stand once."""
    parser.formatter_class = argparse.HelpFormatter  # the defaults worth telling are in the help texts
    add_record_options(parser)
    group = parser.add_argument_group("structure")
    group.add_argument(
        "--structure",
        metavar="NAME",
        default=STRUCTURES[0].name,
        help="; ".join(f"{s.name}: {s.summary}" for s in STRUCTURES) + f" (default: {STRUCTURES[0].name})",
    )
    for option in structure_options():
        group.add_argument(
            option.flag,
            dest=destination(option.flag),
            metavar=option.metavar,
            help=option.help + _owners(option),
        )
    group = parser.add_argument_group("results")
    group.add_argument(
        "--html", metavar="FILE", type=Path, help="page (default: sysid-out/<record>.fit.html)"
    )
    group.add_argument("--pdf", metavar="FILE", type=Path, help="the same content as a PDF")
    group.add_argument("--json", metavar="FILE", type=Path, help="numbers for other programs")
    group.add_argument(
        "--save", metavar="FILE", type=Path, help="model as JSON, read again by sysid.lft.load"
    )
    group.add_argument(
        "--predictions", metavar="FILE", type=Path, help="CSV: k, measured, one_step, free_run"
    )


def structure_options() -> tuple[Option, ...]:
    """Return the options of all structures, each flag once."""
    return tuple({option.flag: option for s in STRUCTURES for option in s.options}.values())


def _owners(option: Option) -> str:
    """Say which structures an option belongs to, unless it is all of them."""
    owners = [s.name for s in STRUCTURES if option.flag in [own.flag for own in s.options]]
    return "" if len(owners) == len(STRUCTURES) else f" [{', '.join(owners)}]"


def destination(flag: str) -> str:
    """Return the attribute under which argparse keeps an option of a structure."""
    return "structure_" + flag.removeprefix("--").replace("-", "_")
