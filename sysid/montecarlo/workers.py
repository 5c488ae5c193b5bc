"""Manners of a process that computes runs: one BLAS thread, no output, an end with its parent."""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Iterator
from functools import cache

import threadpoolctl

from sysid.montecarlo.runs import Chunk, Span, Task, compute

_ORPHAN_CHECK_SECONDS = 0.5
_pinning = threading.Lock()


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS on one thread, in all threads of this process: the sums of many threads round differently."""
    _load_blas()
    with threadpoolctl.threadpool_limits(limits=1, user_api="blas"):
        yield


def compute_in_process(parent: int, task: Task, case: str, seed: int, span: Span) -> Chunk:
    """Compute a work unit in a worker process of `parent`.

    The worker prints nothing, leaves Ctrl-C to the parent, and ends when the parent was killed.
    """
    if os.getpid() == parent:  # where joblib cannot start processes it computes in this one
        return compute(task, case, seed, span)
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with(parent)
    with (
        open(os.devnull, "w") as sink,  # noqa: PTH123
        contextlib.redirect_stdout(sink),
        contextlib.redirect_stderr(sink),
    ):
        return compute_pinned(task, case, seed, span)


def compute_pinned(task: Task, case: str, seed: int, span: Span) -> Chunk:
    """Compute a work unit in a process that works for others: BLAS stays on one thread for good.

    Work units may run side by side in threads of the process, so none of them may lift the limit.
    """
    _load_blas()
    with _pinning:
        # Newer versions listen to the first thread that sets a limit only, and that may have ended.
        getattr(threadpoolctl, "clear_controlling_thread", lambda: None)()
        threadpoolctl.threadpool_limits(limits=1, user_api="blas")
    return compute(task, case, seed, span)


def _load_blas() -> None:
    """Load SciPy's own BLAS: a limit holds only for libraries that are loaded when it is set."""
    import scipy.linalg  # noqa: F401


@cache
def _end_with(parent: int) -> None:
    """Watch `parent`; a worker whose parent was killed would otherwise wait for work for minutes."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_ORPHAN_CHECK_SECONDS)
        os._exit(1)

    if os.name == "posix" and os.getppid() == parent:
        threading.Thread(target=watch, daemon=True).start()
