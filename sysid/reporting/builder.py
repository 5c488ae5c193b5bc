"""From a results folder to ``report.html`` and ``report.pdf``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from sysid.errors import UsageError
from sysid.reporting.blocks import group
from sysid.reporting.document import Chapter, assemble, made_cell, made_notebook
from sysid.reporting.execute import execute
from sysid.reporting.front import front_page
from sysid.reporting.records import Results, claims, gates, load, monte_carlo

FORMATS = ("html", "pdf")
TITLE = "Replication report"

Progress = Callable[[int, int, str], None]


def build(
    results_folder: Path | str,
    formats: Sequence[str] = FORMATS,
    progress: Progress | None = None,
    *,
    notebooks: Mapping[str, Path] | None = None,
    title: str = TITLE,
) -> dict[str, Path]:
    """Write the report of a run: a front page and one chapter for each paper.

    Parameters
    ----------
    results_folder : path
        Folder with ``results.json``; the report goes beside it.
    formats : sequence of str
        Any of ``"html"`` and ``"pdf"``.
    progress : callable, optional
        Called as ``progress(done, total, what)`` before each step and once at the end.
    notebooks : mapping, optional
        Paper to its notebook (jupytext percent text). A paper without one gets a chapter of plain tables.
    title : str
        Title of the report.

    Returns
    -------
    dict
        Format to the path of the file written.

    Raises
    ------
    UsageError
        If a format is unknown or a notebook belongs to no paper of the results.
    DataError
        If ``results.json`` cannot be read.
    ReportError
        If a notebook cannot be executed or shown; the message names the cell.
    """
    if unknown := sorted(set(formats) - set(FORMATS)):
        raise UsageError(f"report format {unknown[0]!r} is unknown; choose from {', '.join(FORMATS)}")
    folder = Path(results_folder).resolve()
    results = load(folder)
    papers, sources = results["papers"], notebooks or {}
    wanted = [name for name in FORMATS if name in formats]
    if not wanted:
        return {}
    steps = _Steps(progress, len(papers) + len(wanted))

    chapters = []
    for paper in papers:
        steps.begin(f"chapter {paper}")
        heading = str(papers[paper].get("title") or paper)
        source = sources.get(paper)
        notebook = execute(Path(source), folder) if source else _plain_chapter(results, paper)
        chapters.append(Chapter(paper, heading, notebook))
    document = assemble(title, front_page(results, title), chapters)

    written = {}
    for name in wanted:
        steps.begin(f"report.{name}")
        written[name] = _write(folder / f"report.{name}", _render(name, document))
    steps.end()
    return written


class _Steps:
    """Counts the steps for whoever shows the progress."""

    def __init__(self, report: Progress | None, total: int) -> None:
        self.report, self.total, self.done = report, total, -1

    def begin(self, what: str) -> None:
        self.done += 1
        if self.report:
            self.report(self.done, self.total, what)

    def end(self) -> None:
        self.begin("done")


def _render(name: str, document: Any) -> bytes:
    if name == "html":
        from sysid.reporting.html import page

        return page(document).encode("utf-8")
    from sysid.reporting.pdf import pdf

    return pdf(document)


def _write(path: Path, content: bytes) -> Path:
    """Replace the file in one step, so that an interrupted build leaves no half of a report."""
    draft = path.with_name(f".{path.name}.part")
    draft.write_bytes(content)
    draft.replace(path)
    return path


def _plain_chapter(results: Results, paper: str) -> Any:
    """Make a chapter without narrative: claims, studies, gates."""
    content = results["papers"][paper]
    shown = [claims(results, paper)] if content.get("claims") else []
    shown += [monte_carlo(results, paper, case) for case in content.get("monte_carlo", {})]
    shown += [gates(results, paper)] if content.get("gates") else []
    return made_notebook([made_cell(f"the chapter of {paper}", list(group(*shown).blocks))])
