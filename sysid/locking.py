"""One writer a folder: two runs that write into the same folder would take away each other's files."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sysid.errors import UsageError


@contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Keep a folder for this process inside a ``with`` block.

    The lock is on the folder itself, leaves no file behind, and ends with the process.

    Parameters
    ----------
    folder : Path
        Made when it does not exist.

    Raises
    ------
    UsageError
        If the folder cannot be written, or another process writes into it.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as name, only_writer(Path(name, "results")):
    ...     Path(name, "results").is_dir()
    True
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(0, "no permission")
    except OSError as error:
        raise UsageError(
            f"the folder {folder} cannot be written ({error.strerror}): name a folder that can be"
        ) from None
    handle = _lock(folder)
    try:
        yield
    finally:
        if handle is not None:
            os.close(handle)


def _lock(folder: Path) -> int | None:
    """Lock a folder and return the handle that holds the lock; None where there are no such locks."""
    try:
        import fcntl
    except ImportError:  # another platform
        return None
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise UsageError(
            f"another process writes into the folder {folder}: wait for it to end or name another folder"
        ) from None
    except OSError:  # a file system without locks
        os.close(handle)
        return None
    return handle
