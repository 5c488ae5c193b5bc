"""The command ``sysid``: parse, call, print; everything heavy is imported by the command that needs it."""

import argparse
import io
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from sysid import __version__
from sysid.errors import SysidError

BAD_INPUT, INTERRUPTED, READER_LEFT = 2, 130, 141


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one sentence, and which takes no abbreviation for an option."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        # "--out" must not be taken for "--output", which is something else.
        super().__init__(*args, **kwargs | {"allow_abbrev": False})

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse the arguments; the command itself says which of its options it does not know."""
        found, unknown = self.parse_known_args(args, namespace)
        if unknown:
            command = getattr(found, "parser", self)
            command.error(_unknown_words(unknown, command))
        return found

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
        child.set_defaults(load=command.load, parser=child)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Returns
    -------
    int
        0 done (and all gates green), 1 a gate red, 2 bad use or bad input, 130 interrupted, 141 the
        reader of the output left.
    """
    _prepare_streams()
    arguments = build_parser().parse_args(argv)
    try:
        code = int(arguments.load()(arguments))
        sys.stdout.flush()
        return code
    except SysidError as error:
        print(f"sysid {arguments.command}: error: {error}", file=sys.stderr)
        return BAD_INPUT
    except SystemExit as stop:
        # What rich makes of a broken pipe would look like a red gate.
        if isinstance(stop.__context__, BrokenPipeError):
            return READER_LEFT
        raise
    except BrokenPipeError:
        # The reader of our output left, as `head` does; nobody is there to be told.
        _drop_output()
        return READER_LEFT
    except OSError as error:
        _drop_output()
        place = f" ({error.filename})" if error.filename else ""
        print(f"sysid {arguments.command}: error: {error.strerror or error}{place}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        kept = "; the finished runs are kept, --resume goes on" if "resume" in arguments else ""
        print(f"sysid {arguments.command}: interrupted{kept}", file=sys.stderr)
        return INTERRUPTED


def _unknown_words(unknown: list[str], parser: argparse.ArgumentParser) -> str:
    """Name what is not known, and the options it may stand for."""
    first = unknown[0].partition("=")[0]
    options = [flag for action in parser._actions for flag in action.option_strings]
    near = [flag for flag in options if first.startswith("--") and flag.startswith(first)]
    if not near and first.startswith("--"):
        from difflib import get_close_matches

        near = get_close_matches(first, options, n=2)
    words = f"unrecognized arguments: {' '.join(unknown)}"
    return f"{words} (did you mean {' or '.join(near)}?)" if near else words


def _prepare_streams() -> None:
    """Let output be written whatever the terminal: closed, or without the letters of a name."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _drop_output() -> None:
    """Forget what could not be written, so that the interpreter does not try again at its end."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    sys.exit(main())
