"""Arguments of ``sysid demo``."""

import argparse
from pathlib import Path


def add(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``sysid demo``."""
    parser.formatter_class = argparse.HelpFormatter
    action = parser.add_mutually_exclusive_group()
    action.add_argument(
        "--out",
        type=Path,
        default=Path("sysid-demo"),
        metavar="DIR",
        help="folder for the record and its sealed truth (default: sysid-demo)",
    )
    action.add_argument(
        "--reveal", type=Path, metavar="DIR", help="tell what was hidden in the record in DIR"
    )
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="another number hides another effect (default: 1)"
    )
