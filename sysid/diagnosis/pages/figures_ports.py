"""The picture of the missing map at each port, with its band and the data it rests on."""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.diagnosis.pages.drawing import NARROW, WIDE, Picture, drawn_picture, legend
from sysid.diagnosis.ports.curves import PortCurve
from sysid.diagnosis.wording import percent
from sysid.reporting.style import COLOURS, GREY, subplots

if TYPE_CHECKING:
    from sysid.diagnosis.models.fitted_model import CurveView, MapView
    from sysid.linear.forms import Floats

PANEL_HEIGHT, MAP_HEIGHT = 3.1, 4.6
# Where the density is below this share of its largest value, the curve is drawn as a guess.
SPARSE = 0.02
# The vertical axis reaches this many times beyond the curve where its data are dense.
MARGIN = 0.12


def ports_figure(curves: Sequence[PortCurve], width: float = WIDE) -> tuple[Any, str, str]:
    """Draw one panel for each port: curve, 95 % band, and the density of data beneath.

    Parameters
    ----------
    curves : sequence of PortCurve
        As `explore_ports` returns them.
    width : float
        Width of the figure [inch]; panels stand side by side where there is room.

    Returns
    -------
    figure : matplotlib.figure.Figure
    title : str
    reading : str
        One sentence for each port.
    """
    drawn = [curve for curve in curves if curve.value.size]
    beside = 2 if width > NARROW and len(drawn) > 1 else 1
    rows = max(-(-len(drawn) // beside), 1)
    figure, grid = subplots(
        2 * rows,
        beside,
        width=width,
        height=PANEL_HEIGHT * rows,
        squeeze=False,
        height_ratios=(4, 1) * rows,
    )
    for number in range(rows * beside):
        top, bottom = grid[2 * (number // beside) : 2 * (number // beside) + 2, number % beside]
        if number < len(drawn):
            _panel(top, bottom, drawn[number], "missing map")
            top.set_title(_heading(drawn[number]), loc="left")
        else:
            top.set_axis_off()
            bottom.set_axis_off()
    reading = " ".join(curve.sentence for curve in curves)
    return figure, "What a static map at each port would have to look like", reading


def ports_picture(curves: Sequence[PortCurve]) -> Picture:
    """Draw the figure for wide and narrow screens, as SVG.

    Parameters
    ----------
    curves : sequence of PortCurve
    """
    return drawn_picture(partial(ports_figure, curves))


def map_figure(view: "MapView", width: float = WIDE) -> tuple[Any, str, str]:
    """Draw a map of the model with its 95 % band, what it has beyond a line, and the density of data.

    Parameters
    ----------
    view : MapView
    width : float
        Width of the figure [inch].
    """
    figure, (top, middle, bottom) = subplots(3, 1, width=width, height=MAP_HEIGHT, height_ratios=(4, 2, 1))
    _panel(top, bottom, view, "map of the model")
    legend(top)
    dense = view.density > SPARSE * view.density.max()
    middle.axhline(0.0, color=GREY, linewidth=0.6)
    middle.fill_between(view.value, view.bend_lower, view.bend_upper, color="#cfcfcf", linewidth=0)
    middle.plot(view.value, view.bend, color=COLOURS[0], linewidth=1.4)
    _limit(middle, view.bend_lower[dense], view.bend_upper[dense])
    middle.set_xlim(view.value[0], view.value[-1])
    middle.set_ylabel("less its line")
    middle.tick_params(labelbottom=False)
    return figure, view.heading, view.sentence


def _panel(top: Any, bottom: Any, curve: "CurveView", label: str) -> None:
    dense = curve.density > SPARSE * curve.density.max()
    top.axhline(0.0, color=GREY, linewidth=0.6)
    top.fill_between(curve.value, curve.lower, curve.upper, color="#cfcfcf", linewidth=0, label="95 % band")
    known = np.where(dense, curve.centre, np.nan)
    top.plot(curve.value, curve.centre, color=COLOURS[0], linestyle=(0, (1.2, 1.4)), linewidth=1.0)
    top.plot(curve.value, known, color=COLOURS[0], linewidth=1.6, label=label)
    _limit(top, curve.lower[dense], curve.upper[dense])
    top.set_ylabel(_label(curve.result, curve.result_unit))
    top.tick_params(labelbottom=False)
    bottom.fill_between(
        curve.value, 0.0, curve.density, step="mid", color=COLOURS[0], alpha=0.45, linewidth=0
    )
    for knot in curve.knots:
        bottom.axvline(knot, ymax=0.16, color=GREY, linewidth=0.6)
    bottom.set_ylim(bottom=0.0)
    bottom.set_yticks([])
    bottom.set_ylabel("data")
    bottom.set_xlabel(_label(curve.quantity, curve.unit))
    for axes in (top, bottom):
        axes.set_xlim(curve.value[0], curve.value[-1])


def _limit(axes: Any, lower: "Floats", upper: "Floats") -> None:
    """Let the vertical axis reach a little beyond a band."""
    low, high = float(lower.min()), float(upper.max())
    axes.set_ylim(low - MARGIN * (high - low) - 1e-300, high + MARGIN * (high - low) + 1e-300)


def _heading(curve: PortCurve) -> str:
    return f"{curve.port}: at most {percent(curve.explains_at_most)} of the error"


def _label(name: str, unit: str) -> str:
    return f"{name} [{unit or '–'}]".replace("$", r"\$")
