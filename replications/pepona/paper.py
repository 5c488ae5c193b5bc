"""Pepona's thesis as the command ``sysid replicate pepona`` sees it."""

from collections.abc import Mapping
from typing import Any

from replications.errata import erratum_gates, erratum_numbers
from replications.paper import ReplicatedPaper
from replications.pepona.chapter import Chapter, Studies
from replications.pepona.chapter4 import CHAPTER_4
from replications.pepona.chapter5 import CHAPTER_5
from replications.pepona.records import record_result
from replications.studies import protocol_gates
from sysid.claims import Claim, judge, read
from sysid.errors import UsageError
from sysid.montecarlo import Task
from sysid.replication import PaperResult, Session

CHAPTERS: tuple[Chapter, ...] = (CHAPTER_4, CHAPTER_5)


class Pepona(ReplicatedPaper):
    """Identification of block-oriented systems: Chapters 4 and 5."""

    id = "pepona"
    title = "Identification of nonlinear interconnected systems"
    citation = (
        "E. Pepona, Identification of nonlinear interconnected systems, doctoral thesis, School of "
        "Information Systems, Computing and Mathematics, Brunel University, July 2009, Chapters 4 and 5"
    )
    default_runs = 200
    smoke_runs = 20

    def plan(self, runs: int) -> Mapping[str, tuple[Task, int]]:
        """Return every case with its task and number of runs."""
        return {case: work for chapter in CHAPTERS for case, work in chapter.plan(runs).items()}

    def replicate(self, session: Session) -> PaperResult:
        """Run every study and hold the thesis against it."""
        studies = self.studies(session)
        with session.timed("errata"):
            found_errata = [erratum for chapter in CHAPTERS for erratum in chapter.errata()]
        numbers: dict[str, float | None] = {**erratum_numbers(found_errata)}
        monte_carlo: dict[str, Any] = {}
        tables: dict[str, Any] = {"errata": [erratum.to_json() for erratum in found_errata]}
        with session.timed("numbers"):
            for chapter in CHAPTERS:
                numbers |= chapter.numbers(studies, session)
                monte_carlo |= chapter.monte_carlo(studies)
                tables |= chapter.tables(studies, session)
        record = record_result(session)
        numbers |= record.numbers
        tables |= record.tables
        claims = [judged(claim, studies, numbers) for claim in read(self.claims_file)]
        gates = [
            *protocol_gates(studies, claims),
            *(gate for chapter in CHAPTERS for gate in chapter.gates(studies, monte_carlo, numbers)),
            *erratum_gates(found_errata),
        ]
        return PaperResult(claims, gates, tables, monte_carlo, numbers, record.notes)


paper = Pepona()


def judged(claim: Claim, studies: Studies, numbers: Mapping[str, float | None]) -> Claim:
    """Hold a claim against a number, or against the runs of a study for a Monte-Carlo band.

    The number of a Monte-Carlo band names the case and a column of its runs, "4.3/initial/a1".  The band
    holds 95 % of the runs; one with a ``tolerance`` reaches that many half widths of the range of 16 to 84 %
    from the median.
    """
    if claim.tolerance["type"] != "monte-carlo-band":
        value = numbers[claim.number]
        return judge(claim, float("nan") if value is None else value)
    parts = claim.number.split("/")
    for cut in range(len(parts) - 1, 0, -1):
        case, column = "/".join(parts[:cut]), "/".join(parts[cut:])
        if case in studies and column in studies[case].columns:
            outer = "tolerance" not in claim.tolerance
            edge = 0.025 if outer else 0.15865525
            low, middle, high = (float(q) for q in studies[case].quantile(column, [edge, 0.5, 1.0 - edge]))
            if not outer:
                half = float(claim.tolerance["tolerance"]) * (high - low) / 2.0
                low, high = middle - half, middle + half
            return judge(claim, middle, (low, high))
    raise UsageError(f"claim {claim.id} names {claim.number!r}, which is no column of a study: correct it")
