"""Arguments of ``sysid data``."""

import argparse
from pathlib import Path


def add(parser: argparse.ArgumentParser) -> None:
    """Add the actions and their arguments."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    actions.add_parser(
        "list",
        help="all registered records, and which are at hand",
        description="List the registered records, and which are at hand.",
        epilog="example: sysid data list",
    )
    info = actions.add_parser(
        "info",
        help="what is known of a record",
        description="Tell what is known of a record: citation, licence, units, split, published scores.",
        epilog="example: sysid data info emps",
    )
    info.add_argument("name", metavar="NAME", help="record, as the list names it")
    fetch = actions.add_parser(
        "fetch",
        help="copy or download a record and check it",
        description="Copy a record from a folder or a mirror, or download the original from its public "
        "address; its SHA-256 is checked where it is known.",
        epilog="example: sysid data fetch emps --from /media/records --to records",
    )
    fetch.add_argument("name", metavar="NAME", help="record, as the list names it")
    fetch.add_argument(
        "--from",
        dest="source",
        metavar="PLACE",
        help="folder or http(s) address with the layout of SYSID_DATA (default: SYSID_DATA, then the "
        "record's public address)",
    )
    fetch.add_argument(
        "--to",
        type=Path,
        metavar="DIR",
        help="folder to put it in (default: the user's cache, where records are found by name)",
    )
