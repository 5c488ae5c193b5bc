"""Chapter 5 of the thesis: piecewise affine maps."""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from replications.errata import Erratum
from replications.pepona import chapter5_errata
from replications.pepona.chapter import Chapter, Numbers, Studies, printed_values
from replications.pepona.chapter5_gates import gates5
from replications.pepona.chapter5_pwarx import (
    n_parameters,
    table_5_3_lft,
    table_5_3_slack,
    table_5_3_unrounded,
)
from replications.pepona.chapter5_runs import (
    MOST_ITERATIONS,
    STAGES,
    THRESHOLDS,
    ExampleRun,
    LongRun,
    PwarxRun,
    StageRun,
    ThresholdRun,
    alternate,
)
from replications.pepona.chapter5_setting import (
    BOUNDARY,
    EXAMPLES,
    PRINTED,
    PRINTED_COUNTS,
    THRESHOLD,
    experiment,
)
from replications.pepona.chapter5_shown import shown
from replications.pepona.chapter5_theory import bound_std, theory_numbers
from replications.studies import entry
from sysid.montecarlo import Study, Task
from sysid.replication import Session

FEW = 40
"""Below so many runs the comparison of map stages is cut to a quarter of them."""
ENOUGH = 20
"""Runs that the gates on bias and spread need."""
LONG = 20_000
"""Samples at which the bias of the alternating scheme is shown."""
PWARX = {"5.2/pwarx-0.4": ("5.2", 0.4), "5.2/pwarx-0.25": ("5.2", 0.25), "5.3/pwarx-0.5": ("5.3", 0.5)}
"""Direct fits of the text: example and bound."""


