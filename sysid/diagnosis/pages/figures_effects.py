"""Pictures of what the added effects do: their laws over the data, or their courses."""

from functools import partial
from typing import Any

import numpy as np

from sysid.diagnosis.effect_views import EffectView
from sysid.diagnosis.pages.drawing import WIDE, Picture, drawn_picture, legend, line_look, plain
from sysid.reporting.style import COLOURS, GREY, subplots

HEIGHT, BINS = 3.1, 60
# The frame reaches this share beyond the law where a free curve is drawn with it.
MARGIN = 0.15
READINGS = {
    "law": "Solid as it was found, dashed without the effect; below, where the data are.",
    "loop": "The force along the motion in the last rows of the longest experiment: what a loop encloses "
    "turns into heat.",
    "course": "What enters and what leaves, in the rows in which they differ most.",
    "time": "Solid as it was found, dashed without the effect.",
}
FREE = (
    " Dotted, in its band, what the data say without knowing the law: a curve of free form that was fitted "
    "instead of the effect; only its straight part, which no data tell, is taken from the law."
)


def effect_pictures(views: tuple[EffectView, ...]) -> list[Picture]:
    """Draw a picture of each view."""
    return [drawn_picture(partial(effect_figure, view)) for view in views]


def effect_figure(view: EffectView, width: float = WIDE) -> tuple[Any, str, str]:
    """Draw a view.

    Parameters
    ----------
    view : EffectView
    width : float
        Width of the figure [inch].

    Returns
    -------
    figure : matplotlib.figure.Figure
    title, reading : str
    """
    if view.seen.size:
        figure, (axes, below) = subplots(2, 1, width=width, height=HEIGHT, height_ratios=(5, 1), sharex=True)
        below.hist(view.seen, bins=BINS, color=COLOURS[0], alpha=0.45)
        below.set_yticks([])
        below.set_ylabel("data")
    else:
        figure, axes = subplots(width=width, height=HEIGHT)
        below = axes
    names = ("what leaves", "what enters") if view.kind == "course" else (view.effect, "without it")
    if view.free is not None:
        _draw_free(axes, view)
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    axes.plot(view.value, view.law, **line_look(0) | {"linewidth": 2.0}, label=names[0])
    if view.kind != "loop":
        axes.plot(view.value, view.without, **line_look(1), label=names[1])
    axes.set_ylabel(_label(view.result, view.result_unit))
    below.set_xlabel(_label(view.quantity, view.unit))
    axes.margins(x=0.0)
    legend(axes)
    reading = READINGS[view.kind] + FREE * (view.free is not None)
    return figure, f"What {plain(view.effect)} does", reading


def _draw_free(axes: Any, view: EffectView) -> None:
    """Draw the free curve within the range of the law; its band may leave the frame where data are few."""
    free = view.free
    assert free is not None
    axes.fill_between(free.value, free.lower, free.upper, color="#cfcfcf", linewidth=0)
    over = line_look(2) | {"color": "black", "zorder": 3}  # where the law holds, it lies on it
    axes.plot(free.value, free.centre, **over, label="free curve, 95 % band")
    both = np.concatenate([view.law, view.without])
    beyond = MARGIN * np.ptp(both)
    axes.set_ylim(both.min() - beyond, both.max() + beyond)
    axes.set_xlim(view.value[0], view.value[-1])


def _label(name: str, unit: str) -> str:
    return f"{plain(name)} [{plain(unit) or '–'}]"
