"""The harness of a replication: what a paper's module gets, what it returns, and where that is written."""

import json
import math
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from hashlib import sha256
from importlib import import_module
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, version
from importlib.resources.abc import Traversable
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

from sysid.errors import UsageError

if TYPE_CHECKING:
    from sysid.claims import Claim
    from sysid.gates import Gate
    from sysid.montecarlo import Runner, Study, Task

SCHEMA = 1
PAPER_PARTS = (
    "id",
    "title",
    "citation",
    "default_runs",
    "smoke_runs",
    "claims_file",
    "notebook",
    "plan",
    "replicate",
)
"""What a `Paper` must have."""
PACKAGES = ("sysid", "numpy", "scipy", "numba", "control", "joblib", "pandas", "pyarrow", "matplotlib")


MOST_FAILURES = 5
"""Failed runs of a case that are listed; all are in the table of its runs."""


@dataclass(frozen=True)
class Failed:
    """A run that failed."""

    case: str
    run: int
    message: str


@dataclass(frozen=True)
class Session:
    """One call of a replication.

    Attributes
    ----------
    runs : int
        Monte-Carlo runs of a case.
    seed : int
        Seed of all studies.
    smoke : bool
        A short run that still meets every gate.
    runner : Runner
        Where the runs are computed.
    finished : callable
        Called with 1 when a study is done.
    timings : dict
        Measured times [s], filled by `timed`, and ratios of times; None for what could not be measured.
    failures : list
        The first failed runs of each case, with what it takes to repeat them.
    with_records : bool
        Also compute what needs real records and takes longer than a default replication may.
    """

    runs: int
    seed: int
    smoke: bool
    runner: "Runner"
    finished: Callable[[int], None] = lambda done: None
    timings: dict[str, float | None] = field(default_factory=dict)
    failures: list["Failed"] = field(default_factory=list)
    with_records: bool = False

    def study(self, case: str, task: "Task", runs: int | None = None) -> "Study":
        """Compute the runs of a case."""
        study = self.runner.run(case, task, self.runs if runs is None else runs, self.seed)
        self.finished(1)
        if study.failed:
            first = islice(study.failures(), MOST_FAILURES)
            self.failures.extend(Failed(case, one.run, one.message) for one in first)
        return study

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Record how long a part takes [s]."""
        start = time.perf_counter()
        yield
        self.timings[name] = time.perf_counter() - start


@dataclass(frozen=True)
class PaperResult:
    """What the module of a paper returns; the fields are those of ``results.json``.

    A number that could not be computed is None, and `notes` says under its name why.
    """

    claims: Sequence["Claim"]
    gates: Sequence["Gate"]
    tables: Mapping[str, Any]
    monte_carlo: Mapping[str, Any]
    numbers: Mapping[str, float | None]
    notes: Mapping[str, str] = field(default_factory=dict)

    def to_json(self, timings: Mapping[str, float | None]) -> dict[str, Any]:
        """Return the result as JSON types."""
        return {
            "claims": [claim.to_json() for claim in self.claims],
            "tables": dict(self.tables),
            "monte_carlo": dict(self.monte_carlo),
            "gates": [gate.to_json() for gate in self.gates],
            "numbers": dict(self.numbers),
            "notes": dict(self.notes),
            "timings": dict(timings),
        }


class Paper(Protocol):
    """What an entry point of the group ``sysid.papers`` provides."""

    id: str
    title: str
    citation: str
    default_runs: int
    smoke_runs: int
    claims_file: Traversable
    notebook: Path

    def plan(self, runs: int) -> Mapping[str, tuple["Task", int]]:
        """Return every case with its task and its number of runs."""

    def replicate(self, session: Session) -> PaperResult:
        """Regenerate the paper."""


def chosen_papers(names: Sequence[str]) -> dict[str, Paper]:
    """Return the papers that were asked for, all when none was named.

    Raises
    ------
    UsageError
        If a paper is not installed or cannot be loaded.
    """
    entries = {entry.name: entry for entry in entry_points(group="sysid.papers")}
    available = sorted(entries)
    for name in names:
        if name not in entries:
            raise UsageError(f"there is no paper {name!r}; installed are: {', '.join(available) or 'none'}")
    return {name: _load(entries[name]) for name in (names or available)}


def _load(entry: EntryPoint) -> Paper:
    """Import a paper; whatever its package does wrong is told in one sentence."""
    remedy = "repair or uninstall the package it comes from"
    try:
        paper = entry.load()
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise UsageError(
            f"the paper {entry.name!r} ({entry.value}) cannot be loaded ({reason}): {remedy}"
        ) from error
    missing = [name for name in PAPER_PARTS if not hasattr(paper, name)]
    if missing:
        raise UsageError(f"the paper {entry.name!r} ({entry.value}) has no {missing[0]!r}: {remedy}")
    return cast(Paper, paper)


def provenance(papers: Mapping[str, Paper], runs: Mapping[str, int], seed: int) -> dict[str, Any]:
    """Return commit, versions, platform, seed, runs, date and hashes of the files read."""
    return {
        "commit": commit(),
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in PACKAGES}},
        "platform": f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors",
        "seed": seed,
        "runs": dict(runs),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "data_hashes": {
            paper.claims_file.name: sha256(paper.claims_file.read_bytes()).hexdigest()
            for paper in papers.values()
        },
        "command": " ".join(["sysid", *sys.argv[1:]]),
    }


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def commit() -> str:
    """Return the commit of the library's own source, or "no repository" for an installed wheel."""
    source = Path(str(import_module("sysid").__file__)).resolve().parent
    try:
        asked = subprocess.run(
            ["git", "-C", str(source), "ls-files", "--error-unmatch", "replication.py"],
            capture_output=True,
            check=False,
        )
        if asked.returncode != 0:
            return "no repository"
        described = subprocess.run(
            ["git", "-C", str(source), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"],
            capture_output=True,
            check=True,
            text=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return "no repository"
    return described.stdout.strip()


def jsonable(value: Any) -> Any:
    """Return the value with numbers JSON knows: not-a-number and infinities become null."""
    if isinstance(value, Mapping):
        return {str(key): jsonable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [jsonable(item) for item in value]
    if hasattr(value, "tolist"):
        return jsonable(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_results(folder: Path, results: Mapping[str, Any]) -> Path:
    """Write ``results.json`` at once or not at all."""
    path = folder / "results.json"
    partial = path.with_suffix(".json.partial")
    partial.write_text(json.dumps(jsonable(results), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    partial.replace(path)
    return path


def read_results(folder: Path) -> dict[str, Any]:
    """Read the ``results.json`` of an output folder.

    Raises
    ------
    UsageError
        If there is none or it has another schema.
    """
    path = folder / "results.json"
    try:
        results = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UsageError(f"{path} does not exist: run `sysid replicate --out {folder}` first") from None
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} cannot be read ({error}): give the folder of a replication") from None
    except json.JSONDecodeError as error:
        raise UsageError(f"{path} is not JSON (line {error.lineno}): run the replication again") from None
    if not isinstance(results, dict) or results.get("schema") != SCHEMA:
        raise UsageError(f"{path} does not have schema {SCHEMA}: run the replication again")
    return results
