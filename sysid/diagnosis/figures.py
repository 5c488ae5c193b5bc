"""Figures of the comparison page."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.diagnosis.summary import FEWEST_TESTED_ROWS, error_size
from sysid.diagnosis.wording import quantity, significant
from sysid.reporting.style import COLOURS, GREY, LINE_STYLES, series, style, subplots, svg

if TYPE_CHECKING:
    from sysid.diagnosis.comparison import Comparison
    from sysid.diagnosis.models import FittedModel, PortView
    from sysid.linear.forms import Floats

# A curve of more points is drawn as the largest and smallest value of so many stretches.
STRETCHES = 600
ZOOMED_ROWS = 250
WIDE, NARROW = 7.2, 3.7
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


def pictures(comparison: "Comparison") -> dict[str, list[Picture]]:
    """Draw all figures of the page, by section."""
    from sysid.diagnosis.figures_residual import correlations, orders, spectrum
    from sysid.diagnosis.figures_where import (
        further_windows,
        new_error_curves,
        residual_curves,
        shares,
        worst_windows,
    )

    found: dict[str, list[Picture]] = {
        "run": [_picture(comparison, overview, 4.3), _picture(comparison, worst_stretch, 4.6)],
        "maps": map_pictures(comparison.model),
        "blocks": block_pictures(comparison.model),
        "where": [],
        "ports": port_pictures(comparison.ports),
        "tests": [],
        "model": [],
    }
    if comparison.location.shares:
        found["where"] = [
            _picture(comparison, draw, 4.0) for draw in (shares, residual_curves, new_error_curves)
        ]
    if further_windows(comparison):
        found["where"].append(_picture(comparison, worst_windows, 3.6))
    if comparison.score_of(comparison.judged).n_rows >= FEWEST_TESTED_ROWS:
        found["tests"] = [_picture(comparison, draw, 3.1) for draw in (spectrum, correlations)]
    if len({c.order for c in comparison.model.candidates}) > 1:
        found["model"] = [_picture(comparison, orders, 3.0)]
    return found


def port_pictures(ports: "tuple[PortView, ...]") -> list[Picture]:
    """Draw the free-form curves, if there are any."""
    from sysid.diagnosis.ports import PortCurve
    from sysid.diagnosis.ports.figures import ports_picture

    curves = [port for port in ports if isinstance(port, PortCurve) and port.value.size]
    return [ports_picture(curves)] if curves else []


def map_pictures(model: "FittedModel") -> list[Picture]:
    """Draw the maps that are part of the model, if there are any."""
    from sysid.diagnosis.models import Mapped
    from sysid.diagnosis.ports.figures import map_figure

    if not isinstance(model, Mapped):
        return []
    return [drawn_picture(partial(map_figure, view)) for view in model.maps()]


def block_pictures(model: "FittedModel") -> list[Picture]:
    """Draw the frequency responses of the model's linear blocks, if it has several."""
    from sysid.diagnosis.figures_blocks import blocks_figure
    from sysid.diagnosis.models import Responding

    if not isinstance(model, Responding):
        return []
    return [drawn_picture(partial(blocks_figure, model.responses()))]


Drawer = Callable[["Comparison", float, float], tuple[Any, str, str]]


def _picture(comparison: "Comparison", draw: Drawer, height: float) -> Picture:
    return drawn_picture(lambda width: draw(comparison, width, height))


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


