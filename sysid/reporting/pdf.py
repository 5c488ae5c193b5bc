"""An assembled notebook to PDF by Typst: no LaTeX, no browser, no font of the machine."""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

from sysid.errors import ReportError
from sysid.reporting.document import blocks_of
from sysid.reporting.html import templates
from sysid.reporting.mathematics import math_font_file


def pdf(notebook: Any) -> bytes:
    """Typeset an assembled notebook.

    Parameters
    ----------
    notebook : nbformat.NotebookNode
        From `sysid.reporting.document.assemble`.

    Returns
    -------
    bytes
        A tagged PDF with outlines; the same notebook gives the same bytes.

    Raises
    ------
    ReportError
        If Typst refuses the document.
    """
    import typst

    document = {"title": notebook.metadata["title"], "blocks": _without_mathml(blocks_of(notebook))}
    with tempfile.TemporaryDirectory(prefix="sysid-pdf-") as scratch:
        folder = Path(scratch)
        shutil.copyfile(templates() / "report.typ", folder / "report.typ")
        (folder / "document.json").write_text(json.dumps(document, ensure_ascii=False), encoding="utf-8")
        try:
            data: bytes = typst.compile(
                str(folder / "report.typ"),
                root=str(folder),
                font_paths=[str(math_font_file().parent)],
                ignore_system_fonts=True,
                format="pdf",
                timestamp=0,
            )
        except typst.TypstError as error:
            raise ReportError(f"Typst cannot set the report: {error}") from None
    return data


def _without_mathml(nodes: Any) -> Any:
    """Leave out what only browsers read."""
    if isinstance(nodes, dict):
        return {key: _without_mathml(value) for key, value in nodes.items() if key != "mathml"}
    return [_without_mathml(node) for node in nodes] if isinstance(nodes, list) else nodes
