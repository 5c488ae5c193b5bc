"""Run a notebook kept as text, in a kernel of this very interpreter."""

from __future__ import annotations

import json
import os
import re
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any

from sysid.errors import ReportError

KERNEL = "sysid-report"
_FIRST_LINE = "__import__('sysid.reporting.style').reporting.style.use()"  # every figure in the house style
_ESCAPES = re.compile(r"\x1b\[[0-9;]*m")


def execute(path: Path, folder: Path, timeout: float = 600.0) -> Any:
    """Run all cells of a notebook.

    Parameters
    ----------
    path : Path
        Notebook as jupytext percent text.
    folder : Path
        Results folder: the kernel's current folder and its variable ``SYSID_RESULTS``.
    timeout : float
        Longest time of one cell [s].

    Returns
    -------
    nbformat.NotebookNode
        The executed notebook; each cell has the words "cell 3 of bai.py" in ``metadata["place"]``.

    Raises
    ------
    ReportError
        If the file cannot be read or a cell fails; the message names the cell and the exception.
    """
    notebook = read(path)
    if not any(cell.cell_type == "code" for cell in notebook.cells):
        return notebook
    with tempfile.TemporaryDirectory(prefix="sysid-kernel-") as scratch:
        _run(notebook, path, folder, Path(scratch), timeout)
    return notebook


def read(path: Path) -> Any:
    """Read a notebook kept as text and name the place of each cell."""
    import jupytext

    try:
        notebook = jupytext.reads(path.read_text(encoding="utf-8"), fmt="py:percent")
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise ReportError(f"cannot read the notebook {path}: {reason}") from None
    for place, cell in enumerate(notebook.cells, start=1):
        cell.metadata["place"] = f"cell {place} of {path.name}"
    return notebook


def _run(notebook: Any, path: Path, folder: Path, scratch: Path, timeout: float) -> None:
    from nbclient import NotebookClient
    from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

    resources = {"metadata": {"path": str(folder)}}
    with (scratch / "kernel.log").open("w+", encoding="utf-8") as log, warnings.catch_warnings():
        # the client libraries warn of their own event loops and ports; a report has no say in those
        warnings.simplefilter("ignore")
        client = NotebookClient(
            notebook,
            km=_kernel_manager(scratch),
            timeout=timeout,
            resources=resources,
            store_widget_state=False,
        )
        try:
            client.execute(cleanup_kc=True, env=_environment(folder, scratch), stdout=log, stderr=log)
        except CellExecutionError as error:
            raise ReportError(_failure(notebook, path, error)) from None
        except CellTimeoutError:
            raise ReportError(
                f"a cell of {path.name} took longer than {timeout:g} s; move the work out of it"
            ) from None
        except (DeadKernelError, RuntimeError) as error:
            log.seek(0)
            said = log.read().strip().splitlines()
            raise ReportError(f"the kernel for {path.name} died: {said[-1] if said else error}") from None


def _kernel_manager(scratch: Path) -> Any:
    """Make a manager that knows one kernel: this interpreter, whatever is installed beside it."""
    from jupyter_client.kernelspec import KernelSpecManager
    from jupyter_client.manager import AsyncKernelManager

    specification = scratch / "kernels" / KERNEL
    specification.mkdir(parents=True)
    command = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
    command += ["--HistoryManager.enabled=False", "--InteractiveShell.colors=nocolor"]
    command += [f"--IPKernelApp.exec_lines={_FIRST_LINE}"]
    content = {"argv": command, "display_name": "sysid report", "language": "python"}
    (specification / "kernel.json").write_text(json.dumps(content), encoding="utf-8")
    return AsyncKernelManager(
        kernel_name=KERNEL,
        kernel_spec_manager=KernelSpecManager(
            kernel_dirs=[str(scratch / "kernels")], ensure_native_kernel=False
        ),
        connection_file=str(scratch / "connection.json"),
        transport="tcp",
    )


def _environment(folder: Path, scratch: Path) -> dict[str, str]:
    return {
        **os.environ,
        "SYSID_RESULTS": str(folder),
        "IPYTHONDIR": str(scratch / "ipython"),  # no start-up files or extensions of the user
        "JUPYTER_RUNTIME_DIR": str(scratch),
        "PYDEVD_DISABLE_FILE_VALIDATION": "1",
    }


def _failure(notebook: Any, path: Path, error: Any) -> str:
    reason = " ".join(_ESCAPES.sub("", f"{error.ename}: {error.evalue}").split())
    for cell in notebook.cells:
        if any(output.get("output_type") == "error" for output in cell.get("outputs", ())):
            line = cell.source.strip().splitlines()[0]
            return f"{cell.metadata['place']} (which begins {line!r}) failed with {reason}"
    return f"{path.name} failed with {reason}"
