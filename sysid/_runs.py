"""One run of a Monte-Carlo study, and a range of runs: what a worker computes."""

import contextlib
import math
import os
import signal
import threading
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import UsageError

Task = Callable[[np.random.Generator], Mapping[str, float]]
Span = tuple[int, int]
"""First run and the run after the last."""

RESERVED_COLUMNS = ("run", "failed", "message")


@dataclass(frozen=True, eq=False)
class Chunk:
    """Results of the runs start, start + 1, ...

    ``names`` is None when every run failed; ``values`` (n_runs, n_columns) is NaN in the rows of failed
    runs; ``messages`` holds one text a run, None for a run that went well.
    """

    start: int
    names: tuple[str, ...] | None
    values: NDArray[np.float64]
    messages: tuple[str | None, ...]

    @property
    def stop(self) -> int:
        """The run after the last."""
        return self.start + len(self.messages)


def spawn_key(case: str, run: int) -> tuple[int, int]:
    """Place of a run in the tree of random streams: (crc32 of the case id, run)."""
    return zlib.crc32(case.encode()), run


def generator(case: str, seed: int, run: int) -> np.random.Generator:
    """Random numbers of one run: those of ``SeedSequence(seed).spawn`` at `spawn_key`."""
    sequence = np.random.SeedSequence(seed, spawn_key=spawn_key(case, run))
    return np.random.Generator(np.random.PCG64(sequence))


def evaluate(task: Task, case: str, seed: int, run: int) -> dict[str, float]:
    """Compute one run; whatever the task raises passes through.

    Raises
    ------
    ArithmeticError
        When a value is infinite; NaN is allowed and means "not defined".
    """
    # Inside workers nothing should be printed, and a caller's `np.errstate` must not change what fails.
    with np.errstate(all="ignore"):
        values = {name: float(value) for name, value in task(generator(case, seed, run)).items()}
    for name, value in values.items():
        if math.isinf(value):
            raise ArithmeticError(f"the value {name!r} is {value}")
    return values


def compute(task: Task, case: str, seed: int, span: Span) -> Chunk:
    """Compute the runs of `span`; a run that raises is kept with its message.

    Raises
    ------
    UsageError
        When two runs return different columns.
    """
    start, stop = span
    names: tuple[str, ...] | None = None
    values: NDArray[np.float64] = np.empty((stop - start, 0))
    messages: list[str | None] = []
    with one_blas_thread():
        for row, run in enumerate(range(start, stop)):
            try:
                result = evaluate(task, case, seed, run)
            except Exception as error:
                messages.append(_one_line(error))
                continue
            messages.append(None)
            if names is None:
                names = tuple(result)
                values = np.full((stop - start, len(names)), np.nan)
            if result.keys() != set(names):
                raise columns_differ(case, run, tuple(result), names)
            values[row] = [result[name] for name in names]
    return Chunk(start, names, values, tuple(messages))


def compute_quietly(task: Task, case: str, seed: int, span: Span) -> Chunk:
    """`compute` in a worker process: prints nothing and leaves Ctrl-C to the parent."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    with (
        open(os.devnull, "w") as sink,  # noqa: PTH123
        contextlib.redirect_stdout(sink),
        contextlib.redirect_stderr(sink),
    ):
        return compute(task, case, seed, span)


def columns_differ(case: str, run: int, found: tuple[str, ...], expected: tuple[str, ...]) -> UsageError:
    """Error for a task that does not return the same keys in every run."""
    return UsageError(
        f"run {run} of case {case!r} returned the columns {', '.join(found)} where other runs returned "
        f"{', '.join(expected)}; a task must return the same keys in every run (NaN for 'not defined')"
    )


def _one_line(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:500]


class _BlasLimit:
    """One BLAS thread while any thread of this process is inside `hold`.

    The limit belongs to the process: the first to enter sets it and the last to leave restores it, so that
    work units side by side do not take it from each other.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users = 0
        self._limits: Any = None

    @contextlib.contextmanager
    def hold(self) -> Iterator[None]:
        from threadpoolctl import threadpool_limits

        with self._lock:
            if self._users == 0:
                self._limits = threadpool_limits(limits=1, user_api="blas")
            self._users += 1
        try:
            yield
        finally:
            with self._lock:
                self._users -= 1
                if self._users == 0:
                    self._limits.restore_original_limits()


one_blas_thread = _BlasLimit().hold
