"""Arguments of `sysid models`."""

import argparse


def add(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sysid models`."""
    parser.formatter_class = argparse.HelpFormatter
    parser.add_argument(
        "models",
        metavar="MODEL",
        nargs="*",
        help="name of a model or TOML file (default: all built-in models)",
    )
