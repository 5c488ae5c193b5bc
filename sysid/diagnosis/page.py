"""The comparison as one self-contained HTML page."""

import base64
from cmath import log
from importlib.resources import files
from math import isfinite, pi
from typing import TYPE_CHECKING, Any

from sysid.diagnosis.wording import percent, quantity, significant

if TYPE_CHECKING:
    from sysid.diagnosis.compare import Comparison


def render(comparison: "Comparison") -> str:
    """Return the page.

    It holds its style sheet and its figures, needs no script, and loads nothing from elsewhere.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    str
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    from sysid.diagnosis.figures import pictures

    environment = Environment(
        loader=PackageLoader("sysid.diagnosis", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["tied"] = _tied
    record, model = comparison.record, comparison.model
    return environment.get_template("compare.html").render(
        css=files("sysid.reporting").joinpath("page.css").read_text(encoding="utf-8"),
        title=f"{record.name}: {model.title}",
        sentences=comparison.sentences(),
        judged=comparison.judged,
        scores=[_score_row(entry) for entry in comparison.scores],
        pictures=[
            {"title": p.title, "reading": p.reading, "wide": _embedded(p.wide), "narrow": _embedded(p.narrow)}
            for p in pictures(comparison)
        ],
        parameters=_parameter_rows(comparison),
        equations=model.equations,
        status=model.status,
        poles=[_pole(pole, record.period) for pole in model.poles],
        warnings=comparison.warnings,
        provenance=_provenance(comparison),
    )


def _tied(text: str) -> str:
    """Keep a percent sign on the line of its number."""
    return text.replace(" %", "\N{NO-BREAK SPACE}%")


def _embedded(svg: str) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(svg.encode("utf-8")).decode("ascii")


def _score_row(entry: Any) -> dict[str, str]:
    free, (low, high) = entry.free_run, entry.interval
    return {
        "name": entry.name,
        "rows": f"{entry.n_rows}" + (f" (skip {entry.skip})" if entry.skip else ""),
        "rmse": quantity(free.rmse, entry.unit),
        "nrmse": significant(free.nrmse),
        "interval": f"{significant(low)} – {significant(high)}",
        "fit": percent(free.fit / 100.0),
        "vaf": percent(free.vaf / 100.0),
        "one_step": quantity(entry.one_step.rmse, entry.unit),
        "initial_state": entry.initial_state,
        "fitted_on": entry.fitted_on,
    }


def _parameter_rows(comparison: "Comparison") -> list[dict[str, str]]:
    return [
        {
            "name": name,
            "value": f"{entry.value:.6g}",
            "error": _error_text(entry.std_error),
            "unit": entry.unit,
        }
        for name, entry in comparison.model.parameters.items()
    ]


def _error_text(std_error: float | None) -> str:
    if std_error is None:
        return "fixed"
    return f"{std_error:.2g}" if isfinite(std_error) else "not determined"


def _pole(pole: complex, period: float) -> dict[str, str]:
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
    return {"value": value, "meaning": meaning}


def _provenance(comparison: "Comparison") -> list[tuple[str, str]]:
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
