"""Markdown to nodes: the one reader of narrative for both HTML and PDF."""

from __future__ import annotations

import re
from functools import cache
from typing import TYPE_CHECKING, Any

from sysid.errors import ReportError
from sysid.reporting.nodes import Blocks, Inline, Node, heading, text

if TYPE_CHECKING:
    from mistune import BlockParser, BlockState, InlineParser, InlineState, Markdown

# a formula may run over lines, not over a blank line; $$ ... $$ may stand alone or inside a paragraph
_DISPLAYED = r"^ {0,3}\$\$(?P<displayed>(?:(?!\$\$)[\s\S])+)\$\$[ \t]*(?:\n|$)"
_IN_LINE = r"\$\$(?P<both>(?:(?!\$\$)[\s\S])+)\$\$|\$(?![\s$])(?P<one>(?:[^$\\]|\\[\s\S])+?)(?<!\s)\$(?!\d)"
_TAG = re.compile(r"\\tag\s*\{([^{}]*)\}")
_SAFE_LINK = re.compile(r"(https?://|mailto:|#|doi:)", re.IGNORECASE)


@cache
def _reader() -> Markdown:
    import mistune
    from mistune.plugins.table import table

    reader = mistune.create_markdown(renderer=None)
    table(reader)
    reader.block.register("block_math", _DISPLAYED, _displayed, before="list")
    reader.block.insert_rule(reader.block.list_rules, "block_math", before="list")
    reader.block.insert_rule(reader.block.block_quote_rules, "block_math", before="list")
    reader.inline.register("dollar", r"\\\$", _dollar, before="escape")
    reader.inline.register("inline_math", _IN_LINE, _in_line, before="codespan")
    return reader


def _displayed(block: BlockParser, found: re.Match[str], state: BlockState) -> int:
    state.append_token({"type": "block_math", "raw": found["displayed"]})
    return found.end()


def _in_line(inline: InlineParser, found: re.Match[str], state: InlineState) -> int:
    kind = "block_math" if found["both"] else "inline_math"
    state.append_token({"type": kind, "raw": found["both"] or " ".join(found["one"].split())})
    return found.end()


def _dollar(inline: InlineParser, found: re.Match[str], state: InlineState) -> int:
    state.append_token({"type": "dollar"})
    return found.end()


def parse(source: str) -> Blocks:
    r"""Read markdown with ``$...$`` and ``$$...$$`` mathematics.

    Parameters
    ----------
    source : str
        Markdown; HTML in it is shown as written, never interpreted.

    Returns
    -------
    list of dict
        Block nodes.

    Raises
    ------
    ReportError
        If the text asks for a picture file (a figure comes from ``display.figure``) or an unsafe link.

    Examples
    --------
    >>> [node["t"] for node in parse("# Title\n\nSome *words*.")]
    ['heading', 'para']
    """
    tokens, _ = _reader().parse(source)
    assert isinstance(tokens, list)
    return _blocks(tokens)


def inline(source: str) -> Inline:
    """Read one line of markdown, as in a caption.

    Examples
    --------
    >>> [node["t"] for node in inline("cost $J(a)$")]
    ['text', 'math']
    """
    content: Inline = []
    for block in parse(source):
        if content:
            content.append(text(" "))
        if block["t"] == "para":
            content.extend(block["c"])
        else:  # "1. row" and the like: one line is never a list or a heading
            content.append(text(source.strip()))
            break
    return content


def equation(source: str) -> Node:
    r"""Make a displayed equation; ``\tag{2.9}`` gives it the number (2.9)."""
    tags = _TAG.findall(source)
    if len(tags) > 1:
        raise ReportError(f"the equation {source.strip()!r} has {len(tags)} tags; give each its own $$ block")
    return {"t": "equation", "tex": _TAG.sub("", source).strip(), "tag": tags[0] if tags else None}


def _blocks(tokens: list[dict[str, Any]]) -> Blocks:
    return [node for token in tokens for node in _block(token)]


def _block(token: dict[str, Any]) -> Blocks:
    kind = token["type"]
    match kind:
        case "blank_line":
            return []
        case "paragraph" | "block_text":
            return _paragraphs(token["children"])
        case "heading":
            return [heading(token["attrs"]["level"], _inline(token["children"]))]
        case "block_math":
            return [equation(token["raw"])]
        case "block_code":
            return [{"t": "pre", "s": token["raw"].rstrip("\n")}]
        case "block_quote":
            return [{"t": "quote", "c": _blocks(token["children"])}]
        case "block_html":
            return [{"t": "para", "c": [text(token["raw"].strip())]}]
        case "thematic_break":
            return [{"t": "rule"}]
        case "list":
            attrs = token["attrs"]
            items = [_blocks(item["children"]) for item in token["children"]]
            return [
                {"t": "list", "ordered": attrs["ordered"], "start": attrs.get("start", 1), "items": items}
            ]
        case "table":
            return [_table(token)]
    raise ReportError(f"the markdown construct {kind!r} is not supported; write it in plainer markdown")


def _paragraphs(children: list[dict[str, Any]]) -> Blocks:
    """Split a paragraph at the displayed equations written inside it."""
    blocks: Blocks = []
    run: list[dict[str, Any]] = []
    for child in [*children, {"type": "block_math", "raw": None}]:
        if child["type"] != "block_math":
            run.append(child)
            continue
        content = _inline(run)
        if any(node["t"] != "text" or node["s"].strip() for node in content):
            blocks.append({"t": "para", "c": content})
        if child["raw"] is not None:
            blocks.append(equation(child["raw"]))
        run = []
    return blocks


def _table(token: dict[str, Any]) -> Node:
    head, body = token["children"]
    alignments = {"left": "left", "right": "right", "center": "centre"}
    columns = [
        {"c": _inline(cell["children"]), "align": alignments.get(cell["attrs"].get("align"), "left")}
        for cell in head["children"]
    ]
    rows = [[_inline(cell["children"]) for cell in row["children"]] for row in body["children"]]
    return {"t": "table", "caption": [], "columns": columns, "rows": rows}


def _inline(tokens: list[dict[str, Any]]) -> Inline:
    return [_inline_node(token) for token in tokens]


def _inline_node(token: dict[str, Any]) -> Node:
    kind = token["type"]
    match kind:
        case "text":
            return _words(token["raw"])
        case "inline_html":
            return text(token["raw"])
        case "dollar":
            return text("$")
        case "softbreak":
            return text(" ")
        case "linebreak":
            return {"t": "break"}
        case "emphasis":
            return {"t": "emph", "c": _inline(token["children"])}
        case "strong":
            return {"t": "strong", "c": _inline(token["children"])}
        case "codespan":
            return {"t": "code", "s": token["raw"]}
        case "inline_math":
            return {"t": "math", "tex": token["raw"]}
        case "link":
            return _link(token)
        case "image":
            raise ReportError(
                f"the narrative asks for the picture {token['attrs']['url']!r}, but pages load nothing; "
                "show it by display.figure"
            )
    raise ReportError(f"the markdown construct {kind!r} is not supported; write it in plainer markdown")


def _words(raw: str) -> Node:
    """Take text as it is; a dollar sign that is left over is a formula gone wrong."""
    if "$" in raw:
        raise ReportError(rf"a lone dollar sign in {raw!r}; close the formula, or write \$ for the sign")
    return text(raw)


def _link(token: dict[str, Any]) -> Node:
    url = token["attrs"]["url"]
    if not _SAFE_LINK.match(url):
        raise ReportError(
            f"the link to {url!r} would break outside the results folder; use https: or #section"
        )
    return {"t": "link", "url": url, "c": _inline(token["children"])}
