"""Figures of where the error lies: shares of regions, and the residual against what may drive it."""

from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.diagnosis.comparison.surrogates import newly_arising
from sysid.diagnosis.comparison.where import LEVEL, Finding, Share
from sysid.diagnosis.pages.drawing import NARROW, axis_label, legend, plain
from sysid.diagnosis.pages.figures_run import draw_with_input, worst_rows
from sysid.diagnosis.residuals import BAND
from sysid.diagnosis.wording import percent, quantity, significant
from sysid.reporting.style import COLOURS, GREY, subplots

if TYPE_CHECKING:
    from sysid.diagnosis.comparison.judgement import Judgement
    from sysid.linear.forms import Floats

PANEL_HEIGHT = 2.15
CURVE_BINS = 24
LIGHT, DARK = "#dddddd", "#a9a9a9"


def shares(comparison: "Judgement", width: float, height: float) -> tuple[Any, str, str]:
    """Draw the share of the squared error in each region beside the share of the data."""
    panels = comparison.location.shares
    figure, grid = _grid(len(panels), width)
    for axes, (name, bars) in zip(grid, panels.items(), strict=True):
        if name in ("velocity-sign", "experiment"):
            _named_bars(axes, name, bars)
        else:
            _level_bars(axes, comparison, name, bars)
        axes.set_ylim(0.0, 1.12 * axes.get_ylim()[1])
        axes.set_ylabel("share [%]")
    legend(grid[0])
    flagged = [
        (name, bar, share, words)
        for name, bars in panels.items()
        for bar in bars
        for share, p_value, words in _measures(bar)
        if p_value <= LEVEL and share > bar.data_share
    ]
    if not flagged:
        words = "no bar exceeds its expectation by more than chance allows."
    else:
        name, worst, share, measure = max(flagged, key=lambda item: item[2] - item[1].data_share)
        words = (
            f"stars mark what chance does not explain, most {_where(name, worst)}: {percent(share)} of the "
            f"{measure} in {percent(worst.data_share)} of the data."
        )
    return (
        figure,
        f"Share of the squared error on {comparison.judged}",
        "Left bars show the free-run error, right ones the error that newly arises, black lines what an "
        "error spread evenly over the data would give; " + words,
    )


def _measures(bar: Share) -> tuple[tuple[float, float, str], ...]:
    return (
        (bar.error_share, bar.p_value, "free-run error"),
        (bar.new_share, bar.new_p_value, "newly arising error"),
    )


def _where(name: str, bar: Share) -> str:
    return bar.region.words if name in ("time", "experiment") else f"while {bar.region.words}"


