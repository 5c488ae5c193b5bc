"""Get a registered record: from a folder, a mirror or its public address."""

import hashlib
import json
import shutil
from dataclasses import dataclass
from pathlib import Path

from sysid.data.registry import FOLDER_VARIABLE, Benchmark, benchmark, cache_folder, local_table, table_in
from sysid.errors import DataError, UsageError

TIMEOUT = 30.0  # [s] without an answer
SCHEMES = ("http://", "https://")


@dataclass(frozen=True)
class Fetched:
    """A file that was fetched.

    Attributes
    ----------
    path : Path
    sha256 : str
    checked : bool
        Whether the hash was known and agrees.
    remark : str
        What to do with it, where it is not a table ready to be read by name.
    """

    path: Path
    sha256: str
    checked: bool
    remark: str = ""


def fetch(name: str, *, source: str | None = None, folder: Path | None = None) -> Fetched:
    """Fetch a record and check it.

    Parameters
    ----------
    name : str
        As registered.
    source : str, optional
        Folder or http(s) address of records, ``<name>/<name>.csv[.gz]``.  By default a copy at hand is
        taken, and otherwise the original is downloaded from its public address.
    folder : Path, optional
        Where to put it, in a folder of the record's name; the user's cache by default.

    Raises
    ------
    UsageError
        If the record is not registered or no place is known to have it.
    DataError
        If it cannot be reached or is not the registered one.
    """
    record = benchmark(name)
    target = (cache_folder() if folder is None else folder) / name
    if source is None:
        table = local_table(name)
        if table is not None:
            return _copy(record, table, target)
        if record.address:
            return _original(record, target)
        raise UsageError(_nowhere(record))
    if source.startswith(SCHEMES):
        if not record.file:
            raise UsageError(
                f"{name!r} has no registered table, so no mirror can have it: {_nowhere(record)}"
            )
        path = _download(f"{source.rstrip('/')}/{name}/{record.file}", record.sha256, target / record.file)
        return _finished(record, path)
    table = table_in(Path(source), name)
    if table is None:
        raise UsageError(f"{source} holds no {name}/{name}.csv or .csv.gz: name the folder of all records")
    return _copy(record, table, target)


def _nowhere(record: Benchmark) -> str:
    where = f", see {record.page}" if record.page else ""
    return (
        f"no direct address of {record.name!r} is known{where}: name a folder or mirror with --from, "
        f"or set {FOLDER_VARIABLE}"
    )


def _copy(record: Benchmark, table: Path, target: Path) -> Fetched:
    """Copy a checked table with its notes; the file appears at once or not at all."""
    found = _sha256(table)
    if record.sha256 and found != record.sha256:
        raise DataError(
            f"{table} has the SHA-256 {found} and not {record.sha256} as registered: "
            "it is another version or damaged; get it anew"
        )
    place = target / table.name
    if place.resolve() != table.resolve():
        target.mkdir(parents=True, exist_ok=True)
        part = place.with_name(place.name + ".part")
        shutil.copyfile(table, part)
        part.replace(place)
        beside = table.with_name(f"{record.name}.json")
        if beside.is_file():
            shutil.copyfile(beside, target / beside.name)
    return _finished(record, place)


def _original(record: Benchmark, target: Path) -> Fetched:
    """Download the authors' own file, which is left as it is."""
    path = _download(record.address, "", target / record.address.rsplit("/", 1)[-1])
    remark = f"This is the original, {record.original}: take it apart and name its columns yourself."
    return Fetched(path, _sha256(path), False, remark)


def _finished(record: Benchmark, path: Path) -> Fetched:
    """Put notes beside a table that has none."""
    beside = path.with_name(f"{record.name}.json")
    if not beside.exists():
        beside.write_text(json.dumps(record.notes(), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return Fetched(path, _sha256(path), bool(record.sha256))


def _download(address: str, sha256: str, place: Path) -> Path:
    import pooch

    pooch.get_logger().setLevel("ERROR")
    try:
        pooch.retrieve(
            address,
            known_hash=sha256 or None,
            fname=place.name,
            path=place.parent,
            downloader=pooch.HTTPDownloader(timeout=TIMEOUT),
        )
    except OSError as problem:
        if problem.errno is not None:  # the disk, not the network
            raise
        answer = getattr(getattr(problem, "response", None), "status_code", None)
        reason = f"HTTP {answer}" if answer else type(problem).__name__
        raise DataError(
            f"{address} cannot be reached ({reason}): "
            "check the connection, or name a folder or mirror with --from"
        ) from None
    except ValueError as problem:
        if "hash" not in str(problem):
            raise DataError(f"{address} is no address: give one such as https://host/records") from None
        raise DataError(
            f"{address} is not the registered file: its SHA-256 is not {sha256}; use another place"
        ) from None
    return place


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
