"""Chapter 4 of the thesis: separable least squares with splines."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import ndtri

from replications.pepona import chapter4_study as study
from replications.pepona import prediction, setting
from replications.pepona.chapter import Chapter, Studies, printed_values
from replications.pepona.chapter4_checks import gates4
from replications.pepona.chapter4_errata import errata4
from replications.pepona.chapter4_shown import shown
from replications.pepona.chapter4_study import SIZES, ExampleRun, HammersteinRun, ReadingRun
from replications.pepona.chapter4_theory import TheoryRun, theory_numbers
from replications.pepona.setting import Example
from replications.studies import entry
from sysid.montecarlo import Study, Task
from sysid.replication import Session

READ_ANEW = ("4.3", "4.4")
"""Examples whose signs are settled by trying all of them."""
ENOUGH = 60
"""Runs below which the tails of a distribution are not known well enough to judge a printed value."""
LONG, RECORDS = 100_000, 20
"""Samples and number of the records that tell whether a system diverges sooner or later."""
FEWER_CASE = f"4.2/n={study.FEWER}"
SCORES = ("vaf_one_step", "vaf_free_run", "ceiling_one_step", "ceiling_free_run")


def plan4(runs: int) -> Mapping[str, tuple[Task, int]]:
    """Return every case with its task and number of runs."""
    enough, fewer = max(runs, ENOUGH), max(runs // 4, 20)
    cases: dict[str, tuple[Task, int]] = {case: (ExampleRun(case), enough) for case in setting.EXAMPLES}
    cases[FEWER_CASE] = (ExampleRun("4.2", study.FEWER), enough)
    cases |= {f"{case}/signs": (ReadingRun(case), fewer) for case in READ_ANEW}
    cases |= {f"{case}/theory": (TheoryRun(case), max(runs // 20, 6)) for case in setting.EXAMPLES}
    for n_g in (0, 1):
        for n in SIZES:
            cases[hammerstein_case(n_g, n)] = (HammersteinRun(n_g, n), fewer)
    return cases


def hammerstein_case(n_g: int, samples: int) -> str:
    """Return the id of the study of a Hammerstein system at N samples."""
    return f"hammerstein/n_g={n_g}/n={samples}"


def monte_carlo4(studies: Studies) -> dict[str, Any]:
    """Return the Monte-Carlo entries of the examples, with the bounds for the spline model."""
    return {
        case: entry(studies[case], one.true, prediction.bounds(case)["spline"])
        for case, one in setting.EXAMPLES.items()
    }


def numbers4(studies: Studies, session: Session) -> dict[str, float | None]:
    """Return the numbers of Chapter 4."""
    numbers: dict[str, float | None] = {**setting_numbers(), **theory_numbers()}
    for case in setting.EXAMPLES:
        numbers |= example_numbers(case, studies[case])
        numbers |= theory_medians(case, studies[f"{case}/theory"])
    numbers |= fewer_numbers(studies[FEWER_CASE])
    for case in READ_ANEW:
        numbers |= reading_numbers(case, studies[f"{case}/signs"])
    return numbers | consistency_numbers(studies)


def tables4(studies: Studies, session: Session) -> dict[str, Any]:
    """Return what the figures of Chapter 4 are drawn from."""
    return {
        "chapter-4": {
            "shown": {case: shown(one, session.seed) for case, one in setting.EXAMPLES.items()},
            "vaf": {
                case: {name: studies[case].column(name).tolist() for name in SCORES}
                for case in setting.EXAMPLES
            },
            "sizes": list(SIZES),
        }
    }


CHAPTER_4 = Chapter(plan4, errata4, monte_carlo4, numbers4, tables4, gates4)


def setting_numbers() -> dict[str, float]:
    """Return the set-up of the examples as the studies use it, and the bounds that follow."""
    numbers: dict[str, float] = {
        "setting/degree": 3.0,
        "initial/g1": 0.0,
        "setting/4.4/noise": setting.UNIFORM_NOISE,
    }
    for case, one in setting.EXAMPLES.items():
        numbers |= {f"setting/{case}/{name}": value for name, value in one.true.items()}
        numbers |= {
            f"setting/{case}/samples": float(2 * one.samples),
            f"setting/{case}/input-low": one.inputs[0],
            f"setting/{case}/input-high": one.inputs[1],
            f"setting/{case}/knots": float(one.knots),
        }
        if not one.uniform:
            numbers[f"setting/{case}/noise"] = one.noise
        for kind, spread in prediction.bounds(case).items():
            numbers |= {f"{case}/bound/{kind}/{name}": value for name, value in spread.items()}
    printed = printed_values()
    for column in ("initial", "final"):
        d = [printed[f"4.2/{column}/d{i}"] for i in (1, 2, 3)]
        numbers[f"table-4.2/{column}-norm"] = float(np.linalg.norm(d))
        numbers[f"table-4.3/{column}-norm"] = float(
            np.linalg.norm([printed[f"4.3/{column}/d{i}"] for i in (1, 2)])
        )
    return numbers


def robust(values: np.ndarray, printed: float) -> dict[str, float]:
    """Return how far a printed value lies from the runs, in half widths of their 16 to 84 % range."""
    defined = values[~np.isnan(values)]
    low, middle, high = np.quantile(defined, [0.15865525, 0.5, 0.84134475])
    half = float(high - low) / 2.0
    below = float(np.mean(defined < printed))
    share = min(max(below, 0.5 / defined.size), 1.0 - 0.5 / defined.size)
    return {
        "z": (printed - float(middle)) / half if half > 0.0 else np.nan,
        "share_below": below,
        "score": float(ndtri(share)),
    }


def example_numbers(case: str, found: Study) -> dict[str, float]:
    """Return medians, and where each printed value lies among the runs."""
    example, printed = setting.EXAMPLES[case], printed_values()
    numbers = {f"{case}/{name}_median": float(np.nanmedian(found.column(name))) for name in SCORES}
    for name in ("map_rmse", "iterations/kaufman", "iterations/exact"):
        numbers[f"{case}/{name}_median"] = float(np.nanmedian(found.column(name)))
    for name in ("vaf_one_step", "vaf_free_run"):
        placed = robust(found.column(name), printed[f"{case}/vaf"])
        numbers |= {f"{case}/{key}/{name}": value for key, value in placed.items()}
    for stage, prefix in (("final", ""), ("initial", "initial/")):
        for name in example.parameters:
            value = printed.get(f"{case}/{stage}/{name}")
            # What 4.3.1 fixes by definition has no spread: g1 starts at 0.
            if value is None or np.ptp(found.column(f"{prefix}{name}")) == 0.0:
                continue
            sign = -1.0 if (case, name) == ("4.4", "g1") else 1.0
            placed = robust(found.column(f"{prefix}{name}"), sign * value)
            numbers |= {f"{case}/{key}/{stage}/{name}": one for key, one in placed.items()}
    for name in example.parameters:
        numbers[f"{case}/coverage/{name}"] = float(np.mean(found.column(f"covered/{name}")))
    numbers[f"{case}/converged_share"] = float(np.mean(found.column("converged")))
    numbers[f"{case}/reached_share"] = float(np.mean(found.column("reached")))
    numbers[f"{case}/free_run_diverges_share"] = float(np.mean(np.isnan(found.column("vaf_free_run"))))
    numbers[f"{case}/fewer_knots_share"] = float(np.mean(found.column("knots") < example.knots))
    return numbers


def fewer_numbers(found: Study) -> dict[str, float]:
    """Return where Table 4.2 and its VAF would lie if there had been fewer samples."""
    printed = printed_values()
    places = {f"final/d{i}": f"d{i}" for i in (1, 2, 3)} | {
        f"initial/d{i}": f"initial/d{i}" for i in (1, 2, 3)
    }
    places["vaf"] = "vaf_one_step"
    return {
        f"{FEWER_CASE}/z/{name}": robust(found.column(column), printed[f"4.2/{name}"])["z"]
        for name, column in places.items()
    }


def reading_numbers(case: str, found: Study) -> dict[str, float]:
    """Return for every reading of the signs how often it diverges, and where the printed VAF lies."""
    printed = printed_values()
    numbers = {}
    for name, example in study.readings(case).items():
        numbers[f"{case}/signs/{name}/diverged_share"] = float(np.mean(found.column(f"{name}/diverged")))
        numbers[f"{case}/signs/{name}/diverged_long_share"] = diverging_share(example)
        for score in ("vaf_one_step", "vaf_free_run", "initial/a1"):
            values = found.column(f"{name}/{score}")
            if np.sum(~np.isnan(values)) < 10:
                continue
            numbers[f"{case}/signs/{name}/{score}_median"] = float(np.nanmedian(values))
            key = f"{case}/initial/a1" if score == "initial/a1" else f"{case}/vaf"
            if key in printed:
                placed = robust(values, printed[key])
                numbers[f"{case}/signs/{name}/{score}_z"] = placed["z"]
                numbers[f"{case}/signs/{name}/{score}_share_below"] = placed["share_below"]
    return numbers


def diverging_share(example: Example) -> float:
    """Return the share of long records in which the system diverges."""
    signals = (
        setting.experiment(example, LONG, np.random.default_rng([seed, 44])) for seed in range(RECORDS)
    )
    return float(np.mean([not np.max(np.abs(one.y)) <= study.FAR for one in signals]))


WORST = (
    "gradient/separated", "gradient/joint", "joint_cost_off", "basis/rounding", "printed/stopped-at-minimum",
    "printed/worst-rise", "printed/excess", "printed/steps",
)  # fmt: skip


def theory_medians(case: str, found: Study) -> dict[str, float]:
    """Return medians of what a record shows, and the worst value where a statement must hold always."""
    numbers = {f"{case}/theory/{name}": float(np.median(found.column(name))) for name in found.columns}
    for name in WORST:
        numbers[f"{case}/theory/{name}_worst"] = float(np.max(found.column(name)))
    ratio = found.column("condition/kaufman") / found.column("condition/joint")
    numbers[f"{case}/theory/condition/ratio_worst"] = float(np.max(ratio))
    return numbers


def consistency_numbers(studies: Studies) -> dict[str, float]:
    """Return RMSE at every N and its exponent for the Hammerstein systems of Lemma 4.1."""
    example = setting.EXAMPLES["4.3"]
    numbers: dict[str, float] = {}
    for n_g in (0, 1):
        for name in ("a1", "g1", "map")[: 3 if n_g else None : 1 if n_g else 2]:
            rmse = []
            for n in SIZES:
                found = studies[hammerstein_case(n_g, n)]
                if name == "map":
                    square = found.column("map_square")
                else:
                    square = (found.column(name) - example.true[name]) ** 2
                rmse.append(float(np.sqrt(np.mean(square))))
                numbers[f"hammerstein/n_g={n_g}/rmse/{name}/{n}"] = rmse[-1]
            slope = float(np.polyfit(np.log(SIZES), np.log(rmse), 1)[0])
            numbers[f"hammerstein/n_g={n_g}/slope/{name}"] = slope
    return numbers
