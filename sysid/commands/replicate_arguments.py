"""Arguments of ``sysid replicate``."""

import argparse
from pathlib import Path

FORMATS = ("html", "pdf", "json")
BACKENDS = ("loky", "threading", "dask")


def positive(text: str) -> int:
    """Parse a whole number of at least 1."""
    return _whole(text, 1)


def not_negative(text: str) -> int:
    """Parse a whole number of at least 0."""
    return _whole(text, 0)


def _whole(text: str, least: int) -> int:
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if value < least:
        raise argparse.ArgumentTypeError(f"{value} is too small, the least is {least}")
    return value


def formats(text: str) -> tuple[str, ...]:
    """Parse a comma-separated list of report formats."""
    chosen = tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    for name in chosen:
        if name not in FORMATS:
            raise argparse.ArgumentTypeError(f"{name!r} is not a format, choose from {', '.join(FORMATS)}")
    if not chosen:
        raise argparse.ArgumentTypeError(f"no format is named, choose from {', '.join(FORMATS)}")
    return chosen


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("papers", nargs="*", metavar="PAPER", help="papers by name; all when none is named")
    parser.add_argument("--runs", type=positive, help="runs of a case; each paper has its own default")
    parser.add_argument("--seed", type=not_negative, default=0, help="seed of all studies")
    parser.add_argument("--jobs", type=positive, default=2, help="workers")
    parser.add_argument("--backend", choices=BACKENDS, default="loky", help="how runs are distributed")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler, such as tcp://127.0.0.1:8786")
    parser.add_argument(
        "--out", type=Path, default=Path("sysid-out"), metavar="DIR", help="folder of all results"
    )
    parser.add_argument("--format", type=formats, default=FORMATS, help="reports to write: html, pdf, json")
    parser.add_argument("--smoke", action="store_true", help="few runs; every gate is still checked")
    parser.add_argument(
        "--with-records",
        action="store_true",
        help="also compute what needs real records (SYSID_DATA names their folder); takes minutes more",
    )
    parser.add_argument("--resume", action="store_true", help="go on from the finished runs in DIR")
    parser.add_argument("--dry-run", action="store_true", help="list what would be run, and stop")
    parser.add_argument("--case", help="case of --only-run, as the dry run lists it (every case when absent)")
    parser.add_argument(
        "--only-run",
        type=not_negative,
        metavar="I",
        help="repeat run I of --case in this process and print it",
    )