def _grid(count: int, width: float) -> tuple[Any, list[Any]]:
    """Return a figure with so many panels, two side by side where there is room."""
    columns = 2 if width > NARROW and count > 1 else 1
    rows = -(-count // columns)
    figure, grid = subplots(rows, columns, width=width, height=PANEL_HEIGHT * rows, squeeze=False)
    for axes in grid.ravel()[count:]:
        axes.set_axis_off()
    return figure, list(grid.ravel()[:count])


def _bar_pair(axes: Any, a: float, b: float, bar: Share, number: int) -> None:
    """Draw both shares and their expectation; a star stands above what is beyond chance."""
    half = 0.5 * (b - a)
    looks = ({"color": COLOURS[6]}, {"color": COLOURS[1], "hatch": "/////"})
    for index, ((share, p_value, words), look) in enumerate(zip(_measures(bar), looks, strict=True)):
        axes.bar(
            a + (index + 0.5) * half,
            100.0 * share,
            half,
            **look,
            edgecolor="#ffffff",
            linewidth=0.5,
            label=None if number else words.removesuffix(" error"),
        )
        if p_value <= LEVEL and share > bar.data_share:
            axes.annotate(
                "*", (a + (index + 0.5) * half, 100.0 * share), ha="center", va="bottom", fontsize=11
            )
    axes.hlines(
        100.0 * bar.data_share, a, b, color="#000000", linewidth=1.8, label=None if number else "expected"
    )


def _named_bars(axes: Any, name: str, bars: tuple[Share, ...]) -> None:
    short = {"is negative": "negative", "is near zero": "near zero", "is positive": "positive"}
    for place, bar in enumerate(bars):
        _bar_pair(axes, place - 0.38, place + 0.38, bar, place)
    words = [bar.region.words for bar in bars]
    if name == "experiment":
        labels = [plain(str(bar.region.place["experiment"])) for bar in bars]
    else:
        labels = [next((s for key, s in short.items() if key in w), "reversal") for w in words]
    axes.set_xticks(range(len(bars)), labels, rotation=0 if len(bars) <= 5 else 60)
    axes.set_xlabel("experiment" if name == "experiment" else "sign of the velocity")


def _level_bars(axes: Any, comparison: "Judgement", name: str, bars: tuple[Share, ...]) -> None:
    low, high, label = _extent(comparison, name)
    for number, bar in enumerate(bars):
        place = bar.region.place
        if name == "time":
            a, b = _time_bounds(comparison, number, place)
        else:
            a, b = max(place.get("above", low), low), min(place.get("up_to", high), high)
        _bar_pair(axes, a, b, bar, number)
    axes.set_xlabel(label)


def _extent(comparison: "Judgement", name: str) -> tuple[float, float, str]:
    """Return the range of a signal without its outermost values, and the label of its axis."""
    series, record = comparison.series, comparison.record
    if name == "time":
        several = bool(np.ptp(series.experiment) > 0)
        return 0.0, 0.0, "window, in order" if several else "time [s]"
    if name == "output":
        values, label = series.output, f"model output {axis_label(record, record.outputs[0])}"
    elif name == "velocity":
        values, label = series.velocity, _velocity_label(comparison)
    else:
        index = [f"input {i}" for i in record.inputs].index(name)
        values, label = series.u[:, index], f"input {axis_label(record, record.inputs[index])}"
    low, high = np.quantile(values, [0.001, 0.999])
    return float(low), float(high), label


def _velocity_label(comparison: "Judgement") -> str:
    unit = comparison.record.unit(comparison.record.outputs[0])
    return f"velocity of the model output [{plain(unit) or '1'}/s]"


def _time_bounds(comparison: "Judgement", number: int, place: dict[str, Any]) -> tuple[float, float]:
    if np.ptp(comparison.series.experiment) > 0:
        return float(number), float(number + 1)
    return float(place["from_s"]), float(place["to_s"])


def residual_curves(comparison: "Judgement", width: float, height: float) -> tuple[Any, str, str]:
    """Draw the residual against model output, velocity and input: its mean and spread level by level."""
    series = comparison.series
    signals = _signals(comparison)
    figure, grid = _grid(len(signals), width)
    unit = comparison.record.unit(comparison.record.outputs[0])
    ranges = []
    for axes, (label, values) in zip(grid, signals, strict=True):
        middle, levels, mean, _ = binned(values, series.residual)
        axes.fill_between(middle, levels[0], levels[4], color=LIGHT, linewidth=0, label="90 %")
        axes.fill_between(middle, levels[1], levels[3], color=DARK, linewidth=0, label="50 %")
        axes.plot(middle, mean, color=COLOURS[0], marker="o", markersize=3.0, linewidth=1.3, label="mean")
        axes.axhline(0.0, color=GREY, linewidth=0.6)
        axes.set_xlabel(label)
        axes.set_ylabel(f"error [{plain(unit) or '–'}]")
        ranges.append((float(np.ptp(mean)), label))
    legend(grid[0])
    widest, label = max(ranges)
    ratio = widest / max(comparison.score_of(comparison.judged).free_run.rmse, 1e-300)
    reading = (
        f"The mean error varies most with the {label.split(' [')[0]}, by {quantity(widest, unit)}, "
        f"{significant(ratio, 2)} times the RMSE; where the mean is flat at zero, nothing is left to explain."
    )
    return figure, "Error (measurement less model) against output, velocity and input", reading


def new_error_curves(comparison: "Judgement", width: float, height: float) -> tuple[Any, str, str]:
    """Draw the mean of the newly arising error against output, velocity and input, with chance's band."""
    series = comparison.series
    innovations, places = newly_arising(series, series.mean_length)
    signals = [(label, values[places]) for label, values in _signals(comparison)]
    figure, grid = _grid(len(signals), width)
    unit = comparison.record.unit(comparison.record.outputs[0])
    outside = []
    for axes, (label, values) in zip(grid, signals, strict=True):
        middle, _, mean, count = binned(values, innovations, max(min(CURVE_BINS, innovations.size // 25), 2))
        band = BAND * float(innovations.std()) / np.sqrt(count)
        axes.fill_between(middle, -band, band, color=LIGHT, linewidth=0, label="99 % of chance")
        axes.plot(middle, mean, color=COLOURS[0], marker="o", markersize=3.0, linewidth=1.3, label="mean")
        axes.axhline(0.0, color=GREY, linewidth=0.6)
        axes.set_xlabel(label)
        axes.set_ylabel(f"new error [{plain(unit) or '–'}]")
        outside.append((int((np.abs(mean) > band).sum()), mean.size, label.split(" [")[0]))
    legend(grid[0])
    most, count_, label = max(outside)
    reading = (
        f"Error that newly arises within {quantity(series.mean_length * series.record.period, 's')}, above "
        f"zero where the measurement is pulled above the model: {most} of {count_} means against {label} lie "
        "beyond the band of chance."
    )
    return figure, "Newly arising error against output, velocity and input", reading


def _signals(comparison: "Judgement") -> list[tuple[str, "Floats"]]:
    """Return what the error may depend on, with the label of its axis."""
    series, record = comparison.series, comparison.record
    signals = [
        (f"model output {axis_label(record, record.outputs[0])}", series.output),
        (_velocity_label(comparison), series.velocity),
    ]
    signals += [(f"input {axis_label(record, n)}", series.u[:, i]) for i, n in enumerate(record.inputs)]
    return [(label, values) for label, values in signals if np.ptp(values) > 0.0]


def binned(
    values: "Floats", residual: "Floats", bins: int = CURVE_BINS
) -> tuple["Floats", "Floats", "Floats", "Floats"]:
    """Return middle, quantiles 5, 25, 50, 75, 95 % and mean of the residual, and count, of equal bins.

    Examples
    --------
    >>> import numpy as np
    >>> middle, levels, mean, count = binned(np.arange(240.0), np.repeat([1.0, 3.0], 120))
    >>> levels.shape, float(mean[0]), float(mean[-1]), float(count.sum())
    ((5, 24), 1.0, 3.0, 240.0)
    """
    edges = np.unique(values)
    if edges.size > bins:
        edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, bins + 1))[:-1])
    cell = np.maximum(np.searchsorted(edges, values, side="right") - 1, 0)
    order = np.argsort(cell, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(cell[order])) + 1)
    middle = np.array([np.median(values[part]) for part in parts])
    levels = np.array([np.quantile(residual[part], [0.05, 0.25, 0.5, 0.75, 0.95]) for part in parts]).T
    mean = np.array([residual[part].mean() for part in parts])
    return middle, levels, mean, np.array([float(part.size) for part in parts])


