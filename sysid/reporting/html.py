"""Nodes to HTML, and by nbconvert to one self-contained page."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from sysid.reporting.document import blocks_of
from sysid.reporting.mathematics import embedded_math_font
from sysid.reporting.nodes import Blocks, Inline, Node, plain, walk

_MANY_COLUMNS = 5
_SHORT = 20  # characters


def templates() -> Path:
    """Find the folder of templates that ships with the notebooks."""
    return Path(str(files("reports"))) / "templates"


def page(notebook: Any) -> str:
    """Convert an assembled notebook to one HTML page that loads nothing.

    Parameters
    ----------
    notebook : nbformat.NotebookNode
        From `sysid.reporting.document.assemble`.

    Returns
    -------
    str
    """
    exporter = _exporter()
    elements = [node["mathml"] for node in walk_all(blocks_of(notebook)) if "mathml" in node]
    style = (files("sysid.reporting") / "page.css").read_text(encoding="utf-8")
    resources = {"page_style": style, "math_font": embedded_math_font(elements)}
    text: str = exporter.from_notebook_node(notebook, resources)[0]
    return text


def walk_all(blocks: Blocks) -> Sequence[Node]:
    """List all nodes, those of the table of contents included."""
    entries = [entry for block in blocks for entry in block.get("entries", ())]
    return [*walk(blocks), *(node for entry in entries for node in walk(entry["c"]))]


def _exporter() -> Any:
    """Give nbconvert's exporter a template without scripts that asks no server for anything."""
    from nbconvert.exporters import HTMLExporter

    make: Any = HTMLExporter
    exporter = make(extra_template_basedirs=[str(templates())], template_name="page")
    exporter.register_filter("page_html", html)
    return exporter


def html(blocks: Blocks) -> str:
    """Render block nodes; every text in them is escaped.

    Examples
    --------
    >>> html([{"t": "para", "c": [{"t": "text", "s": "a < b"}]}])
    '<p>a &lt; b</p>'
    """
    return "\n".join(_BLOCKS[block["t"]](block) for block in blocks)


def inline_html(nodes: Inline) -> str:
    """Render inline nodes; every text in them is escaped."""
    return "".join(_INLINE[node["t"]](node) for node in nodes)


def _title(node: Node) -> str:
    return (
        f'<header><h1>{inline_html(node["c"])}</h1>\n<p class="lead">{inline_html(node["lead"])}</p></header>'
    )


def _chapter(node: Node) -> str:
    number = f'<span class="number">{node["number"]}</span>'
    return f'<h2 class="chapter" id="{escape(node["id"])}">{number} {inline_html(node["c"])}</h2>'


def _heading(node: Node) -> str:
    level = min(node["level"], 5) + (0 if node["id"].startswith("front-") else 1)
    number = f'<span class="number">{node["number"]}</span> ' if "number" in node else ""
    return f'<h{level} id="{escape(node["id"])}">{number}{inline_html(node["c"])}</h{level}>'


def _list(node: Node) -> str:
    name = "ol" if node["ordered"] else "ul"
    start = f' start="{node["start"]}"' if node["ordered"] and node["start"] != 1 else ""
    items = "".join(f"<li>{_item(item)}</li>\n" for item in node["items"])
    return f"<{name}{start}>\n{items}</{name}>"


def _item(blocks: Blocks) -> str:
    return inline_html(blocks[0]["c"]) if [b["t"] for b in blocks] == ["para"] else html(blocks)


def _equation(node: Node) -> str:
    tag = f'<span class="tag">({escape(node["tag"])})</span>' if node["tag"] else ""
    return f'<div class="equation">{node["mathml"]}{tag}</div>'


def _label(node: Node, kind: str) -> str:
    return f'<span class="label">{kind} {node["number"]}.</span> ' if "number" in node else ""


def _table(node: Node) -> str:
    legend = f"<figcaption>{_label(node, 'Table')}{inline_html(node['caption'])}</figcaption>\n"
    sides = [column["align"] for column in node["columns"]]
    heads = "".join(
        f'<th scope="col" class="{side}">{inline_html(column["c"])}</th>'
        for column, side in zip(node["columns"], sides, strict=True)
    )
    rows = "".join(_row(row, sides) for row in node["rows"])
    width = " wide" if len(sides) > _MANY_COLUMNS else ""
    return (
        f'<figure class="table{width}">\n{legend if node["caption"] else ""}<div class="scroll">\n<table>\n'
        f"<thead><tr>{heads}</tr></thead>\n<tbody>\n{rows}</tbody>\n</table>\n</div>\n</figure>"
    )