def _draw(
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


def overview(comparison: "Comparison", width: float, height: float) -> tuple[Any, str, str]:
    """Draw measurement and model over the whole judged set, and the error below."""
    record, rows = comparison.record, _span(comparison)
    t, output = seconds_of(comparison.record, rows), comparison.record.outputs[0]
    y, model = record.y[rows, 0], comparison.prediction.free_run[rows]
    figure, (top, bottom) = subplots(2, 1, width=width, height=height, sharex=True, height_ratios=(2, 1))
    _draw(top, envelope(t, y), 0, MEASURED, filled=True)
    _draw(top, envelope(t, model), 1, MODEL, filled=False)
    top.set_ylabel(axis_label(record, output))
    legend(top)
    _draw(bottom, envelope(t, y - model), 4, "error", filled=True)
    bottom.axhline(0.0, color=GREY, linewidth=0.6)
    _mark_skip(comparison, rows, (top, bottom), t)
    bottom.set_ylabel(f"error [{plain(record.unit(output)) or '–'}]")
    bottom.set_xlabel("time [s]")
    figure.align_ylabels()
    judged = comparison.score_of(comparison.judged)
    reading = f"The free run misses the measurement by {error_size(judged)}, on {judged.n_rows} samples"
    largest = float(np.nanmax(np.abs(y - model)))
    return (
        figure,
        f"Measurement and model on {comparison.judged}",
        f"{reading}; the largest error is {quantity(largest, judged.unit)}.",
    )


def worst_stretch(comparison: "Comparison", width: float, height: float) -> tuple[Any, str, str]:
    """Draw measurement, model and input where the error is largest."""
    record = comparison.record
    rows = worst_rows(comparison)
    figure, (top, bottom) = subplots(2, 1, width=width, height=height, sharex=True, height_ratios=(2, 1))
    draw_with_input(comparison, (top, bottom), rows)
    legend(top)
    figure.align_ylabels()
    error = record.y[rows, 0] - comparison.prediction.free_run[rows]
    local = float(np.sqrt(np.nanmean(error**2)))
    overall = comparison.score_of(comparison.judged)
    ratio = local / overall.free_run.rmse if overall.free_run.rmse > 0.0 else 1.0
    reading = (
        f"Here the error is {quantity(local, overall.unit)} RMSE, {significant(ratio, 2)} times that of the "
        f"whole set; its mean is {quantity(float(np.nanmean(error)), overall.unit)}."
    )
    return figure, f"The worst stretch of {comparison.judged}, with the input", reading


def draw_with_input(comparison: "Comparison", axes: tuple[Any, Any], rows: Any) -> None:
    """Draw measurement and model above, the inputs below."""
    record, (top, bottom) = comparison.record, axes
    t = seconds_of(record, rows)
    _draw(top, envelope(t, record.y[rows, 0]), 0, MEASURED, filled=False)
    _draw(top, envelope(t, comparison.prediction.free_run[rows]), 1, MODEL, filled=False)
    top.set_ylabel(axis_label(record, record.outputs[0]))
    for index, name in enumerate(record.inputs):
        bottom.step(t, record.u[rows, index], where="post", **_inputline_look(index), label=plain(name))
    bottom.set_ylabel(axis_label(record, record.inputs[0]) if len(record.inputs) == 1 else "inputs")
    bottom.set_xlabel("time [s]")


def line_look(index: int) -> dict[str, Any]:
    """Return colour and line style of a curve among many points."""
    return series(index) | {"linewidth": 1.1}


def _inputline_look(index: int) -> dict[str, Any]:
    return {
        "color": COLOURS[2 + index % 5],
        "linestyle": LINE_STYLES[index % len(LINE_STYLES)],
        "linewidth": 1.1,
    }


def legend(axes: Any) -> None:
    """Put the legend above the axes."""
    if axes.get_legend_handles_labels()[1]:
        axes.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.1, columnspacing=1.2
        )


def axis_label(record: Any, name: str) -> str:
    """Return name and unit of a column; the unit once, where the name holds it."""
    unit = record.unit(name)
    return f"{plain(name.removesuffix(f'[{unit}]').rstrip())} [{plain(unit) or '–'}]"


def plain(name: str) -> str:
    """Keep a dollar sign in a name from starting mathematics."""
    return name.replace("$", r"\$")


def scored_places(comparison: "Comparison") -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """Return the scored rows of the judged set."""
    record = comparison.record
    if comparison.judged == "validation":
        return np.flatnonzero(record.validation)
    return np.flatnonzero(record.scored_rows(comparison.judged))


def _span(comparison: "Comparison") -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """Return the rows of the judged set in its first experiment, those that are skipped included."""
    record = comparison.record
    rows = scored_places(comparison)
    part = next(part for part in record.slices if part.start <= rows[0] < part.stop)
    if comparison.judged == "validation":
        return np.asarray(rows[rows < part.stop])
    places = np.flatnonzero(record.split[part] == comparison.judged)
    return np.asarray(part.start + places)


def seconds_of(record: Any, rows: Any) -> "Floats":
    """Return times [s] from the start of the experiment."""
    origin = max(start for start in record.starts if start <= rows[0])
    return np.asarray((np.asarray(rows) - origin) * record.period)


def _mark_skip(comparison: "Comparison", rows: Any, axes: Sequence[Any], t: "Floats") -> None:
    skip = comparison.score_of(comparison.judged).skip
    if skip > 0:
        for one in axes:
            one.axvspan(t[0], t[min(skip, rows.size - 1)], color="#e8e8e8", linewidth=0)


def worst_rows(
    comparison: "Comparison", within: "np.ndarray[tuple[int], np.dtype[np.int64]] | None" = None
) -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """Return the consecutive rows in which the mean squared error is largest."""
    if within is None:
        scored, span = scored_places(comparison), _span(comparison)
        scored = scored[scored <= span[-1]]
        within = np.arange(scored[0], scored[-1] + 1)
    error = comparison.record.y[within, 0] - comparison.prediction.free_run[within]
    length = _zoom_length(error)
    squared = np.concatenate([[0.0], np.cumsum(np.nan_to_num(error) ** 2)])
    first = int(np.argmax(squared[length:] - squared[:-length]))
    return np.asarray(within[first : first + length])


def _zoom_length(error: "Floats") -> int:
    """Return how many rows show some swings of the error: a few of its correlation times."""
    from sysid.diagnosis.scores import block_length

    wanted = max(ZOOMED_ROWS, 3 * block_length(np.nan_to_num(error) ** 2))
    return int(min(wanted, max(error.size // 4, min(60, error.size)), error.size))
