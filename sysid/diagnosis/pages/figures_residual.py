"""Figures of the residual: spectrum, correlations, and the structures that were tried."""

from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.diagnosis.pages.drawing import MEASURED, NARROW, legend, line_look, plain
from sysid.diagnosis.pages.figures_run import scored_places
from sysid.diagnosis.wording import ordinal, quantity
from sysid.reporting.style import COLOURS, GREY, MARKERS, series, subplots

if TYPE_CHECKING:
    from sysid.diagnosis.comparison.judgement import Judgement
    from sysid.linear.forms import Floats


# Correlations that find room beside each other on a wide page.
MOST_BESIDE = 2


def spectrum(comparison: "Judgement", width: float, height: float) -> tuple[Any, str, str]:
    """Draw the spectra of measurement and error."""
    record, rows = comparison.record, scored_places(comparison)
    y = record.y[rows, 0]
    error = y - comparison.prediction.free_run[rows]
    length = min(y.size, max(64, 1 << int(np.log2(y.size / 8))))
    frequency, power = power_density(y, record.period, length)
    _, error_power = power_density(error, record.period, length)
    figure, axes = subplots(width=width, height=height)
    unit = record.unit(record.outputs[0])
    for index, (density, name) in enumerate(((power, MEASURED), (error_power, "error"))):
        if density[1:].max() > 0.0:  # nothing of a constant can be drawn on a logarithmic scale
            axes.loglog(frequency[1:], np.sqrt(density[1:]), **line_look(index), label=name)
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel(f"amplitude density [{plain(unit) or '1'}/√Hz]")
    floor = comparison.noise_floor.rms
    if np.isfinite(floor) and floor > 0.0:
        label = "noise floor" if width > NARROW else "noise"
        axes.axhline(floor * np.sqrt(2.0 * record.period), **line_look(2), label=label)
    legend(axes)
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
    if np.isfinite(floor):
        reading += (
            f" The noise floor, {quantity(floor, unit)} in all, is drawn as if spread evenly over frequency; "
            "what lies above it is the model's or a disturbance."
        )
    return figure, "Spectrum of measurement, error and noise floor", reading


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


def correlations(comparison: "Judgement", width: float, height: float) -> tuple[Any, str, str]:
    """Draw residual auto- and cross-correlations with their bands."""
    inputs = comparison.record.inputs
    tests = list(comparison.tests.items())[: 1 + len(inputs)]
    beside = width > NARROW and len(tests) <= MOST_BESIDE
    figure, grid = subplots(
        1 if beside else len(tests),
        len(tests) if beside else 1,
        width=width,
        height=height if beside else 0.8 * len(tests) * height,
        squeeze=False,
    )
    labels = [
        "residual with itself",
        *(f"{name if len(inputs) > 1 else 'input'} with residual" for name in inputs),
    ]
    for axes, label, (_, test) in zip(grid.ravel(), labels, tests, strict=True):
        axes.fill_between(test.lags, -test.band, test.band, color="#d9d9d9", linewidth=0, label="99 % band")
        axes.vlines(test.lags, 0.0, test.correlation, color=COLOURS[0], linewidth=1.2)
        axes.plot(
            test.lags, test.correlation, linestyle="none", marker=MARKERS[0], markersize=2.6, color=COLOURS[0]
        )
        axes.axhline(0.0, color=GREY, linewidth=0.6)
        axes.set_xlabel("lag [samples]")
        axes.set_ylabel(plain(label))
        legend(axes)
    followed = [name for name, (_, test) in zip(inputs, tests[1:], strict=True) if not test.passed]
    whose = "the input" if len(inputs) == 1 else " and ".join(followed) or "any input"
    words = [
        "the residual is white" if tests[0][1].passed else "the residual has a memory",
        f"it still follows {whose} linearly" if followed else f"no linear trace of {whose} is left in it",
    ]
    reading = f"Bars beyond the grey band speak against chance: {words[0]}, and {words[1]}."
    return figure, "Correlation of the residual with itself and with the input", reading


def orders(comparison: "Judgement", width: float, height: float) -> tuple[Any, str, str]:
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
    axes.set_ylabel(f"validation error [{plain(record.unit(record.outputs[0])) or '–'}]")
    legend(axes)
    best = min(c.validation_rms for c in candidates)
    unit = record.unit(record.outputs[0])
    reading = (
        f"The {ordinal(chosen.order)}-order model chosen has {quantity(chosen.validation_rms, unit)}; "
        f"the smallest error of all is {quantity(best, unit)}."
    )
    return figure, "Free-run error on the validation rows against the order", reading
