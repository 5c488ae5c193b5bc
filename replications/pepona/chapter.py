"""What a chapter of the thesis contributes to its replication."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from replications.errata import Erratum
from replications.paper import claims_of
from sysid.claims import read
from sysid.gates import Gate
from sysid.montecarlo import Study, Task
from sysid.replication import Session

Studies = Mapping[str, Study]
Numbers = Mapping[str, float | None]
MonteCarlo = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Chapter:
    """The parts of a replication that one chapter provides.

    Attributes
    ----------
    plan : callable
        Takes the number of runs; returns every case with its task and its number of runs.
    errata : callable
        Returns the printing errors.
    monte_carlo : callable
        Takes the studies of both chapters; returns the entries of ``monte_carlo`` in the results.
    numbers : callable
        Takes the studies and the session; returns the numbers of ``results.json``.
    tables : callable
        Takes the studies and the session; returns what figures and tables of the report are drawn from.
    gates : callable
        Takes the studies, the Monte-Carlo entries and the numbers; returns the gates.
    """

    plan: Callable[[int], Mapping[str, tuple[Task, int]]]
    errata: Callable[[], list[Erratum]]
    monte_carlo: Callable[[Studies], dict[str, Any]]
    numbers: Callable[[Studies, Session], dict[str, float | None]]
    tables: Callable[[Studies, Session], dict[str, Any]]
    gates: Callable[[Studies, MonteCarlo, Numbers], list[Gate]]


@cache
def printed_values() -> Mapping[str, float]:
    """Return the printed values that are numbers, by claim."""
    return {
        claim.id: float(claim.printed)
        for claim in read(claims_of("pepona"))
        if not isinstance(claim.printed, str)
    }
