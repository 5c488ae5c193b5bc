"""What a comparison shows: the same sections for the HTML page and the PDF."""

from cmath import log
from dataclasses import dataclass
from math import isfinite, pi
from typing import TYPE_CHECKING

from sysid.diagnosis.comparison.summary import sentences, spoken
from sysid.diagnosis.residuals import CorrelationTest
from sysid.diagnosis.wording import interval_text, percent, quantity, significant

if TYPE_CHECKING:
    from sysid.diagnosis.comparison.judgement import Judgement
    from sysid.diagnosis.comparison.scores import SetScore
    from sysid.diagnosis.pages.drawing import Picture


@dataclass(frozen=True)
class Table:
    """A table; columns whose heading begins with ``>`` are aligned to the right."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    @property
    def headings(self) -> tuple[str, ...]:
        """Headings without the mark of their alignment."""
        return tuple(column.removeprefix(">") for column in self.columns)

    @property
    def right(self) -> tuple[bool, ...]:
        """Whether a column is aligned to the right."""
        return tuple(column.startswith(">") for column in self.columns)


@dataclass(frozen=True)
class Section:
    """A heading, then paragraphs, a list, tables, pictures."""

    heading: str
    paragraphs: tuple[str, ...] = ()
    items: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    pictures: "tuple[Picture, ...]" = ()
    facts: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Content:
    """Title, the sentence under it, the summary sentences, and the sections."""

    title: str
    judged: str
    sentences: tuple[str, ...]
    sections: tuple[Section, ...]


def content_of(comparison: "Judgement") -> Content:
    """Return what is shown of a comparison.

    Parameters
    ----------
    comparison : Judgement
    """
    from sysid.diagnosis.pages.figures import pictures

    drawn = {name: tuple(some) for name, some in pictures(comparison).items()}
    record, model = comparison.record, comparison.model
    sections = [
        Section("To keep in mind", items=comparison.warnings),
        Section("Scores", tables=(_scores(comparison),), paragraphs=_score_notes(comparison)),
        Section("Measured and modelled", pictures=drawn["run"]),
        Section("The map", pictures=drawn["maps"]),
        Section("The linear blocks", pictures=drawn["blocks"]),
        Section(
            "Where it fails",
            paragraphs=_where_paragraphs(comparison),
            tables=_findings(comparison),
            pictures=drawn["where"],
        ),
        Section(
            "What a static map could explain",
            items=() if drawn["ports"] else tuple(port.sentence for port in comparison.ports),
            pictures=drawn["ports"],
        ),
        Section(
            "Noise and what is left in the residual",
            paragraphs=(f"Even and odd distortion: {comparison.distortion.reason}.",),
            tables=_tests(comparison),
            pictures=drawn["tests"],
        ),
        Section(
            "The model",
            paragraphs=("\n".join(model.equations), f"The search: {model.status}."),
            tables=_model_tables(comparison),
            pictures=drawn["model"],
        ),
        Section("Provenance", facts=tuple(_provenance(comparison))),
    ]
    return Content(
        f"{record.name}: {model.title}",
        comparison.judged,
        tuple(sentences(comparison)),
        tuple(s for s in sections if s.paragraphs or s.items or s.tables or s.pictures or s.facts),
    )


def _scores(comparison: "Judgement") -> Table:
    columns = ("rows", ">samples", ">RMSE", ">NRMSE", ">95 % interval", ">fit", ">VAF", ">one-step RMSE")
    return Table(
        "Free-run errors; the last column is the error of a one-step prediction, for comparison.",
        columns,
        tuple(_score_row(entry) for entry in comparison.scores),
    )


def _score_row(entry: "SetScore") -> tuple[str, ...]:
    free, (low, high) = entry.free_run, entry.interval
    return (
        entry.name,
        f"{entry.n_rows}" + (f" (skip {entry.skip})" if entry.skip else ""),
        quantity(free.rmse, entry.unit),
        significant(free.nrmse),
        f"{significant(low)} – {significant(high)}",
        percent(free.fit / 100.0),
        percent(free.vaf / 100.0),
        quantity(entry.one_step.rmse, entry.unit),
    )


def _score_notes(comparison: "Judgement") -> tuple[str, ...]:
    notes = [
        f"{entry.name}: model fitted on {entry.fitted_on}, initial state {entry.initial_state}."
        for entry in comparison.scores
    ]
    return (
        "NRMSE is the error over the deviation of the measurement from its mean; fit is 100 % less NRMSE. "
        "The interval comes from a block bootstrap. " + " ".join(notes),
    )


def _where_paragraphs(comparison: "Judgement") -> tuple[str, ...]:
    if not comparison.location.shares:
        return ()
    return (
        "The squared error is divided by time, level, velocity, frequency and experiment. A region counts "
        "only if so large a share has a chance of less than 1 % anywhere, when the error has its own memory "
        "and knows no regions. Newly arising error is the part that the error's own past does not foretell.",
    )


def _findings(comparison: "Judgement") -> tuple[Table, ...]:
    if not comparison.where:
        return ()
    rows = tuple(
        (
            finding.kind,
            finding.sentence,
            percent(finding.error_share),
            percent(finding.data_share),
            _probability(finding.p_value),
        )
        for finding in comparison.where
    )
    columns = ("by", "finding", ">error", ">expected", ">p")
    return (Table("Where the error is concentrated beyond chance.", columns, rows),)


def _probability(p_value: float) -> str:
    return f"{p_value:.2g}" if p_value >= 1e-4 else "< 0.0001"


def _tests(comparison: "Judgement") -> tuple[Table, ...]:
    rows = tuple(_test_row(name, test) for name, test in comparison.tests.items())
    columns = ("what is tested", ">largest correlation", ">99 % band", ">lag", ">p", "verdict")
    return (Table("Tests of the residual; a band holds each correlation with 99 %.", columns, rows),)


def _test_row(name: str, test: CorrelationTest) -> tuple[str, ...]:
    import numpy as np

    if name == "whiteness":
        words = "the residual has a memory"
    elif name.startswith("input_residual"):
        words = f"the residual follows the input {name.removeprefix('input_residual').strip('_')}".strip()
    else:
        words = spoken(name)
    worst = int(np.argmax(np.abs(test.correlation) / test.band)) if test.lags.size else 0
    return (
        words,
        f"{test.correlation[worst]:.3f}" if test.lags.size else "–",
        f"±{test.band[worst]:.3f}" if test.lags.size else "–",
        str(int(test.lags[worst])) if test.lags.size else "–",
        _probability(test.p_value),
        "within chance" if test.passed else "beyond chance",
    )


def _model_tables(comparison: "Judgement") -> tuple[Table, ...]:
    model = comparison.model
    rows = tuple(
        (
            name,
            f"{entry.value:.6g}",
            _error_text(entry.std_error),
            interval_text(entry.value, entry.std_error),
            entry.unit,
        )
        for name, entry in model.parameters.items()
    )
    columns = ("parameter", ">value", ">standard error", ">95 % interval", "unit")
    tables = [Table("Parameters.", columns, rows)]
    if model.poles:
        poles = tuple(_pole(pole, comparison.record.period) for pole in model.poles)
        tables.append(Table("Poles.", ("pole", "meaning"), poles))
    return tuple(tables)


def _error_text(std_error: float | None) -> str:
    if std_error is None:
        return "fixed"
    return f"{std_error:.2g}" if isfinite(std_error) else "not determined"


def _pole(pole: complex, period: float) -> tuple[str, str]:
    """Describe a pole by what an engineer knows: time constant, or frequency and damping."""
    if abs(pole) >= 1.0 - 1e-12 and abs(pole.imag) < 1e-9:
        meaning = "integrator"
    elif abs(pole) < 1e-9:
        meaning = "one sample of delay"
    else:
        s = log(pole) / period
        if abs(pole.imag) < 1e-12 and pole.real > 0.0:
            meaning = f"time constant {quantity(-1.0 / s.real, 's')}"
        elif abs(pole.imag) < 1e-12:
            meaning = "alternates from sample to sample"
        else:
            meaning = f"{quantity(abs(s) / (2.0 * pi), 'Hz')}, damping {significant(-s.real / abs(s))}"
    value = f"{pole.real:.6g}" + (
        f" {'+' if pole.imag > 0 else '−'} {abs(pole.imag):.6g}i" if abs(pole.imag) > 1e-12 else ""
    )
    return value, meaning


def _provenance(comparison: "Judgement") -> list[tuple[str, str]]:
    import platform
    from importlib.metadata import PackageNotFoundError, version

    record = comparison.record
    try:
        own = version("sysid")
    except PackageNotFoundError:
        own = "unknown"
    columns = [f"{name} [{record.unit(name) or '–'}]" for name in (*record.inputs, *record.outputs)]
    return [
        ("Record", f"{record.name}, {record.n_samples} rows, {len(record.starts)} experiment(s)"),
        ("Columns", ", ".join(columns)),
        ("Sampling period", quantity(record.period, "s", 6)),
        ("Content (SHA-256)", record.sha256),
        ("sysid", own),
        ("Python", platform.python_version()),
    ]
