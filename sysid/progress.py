"""Progress bars: on a terminal, and only for work of more than about a second."""

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.progress import Progress as Bars
    from rich.progress import TaskID

# Called with the number of steps done and to do.
Callback = Callable[[int, int], None]


@dataclass(frozen=True)
class ProgressTask:
    """One bar; made by `Progress.task`, usable from any thread."""

    _bars: "Bars | None"
    _id: "TaskID | None"

    def advance(self, steps: int = 1) -> None:
        """Move the bar on by `steps`."""
        if self._bars is not None and self._id is not None:
            self._bars.advance(self._id, steps)


class Progress:
    """A set of bars, one below the other; made by `progress`.

    Parameters
    ----------
    bars : rich.progress.Progress or None
        What is drawn; None is quiet.
    delay : float
        The bars appear when the work has lasted this long [s].
    """

    def __init__(self, bars: "Bars | None" = None, delay: float = 1.0) -> None:
        self._bars = bars
        self._delay = delay
        self._lock = threading.Lock()
        self._timer: threading.Timer | None = None
        self._closed = False

    @contextmanager
    def task(self, description: str, total: int | None, completed: int = 0) -> Iterator[ProgressTask]:
        """Show a bar with count, share and remaining time while the block runs.

        Parameters
        ----------
        description : str
            Text before the bar.
        total : int or None
            Number of steps; None when it is not known.
        completed : int
            Steps done before, e.g. by the study that is being resumed.
        """
        if self._bars is None:
            yield ProgressTask(None, None)
            return
        self._start_clock()
        identifier = self._bars.add_task(description, total=total, completed=completed)
        try:
            yield ProgressTask(self._bars, identifier)
        finally:
            self._bars.remove_task(identifier)

    def close(self) -> None:
        """Remove the bars from the terminal; they do not come back."""
        with self._lock:
            self._closed = True
            if self._timer is not None:
                self._timer.cancel()
            if self._bars is not None:
                self._bars.stop()

    def _start_clock(self) -> None:
        with self._lock:
            if self._timer is None and not self._closed:
                self._timer = threading.Timer(self._delay, self._show)
                self._timer.daemon = True
                self._timer.start()

    def _show(self) -> None:
        with self._lock:
            if self._bars is not None and not self._closed:
                self._bars.start()


@contextmanager
def progress(
    enabled: bool | None = None, *, delay: float = 1.0, stream: TextIO | None = None
) -> Iterator[Progress]:
    """Open a set of progress bars for the length of the block.

    Parameters
    ----------
    enabled : bool or None
        True draws, False is quiet, None draws when `stream` is a terminal.
    delay : float
        The bars appear when the work has lasted this long [s], so that short work does not flicker.
    stream : text file or None
        Where to draw; None is standard error.

    Yields
    ------
    Progress

    Examples
    --------
    >>> with progress(False) as bars, bars.task("runs", total=3) as task:
    ...     for _ in range(3):
    ...         task.advance()
    """
    stream = sys.stderr if stream is None else stream
    shown = stream.isatty() if enabled is None else enabled
    bars = Progress(_rich_bars(stream, force=enabled is True) if shown else None, delay)
    try:
        yield bars
    finally:
        bars.close()


def _rich_bars(stream: TextIO, force: bool) -> "Bars":
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bars

    return Bars(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(file=stream, force_terminal=True if force else None),
        transient=True,
        refresh_per_second=5,
    )


def percent_of(bar: ProgressTask) -> Callback:
    """Return a callback that moves a bar of 100 steps to the share that is done."""
    shown = 0

    def move(done: int, total: int) -> None:
        nonlocal shown
        now = 100 * done // max(total, 1)
        bar.advance(now - shown)
        shown = now

    return move


def part_of(progress: Callback | None, first: int, last: int) -> Callback | None:
    """Return a callback that moves from one percentage to another."""
    if progress is None:
        return None
    return lambda done, total: progress(first + (last - first) * done // max(total, 1), 100)
