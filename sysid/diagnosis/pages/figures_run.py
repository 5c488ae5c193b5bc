"""Figures of the free run beside the measurement: the whole of it, and where it is worst."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.diagnosis.comparison.summary import error_size
from sysid.diagnosis.pages.drawing import MEASURED, MODEL, axis_label, draw_curve, envelope, legend, plain
from sysid.diagnosis.wording import quantity, significant
from sysid.reporting.style import COLOURS, GREY, LINE_STYLES, subplots

if TYPE_CHECKING:
    from sysid.diagnosis.comparison.judgement import Judgement
    from sysid.linear.forms import Floats

ZOOMED_ROWS = 250


def overview(comparison: "Judgement", width: float, height: float) -> tuple[Any, str, str]:
    """Draw measurement and model over the whole judged set, and the error below."""
    record, rows = comparison.record, _span(comparison)
    t, output = seconds_of(comparison.record, rows), comparison.record.outputs[0]
    y, model = record.y[rows, 0], comparison.prediction.free_run[rows]
    figure, (top, bottom) = subplots(2, 1, width=width, height=height, sharex=True, height_ratios=(2, 1))
    draw_curve(top, envelope(t, y), 0, MEASURED, filled=True)
    draw_curve(top, envelope(t, model), 1, MODEL, filled=False)
    top.set_ylabel(axis_label(record, output))
    legend(top)
    draw_curve(bottom, envelope(t, y - model), 4, "error", filled=True)
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


def worst_stretch(comparison: "Judgement", width: float, height: float) -> tuple[Any, str, str]:
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


def draw_with_input(comparison: "Judgement", axes: tuple[Any, Any], rows: Any) -> None:
    """Draw measurement and model above, the inputs below."""
    record, (top, bottom) = comparison.record, axes
    t = seconds_of(record, rows)
    draw_curve(top, envelope(t, record.y[rows, 0]), 0, MEASURED, filled=False)
    draw_curve(top, envelope(t, comparison.prediction.free_run[rows]), 1, MODEL, filled=False)
    top.set_ylabel(axis_label(record, record.outputs[0]))
    for index, name in enumerate(record.inputs):
        bottom.step(t, record.u[rows, index], where="post", **_input_look(index), label=plain(name))
    bottom.set_ylabel(axis_label(record, record.inputs[0]) if len(record.inputs) == 1 else "inputs")
    bottom.set_xlabel("time [s]")


def scored_places(comparison: "Judgement") -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """Return the scored rows of the judged set."""
    record = comparison.record
    if comparison.judged == "validation":
        return np.flatnonzero(record.validation)
    return np.flatnonzero(record.scored_rows(comparison.judged))


def _span(comparison: "Judgement") -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
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


def _mark_skip(comparison: "Judgement", rows: Any, axes: Sequence[Any], t: "Floats") -> None:
    skip = comparison.score_of(comparison.judged).skip
    if skip > 0:
        for one in axes:
            one.axvspan(t[0], t[min(skip, rows.size - 1)], color="#e8e8e8", linewidth=0)


def worst_rows(
    comparison: "Judgement", within: "np.ndarray[tuple[int], np.dtype[np.int64]] | None" = None
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
    from sysid.diagnosis.residuals import block_length

    wanted = max(ZOOMED_ROWS, 3 * block_length(np.nan_to_num(error) ** 2))
    return int(min(wanted, max(error.size // 4, min(60, error.size)), error.size))


def _input_look(index: int) -> dict[str, Any]:
    return {
        "color": COLOURS[2 + index % 5],
        "linestyle": LINE_STYLES[index % len(LINE_STYLES)],
        "linewidth": 1.1,
    }
