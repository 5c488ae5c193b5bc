"""Public benchmark records: what is known of each, and where a local copy is."""

import json
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from sysid.errors import DataError, UsageError

FOLDER_VARIABLE = "SYSID_DATA"
SPLIT_COLUMN, EXPERIMENT_COLUMN = "split", "experiment"
SUFFIXES = (".csv", ".csv.gz")


@dataclass(frozen=True)
class PublishedScores:
    """Scores others have published: values by method, their unit and source."""

    source: str
    unit: str
    values: Mapping[str, float | list[float]]


@dataclass(frozen=True)
class Benchmark:
    """What is known of a public record; empty where nothing is known for sure.

    Attributes
    ----------
    name, title, citation, licence : str
    page : str
        Where it is described.
    effect : str
        What the literature says is not linear in it.
    split : str
        Convention of the split.
    period : float or None
        Sampling period [s].
    rows : int or None
    file, sha256 : str
        Table of a local copy and its hash.
    address, original : str
        Where the original file is, and what is in it.
    units : mapping of str to str
    sets : mapping of str to (int, int)
        Rows of each set, and how many of them are not scored.
    published : tuple of PublishedScores
    """

    name: str
    title: str
    citation: str
    licence: str = ""
    page: str = ""
    effect: str = ""
    split: str = ""
    period: float | None = None
    rows: int | None = None
    file: str = ""
    sha256: str = ""
    address: str = ""
    original: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    sets: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    published: tuple[PublishedScores, ...] = ()

    def notes(self) -> dict[str, Any]:
        """Return what stands in the JSON beside a table."""
        return {
            "name": self.name,
            "title": self.title,
            "file": self.file,
            "rows": self.rows,
            "Ts": self.period,
            "units": dict(self.units),
            "citation": self.citation,
            "licence": self.licence,
            "sha256": self.sha256,
            "splits": {name: {"rows": rows, "skip": skip} for name, (rows, skip) in self.sets.items()},
            "split_convention": self.split,
        }


@cache
def benchmarks() -> Mapping[str, Benchmark]:
    """Return all registered records by name.

    Examples
    --------
    >>> benchmarks()["emps"].period
    0.001
    """
    content = tomllib.loads(files("sysid.data").joinpath("registry.toml").read_text(encoding="utf-8"))
    return {name: _benchmark(name, dict(entry)) for name, entry in sorted(content.items())}


def _benchmark(name: str, entry: dict[str, Any]) -> Benchmark:
    sets = {label: (window["rows"], window["skip"]) for label, window in entry.pop("sets", {}).items()}
    published = tuple(
        PublishedScores(scores["source"], scores["unit"], scores["scores"])
        for scores in entry.pop("published", [])
    )
    return Benchmark(name=name, sets=sets, published=published, **entry)


def benchmark(name: str) -> Benchmark:
    """Return a registered record.

    Raises
    ------
    UsageError
        If there is none of this name.
    """
    known = benchmarks()
    if name not in known:
        near = get_close_matches(name, known, n=1, cutoff=0.5)
        guess = f"; did you mean {near[0]!r}?" if near else ":"
        raise UsageError(f"no record is registered as {name!r}{guess} registered are {', '.join(known)}")
    return known[name]


def cache_folder() -> Path:
    """Return the folder in which fetched records are found by name."""
    import pooch

    return Path(pooch.os_cache("sysid")) / "data"


def local_table(name: str) -> Path | None:
    """Return the table of the local copy of a record, if there is one.

    Looked for in the folder that ``SYSID_DATA`` names, then in the user's cache.
    """
    named = os.environ.get(FOLDER_VARIABLE)
    folders = [Path(named)] if named else []
    for folder in (*folders, cache_folder()):
        if (found := table_in(folder, name)) is not None:
            return found
    return None


def table_in(folder: Path, name: str) -> Path | None:
    """Return the table of a record in a folder of records, if there is one."""
    places = (folder / name / f"{name}{suffix}" for suffix in SUFFIXES)
    return next((place for place in places if place.is_file()), None)


def local_notes(name: str) -> Mapping[str, Any]:
    """Return what stands beside the local copy of a record."""
    table = local_table(name)
    if table is None:
        return {}
    try:
        content = json.loads((table.parent / f"{name}.json").read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def registered_path(path: Path) -> Path | None:
    """Return the table of the record a path names; None if it is a file or no registered name.

    Raises
    ------
    DataError
        If the record is registered and not at hand.
    """
    name = str(path)
    if name not in benchmarks() or path.is_file():
        return None
    table = local_table(name)
    if table is None:
        raise DataError(
            f"the record {name!r} is registered and not at hand: `sysid data fetch {name}` gets it, or let "
            f"{FOLDER_VARIABLE} name the folder that holds it"
        )
    return table
