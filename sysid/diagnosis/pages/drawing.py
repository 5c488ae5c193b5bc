"""What all figures of a page share: pictures for wide and narrow screens, curves, legends, labels."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.reporting.style import COLOURS, series, style, svg

if TYPE_CHECKING:
    from sysid.linear.forms import Floats

# A curve of more points is drawn as the largest and smallest value of so many stretches.
STRETCHES = 600
WIDE, NARROW = 7.2, 3.7
# Columns of a legend; the width of a letter and of a line with its gaps in it [inch].
MOST_COLUMNS, LETTER, HANDLE = 4, 0.053, 0.55
MEASURED, MODEL = "measured", "model, free run"


@dataclass(frozen=True)
class Picture:
    """A figure for wide and narrow screens, with its words.

    Attributes
    ----------
    title, reading : str
        What is drawn, and what it says in this case.
    wide, narrow : str
        SVG texts.
    """

    title: str
    reading: str
    wide: str
    narrow: str


def drawn_picture(draw: Callable[[float], tuple[Any, str, str]]) -> Picture:
    """Draw a figure for wide and narrow screens."""
    with style(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")  # a name in a rare script
        wide, title, reading = draw(WIDE)
        narrow, _, _ = draw(NARROW)
        return Picture(title, reading, svg(wide), svg(narrow))


def envelope(
    t: "Floats", values: "Floats", stretches: int = STRETCHES
) -> tuple["Floats", "Floats", "Floats"]:
    """Thin a curve to the smallest and largest value of each stretch; a short one stays as it is.

    Parameters
    ----------
    t, values : ndarray, shape (n_samples,)
    stretches : int

    Returns
    -------
    t, smallest, largest : ndarray

    Examples
    --------
    >>> import numpy as np
    >>> t, low, high = envelope(np.arange(1000.0), np.eye(1, 1000, 500)[0], stretches=10)
    >>> t.size, float(low.max()), float(high.max())
    (10, 0.0, 1.0)
    """
    if values.size <= 4 * stretches:
        return t, values, values
    edges = np.linspace(0, values.size, stretches + 1).astype(int)[:-1]
    return t[edges], np.fmin.reduceat(values, edges), np.fmax.reduceat(values, edges)


def draw_curve(
    axes: Any, curve: tuple["Floats", "Floats", "Floats"], index: int, label: str, *, filled: bool
) -> None:
    """Draw a curve, or what is left of a long one: a filled band, or its two outlines."""
    t, low, high = curve
    if low is high:
        axes.plot(t, low, **line_look(index), label=label)
    elif filled:
        axes.fill_between(t, low, high, color=COLOURS[index], alpha=0.55, linewidth=1.0, label=label)
    else:
        axes.plot(t, high, **line_look(index), label=label)
        axes.plot(t, low, **line_look(index))


def line_look(index: int) -> dict[str, Any]:
    """Return colour and line style of a curve among many points."""
    return series(index) | {"linewidth": 1.1}


def legend(axes: Any) -> None:
    """Put the legend above the axes, in as many columns as the figure has room for."""
    labels = axes.get_legend_handles_labels()[1]
    if labels:
        columns = legend_columns(labels, axes.figure.get_figwidth())
        axes.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.1, columnspacing=1.2
        )


def legend_columns(labels: Sequence[str], width: float) -> int:
    """Return the columns of a legend in a figure of a width [inch].

    Examples
    --------
    >>> names = ["free curve, 95 % band", "in_deadzone", "without it"]
    >>> legend_columns(names, WIDE), legend_columns(names, NARROW)
    (4, 2)
    """
    for columns in range(MOST_COLUMNS, 1, -1):
        rows = -(-len(labels) // columns)  # a column is filled before the next one
        longest = [max(map(len, labels[i : i + rows])) for i in range(0, len(labels), rows)]
        if LETTER * sum(longest) + HANDLE * len(longest) <= width - HANDLE:
            return columns
    return 1


def axis_label(record: Any, name: str) -> str:
    """Return name and unit of a column; the unit once, where the name holds it."""
    unit = record.unit(name)
    return f"{plain(name.removesuffix(f'[{unit}]').rstrip())} [{plain(unit) or '–'}]"


def plain(name: str) -> str:
    """Keep a dollar sign in a name from starting mathematics."""
    return name.replace("$", r"\$")
