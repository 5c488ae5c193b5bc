"""Figures of the comparison page."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.diagnosis.summary import FEWEST_TESTED_ROWS, error_size
from sysid.diagnosis.wording import ordinal, quantity, significant
from sysid.reporting.style import COLOURS, GREY, LINE_STYLES, MARKERS, series, style, subplots, svg

if TYPE_CHECKING:
    from sysid.diagnosis.compare import Comparison
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


def pictures(comparison: "Comparison") -> list[Picture]:
    """Draw all figures of the page."""
    drawn = [
        _picture(comparison, overview, 4.3),
        _picture(comparison, worst_stretch, 4.6),
    ]
    if comparison.score_of(comparison.judged).n_rows >= FEWEST_TESTED_ROWS:
        drawn += [_picture(comparison, draw, 3.1) for draw in (spectrum, correlations)]
    if len({c.order for c in comparison.model.candidates}) > 1:
        drawn.append(_picture(comparison, orders, 3.0))
    return drawn


Drawer = Callable[["Comparison", float, float], tuple[Any, str, str]]


def _picture(comparison: "Comparison", draw: Drawer, height: float) -> Picture:
    with style(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")  # a name in a rare script
        wide, title, reading = draw(comparison, WIDE, height)
        narrow, _, _ = draw(comparison, NARROW, height)
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
        axes.plot(t, low, **_look(index), label=label)
    elif filled:
        axes.fill_between(t, low, high, color=COLOURS[index], alpha=0.55, linewidth=1.0, label=label)
    else:
        axes.plot(t, high, **_look(index), label=label)
        axes.plot(t, low, **_look(index))


def overview(comparison: "Comparison", width: float, height: float) -> tuple[Any, str, str]:
    """Draw measurement and model over the whole judged set, and the error below."""
    record, rows = comparison.record, _span(comparison)
    t, output = _time(comparison, rows), comparison.record.outputs[0]
    y, model = record.y[rows, 0], comparison.prediction.free_run[rows]
    figure, (top, bottom) = subplots(2, 1, width=width, height=height, sharex=True, height_ratios=(2, 1))
    _draw(top, envelope(t, y), 0, MEASURED, filled=True)
    _draw(top, envelope(t, model), 1, MODEL, filled=False)
    top.set_ylabel(_label(record, output))
    _legend(top)
    _draw(bottom, envelope(t, y - model), 4, "error", filled=True)
    bottom.axhline(0.0, color=GREY, linewidth=0.6)
    _mark_skip(comparison, rows, (top, bottom), t)
    bottom.set_ylabel(f"error [{_plain(record.unit(output)) or '–'}]")
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
    rows = _worst_rows(comparison)
    t, output = _time(comparison, rows), record.outputs[0]
    figure, (top, bottom) = subplots(2, 1, width=width, height=height, sharex=True, height_ratios=(2, 1))
    top.plot(t, record.y[rows, 0], **_look(0), label=MEASURED)
    top.plot(t, comparison.prediction.free_run[rows], **_look(1), label=MODEL)
    top.set_ylabel(_label(record, output))
    _legend(top)
    for index, name in enumerate(record.inputs):
        bottom.step(t, record.u[rows, index], where="post", **_input_look(index), label=_plain(name))
    bottom.set_ylabel(_label(record, record.inputs[0]) if len(record.inputs) == 1 else "inputs")
    bottom.set_xlabel("time [s]")
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


def spectrum(comparison: "Comparison", width: float, height: float) -> tuple[Any, str, str]:
    """Draw the spectra of measurement and error."""
    record, rows = comparison.record, _scored(comparison)
    y = record.y[rows, 0]
    error = y - comparison.prediction.free_run[rows]
    length = min(y.size, max(64, 1 << int(np.log2(y.size / 8))))
    frequency, power = power_density(y, record.period, length)
    _, error_power = power_density(error, record.period, length)
    figure, axes = subplots(width=width, height=height)
    unit = record.unit(record.outputs[0])
    for index, (density, name) in enumerate(((power, MEASURED), (error_power, "error"))):
        if density[1:].max() > 0.0:  # nothing of a constant can be drawn on a logarithmic scale
            axes.loglog(frequency[1:], np.sqrt(density[1:]), **_look(index), label=name)
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel(f"amplitude density [{_plain(unit) or '1'}/√Hz]")
    _legend(axes)
    share = np.cumsum(error_power[1:]) / max(float(error_power[1:].sum()), 1e-300)
    middle = float(frequency[1:][min(int(np.searchsorted(share, 0.9)), share.size - 1)])
    failing = np.flatnonzero(error_power[1:] > 0.5 * power[1:])
    if failing.size == 0:
        verdict = "the model explains more than half of the signal's power at every frequency"
    else:
        verdict = (
            "the first frequency at which the model explains less than half of the signal's power is "
            f"{quantity(float(frequency[1:][failing[0]]), 'Hz')}"
        )
    reading = f"90 % of the error lies below {quantity(middle, 'Hz')}; {verdict}."
    return figure, "Spectrum of measurement and error", reading


def power_density(values: "Floats", period: float, length: int) -> tuple["Floats", "Floats"]:
    """Return frequencies [Hz] and the one-sided power density by Welch's method.

    Hann windows that overlap by half, each less its mean.

    Parameters
    ----------
    values : ndarray, shape (n_samples,)
    period : float
        Sampling period [s].
    length : int
        Rows in each window.

    Examples
    --------
    >>> import numpy as np
    >>> frequency, power = power_density(np.sin(0.5 * np.arange(4000.0)), 1.0, 500)
    >>> round(float(np.sum(power) * frequency[1]), 3)  # the power of a sine
    0.5
    """
    starts = np.arange(0, values.size - length + 1, max(length - length // 2, 1))
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    power = np.zeros(length // 2 + 1)
    for start in starts:
        piece = values[start : start + length]
        power += np.abs(np.fft.rfft(window * (piece - piece.mean()))) ** 2
    power *= 2.0 * period / (starts.size * float(window @ window))
    power[0] *= 0.5
    if length % 2 == 0:
        power[-1] *= 0.5
    return np.asarray(np.fft.rfftfreq(length, period), dtype=np.float64), power


def correlations(comparison: "Comparison", width: float, height: float) -> tuple[Any, str, str]:
    """Draw residual auto- and cross-correlations with their bands."""
    tests = list(comparison.tests.items())[:2]
    beside = width > NARROW
    figure, grid = subplots(
        1 if beside else len(tests),
        len(tests) if beside else 1,
        width=width,
        height=height if beside else 1.6 * height,
        squeeze=False,
    )
    for axes, (name, test) in zip(grid.ravel(), tests, strict=True):
        axes.fill_between(test.lags, -test.band, test.band, color="#d9d9d9", linewidth=0, label="99 % band")
        axes.vlines(test.lags, 0.0, test.correlation, color=COLOURS[0], linewidth=1.2)
        axes.plot(
            test.lags, test.correlation, linestyle="none", marker=MARKERS[0], markersize=2.6, color=COLOURS[0]
        )
        axes.axhline(0.0, color=GREY, linewidth=0.6)
        axes.set_xlabel("lag [samples]")
        axes.set_ylabel("residual with itself" if name == "whiteness" else "input with residual")
        _legend(axes)
    words = [
        "the residual is white" if tests[0][1].passed else "the residual has a memory",
        "no linear trace of the input is left in it"
        if tests[1][1].passed
        else "it still follows the input linearly",
    ]
    reading = f"Bars beyond the grey band speak against chance: {words[0]}, and {words[1]}."
    return figure, "Correlation of the residual with itself and with the input", reading


def orders(comparison: "Comparison", width: float, height: float) -> tuple[Any, str, str]:
    """Draw the validation error of every structure tried."""
    record, candidates = comparison.record, comparison.model.candidates
    figure, axes = subplots(width=width, height=height)
    tried = [c for c in candidates if c.constant == candidates[0].constant]
    for index, delay in enumerate(sorted({c.delay for c in tried})):
        points = sorted((c.order, c.validation_rms) for c in tried if c.delay == delay)
        axes.plot(*zip(*points, strict=True), **series(index, marker=True), label=f"delay {delay}")
    details = comparison.model.details()
    own = tuple(details[name] for name in ("delay", "constant"))
    chosen = min(
        (c for c in candidates if c.order == comparison.model.order and (c.delay, c.constant) == own),
        key=lambda c: c.validation_rms,
    )
    axes.plot(
        chosen.order,
        chosen.validation_rms,
        linestyle="none",
        marker="o",
        markersize=11,
        markerfacecolor="none",
        markeredgecolor="#000000",
        markeredgewidth=1.2,
        label="chosen",
    )
    axes.set_yscale("log")
    axes.set_xlabel("order of the model")
    axes.set_xticks(sorted({c.order for c in tried}))
    axes.set_ylabel(f"validation error [{_plain(record.unit(record.outputs[0])) or '–'}]")
    _legend(axes)
    best = min(c.validation_rms for c in candidates)
    unit = record.unit(record.outputs[0])
    reading = (
        f"The {ordinal(chosen.order)}-order model chosen has {quantity(chosen.validation_rms, unit)}; "
        f"the smallest error of all is {quantity(best, unit)}."
    )
    return figure, "Free-run error on the validation rows against the order", reading


def _look(index: int) -> dict[str, Any]:
    return series(index) | {"linewidth": 1.1}


def _input_look(index: int) -> dict[str, Any]:
    return {
        "color": COLOURS[2 + index % 5],
        "linestyle": LINE_STYLES[index % len(LINE_STYLES)],
        "linewidth": 1.1,
    }


def _legend(axes: Any) -> None:
    if axes.get_legend_handles_labels()[1]:
        axes.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.1, columnspacing=1.2
        )


def _label(record: Any, name: str) -> str:
    return f"{_plain(name)} [{_plain(record.unit(name)) or '–'}]"


def _plain(name: str) -> str:
    """Keep a dollar sign in a name from starting mathematics."""
    return name.replace("$", r"\$")


def _scored(comparison: "Comparison") -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    record = comparison.record
    if comparison.judged == "validation":
        return np.flatnonzero(record.validation)
    return np.flatnonzero(record.scored_rows(comparison.judged))


def _span(comparison: "Comparison") -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """Return the rows of the judged set in its first experiment, those that are skipped included."""
    record = comparison.record
    rows = _scored(comparison)
    part = next(part for part in record.slices if part.start <= rows[0] < part.stop)
    if comparison.judged == "validation":
        return np.asarray(rows[rows < part.stop])
    places = np.flatnonzero(record.split[part] == comparison.judged)
    return np.asarray(part.start + places)


def _time(comparison: "Comparison", rows: Sequence[int] | Any) -> "Floats":
    """Return times [s] from the start of the experiment."""
    origin = max(start for start in comparison.record.starts if start <= rows[0])
    return np.asarray((np.asarray(rows) - origin) * comparison.record.period)


def _mark_skip(comparison: "Comparison", rows: Any, axes: Sequence[Any], t: "Floats") -> None:
    skip = comparison.score_of(comparison.judged).skip
    if skip > 0:
        for one in axes:
            one.axvspan(t[0], t[min(skip, rows.size - 1)], color="#e8e8e8", linewidth=0)


def _worst_rows(comparison: "Comparison") -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """Return the consecutive rows in which the mean squared error is largest."""
    record, scored = comparison.record, _scored(comparison)
    span = _span(comparison)
    scored = scored[scored <= span[-1]]
    whole = np.arange(scored[0], scored[-1] + 1)
    error = record.y[whole, 0] - comparison.prediction.free_run[whole]
    length = _zoom_length(error)
    squared = np.concatenate([[0.0], np.cumsum(np.nan_to_num(error) ** 2)])
    first = int(np.argmax(squared[length:] - squared[:-length]))
    return np.asarray(whole[first : first + length])


def _zoom_length(error: "Floats") -> int:
    """Return how many rows show some swings of the error: a few of its correlation times."""
    from sysid.diagnosis.scores import block_length

    wanted = max(ZOOMED_ROWS, 3 * block_length(np.nan_to_num(error) ** 2))
    return int(min(wanted, max(error.size // 4, min(60, error.size)), error.size))
