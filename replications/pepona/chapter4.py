"""Chapter 4 of the thesis: separable least squares with splines."""

from collections.abc import Mapping
from typing import Any

from replications.errata import Erratum
from replications.pepona import setting
from replications.pepona.chapter import Chapter, MonteCarlo, Numbers, Studies
from sysid.gates import Gate
from sysid.montecarlo import Task
from sysid.replication import Session


def plan4(runs: int) -> Mapping[str, tuple[Task, int]]:
    """Return every case with its task and number of runs."""
    return {}


def errata4() -> list[Erratum]:
    """Return the printing errors of Chapter 4."""
    return []


def monte_carlo4(studies: Studies) -> dict[str, Any]:
    """Return the Monte-Carlo entries of the examples."""
    return {}


def numbers4(studies: Studies, session: Session) -> dict[str, float | None]:
    """Return the numbers of Chapter 4."""
    return {f"setting/{case}/samples": float(one.samples) for case, one in setting.EXAMPLES.items()}


def tables4(studies: Studies, session: Session) -> dict[str, Any]:
    """Return what the figures of Chapter 4 are drawn from."""
    return {}


def gates4(studies: Studies, monte_carlo: MonteCarlo, numbers: Numbers) -> list[Gate]:
    """Return the gates of Chapter 4."""
    return []


CHAPTER_4 = Chapter(plan4, errata4, monte_carlo4, numbers4, tables4, gates4)
