"""Block diagrams of the structures that the papers identify."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from sysid.reporting import display

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Point = tuple[float, float]


def block_diagram(
    blocks: Sequence[tuple[float, str, float]],
    sums: Sequence[float],
    arrows: Sequence[tuple[Point, Point]],
    signals: Sequence[tuple[float, float, str]],
) -> "Figure":
    """Draw blocks and sums in one row, at the height 0.8 of a strip 10 wide and 2 high.

    Parameters
    ----------
    blocks : sequence of (x, mathematics, font size)
    sums : sequence of x
    arrows : sequence of (start, end)
    signals : sequence of (x, y, mathematics)
        Names of the signals, without dollar signs.
    """
    drawing, axes = display.subplots(height=1.15)
    axes.set(xlim=(0, 10), ylim=(0, 2))
    axes.axis("off")
    box = {"boxstyle": "square,pad=0.55", "facecolor": "white", "edgecolor": "black"}
    arrow = {"arrowstyle": "-|>", "color": "black", "shrinkA": 0, "shrinkB": 0}
    for x, words, size in blocks:
        axes.text(x, 0.8, words, ha="center", va="center", fontsize=size, bbox=box)
    for x in sums:
        axes.plot(x, 0.8, "o", markersize=15, markerfacecolor="white", markeredgecolor="black")
        axes.text(x, 0.8, "+", ha="center", va="center")
    for start, end in arrows:
        axes.annotate("", xy=end, xytext=start, arrowprops=arrow)
    for x, y, name in signals:
        axes.text(x, y, f"${name}$", ha="center")
    return drawing
