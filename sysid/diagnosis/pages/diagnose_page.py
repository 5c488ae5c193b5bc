"""What a diagnosis shows: the ladder, the ranked candidates, the equation; as a page and as a PDF."""

from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.diagnosis.decide.evidence import REPLICATES
from sysid.diagnosis.pages.content import Content, Section, Table
from sysid.diagnosis.pages.drawing import (
    NARROW,
    WIDE,
    Picture,
    axis_label,
    envelope,
    legend,
    line_look,
    plain,
)
from sysid.diagnosis.pages.figures import port_pictures
from sysid.diagnosis.pages.figures_effects import effect_pictures
from sysid.diagnosis.pages.figures_run import seconds_of
from sysid.diagnosis.pages.report_words import sentences
from sysid.diagnosis.wording import percent, plus_minus, quantity, significant, value_beside
from sysid.reporting.style import COLOURS, style, svg

if TYPE_CHECKING:
    from sysid.diagnosis.outcome import Outcome

SHOWN_CANDIDATES = 12


def content_of(diagnosis: "Outcome") -> Content:
    """Return what is shown of a diagnosis."""
    judged = diagnosis.judged
    final = diagnosis.final
    sections = (
        Section(
            "The ladder",
            ("The error of the free run with each effect that was added, down to the noise floor.",),
            tables=(_ladder_table(diagnosis, judged),),
            pictures=(_ladder_picture(diagnosis, judged), _runs_picture(diagnosis)),
        ),
        Section("What was added", pictures=tuple(effect_pictures(diagnosis.views))),
        Section(
            "Candidates",
            (
                "Each candidate alone in the model. The p-value is the chance that the best of all "
                "candidates looks as good with nothing missing; the criterion is by how much the "
                "Bayesian information criterion falls; the error is that of the free run on the "
                "validation rows.",
            ),
            tables=(_candidates(diagnosis),),
        ),
        Section("Where the baseline fails", items=tuple(finding.sentence for finding in diagnosis.where)),
        Section("What a static map could explain", pictures=tuple(port_pictures(diagnosis.ports))),
        Section("The model", tuple(final.equation().split("\n")), tables=(_parameters(diagnosis),)),
        Section("To keep in mind", items=diagnosis.record.warnings),
    )
    return Content(
        title=f"{diagnosis.record.name}: what the model {diagnosis.structure.name!r} lacks",
        judged=judged,
        sentences=tuple(sentences(diagnosis)),
        sections=tuple(s for s in sections if s.paragraphs or s.items or s.tables or s.pictures),
    )


def _ladder_table(diagnosis: "Outcome", judged: str) -> Table:
    unit = diagnosis.record.unit(diagnosis.record.outputs[0])
    rows = []
    for rung in diagnosis.ladder:
        entry = rung.scores[judged]
        low, high = entry["interval"]
        rows.append(
            (
                rung.effect or "baseline",
                _number(entry["rmse"], lambda v: quantity(v, unit)),
                _number(entry["nrmse"], percent),
                ""
                if low is None or high is None
                else f"{percent(low).removesuffix(' %')} to {percent(high)}",
                percent(min(rung.removed, 1.0)) if rung.step else "",
            )
        )
    columns = ("added", ">RMSE", ">NRMSE", ">95 % interval", ">removed")
    removed = "removed: share of the explainable error, on the validation rows"
    return Table(f"Free run on {judged}; {removed}.", columns, tuple(rows))


def _candidates(diagnosis: "Outcome") -> Table:
    entries = diagnosis.ranked()[:SHOWN_CANDIDATES]
    rows = tuple(
        (
            entry["effect"],
            _number(entry["p_value"], _chance),
            _number(entry["delta_bic"], significant),
            _number(entry["nrmse_validation"], percent),
            ", ".join(
                f"{name} = {_number(p['value'], significant)} {p['unit']}".rstrip()
                for name, p in entry["parameters"].items()
            )
            if entry["nrmse_validation"] is not None
            else "no place in this model, or no fit",
        )
        for entry in entries
    )
    return Table("Best first.", ("effect", ">p-value", ">criterion", ">NRMSE", "parameters"), rows)


