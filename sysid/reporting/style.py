"""One look for every figure: readable without colour, the same bytes on every machine."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito's palette without its yellow, which vanishes on white paper.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#E69F00", "#56B4E9")
LINE_STYLES: tuple[Any, ...] = (
    "-",
    (0, (5, 1.6)),
    (0, (1.2, 1.4)),
    (0, (6, 1.6, 1.2, 1.6)),
    (0, (2.6, 1.4)),
    (0, (6, 1.4, 1.2, 1.4, 1.2, 1.4)),
    (0, (9, 2.2)),
)
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
GREY = "#6b6b6b"
TEXT_WIDTH = 6.3  # inches: a figure of this width fills the text block of the PDF


def series(index: int, *, marker: bool = False) -> dict[str, Any]:
    """Give colour, line style and, if wanted, marker of a curve.

    Parameters
    ----------
    index : int
        Number of the curve, from 0; the seven looks repeat after that.
    marker : bool
        Also give a marker (for curves of few points).

    Returns
    -------
    dict
        Keywords for ``Axes.plot``.

    Examples
    --------
    >>> series(1, marker=True)["marker"]
    's'
    """
    look = index % len(COLOURS)
    keywords: dict[str, Any] = {"color": COLOURS[look], "linestyle": LINE_STYLES[look]}
    if marker:
        keywords["marker"] = MARKERS[look]
    return keywords


def _settings() -> Any:  # matplotlib types the keys one by one
    from cycler import cycler

    return {
        "font.family": "STIXGeneral",  # ships with matplotlib and matches the mathematics of the pages
        "mathtext.fontset": "stix",
        "font.size": 10.0,
        "axes.titlesize": 10.5,
        "axes.labelsize": 10.0,
        "xtick.labelsize": 9.0,
        "ytick.labelsize": 9.0,
        "legend.fontsize": 9.0,
        "axes.unicode_minus": True,
        "axes.prop_cycle": cycler(color=list(COLOURS)) + cycler(linestyle=list(LINE_STYLES)),
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.linewidth": 0.7,
        "axes.edgecolor": "#333333",
        "axes.grid": False,
        "grid.color": "#d9d9d9",
        "grid.linewidth": 0.5,
        "axes.axisbelow": True,
        "xtick.direction": "out",
        "ytick.direction": "out",
        "xtick.major.width": 0.7,
        "ytick.major.width": 0.7,
        "lines.linewidth": 1.4,
        "lines.markersize": 4.5,
        "legend.frameon": False,
        "legend.handlelength": 2.8,
        "figure.figsize": (TEXT_WIDTH, 3.4),
        "figure.facecolor": "white",
        "figure.constrained_layout.use": True,
        "savefig.facecolor": "white",
        "svg.fonttype": "path",  # glyphs as outlines: the same picture without any font installed
        "svg.hashsalt": "sysid",
        "path.simplify": True,
    }


@contextmanager
def style() -> Iterator[None]:
    """Draw in the house style inside a ``with`` block.

    Examples
    --------
    >>> import matplotlib
    >>> with style():
    ...     matplotlib.rcParams["svg.fonttype"]
    'path'
    """
    import matplotlib

    with matplotlib.rc_context(_settings()):
        yield


def use() -> None:
    """Draw in the house style from now on: for a process that only draws, as a report's kernel does."""
    import matplotlib

    matplotlib.rcParams.update(_settings())


def subplots(
    rows: int = 1, columns: int = 1, *, width: float = TEXT_WIDTH, height: float = 3.4, **keywords: Any
) -> tuple[Figure, Any]:
    """Make a figure in the house style, outside pyplot's global state.

    Parameters
    ----------
    rows, columns : int
        Grid of axes.
    width, height : float
        Size [inch]; the default width fills the text block of the PDF.
    **keywords
        Passed on to ``Figure.subplots`` (``sharex``, ``squeeze``, ...).

    Returns
    -------
    figure : matplotlib.figure.Figure
    axes : Axes or array of Axes

    Examples
    --------
    >>> figure, axes = subplots(1, 2)
    >>> axes.shape
    (2,)
    """
    from matplotlib.figure import Figure

    with style():
        figure = Figure(figsize=(width, height))
        return figure, figure.subplots(rows, columns, **keywords)


def svg(figure: Figure) -> str:
    """Render a figure as SVG text, byte for byte repeatable.

    Text becomes outlines, identifiers have a fixed salt and no date or program name is written.

    Parameters
    ----------
    figure : matplotlib.figure.Figure

    Returns
    -------
    str
        The ``<svg>`` element, without XML declaration or document type.

    Examples
    --------
    >>> figure, axes = subplots()
    >>> lines = axes.plot([0, 1], [1, 0])
    >>> svg(figure) == svg(figure)
    True
    """
    buffer = io.StringIO()
    with style():
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Type": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :].strip() + "\n"
