"""What a notebook calls to put results on the page.

Every function returns a `Display`; as the last line of a cell it appears on the page. Headings, captions and
prose are markdown with ``$...$`` mathematics; what comes out of ``results.json`` is shown letter for letter.
"""

from sysid.reporting.blocks import Display, Markdown, Verdict, facts, figure, group, prose, table
from sysid.reporting.numbers import number, values, with_error
from sysid.reporting.records import claim, claims, gates, load, monte_carlo, symbol, tolerance
from sysid.reporting.style import series, style, subplots

__all__ = [
    "Display",
    "Markdown",
    "Verdict",
    "claim",
    "claims",
    "facts",
    "figure",
    "gates",
    "group",
    "load",
    "monte_carlo",
    "number",
    "prose",
    "series",
    "style",
    "subplots",
    "symbol",
    "table",
    "tolerance",
    "values",
    "with_error",
]
