"""What ``results.json`` says, as blocks of a page: claims, gates and Monte-Carlo studies."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sysid.errors import DataError, ReportError
from sysid.reporting import numbers
from sysid.reporting.blocks import Cell, Display, Markdown, Verdict, facts, table
from sysid.reporting.nodes import Inline, text

Results = Mapping[str, Any]

_GREEK = {
    "alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "kappa", "lambda", "mu", "nu", "xi",
    "rho", "sigma", "tau", "phi", "chi", "psi", "omega",
}  # fmt: skip


def load(folder: Path | str | None = None) -> dict[str, Any]:
    """Read ``results.json`` of the run that is being reported.

    Parameters
    ----------
    folder : path, optional
        Results folder; default the environment variable ``SYSID_RESULTS``, else the current folder.

    Returns
    -------
    dict

    Raises
    ------
    DataError
        If the file is missing, is no JSON or has another schema.
    """
    path = Path(folder or os.environ.get("SYSID_RESULTS") or ".") / "results.json"
    try:
        results = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise DataError(f"cannot read {path}: {reason}; run `sysid replicate` first") from None
    except ValueError as error:
        raise DataError(f"{path} is not valid JSON ({error}); run `sysid replicate` again") from None
    if not isinstance(results, dict) or not isinstance(results.get("papers"), dict):
        raise DataError(f"{path} has no object 'papers'; run `sysid replicate` again")
    if results.get("schema") != 1:
        raise DataError(
            f"{path} has schema {results.get('schema')!r}, this version reads 1; run `sysid replicate` again"
        )
    return results


def claim(results: Results, paper: str, identifier: str, *picture: Display) -> Display:
    """Show one claim of the paper: printed, ours, verdict, tolerance, note.

    Parameters
    ----------
    results : mapping
        Contents of ``results.json``.
    paper, identifier : str
        Which claim.
    *picture : Display
        Figures or tables that belong to it.

    Returns
    -------
    Display

    Raises
    ------
    ReportError
        If the results hold no such claim.
    """
    record = _find(_paper(results, paper).get("claims", []), identifier, f"claim of {paper}")
    unit = f" {_unit(record)}" if _unit(record) else ""
    items: dict[str, Cell] = {
        "Printed": numbers.values(record.get("printed"))
        + (unit if record.get("printed") is not None else ""),
        "Ours": numbers.values(record.get("value")) + (unit if record.get("value") is not None else ""),
        "Verdict": claim_verdict(record),
        "Tolerance": tolerance(record.get("tolerance")),
    }
    if record.get("note"):
        items["Note"] = str(record["note"])
    title = {"t": "para", "c": [{"t": "strong", "c": [text(record.get("where") or identifier)]}, text(" "),
                                {"t": "quiet", "c": [{"t": "code", "s": identifier}]}]}  # fmt: skip
    blocks = [title, *facts(items).blocks, *(block for part in picture for block in part.blocks)]
    return Display(({"t": "box", "c": blocks},))


def claims(
    results: Results, paper: str, *, caption: str = "The paper's claims and what became of them."
) -> Display:
    """Show all claims of a paper in one table."""
    rows = [
        [
            _two_lines(str(record.get("where") or ""), str(record["id"])),
            claim_verdict(record),
            numbers.values(record.get("printed")),
            numbers.values(record.get("value")),
            _unit(record),
        ]
        for record in _paper(results, paper).get("claims", [])
    ]
    columns = ["Claim", "Verdict", "Printed", "Ours", "Unit"]
    shown = 5 if any(row[4] for row in rows) else 4
    return table([row[:shown] for row in rows], columns[:shown], caption=caption, align="llrrl"[:shown])


def gates(results: Results, paper: str, *, caption: str | None = None, reasons: bool = True) -> Display:
    """Show the gates of a paper, red ones first.

    Parameters
    ----------
    results : mapping
        Contents of ``results.json``.
    paper : str
        Identifier of the paper.
    caption : str, optional
        Markdown; by default a sentence with the count.
    reasons : bool
        Group the gates under the reason of their tolerance instead of giving its type in a column.

    Returns
    -------
    Display
    """
    records = _paper(results, paper).get("gates", [])
    ordered = sorted(records, key=lambda record: (bool(record.get("passed")), *_kind(record, records)))
    rows: list[list[Cell]] = []
    for position, record in enumerate(ordered):
        group = " – ".join(word for word in (record.get("type"), record.get("reason")) if word)
        before = ordered[position - 1] if position else None
        if reasons and group and (before is None or _kind(before, records) != _kind(record, records)):
            rows.append([group])
        code: Inline = [{"t": "code", "s": str(record["id"])}]
        kind = [] if reasons else [str(record.get("type") or "")]
        value = numbers.values(record.get("value"))
        rows.append([code, gate_verdict(record), value, allowed(record), *kind])
    passed = sum(bool(record.get("passed")) for record in records)
    words = caption if caption is not None else f"Gates: {passed} of {len(records)} passed."
    columns = ["Gate", "Verdict", "Value", "Allowed", *([] if reasons else ["Type"])]
    return table(rows, columns, caption=words, align="llrll"[: len(columns)])


def _kind(record: Mapping[str, Any], records: Sequence[Mapping[str, Any]]) -> tuple[int, str]:
    """Tell apart the groups of gates with one type and reason, in the order in which they first appear."""
    key = (record.get("type"), record.get("reason"))
    first = next(
        place for place, other in enumerate(records) if (other.get("type"), other.get("reason")) == key
    )
    return first, str(key)


def monte_carlo(results: Results, paper: str, case: str, *, caption: str | None = None) -> Display:
    """Show a Monte-Carlo study: bias with its standard error, spread, band and efficiency of each parameter.

    Parameters
    ----------
    results : mapping
        Contents of ``results.json``.
    paper, case : str
        Which study.
    caption : str, optional
        Markdown; by default the case with its runs.

    Returns
    -------
    Display
    """
    studies = _paper(results, paper).get("monte_carlo", {})
    if case not in studies:
        raise ReportError(
            f"results of {paper} hold no Monte-Carlo case {case!r}; there are: {', '.join(studies)}"
        )
    study = studies[case]
    rows = [[Markdown(symbol(name)), *_statistics(entry)] for name, entry in study["parameters"].items()]
    columns = [
        "Parameter",
        "True",
        "Mean",
        "Bias ± its std error",
        "Std",
        "RMSE",
        "95 % band",
        "Bound",
        "Efficiency",
    ]
    words = caption if caption is not None else (
        f"{_markdown_text(case)}: {numbers.number(study.get('n_runs'))} runs, "
        f"{numbers.number(study.get('failed', 0))} failed. Bound: the asymptotic standard deviation."
    )  # fmt: skip
    return table(rows, columns, caption=words, align="lrrrrrrrr")


def _statistics(entry: Mapping[str, Any]) -> list[Cell]:
    error, spread = entry.get("bias_std_error"), entry.get("std")
    edge = spread / 3 if spread else None
    low, high = entry.get("q025"), entry.get("q975")
    band = (
        None if low is None or high is None else _range(numbers.number(low, edge), numbers.number(high, edge))
    )
    return [
        numbers.number(entry.get("true")),
        numbers.number(entry.get("mean"), error),
        numbers.with_error(entry.get("bias"), error),
        numbers.number(spread, digits=3),
        numbers.number(entry.get("rmse"), digits=3),
        band,
        numbers.number(entry.get("crlb_std"), digits=3),
        numbers.number(entry.get("efficiency"), digits=3),
    ]


def symbol(name: str) -> str:
    r"""Write a parameter's name as mathematics where it has the form of a symbol.

    Examples
    --------
    >>> symbol("alpha1"), symbol("a"), symbol("rise time")
    ('$\\alpha_{1}$', '$a$', 'rise time')
    """
    found = re.fullmatch(r"([A-Za-z]+?)_?([0-9]*)", name)
    if found is None or (len(found[1]) > 1 and found[1] not in _GREEK):
        return _markdown_text(name)
    letter = f"\\{found[1]}" if found[1] in _GREEK else found[1]
    return f"${letter}_{{{found[2]}}}$" if found[2] else f"${letter}$"


def gate_verdict(record: Mapping[str, Any]) -> Verdict:
    """Give the word of a gate."""
    if record.get("passed") is None:
        return Verdict("not run", "open")
    return Verdict("passed", "passed") if record["passed"] else Verdict("failed", "failed")


def claim_verdict(record: Mapping[str, Any]) -> Verdict:
    """Give the word of a claim; what was not replicated is open, what missed its tolerance has failed."""
    word = str(record.get("verdict") or "not judged")
    if record.get("passed") is False:
        return Verdict(f"{word} (outside tolerance)" if word != "not replicated" else word, "failed")
    return Verdict(word, "passed" if word in ("reproduced", "replicated") else "open")


def allowed(record: Mapping[str, Any]) -> str:
    """Write the bounds of a gate."""
    lower, upper = record.get("lower"), record.get("upper")
    if lower is None and upper is None:
        return numbers.MISSING
    if lower is None or upper is None:
        sign, bound = ("≤", upper) if lower is None else ("≥", lower)
        return f"{sign}{numbers.TIED}{numbers.values(bound)}"
    if lower == upper:
        return f"={numbers.TIED}{numbers.values(lower)}"
    return _range(numbers.values(lower), numbers.values(upper))


def tolerance(record: object) -> str:
    """Write a tolerance: its type, then its bounds."""
    if not isinstance(record, Mapping):
        return numbers.values(record)
    rest = {str(key).replace("_", " "): value for key, value in record.items() if key != "type"}
    kind = str(record.get("type") or "")
    return ", ".join(part for part in (kind, numbers.values(rest)) if part) or numbers.MISSING


def _unit(record: Mapping[str, Any]) -> str:
    """Give the unit; a pure number has none."""
    unit = str(record.get("unit") or "")
    return "" if unit == "1" else unit


def _range(low: str, high: str) -> str:
    return f"{low}{numbers.TIED}…{numbers.TIED}{high}"


def _paper(results: Results, paper: str) -> Mapping[str, Any]:
    papers: Mapping[str, Mapping[str, Any]] = results["papers"]
    if paper not in papers:
        raise ReportError(f"the results hold no paper {paper!r}; there are: {', '.join(papers)}")
    return papers[paper]


def _find(records: Sequence[Mapping[str, Any]], identifier: str, what: str) -> Mapping[str, Any]:
    for record in records:
        if record.get("id") == identifier:
            return record
    known = ", ".join(str(record.get("id")) for record in records)
    raise ReportError(f"the results hold no {what} {identifier!r}; there are: {known}")


def _two_lines(first: str, second: str) -> Inline:
    """Set words with an identifier, in quiet type, below them."""
    nodes: Inline = [text(first), {"t": "break"}] if first else []
    return [*nodes, {"t": "quiet", "c": [{"t": "code", "s": second}]}]


def _markdown_text(words: str) -> str:
    """Protect plain words from being read as markdown."""
    return re.sub(r"([\\`*_\[\]<>$|#&~-])", r"\\\1", words)