def _row(row: list[Inline], sides: list[str]) -> str:
    first = inline_html(row[0]) if row else ""
    if len(row) == 1 < len(sides):  # a line across, which heads the rows below it
        head = f'<th scope="rowgroup" colspan="{len(sides)}">{first}</th>'
        return f'</tbody>\n<tbody>\n<tr class="group">{head}</tr>\n'
    cells = [
        f'<td class="{side}{_tied(cell)}">{inline_html(cell)}</td>'
        for cell, side in zip(row, sides, strict=True)
    ]
    cells[:1] = [f'<th scope="row" class="{sides[0]}">{first}</th>']
    return f"<tr>{''.join(cells)}</tr>\n"


def _tied(cell: Inline) -> str:
    """Keep a short value in one line; a long list of numbers may break."""
    return " tied" if len(plain(cell)) <= _SHORT else ""


def _figure(node: Node) -> str:
    data = base64.b64encode(node["svg"].encode("utf-8")).decode("ascii")
    reading = f' <span class="reading">{inline_html(node["reading"])}</span>' if node["reading"] else ""
    style = f' style="max-width:{100 * node["width"]:g}%"' if node["width"] < 1 else ""
    return (
        f'<figure>\n<div class="scroll"><img src="data:image/svg+xml;base64,{data}" '
        f'alt="{escape(node["alt"])}"{style}></div>\n'
        f"<figcaption>{_label(node, 'Figure')}{inline_html(node['caption'])}{reading}</figcaption>\n</figure>"
    )


def _facts(node: Node) -> str:
    items = "".join(
        f"<dt>{inline_html(term)}</dt><dd>{inline_html(value)}</dd>\n" for term, value in node["items"]
    )
    return f'<dl class="facts">\n{items}</dl>'


def _contents(node: Node) -> str:
    items = "".join(
        f'<li class="level-{entry["level"]}"><span class="number">{entry["number"]}</span> '
        f'<a href="#{escape(entry["id"])}">{inline_html(entry["c"])}</a></li>\n'
        for entry in node["entries"]
    )
    return f'<nav aria-label="Contents">\n<ul class="contents">\n{items}</ul>\n</nav>'


def _banner(node: Node) -> str:
    tone = {"passed": "good", "failed": "bad"}.get(node["kind"], "")
    return f'<p class="summary {tone}">{inline_html(node["c"])}</p>'


def _link(node: Node) -> str:
    url = f"#{node['anchor']}" if "anchor" in node else node["url"]
    return f'<a href="{escape(url)}">{inline_html(node["c"])}</a>'


_BLOCKS: dict[str, Callable[[Node], str]] = {
    "title": _title,
    "chapter": _chapter,
    "heading": _heading,
    "contents": _contents,
    "para": lambda node: f"<p>{inline_html(node['c'])}</p>",
    "list": _list,
    "quote": lambda node: f"<blockquote>\n{html(node['c'])}\n</blockquote>",
    "pre": lambda node: f"<pre><code>{escape(node['s'])}</code></pre>",
    "rule": lambda node: "<hr>",
    "equation": _equation,
    "table": _table,
    "figure": _figure,
    "facts": _facts,
    "banner": _banner,
    "box": lambda node: f'<section class="claim">\n{html(node["c"])}\n</section>',
}

_INLINE: dict[str, Callable[[Node], str]] = {
    "text": lambda node: escape(node["s"], quote=False),
    "emph": lambda node: f"<em>{inline_html(node['c'])}</em>",
    "strong": lambda node: f"<strong>{inline_html(node['c'])}</strong>",
    "code": lambda node: f"<code>{escape(node['s'], quote=False)}</code>",
    "math": lambda node: node["mathml"],
    "link": _link,
    "break": lambda node: "<br>",
    "mark": lambda node: f'<span class="{node["kind"]}">{escape(node["s"], quote=False)}</span>',
    "quiet": lambda node: f'<span class="quiet">{inline_html(node["c"])}</span>',
}
