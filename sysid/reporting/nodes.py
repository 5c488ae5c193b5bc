"""The small vocabulary in which every page is written before it becomes HTML or PDF.

A node is a dictionary with its kind under ``"t"``; it survives JSON, so a notebook's kernel can hand it on.

Inline nodes: ``text`` (s), ``emph`` (c), ``strong`` (c), ``code`` (s), ``math`` (tex), ``link`` (url, c),
``break``, ``mark`` (kind, s: a verdict), ``quiet`` (c: secondary text).

Block nodes: ``para`` (c), ``heading`` (level, c, id), ``list`` (ordered, start, items of blocks), ``quote``
(c: blocks), ``pre`` (s), ``rule``, ``equation`` (tex, tag), ``table`` (caption, columns, rows), ``figure``
(svg, caption, reading, alt, width, floats), ``facts`` (items: pairs of inline lists), ``banner`` (kind,
c), ``box`` (c: blocks). The builder adds ``title`` (c, lead), ``contents`` (entries) and ``chapter`` (id,
number, c).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

Node = dict[str, Any]
Inline = list[Node]
Blocks = list[Node]

MIME = "application/vnd.sysid.nodes+json"
MARKS = ("passed", "failed", "open")


def text(value: object) -> Node:
    """Make plain text: shown letter for letter, never read as markup."""
    return {"t": "text", "s": str(value)}


def mark(word: str, kind: str) -> Node:
    """Make a verdict word; its kind (passed, failed, open) only adds the colour."""
    if kind not in MARKS:
        raise ValueError(f"a mark is one of {', '.join(MARKS)}, not {kind!r}")
    return {"t": "mark", "kind": kind, "s": word}


def heading(level: int, content: Inline) -> Node:
    """Make a heading; its identifier comes from its words."""
    return {"t": "heading", "level": level, "c": content, "id": slug(plain(content))}


def plain(nodes: Sequence[Node]) -> str:
    """Give the words of inline nodes without any markup (mathematics as its source)."""
    parts = []
    for node in nodes:
        if node["t"] == "break":
            parts.append(" ")
        elif node["t"] == "math":
            parts.append(node["tex"])
        else:
            parts.append(node["s"] if "s" in node else plain(node.get("c", [])))
    return "".join(parts)


def slug(words: str) -> str:
    """Turn words into an identifier for links.

    Examples
    --------
    >>> slug("Is the table plausible?")
    'is-the-table-plausible'
    """
    return re.sub(r"[^a-z0-9]+", "-", words.lower()).strip("-") or "section"


def walk(nodes: Sequence[Node]) -> Iterator[Node]:
    """Visit every node of a tree, parents first."""
    for node in nodes:
        yield node
        yield from walk(list(_children(node)))


def _children(node: Node) -> Iterator[Node]:
    for field in ("c", "caption", "reading"):
        yield from node.get(field) or ()
    for item in node.get("items", ()):
        for entry in item:
            yield from entry if isinstance(entry, list) else (entry,)
    for column in node.get("columns", ()):
        yield from column["c"]
    for row in node.get("rows", ()):
        for cell in row:
            yield from cell
