"""The runner: hands the runs of a case to workers and keeps what is finished."""

import math
import shutil
import tempfile
import time
import weakref
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from types import TracebackType

from sysid.errors import UsageError
from sysid.montecarlo.backends import DaskPool, compute_here, compute_on_joblib
from sysid.montecarlo.checkpoints import CaseFiles, Identity
from sysid.montecarlo.runs import Chunk, Span, Task, compute, evaluate
from sysid.montecarlo.study import Failure, Study
from sysid.montecarlo.workers import one_blas_thread
from sysid.progress import Progress

__all__ = ["Failure", "Runner", "Study", "Task"]

BACKENDS = ("loky", "threading", "dask")
_UNIT_SECONDS = 0.25
_SHORTEST_UNIT_SECONDS = 0.03  # a checkpoint costs some milliseconds
_UNITS_PER_JOB = 8
_LARGEST_UNIT = 4096


@dataclass(frozen=True)
class Runner:
    """Runs Monte-Carlo studies; no option changes a number.

    Run i of a case draws from ``SeedSequence(seed, spawn_key=(crc32(case), i))``, so its values do not
    depend on the workers, the backend, the chunks, the order of the cases or an interruption.

    Parameters
    ----------
    jobs : int
        Number of workers; a Dask cluster with an address has its own number.
    backend : {"loky", "threading", "dask"}
        Processes, threads (for tasks that release the interpreter lock), or a Dask cluster.
    scheduler : str or None
        Address of a Dask scheduler, e.g. ``tcp://127.0.0.1:8786``; None starts a local cluster.
    folder : Path or None
        Where checkpoints and tables of runs are kept; None is a temporary folder that lives as long as the
        study.
    resume : bool
        Go on from what is in `folder`: only missing runs are computed. Without it a case begins anew.
    chunk : int or None
        Runs of one work unit and checkpoint; None aims at a quarter of a second.
    progress : Progress or None
        Where to show a bar a case.

    Raises
    ------
    UsageError
        When an option is out of its range.

    Examples
    --------
    >>> def task(rng):
    ...     return {"mean": rng.normal(size=50).mean()}
    >>> study = Runner(jobs=1).run("gaussian", task, n_runs=100, seed=1)
    >>> study.n_runs, study.failed, study.columns
    (100, 0, ('mean',))
    >>> study.std()["mean"]
    0.1...
    """

    jobs: int = 2
    backend: str = "loky"
    scheduler: str | None = None
    folder: Path | None = None
    resume: bool = False
    chunk: int | None = None
    progress: Progress | None = None
    _dask: DaskPool = field(default_factory=DaskPool, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise UsageError(f"the number of jobs is {self.jobs}; it must be at least 1")
        if self.backend not in BACKENDS:
            raise UsageError(f"there is no backend {self.backend!r}; choose one of {', '.join(BACKENDS)}")
        if self.scheduler is not None and self.backend != "dask":
            raise UsageError(
                f"a scheduler ({self.scheduler}) goes with the backend 'dask', not {self.backend!r}; "
                "choose the backend 'dask' or leave the scheduler out"
            )
        if self.chunk is not None and self.chunk < 1:
            raise UsageError(f"the chunk is {self.chunk} runs; it must be at least 1")
        if self.resume and self.folder is None:
            raise UsageError("to resume a study, name the folder where its runs were kept")

    def run(self, case: str, task: Task, n_runs: int, seed: int) -> Study:
        """Compute the runs 0 ... n_runs - 1 of a case.

        Each finished chunk is kept at once, so an interruption (Ctrl-C, a killed process) loses at most the
        chunks in work.

        Parameters
        ----------
        case : str
            Id of the case, e.g. ``example-2/m4``; part of the seed.
        task : Task
            Called with the generator of a run; returns the same keys in every run. It must be picklable:
            a function of a module or, with settings, a frozen dataclass with ``__call__``.
        n_runs : int
            Number of runs, at least 1.
        seed : int
            Seed of the study, not negative.

        Returns
        -------
        Study

        Raises
        ------
        UsageError
            When an argument is wrong, the runs in the folder belong to another study, or the backend
            cannot be reached.
        SysidError
            When workers died; the finished runs are kept.
        """
        _check(case, seed)
        if n_runs < 1:
            raise UsageError(f"case {case!r} has {n_runs} runs; it must have at least 1")
        identity = Identity.of(case, seed, task)
        if self.folder is not None:
            files = CaseFiles(Path(self.folder), identity, durable=True)
            self._compute(files, case, task, n_runs, seed)
            return Study.load(files.table, n_runs)
        folder = tempfile.mkdtemp(prefix="sysid-")
        try:
            files = CaseFiles(Path(folder), identity, durable=False)
            self._compute(files, case, task, n_runs, seed)
            study = Study.load(files.table, n_runs)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        weakref.finalize(study, shutil.rmtree, folder, ignore_errors=True)
        return study

    def replay(self, case: str, task: Task, run: int, seed: int) -> dict[str, float]:
        """Compute one run in this process; what the task raises passes through.

        Parameters
        ----------
        case, task, seed
            As in `run`.
        run : int
            Number of the run, from 0.

        Returns
        -------
        dict
            The same values as in the study.
        """
        _check(case, seed)
        if run < 0:
            raise UsageError(f"the run {run} of case {case!r} does not exist; runs count from 0")
        with one_blas_thread():
            return evaluate(task, case, seed, run)

    def close(self) -> None:
        """End the connection to a Dask cluster, and a local cluster; only needed to do so early."""
        self._dask.close()

    def __enter__(self) -> "Runner":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _compute(self, files: CaseFiles, case: str, task: Task, n_runs: int, seed: int) -> None:
        """Compute and keep the missing runs, then put all into the table."""
        if self.resume:
            files.recover()
        missing = files.missing(n_runs)
        if missing and self.backend == "dask":
            self._dask.open(self.scheduler, self.jobs)
        if not self.resume:  # only now, when nothing more can be wrong with the options
            files.clear()
        done = n_runs - sum(stop - start for start, stop in missing)
        bars = Progress() if self.progress is None else self.progress
        with one_blas_thread(), bars.task(case, n_runs, completed=done) as bar:
            for chunk in self._chunks(missing, case, task, seed):
                files.save(chunk)
                bar.advance(chunk.stop - chunk.start)
        files.assemble(n_runs)

    def _chunks(self, missing: list[Span], case: str, task: Task, seed: int) -> Iterator[Chunk]:
        """Compute the spans; the chunks come as they finish."""
        rest = missing
        duration = 0.0
        # The first run is computed here, so that workers find its kernels compiled in the cache. When it was
        # slow, compilation may have been the reason: then a second one shows how long a run takes.
        for _ in range(2):
            if not rest:
                return
            (start, stop), rest = rest[0], rest[1:]
            began = time.perf_counter()
            yield compute(task, case, seed, (start, start + 1))
            duration = time.perf_counter() - began
            rest = [(start + 1, stop), *rest] if start + 1 < stop else rest
            if duration < 0.2 * _UNIT_SECONDS:
                break
        if rest:
            units = _cut(rest, self.chunk or self._unit_size(rest, duration))
            yield from self._distribute(units, case, task, seed)

    def _distribute(self, units: list[Span], case: str, task: Task, seed: int) -> Iterator[Chunk]:
        if self.backend == "dask":
            return self._dask.compute(task, case, seed, units)
        if self.jobs == 1:
            return compute_here(task, case, seed, units)
        return compute_on_joblib(self.backend, self.jobs, task, case, seed, units)

    def _unit_size(self, spans: list[Span], duration: float) -> int:
        """Choose units so long that their overhead is small, and so short that the work is shared evenly."""
        runs = sum(stop - start for start, stop in spans)
        shortest, long_enough = (
            math.ceil(seconds / max(duration, 1e-6)) for seconds in (_SHORTEST_UNIT_SECONDS, _UNIT_SECONDS)
        )
        even_share = math.ceil(runs / (_UNITS_PER_JOB * self.jobs))
        return min(max(even_share, shortest), long_enough, _LARGEST_UNIT)


def _cut(spans: list[Span], size: int) -> list[Span]:
    """Cut spans into work units of at most `size` runs."""
    return list(
        chain.from_iterable(
            ((first, min(first + size, stop)) for first in range(start, stop, size)) for start, stop in spans
        )
    )


def _check(case: str, seed: int) -> None:
    if not case:
        raise UsageError("the id of a case is empty; name it, e.g. 'saturation'")
    if seed < 0:
        raise UsageError(f"the seed {seed} of case {case!r} is negative; choose one from 0")
