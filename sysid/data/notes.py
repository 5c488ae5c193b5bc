"""The JSON beside a table: units, sampling period, rows that are not scored."""

import json
import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import DataError, UsageError


@dataclass(frozen=True)
class Notes:
    """What is known of a record beside its table.

    Attributes
    ----------
    path : Path
        Where it stands.
    period : float or None
        Sampling period [s].
    units : mapping of str to str
        Unit of each column.
    skip : mapping of str to int
        Rows not scored at the beginning of each test set.
    warnings : tuple of str
        What could not be used.
    """

    path: Path
    period: float | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    skip: Mapping[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def skips(self, labels: NDArray[np.str_] | None) -> dict[str, int]:
        """Return the rows to skip of each set that the table has.

        Raises
        ------
        DataError
            If nothing of a set would be left.
        """
        found: dict[str, int] = {}
        if labels is None:
            return found
        names, counts = np.unique(np.char.strip(labels), return_counts=True)
        for name, count in zip(names.tolist(), counts.tolist(), strict=True):
            if name not in self.skip:
                continue
            if not 0 <= self.skip[name] < count:
                raise DataError(
                    f"the notes in {self.path.name} skip {self.skip[name]} rows of the set {name!r}, which "
                    f"has {count}: correct it there, or give --skip with a number from 0 to {count - 1}"
                )
            found[name] = self.skip[name]
        return found


def notes_path(table: Path) -> Path:
    """Return the place of the JSON that belongs to a table."""
    return table.with_name(table.name.removesuffix(".gz").rsplit(".", 1)[0] + ".json")


def read_notes(table: Path) -> Notes:
    """Read the JSON beside a table; what cannot be used is left out with a warning."""
    path = notes_path(table)
    try:
        content = json.loads(path.read_text(encoding="utf-8-sig"))
    except (FileNotFoundError, NotADirectoryError):
        return Notes(path)
    except (OSError, ValueError, RecursionError):
        return Notes(path, warnings=(f"{path.name} beside the table is not readable JSON: it is not used.",))
    if not isinstance(content, dict):
        return Notes(path, warnings=(f"{path.name} beside the table holds no JSON object: it is not used.",))
    wrong: list[str] = []
    return Notes(
        path, _period(content, wrong), _units(content, wrong), _skip(content, wrong), _warnings(path, wrong)
    )


def known_period(stated: float | None, notes: Notes, clock: str | None = None) -> float:
    """Return the sampling period [s] that was stated or stands in the notes.

    ``clock`` names the column that would tell it.

    Raises
    ------
    UsageError
        If there is neither.
    """
    period = notes.period if stated is None else stated
    if period is None:
        why = f" ({notes.warnings[0].rstrip('.')})" if notes.warnings else ""
        raise UsageError(
            f"the sampling period is not known{why}: give it in seconds (--period 0.01) or name the "
            f"time column (--time {'NAME' if clock is None else shlex.quote(clock)})"
        )
    return period


def _period(content: Mapping[str, Any], wrong: list[str]) -> float | None:
    if "Ts" not in content:
        return None
    value = content["Ts"]
    if isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf:
        try:
            return float(value)
        except OverflowError:
            pass
    wrong.append(f"'Ts' is no positive number of seconds ({_shown(value)})")
    return None


def _units(content: Mapping[str, Any], wrong: list[str]) -> dict[str, str]:
    """Return the unit of each column: the first words of its description."""
    units = _mapping(content, "units", wrong)
    known = {name: text for name, text in units.items() if isinstance(text, str)}
    for name in units.keys() - known.keys():
        wrong.append(f"the unit of {name!r} is no text ({_shown(units[name])})")
    return {name: text.split(" (")[0].strip() for name, text in known.items()}


def _skip(content: Mapping[str, Any], wrong: list[str]) -> dict[str, int]:
    found = {}
    for name, window in _mapping(content, "splits", wrong).items():
        rows = window.get("skip") if isinstance(window, dict) else None
        if isinstance(rows, int) and not isinstance(rows, bool):
            found[name] = rows
        elif rows is not None:
            wrong.append(f"'skip' of the set {name!r} is no whole number ({_shown(rows)})")
    return found


def _mapping(content: Mapping[str, Any], key: str, wrong: list[str]) -> Mapping[str, Any]:
    value = content.get(key, {})
    if isinstance(value, dict):
        return value
    wrong.append(f"{key!r} is no JSON object ({_shown(value)})")
    return {}


def _shown(value: Any) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= 40 else text[:37] + "..."


def _warnings(path: Path, wrong: list[str]) -> tuple[str, ...]:
    return tuple(f"{path.name} beside the table: {what}, and is not used." for what in sorted(wrong))
