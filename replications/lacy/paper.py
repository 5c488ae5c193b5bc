"""The paper of Lacy, Erwin and Bernstein as the command ``sysid replicate lacy`` sees it."""

from collections.abc import Mapping

import numpy as np

from replications.errata import erratum_numbers
from replications.lacy import checks, exactness, setting, step_tests
from replications.lacy.errata import errata, fast_form_errors, literal_growth
from replications.lacy.examples import METHODS, SCORES, ConsistencyRun, ExampleRun, shown_run
from replications.paper import ReplicatedPaper
from replications.studies import entry
from sysid.claims import judge, read
from sysid.montecarlo import Study, Task
from sysid.replication import PaperResult, Session

SIZES = (60, 120, 240)
"""Numbers of samples of the dead zone at which the error is measured."""
CONSISTENT = "dead-zone"
_TRUE = dict(zip(setting.PARAMETERS, setting.TRUE.tolist(), strict=True))


class Lacy(ReplicatedPaper):
    """Identification of Wiener systems with known noninvertible nonlinearities."""

    id = "lacy"
    title = "Identification of Wiener systems with known noninvertible nonlinearities"
    citation = (
        "S. L. Lacy, R. S. Erwin, D. S. Bernstein, Identification of Wiener systems with known "
        "noninvertible nonlinearities, ASME Journal of Dynamic Systems, Measurement, and Control 123(4), "
        "566-571, 2001"
    )
    default_runs = 200
    smoke_runs = 20

    def plan(self, runs: int) -> Mapping[str, tuple[Task, int]]:
        """Return every case with its task and number of runs."""
        fewer = max(runs // 4, 20)
        cases: dict[str, tuple[Task, int]] = {case: (ExampleRun(case), runs) for case in setting.EXAMPLES}
        for case in setting.EXAMPLES:
            cases[f"noise-free/{case}"] = (ExampleRun(case, noisy=False), max(runs // 8, 10))
        for n in SIZES:
            cases[f"{CONSISTENT}/n={n}"] = (ConsistencyRun(CONSISTENT, n), max(runs // 4, 40))
        cases["step-tests"] = (step_tests.StepTestRun(), fewer)
        cases["step-tests/noise-free"] = (step_tests.StepTestRun(noisy=False), 10)
        return cases

    def replicate(self, session: Session) -> PaperResult:
        """Run every study and hold the paper against it."""
        studies = self.studies(session)
        with session.timed("errata"):
            found_errata = errata()
        with session.timed("exactness"):
            exact = exactness_numbers()
        session.timings["branch_and_bound/sine_seconds"] = exactness.sine_seconds()
        monte_carlo = {
            f"{case}/{method}": entry(
                studies[case], _TRUE, bound_std(studies[case]) if method != "naive" else None, f"{method}/"
            )
            for case in setting.EXAMPLES
            for method in ("paper", "ml", "naive")
        }
        monte_carlo["step-tests"] = entry(studies["step-tests"], step_test_true())
        numbers = {
            **setting_numbers(),
            **exact,
            **erratum_numbers(found_errata),
            **consistency_numbers(studies),
            **step_test_numbers(studies),
        }
        for case in setting.EXAMPLES:
            numbers |= example_numbers(case, studies[case])
            numbers |= noise_free_numbers(case, studies[f"noise-free/{case}"])
        tables = {
            "errata": [erratum.to_json() for erratum in found_errata],
            "sizes": list(SIZES),
            "figures": {
                case: shown_run(case, np.random.default_rng([session.seed, setting.EXAMPLES[case].number]))
                for case in setting.EXAMPLES
            },
        }
        claims = [judge(claim, numbers[claim.number]) for claim in read(self.claims_file)]
        gates = checks.gates(studies, monte_carlo, numbers, found_errata, claims)
        return PaperResult(claims, gates, tables, monte_carlo, numbers)


paper = Lacy()


def setting_numbers() -> dict[str, float]:
    """Return the set-up of the examples as the studies use it."""
    found: dict[str, float] = {
        "setting/numerator-1": setting.B[1],
        "setting/numerator-2": setting.B[2],
        "setting/denominator-1": setting.A[1],
        "setting/denominator-2": setting.A[2],
        "setting/order": setting.ORDER,
        "setting/signal-to-noise": setting.SIGNAL_TO_NOISE,
        "setting/dc-gain": sum(setting.B) / sum(setting.A),
        "setting/pole-modulus": float(np.max(np.abs(np.roots(setting.A)))),
        "setting/zero": float(np.roots(setting.B[1:])[0].real),
    }
    for case, example in setting.EXAMPLES.items():
        found[f"setting/{case}/samples"] = example.samples
        found[f"setting/{case}/example"] = example.number
    data = ExampleRun("sign", samples=20_000).experiment(np.random.default_rng(0))
    found["setting/input-variance"] = float(np.var(data.u))
    found["setting/realised-signal-to-noise"] = float(
        np.linalg.norm(data.y - data.y.mean()) / np.linalg.norm(data.w)
    )
    return found


def exactness_numbers() -> dict[str, float]:
    """Return what is checked without a study."""
    gradient, hessian = fast_form_errors()
    return {
        "branch_and_bound/agrees_with_brute_force": exactness.agreement_with_brute_force(),
        "fast-form/gradient": gradient,
        "fast-form/hessian": hessian,
        "literal-reading/growth": literal_growth(),
        "step-tests/normalisation-error": step_tests.normalisation_error(),
        **exactness.special_cases(),
        **exactness.section_4_numbers(),
        **exactness.scale_numbers(),
        **exactness.outside_numbers(),
        **exactness.asymptotic_bias(),
    }


def median(values: np.ndarray) -> float:
    """Return the median of the defined values."""
    return float(np.nanmedian(values))


def bound_std(study: Study) -> dict[str, float]:
    """Return the standard deviations at the Cramér-Rao bound, root mean square over the experiments."""
    return {
        name: float(np.sqrt(np.nanmean(study.column(f"crlb/{name}") ** 2))) for name in setting.PARAMETERS
    }


def example_numbers(case: str, study: Study) -> dict[str, float]:
    """Return the medians of every score over all runs and over the first twenty, by method."""
    numbers: dict[str, float] = {}
    for method in METHODS:
        for name in SCORES:
            values = study.column(f"{method}/{name}")
            if name == "stable":
                numbers[f"{case}/{method}/unstable_share"] = 1.0 - float(np.nanmean(values))
                continue
            numbers[f"{case}/{method}/{name}_median"] = median(values)
            numbers[f"{case}/{method}/{name}_median_of_20"] = median(values[:20])
    numbers[f"{case}/ml/beyond_db_median"] = median(study.column("ml/beyond_db"))
    numbers[f"{case}/recovered_share"] = float(np.mean(study.column("recovered")))
    numbers[f"{case}/all_recovered_share"] = float(np.mean(study.column("recovered") == 1.0))
    numbers[f"{case}/mismatches"] = float(np.sum(study.column("mismatches")))
    numbers[f"{case}/moved"] = float(np.sum(study.column("moved")))
    numbers[f"{case}/exact_fit_share"] = float(np.mean(study.column("exact")))
    return numbers


def noise_free_numbers(case: str, study: Study) -> dict[str, float]:
    """Return what the paper's method finds without noise."""
    error = np.max(
        [np.abs(study.column(f"paper/{name}") - _TRUE[name]) for name in setting.PARAMETERS], axis=0
    )
    return {
        f"noise-free/{case}/largest_error": float(np.max(error)),
        f"noise-free/{case}/median_error": median(error),
        f"noise-free/{case}/largest_criterion": float(np.max(study.column("criterion"))),
        f"noise-free/{case}/median_criterion": median(study.column("criterion")),
        f"noise-free/{case}/exact_fit_share": float(np.mean(study.column("criterion") < 1e-14)),
        f"noise-free/{case}/rms_db_median": median(study.column("paper/rms_db")),
        f"noise-free/{case}/ml_rms_db_median": median(study.column("ml/rms_db")),
    }


def consistency_numbers(studies: Mapping[str, Study]) -> dict[str, float]:
    """Return RMSE, efficiency and exponent for the dead zone with growing records."""
    numbers: dict[str, float] = {}
    for method in ("paper", "ml"):
        for name in setting.PARAMETERS:
            rmse, bound = [], []
            for n in SIZES:
                study = studies[f"{CONSISTENT}/n={n}"]
                rmse.append(float(np.sqrt(np.mean((study.column(f"{method}/{name}") - _TRUE[name]) ** 2))))
                bound.append(float(np.sqrt(np.mean(study.column(f"crlb/{name}") ** 2))))
                numbers[f"rmse/{method}/{name}/{n}"] = rmse[-1]
                numbers[f"efficiency/{method}/{name}/{n}"] = (bound[-1] / rmse[-1]) ** 2
                numbers[f"crlb/{name}/{n}"] = bound[-1]
            error = studies[f"{CONSISTENT}/n={SIZES[-1]}"].column(f"{method}/{name}") - _TRUE[name]
            numbers[f"bias/{method}/{name}"] = float(np.mean(error))
            numbers[f"bias_std_error/{method}/{name}"] = float(np.std(error, ddof=1) / np.sqrt(error.size))
            numbers[f"slope/{method}/{name}"] = float(np.polyfit(np.log(SIZES), np.log(rmse), 1)[0])
            numbers[f"slope/bound/{name}"] = float(np.polyfit(np.log(SIZES), np.log(bound), 1)[0])
    return numbers


def step_test_true() -> dict[str, float]:
    """Return the true parameters of the system with G(1) = 1."""
    return dict(zip(setting.PARAMETERS, step_tests.normalised_true().tolist(), strict=True))


def step_test_numbers(studies: Mapping[str, Study]) -> dict[str, float]:
    """Return how well the system behind a measured nonlinearity is found."""
    exact, noisy = studies["step-tests/noise-free"], studies["step-tests"]
    true = step_test_true()
    error = [np.max(np.abs(exact.column(name) - true[name])) for name in setting.PARAMETERS]
    return {
        "step-tests/noise-free/largest_error": float(np.max(error)),
        "step-tests/rms_db_median": median(noisy.column("rms_db")),
        "step-tests/rms_deg_median": median(noisy.column("rms_deg")),
        "step-tests/relative_h2_median": median(noisy.column("relative_h2")),
    }
