"""Bai's paper as the command ``sysid replicate bai`` sees it."""

from collections.abc import Mapping, Sequence

import numpy as np

from replications.bai import checks, example_2, setting
from replications.bai.errata import (
    centred_covariance_spread,
    confirmed_moments,
    cubic_root_counts,
    errata,
)
from replications.bai.example_1 import Example1, asymptotic_std, cost_curve, one_parameter_map
from replications.bai.plausibility import (
    Plausibility,
    combined_probability,
    plausibility,
    rounded_share,
)
from replications.bai.worked import WORKED, WorkedRun, true_parameters
from replications.errata import Erratum, erratum_numbers
from replications.paper import ReplicatedPaper
from replications.studies import entry, slope_std_error
from sysid.claims import Claim, judge, read
from sysid.montecarlo import Study, Task
from sysid.replication import PaperResult, Session

SIZES = (100, 200, 400, 800, 1600, 3200, 6400)
"""Numbers of samples at which the error is measured."""


class Bai(ReplicatedPaper):
    """Identification of linear systems with hard input nonlinearities of known structure."""

    id = "bai"
    title = "Identification of linear systems with hard input nonlinearities of known structure"
    citation = (
        "E.-W. Bai, Identification of linear systems with hard input nonlinearities of known structure, "
        "15th IFAC World Congress, Barcelona, 2002; Automatica 38(5), 853-860, 2002"
    )
    default_runs = 1000
    smoke_runs = 100

    def plan(self, runs: int) -> Mapping[str, tuple[Task, int]]:
        """Return every case with its task and number of runs."""
        fewer = max(runs // 4, 25)
        cases: dict[str, tuple[Task, int]] = {case: (Example1(case), runs) for case in setting.CASES}
        for case in setting.CASES:
            cases |= {size_case(case, n): (Example1(case, n), fewer) for n in SIZES[1:]}
        cases["example-2"] = (example_2.Example2(), runs)
        cases |= {f"worked/{name}": (WorkedRun(name), fewer) for name in WORKED}
        return cases

    def replicate(self, session: Session) -> PaperResult:
        """Run every study and hold the paper against it."""
        studies = self.studies(session)
        with session.timed("errata"):
            found_errata = errata()
        bounds = {case: asymptotic_std(case, setting.EXAMPLE_1_SAMPLES) for case in setting.CASES}
        claims_read = read(self.claims_file)
        example_2_rows = {
            name: example_2_plausibility(studies["example-2"], name) for name in example_2.variants()
        }
        monte_carlo = {
            **{case: entry(studies[case], setting.TRUE, bounds[case]) for case in setting.CASES},
            **{
                f"example-2/{name}": entry(studies["example-2"], setting.TRUE, prefix=f"{name}/")
                for name in (*example_2.variants(), "separable")
            },
            **{f"worked/{name}": entry(studies[f"worked/{name}"], true_parameters(name)) for name in WORKED},
        }
        numbers = {
            **setting_numbers(),
            "slope_std_error": slope_std_error(
                SIZES, [studies[size_case("preload", n)].n_runs for n in SIZES]
            ),
            **reading_numbers(),
            **plausibility_numbers(studies, claims_read, example_2_rows),
            **example_2_numbers(studies["example-2"], monte_carlo),
            **errata_numbers(found_errata),
        }
        for case in setting.CASES:
            numbers |= consistency_numbers(case, studies) | cost_numbers(studies[case])
        tables = {
            "table-1": table_1(studies, claims_read),
            "errata": [erratum.to_json() for erratum in found_errata],
            "sizes": list(SIZES),
            "figure-3": {
                case: cost_curve(Example1(case), np.random.default_rng([session.seed, 3]))
                for case in setting.CASES
            },
        }
        claims = [self._judge(claim, studies, numbers) for claim in claims_read]
        gates = checks.gates(studies, monte_carlo, numbers, found_errata, claims)
        return PaperResult(claims, gates, tables, monte_carlo, numbers)

    def _judge(self, claim: Claim, studies: Mapping[str, Study], numbers: Mapping[str, float]) -> Claim:
        if claim.tolerance["type"] != "monte-carlo-band":
            return judge(claim, numbers[claim.number])
        case, _, column = claim.number.partition("/")
        low, middle, high = studies[case].quantile(column, [0.025, 0.5, 0.975])
        return judge(claim, float(middle), (float(low), float(high)))


paper = Bai()


def size_case(case: str, n: int) -> str:
    """Return the id of the study of a case at N samples."""
    return case if n == setting.EXAMPLE_1_SAMPLES else f"{case}/n={n}"


def setting_numbers() -> dict[str, float]:
    """Return the set-up of the examples as the studies use it."""
    b1, b2 = setting.EXAMPLE_2_INPUTS
    single = Example1("saturation").identify(*Example1("saturation").experiment(np.random.default_rng(0)))
    return {
        **{f"setting/{name}": value for name, value in setting.TRUE.items()},
        "setting/example-1/samples": setting.EXAMPLE_1_SAMPLES,
        "setting/example-1/input": setting.EXAMPLE_1_INPUT,
        "setting/example-1/noise": setting.EXAMPLE_1_NOISE,
        "setting/example-2/samples": setting.EXAMPLE_2_SAMPLES,
        "setting/example-2/noise": setting.EXAMPLE_2_NOISE,
        "setting/example-2/input-1": b1,
        "setting/example-2/input-2": b2,
        "search-dimension": single.eta.size,
    }


def consistency_numbers(case: str, studies: Mapping[str, Study]) -> dict[str, float]:
    """Return RMSE at every N and the slope of its logarithm against that of N."""
    numbers: dict[str, float] = {}
    summaries = [studies[size_case(case, n)].summary(setting.TRUE) for n in SIZES]
    for name in setting.PARAMETERS:
        rmse = np.array([float(summary[name]["rmse"] or np.nan) for summary in summaries])
        numbers |= {f"rmse/{case}/{name}/{n}": float(value) for n, value in zip(SIZES, rmse, strict=True)}
        numbers[f"slope/{case}/{name}"] = float(np.polyfit(np.log(SIZES), np.log(rmse), 1)[0])
    return numbers


def cost_numbers(study: Study) -> dict[str, float]:
    """Return E[J] and the share of experiments whose J(a) has more than one local minimum."""
    case, n = study.case, setting.EXAMPLE_1_SAMPLES
    minima = study.column("n_minima")
    return {
        f"ej/{case}/{n}": study.mean()["j"],
        f"ej_std_error/{case}/{n}": study.standard_error()["j"],
        f"local_minima_share/{case}": float(np.mean(minima > 1)),
        f"local_minima_mean/{case}": float(np.mean(minima)),
    }


def reading_numbers() -> dict[str, float]:
    """Return the share of samples on which a printed hysteretic rule and its physical reading differ."""
    u = np.random.default_rng(7).uniform(-setting.EXAMPLE_1_INPUT, setting.EXAMPLE_1_INPUT, 100_000)
    numbers = {}
    for printed, physical in zip(("hysteresis-relay", "hysteresis"), setting.PHYSICAL_READINGS, strict=True):
        outputs = [one_parameter_map(name)(u, setting.THRESHOLD) for name in (printed, physical)]
        numbers[f"differs_share/{physical}"] = float(np.mean(np.abs(outputs[0] - outputs[1]) > 1e-12))
    return numbers


def printed_row(case: str, claims: Sequence[Claim]) -> list[float]:
    """Return a row of Table 1 as printed."""
    row = {claim.id: float(claim.printed) for claim in claims if claim.id.startswith(f"table-1/{case}/")}
    return [row[f"table-1/{case}/{name}"] for name in setting.PARAMETERS]


def table_plausibility(study: Study, printed: Sequence[float]) -> Plausibility:
    """Return the plausibility of a printed row of Table 1, which has two decimals."""
    runs = np.column_stack([study.column(name) for name in setting.PARAMETERS])
    return plausibility(runs, printed, [2] * len(printed), list(setting.TRUE.values()))


def example_2_plausibility(study: Study, variant: str) -> Plausibility:
    """Return the joint plausibility of (3.20) under one variant of the correlation method."""
    runs = np.column_stack([study.column(f"{variant}/{name}") for name in setting.PARAMETERS])
    return plausibility(runs, example_2.PRINTED, example_2.PRINTED_DECIMALS, list(setting.TRUE.values()))


def plausibility_numbers(
    studies: Mapping[str, Study], claims: Sequence[Claim], variants: Mapping[str, Plausibility]
) -> dict[str, float]:
    """Return the plausibility of Table 1, row by row and as a set, and of (3.20)."""
    numbers: dict[str, float] = {}
    shares, threshold_shares = [], []
    for case in setting.TABLE_ROWS:
        printed = printed_row(case, claims)
        row = table_plausibility(studies[case], printed)
        threshold = rounded_share(studies[case].column("a"), printed[0], 2, setting.THRESHOLD)
        numbers[f"plausibility/{case}/mahalanobis"] = row.mahalanobis
        numbers[f"plausibility/{case}/p_value"] = row.p_value
        numbers[f"plausibility/{case}/closer_share"] = row.closer_share
        numbers[f"plausibility/{case}/closer_share_of_a"] = threshold
        shares.append(row.closer_share)
        threshold_shares.append(threshold)
    numbers["plausibility/table-1/probability"] = combined_probability(shares)
    numbers["plausibility/table-1/all_a_as_close"] = float(np.prod(threshold_shares))
    for name, found in variants.items():
        numbers[f"plausibility/example-2/{name}/mahalanobis"] = found.mahalanobis
        numbers[f"plausibility/example-2/{name}/p_value"] = found.p_value
    return numbers


def example_2_numbers(study: Study, monte_carlo: Mapping[str, Mapping[str, object]]) -> dict[str, float]:
    """Return spreads, irregular square roots and the gain of least squares on the same data.

    Bands, not standard deviations: with independent inputs the ratio c has heavy tails.
    """

    def width(column: str) -> float:
        low, high = study.quantile(column, [0.025, 0.975])
        return float(high - low)

    numbers: dict[str, float] = {}
    for name in example_2.variants():
        numbers[f"example-2/{name}/negative_square_share"] = 1.0 - study.mean()[f"{name}/regular"]
        a = study.column(f"{name}/a")
        as_close = rounded_share(a, example_2.PRINTED[0], example_2.PRINTED_DECIMALS[0], setting.THRESHOLD)
        numbers[f"example-2/{name}/a_off_by_a_tenth_share"] = float(
            np.mean(np.abs(a - setting.THRESHOLD) > 0.1)
        )
        numbers[f"example-2/{name}/a_as_close_share"] = as_close
        for parameter in setting.PARAMETERS:
            numbers[f"example-2/{name}/median/{parameter}"] = float(
                study.quantile(f"{name}/{parameter}", [0.5])[0]
            )
            ratio = width(f"{name}/{parameter}") / width(f"separable/{parameter}")
            numbers[f"example-2/{name}/band_over_separable/{parameter}"] = ratio
    saturation = monte_carlo["saturation"]["parameters"]
    assert isinstance(saturation, dict)
    band = saturation["a"]["q975"] - saturation["a"]["q025"]
    widest = min(width(f"{name}/a") for name in example_2.variants() if name.endswith("independent"))
    numbers["example-2/separable-100-is-closer"] = float(band < widest)
    return numbers


def errata_numbers(found: list[Erratum]) -> dict[str, float]:
    """Return the errors of printed and corrected formulas, and what is confirmed."""
    numbers = erratum_numbers(found)
    numbers["erratum/nonzero-mean-input/centred_covariance_spread"] = centred_covariance_spread()
    numbers |= {f"confirmed/{name}": value for name, value in confirmed_moments().items()}
    right, total = cubic_root_counts()
    numbers["confirmed/(3.16) root intervals"] = right / total
    return numbers


def table_1(studies: Mapping[str, Study], claims: Sequence[Claim]) -> list[dict[str, object]]:
    """Return Table 1 regenerated: printed, the first run of each study, and the mean of all."""
    return [
        {
            "case": case,
            "title": one_parameter_map(case).title,
            "printed": printed_row(case, claims) if case in setting.TABLE_ROWS else None,
            "first_run": [float(studies[case].column(name)[0]) for name in setting.PARAMETERS],
            "mean": [studies[case].mean()[name] for name in setting.PARAMETERS],
        }
        for case in setting.CASES
    ]
