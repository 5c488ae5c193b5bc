"""What other tools answered on the same cases, as totals."""

import json
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

FILE = "peers.json"


def compared(folder: Path) -> dict[str, Any] | None:
    """Return the totals of each tool in the ``peers.json`` of a folder, None if there is none.

    The ratio is the free-run error on the test rows over that of the true structure.
    """
    path = folder / FILE
    if not path.exists():
        return None
    rows = json.loads(path.read_text(encoding="utf-8"))["outcomes"]
    tools = list(dict.fromkeys(row["tool"] for row in rows))
    return {tool: _total([row for row in rows if row["tool"] == tool]) for tool in tools}


def _total(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    ratios = sorted(row["ratio"] for row in rows if row["ratio"] is not None)
    return {
        "cases": len(rows),
        "failed": sum(row["error"] is not None for row in rows),
        "ratio_median": median(ratios) if ratios else None,
        "ratio_q90": ratios[min(int(0.9 * len(ratios)), len(ratios) - 1)] if ratios else None,
        "within_double": sum(ratio <= 2.0 for ratio in ratios) / len(rows),
        "seconds_median": median(row["seconds"] for row in rows),
        "names": rows[0]["names"],
        "told": rows[0]["told"],
    }
