"""Tables, figures, facts and prose as blocks of a page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sysid.errors import UsageError
from sysid.reporting import numbers
from sysid.reporting.markdown import inline, parse
from sysid.reporting.nodes import MIME, Inline, Node, mark, plain, text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Cell = object
Format = str | Callable[[Any], Cell]


@dataclass(frozen=True)
class Display:
    """Blocks of a page, shown by the report builder and by any notebook program."""

    blocks: tuple[Node, ...]

    def _repr_mimebundle_(self, include: object = None, exclude: object = None) -> dict[str, Any]:
        return {MIME: {"blocks": list(self.blocks)}, "text/plain": repr(self)}

    def __repr__(self) -> str:
        return f"Display({', '.join(block['t'] for block in self.blocks)})"


@dataclass(frozen=True)
class Markdown:
    """A table cell that is markdown with mathematics; a plain ``str`` is shown as it is."""

    source: str


@dataclass(frozen=True)
class Verdict:
    """A word with the colour of its kind: passed, failed or open."""

    word: str
    kind: str


def group(*parts: Display) -> Display:
    """Show several displays one after another.

    Examples
    --------
    >>> group(prose("one"), prose("two"))
    Display(para, para)
    """
    return Display(tuple(block for part in parts for block in part.blocks))


def prose(source: str) -> Display:
    """Show markdown that depends on the results.

    Examples
    --------
    >>> prose("The slope is $-1$.")
    Display(para)
    """
    return Display(tuple(parse(source)))


def table(
    rows: Sequence[Sequence[Cell]],
    columns: Sequence[str],
    *,
    caption: str = "",
    formats: Mapping[str, Format] | None = None,
    align: str | None = None,
) -> Display:
    """Show a table.

    Parameters
    ----------
    rows : sequence of sequences
        Cells: numbers, plain text, ``None`` (a dash), `Markdown` or `Verdict`. A row of one cell in a table
        of several columns is a line across, above the rows it speaks of.
    columns : sequence of str
        Column heads, markdown.
    caption : str
        Markdown; a table with a caption is numbered.
    formats : mapping, optional
        Column head to a format specification (``".2f"``) or a function of the value.
    align : str, optional
        One letter a column: l, c or r. By default columns of numbers are set right, the others left.

    Returns
    -------
    Display

    Raises
    ------
    UsageError
        If a row is not as long as the list of columns, or a format names no column.

    Examples
    --------
    >>> table([["preload", 1.0]], ["case", "$a$"], caption="Found.", formats={"$a$": ".2f"})
    Display(table)
    """
    formats = formats or {}
    _check_table(rows, columns, formats, align)
    letters = {"l": "left", "c": "centre", "r": "right"}
    sides = (
        [letters[letter] for letter in align]
        if align
        else [_side(rows, place) for place in range(len(columns))]
    )
    heads = [{"c": inline(head), "align": side} for head, side in zip(columns, sides, strict=True)]
    body = [
        [_cell(value, formats.get(head)) for head, value in zip(columns, row, strict=False)] for row in rows
    ]
    return Display(({"t": "table", "caption": inline(caption), "columns": heads, "rows": body},))


def figure(
    drawing: Figure | str, caption: str, reading: str = "", *, alt: str | None = None, width: float = 1.0
) -> Display:
    """Show a figure as vector graphics.

    Parameters
    ----------
    drawing : matplotlib.figure.Figure or str
        The figure, or SVG text.
    caption : str
        What is shown (markdown).
    reading : str
        What to see in it (markdown), set below the caption.
    alt : str, optional
        Description for those who cannot see it; default caption and reading without markup.
    width : float
        Share of the text width, in (0, 1].

    Returns
    -------
    Display
    """
    from sysid.reporting.style import svg

    if not 0 < width <= 1:
        raise UsageError(f"figure: width is {width:g}, but it is a share of the text width in (0, 1]")
    picture = drawing if isinstance(drawing, str) else svg(drawing)
    title, remark = inline(caption), inline(reading)
    words = alt or " ".join(part for part in (plain(title), plain(remark)) if part)
    node = {"t": "figure", "svg": picture, "caption": title, "reading": remark, "alt": words, "width": width}
    return Display((node,))


def facts(items: Mapping[str, Cell]) -> Display:
    """Show terms and their values, one below the other.

    Examples
    --------
    >>> facts({"runs": 1000, "seed": 1})
    Display(facts)
    """
    return Display(
        ({"t": "facts", "items": [[[text(term)], _cell(value)] for term, value in items.items()]},)
    )


def _check_table(
    rows: Sequence[Sequence[Cell]], columns: Sequence[str], formats: Mapping[str, Format], align: str | None
) -> None:
    for place, row in enumerate(rows):
        if len(row) not in (len(columns), 1):
            raise UsageError(f"table: row {place} has {len(row)} cells, but there are {len(columns)} columns")
    if unknown := sorted(set(formats) - set(columns)):
        raise UsageError(
            f"table: formats name no column: {', '.join(unknown)}; columns are {', '.join(columns)}"
        )
    if align is not None and (len(align) != len(columns) or set(align) - set("lcr")):
        raise UsageError(
            f"table: align is {align!r}, but {len(columns)} columns need a letter l, c or r each"
        )


def _side(rows: Sequence[Sequence[Cell]], place: int) -> str:
    cells = [row[place] for row in rows if len(row) > place and row[place] is not None]
    numeric = cells and not any(
        isinstance(cell, (str, Markdown, Verdict, dict, list, tuple, bool)) for cell in cells
    )
    return "right" if numeric else "left"


def _cell(value: Cell, form: Format | None = None) -> Inline:
    if form is not None and value is not None:
        value = form(value) if callable(form) else numbers.formatted(value, form)
    if isinstance(value, Markdown):
        return inline(value.source)
    if isinstance(value, Verdict):
        return [mark(value.word, value.kind)]
    if isinstance(value, list) and value and isinstance(value[0], dict) and "t" in value[0]:
        return value
    return [text(numbers.values(value))]