def _parameters(diagnosis: "Outcome") -> Table:
    rows = tuple(
        (
            f"{p.owner}: {p.name}" if p.owner else p.name,
            value_beside(p.value, p.std_error),
            plus_minus(p.std_error),
            p.unit,
        )
        for p in diagnosis.final.parameters
    ) + _known(diagnosis)
    return Table("With 95 % intervals.", ("parameter", ">value", ">interval", "unit"), rows)


def _known(diagnosis: "Outcome") -> tuple[tuple[str, ...], ...]:
    """Return the rows of a physical model's parameters that were fixed."""
    model = getattr(diagnosis.structure, "model", None)
    fixed = () if model is None else [p for p in model.parameters if p.status == "fixed"]
    return tuple((p.name, significant(p.start, 4), "fixed", p.unit) for p in fixed)


def _chance(p_value: float) -> str:
    """Return a p-value; one that no simulated record reached is smaller than can be told."""
    least = 1.0 / (REPLICATES + 1)
    return f"≤ {least:g}" if p_value <= least else significant(p_value)


def _number(value: float | None, words: Any) -> str:
    return "" if value is None else str(words(value))


def _ladder_picture(diagnosis: "Outcome", judged: str) -> Picture:
    with style():
        wide, narrow = (svg(_draw(diagnosis, judged, width)) for width in (WIDE, NARROW))
    first, last = (rung.scores[judged]["rmse"] or 0.0 for rung in (diagnosis.ladder[0], diagnosis.ladder[-1]))
    fall = f"It falls to {percent(last / first)} of the baseline's." if first else ""
    reading = fall if len(diagnosis.ladder) > 1 else "Nothing was added."
    return Picture("Free-run error, rung by rung", reading, wide, narrow)


def _runs_picture(diagnosis: "Outcome") -> Picture:
    with style():
        wide, narrow = (svg(_draw_runs(diagnosis, width)) for width in (WIDE, NARROW))
    reading = "Below, what each free run misses; a fall to the noise leaves a band without a pattern."
    return Picture(f"Measured and modelled on {diagnosis.judged}", reading, wide, narrow)


def _draw_runs(diagnosis: "Outcome", width: float) -> Any:
    from matplotlib.figure import Figure

    record, judged = diagnosis.record, diagnosis.judged
    chosen = record.validation if judged == "validation" else record.scored_rows(judged)
    rows = np.flatnonzero(chosen)
    first = next(part for part in record.slices if part.start <= rows[0] < part.stop)
    rows = rows[rows < first.stop]
    t, y = seconds_of(record, rows), record.y[rows, 0]
    runs = {"baseline": diagnosis.baseline.output[rows]}
    if len(diagnosis.ladder) > 1:
        runs["final"] = diagnosis.final.output[rows]
    figure = Figure(figsize=(width, 4.0), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    curves = {"measured": y} | runs
    for index, (name, values) in enumerate(curves.items()):
        top.plot(*_line(t, values), label=name, **line_look(index))
    for index, (name, values) in enumerate(runs.items(), start=1):
        bottom.plot(*_line(t, y - values), label=name, **line_look(index))
    top.set_ylabel(axis_label(record, record.outputs[0]))
    bottom.set_ylabel(f"error [{plain(record.unit(record.outputs[0])) or '–'}]")
    bottom.set_xlabel("time [s]")
    legend(top)
    return figure


def _line(t: Any, values: Any) -> tuple[Any, Any]:
    """Return a curve, a long one thinned to its envelope drawn as one line."""
    places, low, high = envelope(t, values)
    if low is high:
        return places, low
    return np.repeat(places, 2), np.column_stack([low, high]).ravel()


def _draw(diagnosis: "Outcome", judged: str, width: float) -> Any:
    from matplotlib.figure import Figure

    names = [rung.effect or "baseline" for rung in diagnosis.ladder]
    values = [rung.scores[judged]["rmse"] or np.nan for rung in diagnosis.ladder]
    figure = Figure(figsize=(width, 1.2 + 0.35 * len(names)), layout="constrained")
    axes = figure.add_subplot()
    axes.barh(range(len(names)), values, color=COLOURS[0], height=0.6)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    unit = diagnosis.record.unit(diagnosis.record.outputs[0])
    axes.set_xlabel(f"RMSE on {judged}" + (f" [{unit}]" if unit else ""))
    if np.isfinite(diagnosis.noise_floor):
        axes.axvline(diagnosis.noise_floor, color=COLOURS[1], linestyle="--", label="noise floor")
        legend(axes)
    return figure
