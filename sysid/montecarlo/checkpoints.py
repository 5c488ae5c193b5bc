"""Files of one Monte-Carlo case: finished chunks, and the table of all runs made of them."""

import contextlib
import hashlib
import inspect
import json
import os
import pickle
import re
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import UsageError
from sysid.montecarlo.runs import RESERVED_COLUMNS, Chunk, Span, Task, columns_differ

ROW_GROUP = 16384
"""Rows of a row group of the table: fixed, so that the bytes of the file do not depend on the chunks."""

_KEY = b"sysid.study"
_CHUNK_NAME = re.compile(r"chunk-(\d{10})-(\d{10})-([0-9a-f]{8})\.parquet")


class _DamagedFileError(Exception):
    """A file that cannot be trusted: it is computed again."""


@dataclass(frozen=True)
class Identity:
    """What the numbers of a run depend on; runs are reused only where all of it is equal."""

    case: str
    seed: int
    task: str
    fingerprint: str
    versions: str

    @classmethod
    def of(cls, case: str, seed: int, task: Task) -> "Identity":
        """Identity of the study of `task`."""
        return cls(case, seed, f"{task.__module__}.{_name(task)}", _fingerprint(task), versions())

    def difference(self, other: "Identity") -> str | None:
        """First difference in words, None when both are equal."""
        for field in fields(self):
            ours, theirs = getattr(self, field.name), getattr(other, field.name)
            if ours != theirs:
                what = f"settings or code of {self.task}" if field.name == "fingerprint" else field.name
                return f"{what} ({theirs!r} then, {ours!r} now)"
        return None


def versions() -> str:
    """Versions of the packages that the numbers of a study depend on."""
    return ", ".join(f"{name} {metadata.version(name)}" for name in ("sysid", "numpy", "scipy", "numba"))


def _name(task: Task) -> str:
    return getattr(task, "__qualname__", type(task).__qualname__)


def _fingerprint(task: Task) -> str:
    """Hash of the task's data and of the source text of its class or function."""
    source: Any = getattr(task, "func", task)  # of a functools.partial
    try:
        text = inspect.getsource(source if inspect.isroutine(source) else type(source))
    except (OSError, TypeError):
        text = ""
    return hashlib.sha256((_content_hash(task) + text).encode()).hexdigest()[:16]


def _settings(task: Task) -> object:
    """Return what a task holds, a path as its text: equal paths can be pickled differently."""
    held = getattr(task, "__dict__", None)
    if not is_dataclass(task) or held is None:
        return task
    return {
        name: os.fspath(value) if isinstance(value, os.PathLike) else value for name, value in held.items()
    }


def _content_hash(task: Task) -> str:
    import joblib

    failures = (pickle.PicklingError, AttributeError, TypeError)
    try:
        return str(joblib.hash(_settings(task)))
    except failures:
        pass  # a function inside a function or a notebook, which workers get by value
    try:
        return hashlib.sha256(pickle.dumps(joblib.wrap_non_picklable_objects(task))).hexdigest()
    except failures as error:
        raise UsageError(
            f"the task {_name(task)} cannot be sent to a worker ({error}); define it at the top of a module, "
            "e.g. as a frozen dataclass with __call__ whose fields are numbers, texts or arrays"
        ) from error


def safe_name(case: str) -> str:
    """File name of a case id; different ids have different names.

    Examples
    --------
    >>> safe_name("example-2/m4")
    'example-2~2fm4'
    """
    name = re.sub(r"[^A-Za-z0-9._-]", lambda kept: "".join(f"~{byte:02x}" for byte in kept[0].encode()), case)
    return name.replace(".", "~2e", 1) if name.startswith(".") else name


