"""From a finished bench to ``report.html`` and ``report.pdf``."""

import json
import os
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from platform import machine, python_version, system
from typing import Any

from benchmarks.hidden_effects.peers_summary import compared
from benchmarks.hidden_effects.study import outcomes
from benchmarks.hidden_effects.summary import Outcome, summarise
from sysid.errors import UsageError
from sysid.gates import Gate, at_least, at_most

PAPER = "hidden-effects"
TITLE = "Which effect is missing? The bench of the diagnosis"
ROOT = Path(__file__).resolve().parents[2]


def build_report(folder: Path) -> dict[str, Path]:
    """Write ``results.json`` from the outcomes in a folder and build the report from it.

    Raises
    ------
    UsageError
        If the folder holds no outcome.
    """
    from sysid.reporting import build

    found = outcomes(folder) if (folder / "outcomes").is_dir() else []
    if not found:
        raise UsageError(
            f"{folder} holds no outcome; run `python -m benchmarks.hidden_effects --out {folder}`."
        )
    content = results(found, compared(folder))
    (folder / "results.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    # The notebook imports this package, from wherever the kernel is started.
    path = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    os.environ["PYTHONPATH"] = os.pathsep.join(path)
    return build(folder, notebooks={PAPER: ROOT / "reports" / "hidden_effects.py"}, title=TITLE)


def results(found: list[dict[str, Any]], peers: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the outcomes as a ``results.json`` of one paper."""
    from sysid.replication import commit

    summary = summarise(found)
    seeds = sorted({outcome["id"].split("-")[1] for outcome in found})
    return {
        "schema": 1,
        "lead": "Records with hidden effects, diagnosed and compared with the truth.",
        "provenance": {
            "commit": commit(),
            "versions": {"python": python_version(), **{n: version(n) for n in ("numpy", "scipy", "numba")}},
            "platform": f"{system()} {machine()}, {os.cpu_count()} processors",
            "seed": ", ".join(str(int(seed)) for seed in seeds),
            "runs": {tier: figures["cases"] for tier, figures in summary.items()},
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
        },
        "papers": {
            PAPER: {
                "title": "Hidden effects",
                "claims": [],
                "gates": [gate.to_json() for gate in target_gates(summary)],
                "monte_carlo": {},
                "numbers": {},
                "timings": {},
                "tables": {"summary": summary, "errors": _errors(found), "peers": peers},
            }
        },
    }


def target_gates(summary: Mapping[str, Any]) -> list[Gate]:
    """Return a gate for each share that has a target and a case."""
    gates = []
    for tier, figures in summary.items():
        for name, score in figures["scores"].items():
            if not score["n"] or (score["least"] is None and score["most"] is None):
                continue
            reason = (
                f"{score['meaning']}: {score['hits']} of {score['n']}, "
                f"95 % interval {score['low']:.3f} to {score['high']:.3f}"
            )
            identifier = f"{tier}/{name}"
            if score["least"] is not None:
                gates.append(at_least(identifier, score["share"], score["least"], "absolute", reason))
            else:
                gates.append(at_most(identifier, score["share"], score["most"], "absolute", reason))
    return gates


def _errors(found: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return what the figure of the errors shows: final over true error against baseline over true."""
    return [_error(o) for o in found if o["error"] is None and o["kind"] in ("single", "two")]


def _error(outcome: Outcome) -> dict[str, Any]:
    keys = ("id", "tier", "truth", "test_baseline", "test_final", "test_true")
    return {key: outcome[key] for key in keys}
