"""One run of a Monte-Carlo study, and a range of runs: what a worker computes."""

import math
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass

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
    # A caller's `np.errstate` must not decide which runs fail.
    with np.errstate(all="ignore"):
        values = {name: float(value) for name, value in task(generator(case, seed, run)).items()}
    for name, value in values.items():
        if math.isinf(value):
            raise ArithmeticError(f"the value {name!r} is {value}")
    return values


def compute(task: Task, case: str, seed: int, span: Span) -> Chunk:
    """Compute the runs of `span`, on one BLAS thread if the caller saw to it.

    A run that raises is kept with its message.

    Raises
    ------
    UsageError
        When two runs return different columns.
    """
    start, stop = span
    names: tuple[str, ...] | None = None
    values: NDArray[np.float64] = np.empty((stop - start, 0))
    messages: list[str | None] = []
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


def columns_differ(case: str, run: int, found: tuple[str, ...], expected: tuple[str, ...]) -> UsageError:
    """Error for a task that does not return the same keys in every run."""
    return UsageError(
        f"run {run} of case {case!r} returned the columns {', '.join(found)} where other runs returned "
        f"{', '.join(expected)}; a task must return the same keys in every run (NaN for 'not defined')"
    )


def _one_line(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:500]
