"""Arguments of `sysid effects`."""

import argparse
from pathlib import Path


def add(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sysid effects`."""
    parser.formatter_class = argparse.HelpFormatter
    parser.add_argument(
        "effects", metavar="NAME", nargs="*", help="effect to explain (default: list all effects)"
    )
    parser.add_argument("--file", metavar="TOML", type=Path, help="file with effects of your own")
    parser.add_argument(
        "--template",
        choices=("input", "output", "force", "gain"),
        help="print a TOML file with an effect at this port, to be edited and given with --effects-file",
    )
