"""The paper of Borges, Verdult and Ayala Botto as the command ``sysid replicate borges`` sees it."""

from collections.abc import Mapping

import numpy as np

from replications.borges import checks, peer, setting
from replications.borges.derivatives import derivative_numbers
from replications.borges.errata import condition_numbers, errata
from replications.borges.flops import flop_numbers
from replications.borges.study import Run
from replications.borges.timing import ratios
from replications.errata import erratum_numbers
from replications.paper import ReplicatedPaper
from sysid.claims import judge, read
from sysid.montecarlo import Study, Task
from sysid.replication import PaperResult, Session

FEWEST_RUNS = 6
SLS = "kaufman"
SEARCHED = ("kaufman", "exact", "approach-2b", "joint")
IDENTITY = tuple(
    f"identity/{name}/{how}" for name in ("kaufman", "approach-2b") for how in ("free", "projected")
)


class Borges(ReplicatedPaper):
    """Separable least squares for composite local linear state-space models."""

    id = "borges"
    title = "Separable least squares for composite local linear state-space models"
    citation = (
        "J. Borges (Instituto Superior Técnico, Lisbon), V. Verdult (Delft University of Technology), M. "
        "Ayala Botto (Lisbon), Efficient implementation of separable least squares for the identification of "
        "composite local linear state-space models, IFAC World Congress 2005"
    )
    default_runs = 50
    smoke_runs = 6

    def plan(self, runs: int) -> Mapping[str, tuple[Task, int]]:
        """Return every case with its task and number of runs."""
        fewer = max(runs // 2, FEWEST_RUNS)
        return {
            "q1/20-dB": (Run(1, "20-dB", methods="sls"), fewer),
            "q1/noise-free": (Run(1, "noise-free", methods="sls"), fewer),
            "q2/20-dB": (Run(2, "20-dB", methods="searches"), fewer),
            "q2/noise-free": (Run(2, "noise-free"), runs),
        }

    def replicate(self, session: Session) -> PaperResult:
        """Run every study and hold the paper against it."""
        with session.timed("derivatives"):
            numbers = {**setting.numbers(), **derivative_numbers(), **flop_numbers(), **condition_numbers()}
        with session.timed("errata"):
            found_errata = errata()
            numbers |= erratum_numbers(found_errata)
        studies = self.studies(session)
        numbers |= study_numbers(studies)
        beside = peer.times(0.1 if session.smoke else 0.5)
        session.timings.update(ratios(session.smoke) | beside)
        tables: dict[str, object] = {"errata": [erratum.to_json() for erratum in found_errata]}
        if beside[peer.NAME] is None:
            tables["notes"] = {peer.NAME: peer.MISSING}
        claims = [judge(claim, numbers[claim.number]) for claim in read(self.claims_file)]
        gates = checks.gates(studies, numbers, found_errata, claims)
        return PaperResult(claims, gates, tables, monte_carlo(studies), numbers)


paper = Borges()


def study_numbers(studies: Mapping[str, Study]) -> dict[str, float]:
    """Return medians over the runs; iterations are those without noise unless the name says otherwise."""
    numbers: dict[str, float] = {}

    def median(case: str, column: str) -> float:
        return float(np.median(studies[case].column(column)))

    for output in range(1, setting.N_OUTPUTS + 1):
        for case in studies:
            q, _, noise = case.partition("/")
            suffix = "" if noise == "20-dB" else f"/{noise}"
            for method in ("linear", "start", *SEARCHED):
                if f"{method}/vaf/output-{output}" not in studies[case].columns:
                    continue
                name = "" if method == SLS else f"{method}/"
                for kind in ("vaf", "rmse"):
                    numbers[f"{q}/{kind}_validation/{name}output-{output}{suffix}"] = median(
                        case, f"{method}/{kind}/output-{output}"
                    )
    for case, suffix in (("q2/noise-free", ""), ("q2/20-dB", "/20-dB")):
        for method in (*SEARCHED, *IDENTITY):
            if f"{method}/iterations" in studies[case].columns:
                numbers[f"lm_iterations/{method}{suffix}"] = median(case, f"{method}/iterations")
                numbers[f"cost_over_best/{method}{suffix}"] = median(case, f"{method}/cost_over_best")
    return numbers


def monte_carlo(studies: Mapping[str, Study]) -> dict[str, object]:
    """Return the number of runs and the mean of every column of each case."""
    return {
        case: {"n_runs": study.n_runs, "failed": study.failed, "mean": study.mean(), "std": study.std()}
        for case, study in studies.items()
    }