class CaseFiles:
    """The files of one case: ``<root>/<case>/chunk-*.parquet`` and, in the end, ``<root>/<case>.parquet``.

    Parameters
    ----------
    root : Path
        Folder of all cases; made when it does not exist.
    identity : Identity
        Written into each file.
    durable : bool
        Wait until a file is on the disk before it gets its name, so that not even a power cut leaves half
        a file under it.
    """

    def __init__(self, root: Path, identity: Identity, durable: bool) -> None:
        self.table = root / f"{safe_name(identity.case)}.parquet"
        self.names: tuple[str, ...] | None = None
        self._folder = root / safe_name(identity.case)
        self._identity = identity
        self._durable = durable
        self._chunks: dict[Path, Span] = {}
        self._table_runs = 0
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(
                f"the folder {root} cannot hold the runs of case {identity.case!r} ({error.strerror}); "
                "choose a folder that can be written"
            ) from error

    def clear(self) -> None:
        """Remove what an earlier study of this case left."""
        for path in [*self._folder.glob("chunk-*.parquet"), *self._folder.glob("*.tmp"), self.table]:
            path.unlink(missing_ok=True)
        self._chunks, self._table_runs, self.names = {}, 0, None

    def recover(self) -> None:
        """Take over the finished runs of an earlier study; remove files that are damaged.

        Raises
        ------
        UsageError
            When they belong to another study.
        """
        for path in self._folder.glob("*.tmp"):
            path.unlink()
        if self.table.exists() and (span := self._checked(self.table)) is not None:
            self._table_runs = span[1]
        for path in sorted(self._folder.glob("chunk-*.parquet")):
            if (span := self._checked(path)) is not None:
                self._chunks[path] = span

    def missing(self, n_runs: int) -> list[Span]:
        """Return the runs below `n_runs` that are not finished, as spans in their order."""
        gaps = []
        reached = self._table_runs
        for start, stop in [*sorted(self._chunks.values()), (n_runs, n_runs)]:
            if reached < min(start, n_runs):
                gaps.append((reached, min(start, n_runs)))
            reached = max(reached, stop)
        return gaps

    def save(self, chunk: Chunk) -> None:
        """Keep a finished chunk."""
        import pyarrow as pa

        self._agree_on_names(chunk.names, chunk.start)
        names = chunk.names or ()
        columns = [
            pa.array(np.arange(chunk.start, chunk.stop)),
            pa.array([message is not None for message in chunk.messages]),
            pa.array(chunk.messages, pa.string()),
            *(pa.array(chunk.values[:, index]) for index in range(len(names))),
        ]
        partial = self._write(names, [pa.Table.from_arrays(columns, schema=self._schema(names))])
        name = f"chunk-{chunk.start:010d}-{chunk.stop:010d}-{_check_sum(partial):08x}.parquet"
        path = partial.replace(self._folder / name)
        self._chunks[path] = (chunk.start, chunk.stop)

    def assemble(self, n_runs: int) -> None:
        """Write the table of all runs, at least `n_runs`, and remove the chunks it holds."""
        if self._table_runs < n_runs:
            spans = [(0, self._table_runs, self.table)] if self._table_runs else []
            spans += [(start, stop, path) for path, (start, stop) in self._chunks.items()]
            self._write(self.names or (), self._groups(sorted(spans))).replace(self.table)
            self._table_runs = read_header(self.table)[2]
        for path, (_, stop) in list(self._chunks.items()):
            if stop <= self._table_runs:
                path.unlink()
                del self._chunks[path]
        if not self._chunks:
            with contextlib.suppress(OSError):  # somebody's file in it
                self._folder.rmdir()

    def _groups(self, sources: Sequence[tuple[int, int, Path]]) -> Iterator[Any]:
        """Rows of the sources in the order of the runs, in tables of `ROW_GROUP` rows."""
        import pyarrow as pa

        waiting: list[Any] = []
        schema = self._schema(self.names or ())
        for batch in self._in_order(sources):
            missing = pa.array(np.full(len(batch), np.nan))
            columns = [batch.column(name) if name in batch.schema.names else missing for name in schema.names]
            waiting.append(pa.Table.from_arrays(columns, schema=schema))
            while sum(map(len, waiting)) >= ROW_GROUP:
                rows = pa.concat_tables(waiting).combine_chunks()
                yield rows.slice(0, ROW_GROUP)
                waiting = [rows.slice(ROW_GROUP)]
        yield pa.concat_tables([schema.empty_table(), *waiting]).combine_chunks()

    @staticmethod
    def _in_order(sources: Sequence[tuple[int, int, Path]]) -> Iterator[Any]:
        """Rows from run 0 up to the first gap, each run once."""
        reached = 0
        for start, stop, path in sources:
            if start > reached:
                return
            for batch in read_rows(path, None):
                first = batch.column("run")[0].as_py() if len(batch) else reached
                rows = batch.slice(max(reached - first, 0))
                reached = max(reached, first + len(batch))
                yield rows
            reached = max(reached, stop)

    def _checked(self, path: Path) -> Span | None:
        """Return the runs of a file of this study; None, and the file removed, when it is damaged."""
        try:
            identity, names, span = _inspect(path)
        except _DamagedFileError:
            path.unlink()
            return None
        difference = self._identity.difference(identity)
        if difference is not None:
            raise UsageError(
                f"the runs in {path} cannot be continued: they were made with different {difference}; "
                "start without resuming, or choose another folder"
            )
        self._agree_on_names(names or None, span[0])
        return span

    def _agree_on_names(self, names: tuple[str, ...] | None, run: int) -> None:
        if names is None:
            return
        if self.names is None:
            reserved = sorted(set(names) & set(RESERVED_COLUMNS))
            if reserved:
                raise UsageError(
                    f"case {self._identity.case!r} returns a column {reserved[0]!r}, a name that the table "
                    "of runs needs itself; rename it"
                )
            self.names = names
        elif set(self.names) != set(names):
            raise columns_differ(self._identity.case, run, names, self.names)

    def _schema(self, names: tuple[str, ...]) -> Any:
        import pyarrow as pa

        head = [("run", pa.int64()), ("failed", pa.bool_()), ("message", pa.string())]
        values = [(name, pa.float64()) for name in names]
        return pa.schema(head + values, metadata={_KEY: json.dumps(asdict(self._identity))})

    def _write(self, names: tuple[str, ...], tables: Iterable[Any]) -> Path:
        """Write a file under a passing name; its own name it gets by a rename, so that it is always whole."""
        import pyarrow.parquet as pq

        partial = self._folder / f"{os.getpid()}.tmp"
        schema = self._schema(names)
        # The run numbers and estimates hardly repeat: a dictionary would only make the file larger.
        with pq.ParquetWriter(
            partial, schema, compression="zstd", use_dictionary=False, write_page_checksum=True
        ) as writer:
            for table in tables:
                writer.write_table(table, row_group_size=ROW_GROUP)
        if self._durable:
            with partial.open("rb+") as file:
                os.fsync(file.fileno())
        return partial


