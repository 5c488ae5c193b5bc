"""The paper of Giri, Rochdi and Chaoui as the command ``sysid replicate giri`` sees it."""

from collections.abc import Mapping

from replications.errata import Erratum, erratum_numbers
from replications.giri import checks, setting
from replications.giri.convergence import (
    convergence_numbers,
    figure_3,
    proposition_4_1,
    setting_effects,
    update_seconds,
)
from replications.giri.disturbance import KINDS, RANDOM_KINDS, DisturbedRun, ratio_numbers
from replications.giri.errata import as_printed, confirmed, errata, excited_share
from replications.giri.excitation import excitation_numbers
from replications.giri.identifiability import identifiability_numbers
from replications.giri.precision import (
    METHODS,
    NOISES,
    SIZES,
    NoisyRun,
    bound,
    case_name,
    entry_name,
    slope_numbers,
)
from replications.giri.theory import theory_numbers
from replications.paper import ReplicatedPaper
from replications.studies import entry, slope_std_error
from sysid.claims import judge, read
from sysid.montecarlo import Study, Task
from sysid.replication import PaperResult, Session

FEWEST_RUNS = 10


class Giri(ReplicatedPaper):
    """Recursive identification of systems with hard input nonlinearities of known structure."""

    id = "giri"
    title = "Recursive identification of systems with hard input nonlinearities of known structure"
    citation = (
        "F. Giri, Y. Rochdi (GREYC, Caen), F.-Z. Chaoui (LA2I, Rabat), Recursive identification of systems "
        "with hard input nonlinearities of known structure, conference paper"
    )
    default_runs = 200
    smoke_runs = 40

    def plan(self, runs: int) -> Mapping[str, tuple[Task, int]]:
        """Return every case with its task and number of runs."""
        half, periodic = max(runs // 2, FEWEST_RUNS), max(runs // 20, FEWEST_RUNS)
        cases: dict[str, tuple[Task, int]] = {
            disturbance_case(kind): (DisturbedRun(kind), half if kind in RANDOM_KINDS else periodic)
            for kind in KINDS
        }
        for noise in NOISES:
            cases |= {
                case_name(noise, n): (NoisyRun(noise, n), runs if n == checks.GATED_SIZE else half)
                for n in SIZES
            }
        return cases

    def replicate(self, session: Session) -> PaperResult:
        """Run every study and hold the paper against it."""
        studies = self.studies(session)
        with session.timed("convergence"):
            found = {**convergence_numbers(), **setting_effects(), **proposition_4_1()}
        with session.timed("errata"):
            found_errata = errata()
            found |= errata_numbers(found_errata)
        with session.timed("bounds"):
            monte_carlo = monte_carlo_entries(studies)
        numbers = {
            **found,
            **setting.numbers(),
            **theta_numbers(),
            **identifiability_numbers(),
            **excitation_numbers(),
            **theory_numbers(),
            **disturbance_numbers(studies),
            **slope_numbers(monte_carlo),
            "slope_std_error": slope_std_error(
                SIZES, [studies[case_name("output", n)].n_runs for n in SIZES]
            ),
        }
        session.timings.update(update_seconds())
        tables = {
            "errata": [erratum.to_json() for erratum in found_errata],
            "sizes": list(SIZES),
            "figure-3": figure_3(),
        }
        claims = [judge(claim, numbers[claim.number]) for claim in read(self.claims_file)]
        gates = checks.gates(studies, monte_carlo, numbers, found_errata, claims)
        return PaperResult(claims, gates, tables, monte_carlo, numbers)


paper = Giri()


def disturbance_case(kind: str) -> str:
    """Return the id of the study of a disturbance."""
    return f"disturbance/{kind}"


def theta_numbers() -> dict[str, float]:
    """Return theta* exactly, by name and as the paper lists it."""
    exact = setting.theta_star()
    names = ["a1", "a2", *(f"mu{i + 1}{j + 1}" for j in range(4) for i in range(setting.ORDER))]
    found = {f"theta-star/{name}": float(value) for name, value in zip(names, exact, strict=True)}
    listed = as_printed(exact[: setting.ORDER], exact[setting.ORDER : 2 * setting.ORDER] / setting.gains()[0])
    difference = max(abs(listed - setting.PRINTED_THETA))
    return found | {"theta-star/difference_from_print": float(difference)}


def disturbance_numbers(studies: Mapping[str, Study]) -> dict[str, float]:
    """Return what every disturbance does; ``noise_slope`` is that of the uniform one."""
    found: dict[str, float] = {}
    for kind in KINDS:
        found |= ratio_numbers(kind, studies[disturbance_case(kind)])
    return found | {"noise_slope": found["noise_slope/uniform"]}


def monte_carlo_entries(studies: Mapping[str, Study]) -> dict[str, dict[str, object]]:
    """Return the quality of every method at every length, for both kinds of noise."""
    return {
        entry_name(noise, method, n): entry(
            studies[case_name(noise, n)], setting.TRUE, bound(noise, n), prefix=f"{method}/"
        )
        for noise in NOISES
        for method in METHODS
        for n in SIZES
    }


def errata_numbers(found: list[Erratum]) -> dict[str, float]:
    """Return the errors of printed and corrected forms, and what is confirmed."""
    numbers = erratum_numbers(found) | {f"confirmed/{name}": value for name, value in confirmed().items()}
    return numbers | {"confirmed/Proposition 5.1, random plants": excited_share()}
