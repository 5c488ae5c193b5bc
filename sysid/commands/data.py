"""What ``sysid data`` does."""

import argparse
import json
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sysid.data.registry import Benchmark, benchmark, benchmarks, local_notes, local_table


def run(arguments: argparse.Namespace) -> int:
    """List, describe or fetch records; return 0."""
    console = Console(highlight=False)
    if arguments.action == "list":
        _list(console)
    elif arguments.action == "info":
        for line in _description(benchmark(arguments.name)):
            console.print(line, markup=False, soft_wrap=True)
    else:
        _fetch(console, arguments)
    return 0


def _list(console: Console) -> None:
    table = Table(box=None, pad_edge=False)
    for heading in ("name", "rows", "period", "at hand"):
        table.add_column(heading, justify="right" if heading in ("rows", "period") else "left", no_wrap=True)
    table.add_column("title")
    for name, record in benchmarks().items():
        rows = "" if record.rows is None else str(record.rows)
        period = "" if record.period is None else f"{record.period:.6g} s"
        table.add_row(name, rows, period, "yes" if local_table(name) else "no", escape(record.title))
    console.print(table)


def _description(record: Benchmark) -> list[str]:
    """Return the lines of ``info``."""
    place = local_table(record.name)
    facts = [
        ("title", record.title),
        ("citation", record.citation),
        ("licence", record.licence),
        ("page", record.page),
        ("effect", record.effect),
        ("split", record.split),
        ("period", "" if record.period is None else f"{record.period:.12g} s"),
        ("rows", "" if record.rows is None else str(record.rows)),
        *((f"unit of {column}", unit) for column, unit in record.units.items()),
        *((f"set {name}", f"{size} rows, {skip} skipped") for name, (size, skip) in record.sets.items()),
        ("SHA-256", f"{record.sha256} ({record.file})" if record.sha256 else ""),
        ("original", f"{record.address} ({record.original})" if record.address else ""),
        ("at hand", str(place) if place else f"no; `sysid data fetch {record.name}`"),
    ]
    lines = [record.name, *(f"  {word}: {text}" for word, text in facts if text)]
    for scores in record.published:
        lines.append(f"  published ({scores.unit}), {scores.source}:")
        lines += [f"    {method}: {_numbers(value)}" for method, value in scores.values.items()]
    told = {
        "name",
        "title",
        "file",
        "rows",
        "Ts",
        "units",
        "citation",
        "licence",
        "published",
        "sha256",
        "splits",
    }
    told |= {"effect_known_from_literature", "split_convention"}
    more = {key: value for key, value in local_notes(record.name).items() if key not in told}
    if more:
        lines.append("  from the notes beside the local copy:")
        lines += [f"    {key}: {_plain(value)}" for key, value in more.items()]
    return lines


def _numbers(value: Any) -> str:
    return ", ".join(f"{part:g}" for part in value) if isinstance(value, list) else f"{value:g}"


def _plain(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _fetch(console: Console, arguments: argparse.Namespace) -> None:
    from sysid.data.fetching import fetch
    from sysid.progress import progress

    with progress() as bars, bars.task(arguments.name, total=None):
        fetched = fetch(arguments.name, source=arguments.source, folder=arguments.to)
    checked = "as registered" if fetched.checked else "not registered: keep it to check later copies"
    console.print(f"{fetched.path}", markup=False, soft_wrap=True)
    console.print(f"SHA-256 {fetched.sha256}, {checked}", markup=False, soft_wrap=True)
    if fetched.remark:
        console.print(fetched.remark, markup=False, soft_wrap=True)
