"""The front page: what was run, from what, and which gates hold."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sysid.reporting import numbers
from sysid.reporting.blocks import Cell, Verdict, facts, table
from sysid.reporting.nodes import Blocks, Inline, Node, text
from sysid.reporting.records import Results, gates

_VERDICTS = ("reproduced", "replicated", "partial", "not replicated")
_KNOWN = ("commit", "date", "platform", "seed", "runs", "versions")
_SHORT_HASH = 16
_FEW = 24


def summary(results: Results) -> tuple[str, bool]:
    """Say in one sentence how the gates stand.

    Parameters
    ----------
    results : mapping
        Contents of ``results.json``.

    Returns
    -------
    sentence : str
    green : bool
        All gates passed, and there is at least one.

    Examples
    --------
    >>> summary({"papers": {"bai": {"gates": [{"id": "a", "passed": True}, {"id": "b", "passed": False}]}}})
    ('1 of 2 gates passed; red: bai/b.', False)
    """
    records = [
        (paper, gate) for paper, content in results["papers"].items() for gate in content.get("gates", [])
    ]
    red = [f"{paper}/{gate['id']}" for paper, gate in records if not gate.get("passed")]
    if not records:
        return "No gates were run.", False
    if not red:
        return f"{len(records)} gates: all passed." if len(records) > 1 else "One gate: passed.", True
    named = ", ".join(red[:6]) + (f" and {len(red) - 6} more" if len(red) > 6 else "")
    return f"{len(records) - len(red)} of {len(records)} gates passed; red: {named}.", False


def front_page(results: Results, title: str) -> Blocks:
    """Write the blocks of the front page.

    Parameters
    ----------
    results : mapping
        Contents of ``results.json``.
    title : str
        Title of the report.

    Returns
    -------
    list of dict
    """
    sentence, green = summary(results)
    papers = results["papers"]
    blocks: Blocks = [
        {"t": "title", "c": [text(title)], "lead": [text(_lead(results))]},
        {"t": "banner", "kind": "passed" if green else "failed", "c": [text(sentence)]},
        *_overview(papers),
        _section("What was run"),
        *facts(_provenance(results.get("provenance") or {})).blocks,
        _section("Gates"),
    ]
    for paper, content in papers.items():
        blocks += _gates(results, paper, "" if len(papers) == 1 else f"{_name(paper, content)}.")
    return [*blocks, _section("Contents"), {"t": "contents", "entries": []}]


def _gates(results: Results, paper: str, caption: str) -> Blocks:
    """Show all gates where they are few; else the red ones, and the others by family."""
    records = results["papers"][paper].get("gates", [])
    named: Inline = [text(caption)] if caption else []
    if not records:
        return [{"t": "para", "c": [*named, text(" No gates." if caption else "No gates.")]}]
    if len(records) <= _FEW:
        return [{**gates(results, paper, caption="", reasons=False).blocks[0], "caption": named}]
    red = [record for record in records if not record.get("passed")]
    shown: Blocks = []
    if red:
        only = {"papers": {paper: {"gates": red}}}
        shown.append({**gates(only, paper, caption="").blocks[0], "caption": [*named, text(" Red gates.")]})
    families: dict[tuple[str, str], list[bool]] = {}
    for record in records:
        key = (str(record["id"]).split("/")[0], str(record.get("type") or ""))
        families.setdefault(key, []).append(bool(record.get("passed")))
    rows: list[list[Cell]] = [
        [[{"t": "code", "s": family}], _count_verdict(sum(passed), len(passed)), kind]
        for (family, kind), passed in families.items()
    ]
    summed = table(rows, ["Family of gates", "Passed", "Type"], align="lll").blocks[0]
    return [*shown, {**summed, "caption": named}]


def _count_verdict(passed: int, total: int) -> Verdict:
    words = f"all {total} passed" if 1 < passed == total else f"{passed} of {total} passed"
    if total == 1:
        words = "passed" if passed else "failed"
    return Verdict(words, "passed" if passed == total else "failed")


def _section(words: str) -> Node:
    return {"t": "heading", "level": 2, "c": [text(words)], "id": f"front-{words.lower().replace(' ', '-')}"}


def _lead(results: Results) -> str:
    if "lead" in results:
        return str(results["lead"])
    named = "; ".join(_name(paper, content) for paper, content in results["papers"].items())
    return f"Replication of {named}." if named else "No paper was run."


def _name(paper: str, content: Mapping[str, Any]) -> str:
    return str(content.get("title") or paper)


def _overview(papers: Mapping[str, Mapping[str, Any]]) -> Blocks:
    if not papers:
        return []
    used = [verdict for verdict in _VERDICTS if any(_count(content, verdict) for content in papers.values())]
    rows: list[list[Cell]] = []
    for paper, content in papers.items():
        records = content.get("gates", [])
        passed = sum(bool(gate.get("passed")) for gate in records)
        link: Inline = [{"t": "link", "url": f"#{paper}", "c": [text(_name(paper, content))]}]
        word = Verdict(f"{passed} of {len(records)}", "passed" if passed == len(records) else "failed")
        rows.append(
            [link, word, len(content.get("claims", [])), *(_count(content, verdict) for verdict in used)]
        )
    columns = ["Paper", "Gates passed", "Claims", *(verdict.capitalize() for verdict in used)]
    return list(table(rows, columns, align="ll" + "r" * (len(columns) - 2)).blocks)


def _count(content: Mapping[str, Any], verdict: str) -> int:
    return sum(claim.get("verdict") == verdict for claim in content.get("claims", []))


def _provenance(record: Mapping[str, Any]) -> dict[str, Cell]:
    keys = [key for key in _KNOWN if key in record] + [key for key in record if key not in _KNOWN]
    return {key.replace("_", " ").capitalize(): _value(record[key]) for key in keys}


def _value(value: Any) -> Cell:
    if isinstance(value, Mapping):
        if not value:
            return "none"
        nodes: Inline = []
        for key, item in value.items():
            nodes += [text(", ")] if nodes else []
            nodes += [text(f"{key}\N{NO-BREAK SPACE}"), {"t": "code", "s": _short(item)}]
        return nodes
    return str(value) if isinstance(value, int) else _short(value)  # a seed is a name, not a quantity


def _short(value: Any) -> str:
    """Shorten a hash; the whole of it stands in ``results.json``."""
    words = numbers.values(value)
    is_hash = len(words) > _SHORT_HASH and all(char in "0123456789abcdef" for char in words)
    return words[:_SHORT_HASH] + "…" if is_hash else words