def plan5(runs: int) -> Mapping[str, tuple[Task, int]]:
    """Return every case with its task and number of runs."""
    half = runs // 2 if runs >= FEW else max(runs // 4, 3)
    cases: dict[str, tuple[Task, int]] = {}
    for case in EXAMPLES:
        cases[case] = (ExampleRun(case), max(half, min(runs, ENOUGH)))
        cases[f"{case}/k-plane"] = (StageRun(case, "k-plane"), half)
        cases[f"{case}/bounded-error"] = (StageRun(case, "bounded-error"), half)
        cases[f"{case}/threshold"] = (ThresholdRun(case), max(runs // 10, 5))
    for case in ("5.2", "5.3"):
        cases[f"{case}/long"] = (LongRun(case, LONG), max(runs // 25, 4))
    for case, (name, delta) in PWARX.items():
        cases[case] = (PwarxRun(name, delta), max(runs // 20, 3))
    return cases


def monte_carlo5(studies: Studies) -> dict[str, Any]:
    """Return the Monte-Carlo entries of the examples, of the joint fit and of each map stage."""
    found: dict[str, Any] = {}
    for case, example in EXAMPLES.items():
        main = studies[case]
        found[case] = entry(main, example.true, bound_std(case), "final/")
        found[f"{case}/joint"] = entry(main, example.true, bound_std(case), "joint/") | {
            "success_share": main.mean()["joint/success"]
        }
        for stage in STAGES:
            study = stage_study(studies, case, stage)
            found[f"{case}/{stage}"] = entry(study, example.true, None, "final/") | {
                "success_share": study.mean()["success"]
            }
    return found


def stage_study(studies: Studies, case: str, stage: str) -> Study:
    """Return the study of a map stage; the global one is that of the example itself."""
    return studies[case if stage == "global" else f"{case}/{stage}"]


def numbers5(studies: Studies, session: Session) -> dict[str, float | None]:
    """Return the numbers of Chapter 5."""
    _measure(session)
    return {
        **setting_numbers(),
        **theory_numbers(),
        **table_5_3_numbers(studies["5.2"]),
        **z_scores(studies),
        **precision_numbers(studies),
        **bias_numbers(studies),
        **stage_numbers(studies),
        **threshold_numbers(studies),
        **pwarx_numbers(studies),
    }


def setting_numbers() -> dict[str, float | None]:
    """Return the set-up of the examples as the studies use it."""
    found: dict[str, float | None] = {"setting/5/threshold": THRESHOLD}
    for case, example in EXAMPLES.items():
        found |= {f"setting/{case}/{name}": value for name, value in example.true.items()}
        found |= {f"setting/{case}/delta-{i}": value for i, value in enumerate(example.deltas, 1)}
        lft, pwarx = n_parameters(example)
        modes = len(example.theta) ** (example.structure.n_g + 1)
        found |= {
            f"setting/{case}/samples": float(example.samples),
            f"setting/{case}/input": example.input,
            f"setting/{case}/noise": example.noise,
            f"setting/{case}/parameters": float(lft),
            f"setting/{case}/pwarx-parameters": float(pwarx),
            f"setting/{case}/pwarx-modes": float(modes),
            f"setting/{case}/pwarx-width": float(pwarx // modes),
        }
        if example.start is not None:
            found |= {f"setting/{case}/start-{i}": value for i, value in enumerate(example.start, 1)}
    return found


def table_5_3_numbers(study: Study) -> dict[str, float | None]:
    """Return Table 5.3: the last column from the printed estimates, both columns over the runs."""
    found: dict[str, float | None] = {"table_5.3_lft/unrounded": table_5_3_unrounded()}
    slack = table_5_3_slack()
    better = []
    for pair, value in table_5_3_lft().items():
        lft, direct = study.column(f"lft/{pair}"), study.column(f"direct/{pair}")
        found[f"table_5.3_lft/{pair}"] = value
        found[f"table_5.3_lft/slack/{pair}"] = slack[pair]
        found[f"table_5.3_lft/median/{pair}"] = float(np.nanmedian(lft))
        found[f"table_5.3_direct/median/{pair}"] = float(np.nanmedian(direct))
        better.append(lft < direct)
    found["table_5.3/all_better_share"] = float(np.mean(np.all(better, axis=0)))
    found["table_5.3/better_share"] = float(np.mean(better))
    return found


def z_scores(studies: Studies) -> dict[str, float | None]:
    """Return how many standard deviations of single runs each printed estimate lies from their mean."""
    found: dict[str, float | None] = {}
    for name, (case, column) in PRINTED_COUNTS.items():
        values = studies[case].column(column)
        limit = MOST_ITERATIONS["bounded-error" if "/" in case else "global"]
        counted = np.where(np.isnan(values), limit, values)  # what had not settled by then
        found[f"count/{name}"] = float(np.median(counted))
        spread = float(np.std(counted))
        found[f"z/{name}"] = (printed_values()[name] - float(counted.mean())) / spread if spread else None
    for name, (case, column, printed) in PRINTED.items():
        study = studies[case]
        found[f"z/{name}"] = (printed - study.mean()[column]) / study.std()[column]
        found[f"mean/{name}"] = study.mean()[column]
        found[f"std/{name}"] = study.std()[column]
    return found


def precision_numbers(studies: Studies) -> dict[str, float | None]:
    """Return RMSE over the bound of a known partition, for the alternating and the joint estimate."""
    found: dict[str, float | None] = {}
    for case, example in EXAMPLES.items():
        study = studies[case]
        for method in ("final", "joint"):
            ratios = []
            for name, bound in bound_std(case).items():
                error = study.column(f"{method}/{name}") - example.true[name]
                ratios.append(float(np.sqrt(np.nanmean(error**2))) / bound)
                found[f"ratio_to_bound/{case}/{method}/{name}"] = ratios[-1]
            found[f"ratio_to_bound/{case}/{method}/largest"] = max(ratios)
        found[f"misplaced/{case}/joint"] = study.mean()["joint/misplaced"]
    return found


def bias_numbers(studies: Studies) -> dict[str, float | None]:
    """Return the bias at 20,000 samples and its size in standard errors at the bound."""
    found: dict[str, float | None] = {}
    for case in ("5.2", "5.3"):
        study, example = studies[f"{case}/long"], EXAMPLES[case]
        for method in ("alternating", "joint"):
            scores = []
            for name, bound in bound_std(case).items():
                bias = study.mean()[f"{method}/{name}"] - example.true[name]
                score = bias / (bound * np.sqrt(example.samples / LONG / study.n_runs))
                scores.append(abs(score))
                found[f"bias/{case}/{method}/{name}"] = bias
                found[f"bias/{case}/{method}/{name}/z"] = score
            found[f"bias/{case}/{method}/largest_z"] = max(scores)
    return found


def stage_numbers(studies: Studies) -> dict[str, float | None]:
    """Return success, modes, misplaced samples, error and iterations of each map stage."""
    found: dict[str, float | None] = {}
    for case in EXAMPLES:
        for stage in STAGES:
            study = stage_study(studies, case, stage)
            mean = study.mean()
            settled = study.n_runs - study.failed - study.undefined()["iterations"]
            found |= {
                f"stage/{case}/{stage}/success": mean["success"],
                f"stage/{case}/{stage}/two_modes": float(np.mean(study.column("modes") == 2)),
                f"stage/{case}/{stage}/misplaced": float(np.median(study.column("misplaced"))),
                f"stage/{case}/{stage}/settled": settled / study.n_runs,
                f"stage/{case}/{stage}/iterations": mean["iterations"] if settled else None,
                f"stage/{case}/{stage}/runs": float(study.n_runs),
            }
    return found


def threshold_numbers(studies: Studies) -> dict[str, float | None]:
    """Return iterations and relative distance to the fixed point by threshold, medians."""
    found: dict[str, float | None] = {}
    for case in EXAMPLES:
        study = studies[f"{case}/threshold"]
        for name in ("as_printed", "constant"):
            found[f"threshold/{case}/{name}/rate"] = float(np.median(study.column(f"{name}/rate")))
            for threshold in THRESHOLDS:
                for what in ("iterations", "distance"):
                    column = f"{name}/{threshold:g}/{what}"
                    found[f"threshold/{case}/{column}"] = float(np.median(study.column(column)))
    for column in (
        "as_printed/iterations",
        "as_printed/a1_after_5",
        "as_printed/a1",
        "shift/first",
        "shift/last",
    ):
        found[f"5.1/{column}"] = studies["5.1"].mean()[column]
    return found


def pwarx_numbers(studies: Studies) -> dict[str, float | None]:
    """Return what direct fits of the whole system find, and how many modes are visited."""
    found: dict[str, float | None] = {}
    for case in PWARX:
        study = studies[case]
        modes = study.column("modes")
        found |= {
            f"{case}/modes_median": float(np.median(modes)),
            f"{case}/two_modes_share": float(np.mean(modes == 2)),
            f"{case}/misplaced_median": float(np.median(study.column("misplaced"))),
            f"{case}/least_misplaced": float(np.min(study.column("misplaced"))),
            f"{case}/outliers_median": float(np.median(study.column("outliers"))),
        }
    modes = studies["5.2/bounded-error"].column("modes")
    found["5.2/bounded-error/modes_median"] = float(np.median(modes))
    return found


def _measure(session: Session) -> None:
    """Time each map stage inside the alternating scheme, on one experiment [s]."""
    for case, example in EXAMPLES.items():
        for stage in STAGES:
            if session.smoke and (case, stage) == ("5.3", "bounded-error"):
                continue
            rng = np.random.default_rng([session.seed, 53])
            u, y = experiment(example, rng)
            begin = time.perf_counter()
            iterations = alternate(example, u, y, stage, rng).iterations
            session.timings[f"stage/{case}/{stage}/seconds"] = time.perf_counter() - begin
            session.timings[f"stage/{case}/{stage}/seconds_an_iteration"] = (
                time.perf_counter() - begin
            ) / iterations


def tables5(studies: Studies, session: Session) -> dict[str, Any]:
    """Return what the figures of Chapter 5 are drawn from."""
    return {"chapter5": shown(session.seed, session.smoke)}


def errata5() -> list[Erratum]:
    """Return the printing errors of Chapter 5."""
    return chapter5_errata.errata5()


CHAPTER_5 = Chapter(plan5, errata5, monte_carlo5, numbers5, tables5, gates5)

__all__ = [
    "BOUNDARY",
    "CHAPTER_5",
    "Numbers",
    "errata5",
    "gates5",
    "monte_carlo5",
    "numbers5",
    "plan5",
    "tables5",
]