def worst_windows(comparison: "Judgement", width: float, height: float) -> tuple[Any, str, str]:
    """Draw measurement, model and input in the windows found besides the worst stretch."""
    found = further_windows(comparison)
    columns = len(found) if width > NARROW else 1
    rows = 2 * (len(found) // columns)
    figure, grid = subplots(
        rows,
        columns,
        width=width,
        height=height * (rows // 2),
        squeeze=False,
        height_ratios=(2, 1) * (rows // 2),
    )
    for number, finding in enumerate(found):
        window = np.arange(finding.region["first_row"] - 1, finding.region["last_row"])
        row = 2 * (number // columns)
        axes = (grid[row, number % columns], grid[row + 1, number % columns])
        draw_with_input(comparison, axes, worst_rows(comparison, window))
    legend(grid[0, 0])
    reading = " ".join(finding.sentence for finding in found)
    return (
        figure,
        f"Further windows of {comparison.judged} with large errors, where they are largest",
        reading,
    )


def further_windows(comparison: "Judgement") -> list[Finding]:
    """Return up to two windows found that do not hold the worst stretch of all."""
    worst = worst_rows(comparison)
    return [
        finding
        for finding in comparison.where
        if finding.kind == "time"
        and finding.measure == "free-run error"
        and not (finding.region["first_row"] - 1 <= worst[-1] and worst[0] < finding.region["last_row"])
    ][:2]