def read_rows(path: Path, columns: Sequence[str] | None, stop: int | None = None) -> Iterator[Any]:
    """Stream the rows of a chunk or table as record batches, those of the runs below `stop`."""
    import pyarrow.parquet as pq

    with pq.ParquetFile(path, page_checksum_verification=True) as file:
        left = file.metadata.num_rows if stop is None else min(stop, file.metadata.num_rows)
        for batch in file.iter_batches(ROW_GROUP, columns=columns):
            if left <= 0:
                return
            yield batch.slice(0, left)
            left -= len(batch)


def read_header(path: Path) -> tuple[Identity, tuple[str, ...], int]:
    """Identity, value columns and number of rows of a chunk or table."""
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        schema = file.schema_arrow
        identity = Identity(**json.loads(schema.metadata[_KEY]))
        names = tuple(name for name in schema.names if name not in RESERVED_COLUMNS)
        return identity, names, file.metadata.num_rows


def _inspect(path: Path) -> tuple[Identity, tuple[str, ...], Span]:
    """Header and runs of a chunk or table, after a check of the whole file."""
    import pyarrow as pa

    try:
        match = _CHUNK_NAME.fullmatch(path.name)
        if match is None:
            return _inspect_table(path)
        if _check_sum(path) != int(match[3], 16):
            raise _DamagedFileError(path)
        identity, names, _ = read_header(path)
        return identity, names, (int(match[1]), int(match[2]))
    except (OSError, ValueError, TypeError, KeyError, pa.ArrowException) as error:
        raise _DamagedFileError(path) from error


def _inspect_table(path: Path) -> tuple[Identity, tuple[str, ...], Span]:
    identity, names, n_rows = read_header(path)
    reached = 0
    for batch in read_rows(path, None):  # verifies the check sum of each page
        if not np.array_equal(batch.column("run"), np.arange(reached, reached + len(batch))):
            raise _DamagedFileError(path)
        reached += len(batch)
    if reached != n_rows:
        raise _DamagedFileError(path)
    return identity, names, (0, n_rows)


def _check_sum(path: Path) -> int:
    value = 0
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            value = zlib.crc32(block, value)
    return value
