"""The command ``sysid``: parse, call, print; everything heavy is imported by the command that needs it."""

import argparse
import sys
from collections.abc import Sequence
from typing import NoReturn

from sysid import __version__
from sysid.errors import SysidError

DONE, RED_GATE, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one sentence."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: error: {message}; see `{self.prog} --help`\n")


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    from sysid.commands import COMMANDS

    parser = _Parser(
        prog="sysid",
        description="Identify block-structured nonlinear systems: replicate the classic papers under gates, "
        "compare models with measurements.",
        epilog="example: sysid replicate bai --smoke",
    )
    parser.add_argument("--version", action="version", version=f"sysid {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=_Parser)
    for command in COMMANDS:
        child = commands.add_parser(
            command.name,
            help=command.summary,
            description=command.description,
            epilog=f"example: {command.example}",
            formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        )
        command.add_arguments(child)
        child.set_defaults(load=command.load)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Returns
    -------
    int
        0 done (and all gates green), 1 a gate red, 2 bad use or bad input, 130 interrupted.
    """
    arguments = build_parser().parse_args(argv)
    try:
        return int(arguments.load()(arguments))
    except SysidError as error:
        print(f"sysid {arguments.command}: error: {error}", file=sys.stderr)
        return BAD_INPUT
    except OSError as error:
        place = f" ({error.filename})" if error.filename else ""
        print(f"sysid {arguments.command}: error: {error.strerror or error}{place}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print(f"sysid {arguments.command}: interrupted; what was finished is kept", file=sys.stderr)
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
