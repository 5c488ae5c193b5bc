"""Executed notebooks to the blocks of one document: numbered, linked, with the mathematics typeset."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from sysid.errors import ReportError
from sysid.reporting.markdown import equation, parse
from sysid.reporting.mathematics import mathml
from sysid.reporting.nodes import MIME, Blocks, Inline, Node, plain, slug, text, walk
from sysid.reporting.typst_math import typst_math


@dataclass(frozen=True)
class Chapter:
    """One executed notebook (or a made-up one) under the identifier of its paper."""

    identifier: str
    title: str
    notebook: Any


def assemble(title: str, front: Blocks, chapters: Sequence[Chapter]) -> Any:
    """Join the front page and the chapters into one notebook.

    Parameters
    ----------
    title : str
        Title of the report.
    front : list of dict
        Blocks of the front page; a block ``contents`` among them receives its entries.
    chapters : sequence of Chapter
        In the order of the report.

    Returns
    -------
    nbformat.NotebookNode
        Every cell carries its blocks in ``metadata["blocks"]``: what the HTML template and the PDF show.

    Raises
    ------
    ReportError
        If a formula is not understood or a link leads nowhere; the message names the cell.
    """
    cells = []
    for number, chapter in enumerate(chapters, start=1):
        cells += _chapter(chapter, number)
    entries = _contents(cells)
    front = [{**block, "entries": entries} if block["t"] == "contents" else block for block in front]
    cells.insert(0, made_cell("the front page", front))
    anchors = {node["id"] for cell in cells for node in walk(cell.metadata["blocks"]) if "id" in node}
    for cell in cells:
        _finish(cell.metadata["blocks"], anchors, cell.metadata["place"])
    return made_notebook(cells, title=title)


def blocks_of(notebook: Any) -> Blocks:
    """List the blocks of an assembled notebook in reading order."""
    return [block for cell in notebook.cells for block in cell.metadata["blocks"]]


def made_cell(place: str, blocks: Blocks) -> Any:
    """Make a cell that no notebook file holds."""
    import nbformat.v4

    make: Any = nbformat.v4
    return make.new_code_cell(metadata={"place": place, "blocks": blocks})


def made_notebook(cells: Sequence[Any], **metadata: Any) -> Any:
    """Make a notebook of cells."""
    import nbformat.v4

    make: Any = nbformat.v4
    return make.new_notebook(cells=list(cells), metadata=metadata)


def _chapter(chapter: Chapter, number: int) -> list[Any]:
    """Give each cell its blocks and number what carries a caption."""
    cells = [cell for cell in chapter.notebook.cells if cell.cell_type in ("markdown", "code")]
    for cell in cells:
        if "blocks" not in cell.metadata:
            cell.metadata["blocks"] = _cell_blocks(cell)
    opening = _opening(chapter, cells, number)
    cells[:0] = [opening]
    _Numbers(chapter.identifier, number).apply(cells[1:])
    return cells


def _opening(chapter: Chapter, cells: list[Any], number: int) -> Any:
    """Make the chapter's title from the notebook's first heading, else from the results."""
    content: Inline = [text(chapter.title)]
    for cell in cells:
        blocks = cell.metadata["blocks"]
        if blocks and blocks[0]["t"] == "heading" and blocks[0]["level"] == 1:
            content = blocks.pop(0)["c"]
        if blocks:
            break
    node: Node = {"t": "chapter", "id": chapter.identifier, "number": str(number), "c": content}
    return made_cell(f"chapter {chapter.identifier}", [node])


def _cell_blocks(cell: Any) -> Blocks:
    place = cell.metadata["place"]
    try:
        if cell.cell_type == "markdown":
            return parse(cell.source)
        return [block for output in cell.outputs for block in _output_blocks(output)]
    except ReportError as error:
        raise ReportError(f"{place}: {error}") from None


def _output_blocks(output: Any) -> Blocks:
    if output.output_type == "stream":
        return [{"t": "pre", "s": output.text.rstrip("\n")}]
    data = output.get("data", {})
    if MIME in data:
        blocks: Blocks = data[MIME]["blocks"]
        return blocks
    if "text/markdown" in data:
        return parse(data["text/markdown"])
    if "text/latex" in data:
        return [equation(data["text/latex"].strip().strip("$"))]
    if "image/svg+xml" in data or "image/png" in data:
        raise ReportError(
            "the output is a picture without caption; show it by display.figure(figure, caption)"
        )
    return [{"t": "pre", "s": data["text/plain"]}] if "text/plain" in data else []


class _Numbers:
    """Counters of one chapter: sections, tables, figures; unique identifiers of headings."""

    def __init__(self, chapter: str, number: int) -> None:
        self.chapter, self.number = chapter, number
        self.counts = {"section": 0, "table": 0, "figure": 0}
        self.seen: dict[str, int] = {}

    def apply(self, cells: list[Any]) -> None:
        for cell in cells:
            for node in walk(cell.metadata["blocks"]):
                self._visit(node)

    def _visit(self, node: Node) -> None:
        if node["t"] == "heading":
            node["level"] = max(node["level"], 2)
            node["id"] = self._unique(f"{self.chapter}-{slug(plain(node['c']))}")
            if node["level"] == 2:
                node["number"] = self._next("section")
        elif node["t"] in ("table", "figure") and node["caption"]:
            node["number"] = self._next(node["t"])
        elif node["t"] == "link" and node["url"].startswith("#"):
            node["chapter"] = self.chapter

    def _next(self, kind: str) -> str:
        self.counts[kind] += 1
        return f"{self.number}.{self.counts[kind]}"

    def _unique(self, identifier: str) -> str:
        self.seen[identifier] = self.seen.get(identifier, 0) + 1
        return identifier if self.seen[identifier] == 1 else f"{identifier}-{self.seen[identifier]}"


def _contents(cells: list[Any]) -> list[Node]:
    return [
        {"level": node.get("level", 1), "id": node["id"], "number": node["number"], "c": node["c"]}
        for cell in cells
        for node in cell.metadata["blocks"]
        if node["t"] in ("chapter", "heading") and "number" in node
    ]


def _finish(blocks: Blocks, anchors: set[str], place: str) -> None:
    """Typeset the mathematics and settle the links of a cell."""
    for node in _with_contents(blocks):
        if node["t"] in ("math", "equation"):
            try:
                node["mathml"] = mathml(node["tex"], display=node["t"] == "equation")
                node["typst"] = typst_math(node["mathml"])
            except ReportError as error:
                raise ReportError(f"{place}: {error}") from None
        elif node["t"] == "link" and node["url"].startswith("#"):
            node["anchor"] = _anchor(node, anchors, place)


def _with_contents(blocks: Blocks) -> Iterator[Node]:
    yield from walk(blocks)
    for block in blocks:
        for entry in block.get("entries", ()):
            yield from walk(entry["c"])


def _anchor(node: Node, anchors: set[str], place: str) -> str:
    target = node["url"][1:]
    for candidate in (f"{node.get('chapter')}-{target}", target):
        if candidate in anchors:
            return candidate
    raise ReportError(
        f"{place}: the link {node['url']} leads nowhere; sections are {', '.join(sorted(anchors))}"
    )
