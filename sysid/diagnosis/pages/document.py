"""The comparison as a PDF, typeset like the reports."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from sysid.reporting.nodes import Blocks, Inline, Node, heading, text

if TYPE_CHECKING:
    from sysid.diagnosis.pages.content import Content, Section, Table


def render_pdf(content: "Content") -> bytes:
    """Return the PDF of a comparison, the same content as the page.

    Parameters
    ----------
    content : Content
    """
    from sysid.reporting.document import made_cell, made_notebook
    from sysid.reporting.pdf import pdf

    return pdf(made_notebook([made_cell("the comparison", list(_blocks(content)))], title=content.title))


def _blocks(content: "Content") -> Iterator[Node]:
    lead = f"A model beside measurements it was not fitted to: its free run on the rows of {content.judged}."
    yield {"t": "title", "c": _words(content.title), "lead": _words(lead)}
    yield {"t": "para", "c": [{"t": "strong", "c": _words(content.sentences[0])}]}
    if content.sentences[1:]:
        yield _list(content.sentences[1:])
    for section in content.sections:
        yield heading(2, _words(section.heading))
        yield from _section(section)


def _section(section: "Section") -> Blocks:
    found: Blocks = []
    for paragraph in section.paragraphs:
        lines: Inline = []
        for line in paragraph.split("\n"):
            lines += [*([{"t": "break"}] if lines else []), text(line)]
        found.append({"t": "para", "c": lines})
    if section.items:
        found.append(_list(section.items))
    found += [_table(table) for table in section.tables]
    for picture in section.pictures:
        found.append(
            {
                "t": "figure",
                "svg": picture.wide,
                "caption": _words(picture.title + "."),
                "reading": _words(picture.reading),
                "alt": f"{picture.title}. {picture.reading}",
                "width": 1.0,
                "floats": False,
            }
        )
    if section.facts:
        found.append(
            {"t": "facts", "items": [[_words(name), _words(value)] for name, value in section.facts]}
        )
    return found


def _words(sentence: str) -> Inline:
    return [text(sentence)]


def _list(sentences: "tuple[str, ...]") -> Node:
    items = [[{"t": "para", "c": _words(sentence)}] for sentence in sentences]
    return {"t": "list", "ordered": False, "start": 1, "items": items}


def _table(table: "Table") -> Node:
    columns = [
        {"c": _words(name), "align": "right" if right else "left"}
        for name, right in zip(table.headings, table.right, strict=True)
    ]
    rows = [[_words(cell) for cell in row] for row in table.rows]
    return {"t": "table", "caption": _words(table.caption), "columns": columns, "rows": rows}
