"""Arguments of `sysid models`."""

import argparse


def add(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sysid models`."""
    parser.formatter_class = argparse.HelpFormatter
    parser.add_argument(
        "models",
        metavar="MODEL",
        nargs="*",
        help="name of a model, TOML file, or Python class as module:Class or file.py:Class (default: all "
        "that are installed)",
    )
