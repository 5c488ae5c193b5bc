"""Where the work units of a Monte-Carlo study are computed: here, on joblib workers, on a Dask cluster."""

import logging
import os
import re
import weakref
from collections.abc import Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from functools import partial
from importlib import import_module
from itertools import islice
from typing import Any

from sysid.errors import SysidError, UsageError
from sysid.montecarlo.checkpoints import versions
from sysid.montecarlo.runs import Chunk, Span, Task, compute
from sysid.montecarlo.workers import compute_in_process, compute_pinned

CONNECT_SECONDS = 5.0
_ADDRESS = re.compile(r"((tcp|tls|ws|wss|ucx)://)?([^\s/:\[\]]+|\[[0-9A-Fa-f:.]+\]):\d{1,5}")


def compute_here(task: Task, case: str, seed: int, spans: Iterable[Span]) -> Iterator[Chunk]:
    """Compute one unit after the other in this process."""
    for span in spans:
        yield compute(task, case, seed, span)


def compute_on_joblib(
    backend: str, jobs: int, task: Task, case: str, seed: int, spans: Iterable[Span]
) -> Iterator[Chunk]:
    """Compute on worker processes ("loky") or threads ("threading"); chunks come as they finish."""
    import joblib

    work = joblib.delayed(partial(compute_in_process, os.getpid()) if backend == "loky" else compute)
    # batch_size=1: a work unit is long enough by itself, and each is to be kept as soon as it is finished.
    parallel = joblib.Parallel(jobs, backend=backend, batch_size=1, return_as="generator_unordered")
    with closing(parallel(work(task, case, seed, span) for span in spans)) as chunks:
        try:
            yield from chunks
        except BrokenProcessPool as error:
            raise SysidError(
                f"a worker process died in case {case!r}, perhaps for want of memory; the finished runs are "
                "kept: resume with fewer jobs"
            ) from error


class DaskPool:
    """A connection to a Dask cluster, kept from one case to the next."""

    def __init__(self) -> None:
        self._client: Any = None
        self._close: weakref.finalize[Any, DaskPool] | None = None

    def open(self, scheduler: str | None, jobs: int) -> None:
        """Connect to `scheduler`; when it is None, start `jobs` local worker processes.

        Raises
        ------
        UsageError
            When Dask is not installed, nothing answers, or the workers have other versions.
        """
        if self._client is None:
            self._client = _connect(scheduler, jobs)
            self._close = weakref.finalize(self, _disconnect, self._client)

    def compute(self, task: Task, case: str, seed: int, spans: Iterable[Span]) -> Iterator[Chunk]:
        """Compute on the workers; chunks come as they finish."""
        return _compute_on_dask(self._client, task, case, seed, iter(spans))

    def close(self) -> None:
        """Give the connection back; a local cluster ends."""
        if self._close is not None:
            self._close()
        self._client = None


def _compute_on_dask(client: Any, task: Task, case: str, seed: int, spans: Iterator[Span]) -> Iterator[Chunk]:
    # Two units a thread: one in work, one at hand. The scheduler repeats what a lost worker had.
    in_flight = 2 * max(sum(client.nthreads().values()), 1)
    submitted = (client.submit(compute_pinned, task, case, seed, span, pure=False) for span in spans)
    pending = set(islice(submitted, in_flight))
    finished = _distributed().as_completed(pending, loop=client.loop)
    try:
        for future in finished:
            pending.discard(future)
            yield _result(future, case)
            for new in islice(submitted, in_flight - len(pending)):
                pending.add(new)
                finished.add(new)
    finally:
        client.cancel(list(pending))


def _result(future: Any, case: str) -> Chunk:
    try:
        chunk: Chunk = future.result()
    except SysidError:
        raise
    except Exception as error:  # the cluster's: what the task raises is part of a chunk
        cause = error.__cause__ or error
        remedy = (
            "install the task's module where the workers can import it"
            if isinstance(cause, ImportError)
            else "the finished runs are kept: resume when the cluster is back"
        )
        raise SysidError(
            f"the Dask cluster cannot compute case {case!r} ({_brief(cause)}); {remedy}"
        ) from error
    return chunk


def _connect(scheduler: str | None, jobs: int) -> Any:
    distributed = _distributed()
    for name in ("distributed", "distributed.client"):
        # What these say in tracebacks about a lost connection, the errors raised here say in a sentence.
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if scheduler is None:
        cluster = distributed.LocalCluster(
            n_workers=jobs,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        )
        return distributed.Client(cluster, set_as_default=False)
    if not _ADDRESS.fullmatch(scheduler):
        # Dask itself would complain again, in a traceback, when its half-made client is thrown away.
        raise UsageError(
            f"{scheduler!r} is no address of a Dask scheduler: give tcp://HOST:PORT, as tcp://127.0.0.1:8786"
        )
    try:
        client = distributed.Client(scheduler, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise UsageError(
            f"no Dask scheduler answers at {scheduler!r} within {CONNECT_SECONDS:g} s; "
            "check the address (tcp://HOST:PORT) and that it runs"
        ) from error
    try:
        _check_workers(client, scheduler)
    except BaseException:
        client.close()
        raise
    return client


def _distributed() -> Any:
    try:
        return import_module("distributed")
    except ImportError as error:
        raise UsageError(
            "the backend 'dask' needs the package dask[distributed], which is not installed; "
            "install sysid[dask] or choose the backend 'loky'"
        ) from error


def _check_workers(client: Any, scheduler: str) -> None:
    """Make sure that there are workers and that they compute with the same versions."""
    try:
        client.wait_for_workers(1, timeout=CONNECT_SECONDS)
    except TimeoutError as error:
        raise UsageError(
            f"the Dask scheduler at {scheduler!r} has no worker after {CONNECT_SECONDS:g} s; start one with "
            f"'dask worker {scheduler}'"
        ) from error
    ours = versions()
    for worker, theirs in client.run(versions, on_error="return").items():
        if theirs != ours:
            raise UsageError(
                f"the Dask worker {worker} has {theirs} where this process has {ours}; the numbers could "
                "differ: install the same versions there"
            )


def _disconnect(client: Any) -> None:
    cluster = client.cluster
    client.close()
    if cluster is not None:
        cluster.close()


def _brief(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]
