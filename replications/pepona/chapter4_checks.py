"""The gates of Chapter 4: what must hold, how closely, and why."""

from collections.abc import Mapping
from typing import Any

from replications.pepona import setting
from replications.pepona.chapter import MonteCarlo, Numbers, Studies
from replications.pepona.chapter4_study import SIZES
from replications.studies import parameters_of, slope_std_error
from sysid import gates as gate
from sysid.gates import Gate

Found = dict[str, float]

SMOOTH = ("4.2", "4.3")
"""Examples whose map a cubic spline follows to a fraction of the noise; that of 4.4 has a bend."""
GRADIENT = 1e-6
LOSS = {"4.2": 0.3, "4.3": 0.15}
"""VAF that estimating fifteen or so parameters from 1000 samples may cost at most [%]: p/N of the noise."""


def gates4(studies: Studies, monte_carlo: MonteCarlo, numbers: Numbers) -> list[Gate]:
    """Return the gates of Chapter 4."""
    found: Found = {name: float("nan") if value is None else value for name, value in numbers.items()}
    return [
        *(item for case in setting.EXAMPLES for item in estimate_gates(case, monte_carlo[case], found)),
        *(item for case in setting.EXAMPLES for item in search_gates(case, found)),
        *vaf_gates(found),
        *reading_gates(found),
        *(item for case in setting.EXAMPLES for item in theory_gates(case, found)),
        *statement_gates(found),
        *consistency_gates(found, [studies[f"hammerstein/n_g=1/n={n}"].n_runs for n in SIZES]),
    ]


def estimate_gates(case: str, entry: Mapping[str, Any], numbers: Found) -> list[Gate]:
    """Bias, spread against the bound of the spline model, coverage."""
    found = []
    n_runs = int(entry["n_runs"])
    for name, quality in parameters_of(entry).items():
        found.append(
            gate.monte_carlo_band(
                f"bias/{case}/{name}",
                quality["bias"],
                0.0,
                quality["bias_std_error"],
                "no bias beyond a third of the spread: what the spline cannot follow, and terms of order 1/N",
                allowance=0.33 * quality["std"],
            )
        )
        found.append(
            gate.monte_carlo_band(
                f"efficiency/{case}/{name}",
                quality["std"] / numbers[f"{case}/bound/spline/{name}"],
                1.05,
                1.05 / (2.0 * n_runs) ** 0.5,
                "least squares attains the bound of its model up to terms of order 1/N; a standard deviation "
                "over n runs has a relative error of 1/sqrt(2n)",
                allowance=0.15,
            )
        )
        found.append(
            gate.monte_carlo_band(
                f"coverage/{case}/{name}",
                numbers[f"{case}/coverage/{name}"],
                0.95,
                (0.95 * 0.05 / n_runs) ** 0.5,
                "the 95 % intervals of the fit hold the true value that often, up to terms of order 1/N",
                allowance=0.05,
            )
        )
    return found


def search_gates(case: str, numbers: Found) -> list[Gate]:
    """Convergence from the start of 4.3.1."""
    return [
        gate.exact(
            f"converged/{case}", numbers[f"{case}/converged_share"], 1.0, "every search ends at a minimum"
        ),
        gate.at_least(
            f"reached/{case}",
            numbers[f"{case}/reached_share"],
            0.95,
            "relative",
            "the start of 4.3.1 leads to the minimum that a start at the true parameters finds",
        ),
    ]


def vaf_gates(numbers: Found) -> list[Gate]:
    """Which VAF the thesis prints, and how near the models come to what is possible."""
    found = []
    for case in SMOOTH:
        for kind in ("one_step", "free_run"):
            loss = numbers[f"{case}/ceiling_{kind}_median"] - numbers[f"{case}/vaf_{kind}_median"]
            found.append(
                gate.Gate(
                    f"vaf-loss/{case}/{kind}", loss, 0.0, LOSS[case], "relative",
                    "the true system is best, and the model of 1000 samples loses little",
                )
            )  # fmt: skip
    found.append(
        gate.at_least(
            "which-vaf/4.3",
            abs(numbers["4.3/z/vaf_free_run"]) - abs(numbers["4.3/z/vaf_one_step"]),
            0.5,
            "monte-carlo-band",
            "the printed 98.32 % lies in the middle of the one-step values and in the tail of the free runs",
        )
    )
    found.append(
        gate.at_least(
            "which-vaf/4.4",
            numbers["4.4/vaf_one_step_median"] - 97.85,
            1.0,
            "monte-carlo-band",
            "the printed 97.85 % is too little for a prediction: half of the runs predict better than 98.9 %",
        )
    )
    found.append(
        gate.at_most(
            "which-vaf/4.4/free-run",
            abs(numbers["4.4/score/vaf_free_run"]),
            2.0,
            "monte-carlo-band",
            "the printed 97.85 % is an ordinary free run",
        )
    )
    return found


def reading_gates(numbers: Found) -> list[Gate]:
    """Check the signs of examples 4.3 and 4.4."""
    as_printed = numbers["4.4/signs/+a+g/diverged_share"]
    corrected = numbers["4.4/signs/+a-g/diverged_share"]
    off = numbers["4.3/signs/-a-g/vaf_one_step_z"], numbers["4.3/signs/-a-g/vaf_free_run_z"]
    return [
        gate.exact("signs/4.4/as-printed", as_printed, 1.0, "as printed every record diverges"),
        gate.exact("signs/4.4/corrected", corrected, 0.0, "with -g1 none does"),
        *(
            gate.exact(
                f"signs/4.4/stable/{name}", numbers[f"4.4/signs/{name}/diverged_long_share"], expected,
                "over 100 000 samples the two readings with +g1 always diverge, those with -g1 never",
            )
            for name, expected in (("+a+g", 1.0), ("-a+g", 1.0), ("+a-g", 0.0), ("-a-g", 0.0))
        ),
        gate.at_least(
            "signs/4.4/other-stable", numbers["4.4/signs/-a-g/vaf_free_run_share_below"], 0.9,
            "monte-carlo-band",
            "the other stable reading has free runs below the printed VAF, its predictions are above",
        ),
        gate.at_most(
            "signs/4.3/as-printed", max(off), -4.0, "monte-carlo-band",
            "as printed no VAF is as low as 98.32 %, one-step or free-run",
        ),
    ]  # fmt: skip


def theory_gates(case: str, numbers: Found) -> list[Gate]:
    """Check both theorems, both bases and Table 4.1 on the records of an example."""
    one = {name.removeprefix(f"{case}/theory/"): value for name, value in numbers.items()
           if name.startswith(f"{case}/theory/")}  # fmt: skip
    return [
        gate.at_most(
            f"theorem-4.1/{case}/gradient", one["gradient/joint_worst"], GRADIENT, "exact",
            "the minimum of the separated problem is a critical point of the joint one; the search stops "
            "at cosines of about 1e-8",
        ),
        gate.at_most(
            f"theorem-4.1/{case}/cost", one["joint_cost_off_worst"], 1e-9, "exact",
            "both searches find one minimum",
        ),
        gate.at_most(
            f"theorem-4.2/{case}", one["condition/ratio_worst"], 1.0 + 1e-9, "exact",
            "the separated problem is never worse conditioned than the joint one",
        ),
        gate.at_most(
            f"basis/{case}/same-fit", one["basis/difference"], 1e-9, "exact",
            "both bases span one space; the median condition of the printed one leaves ten digits",
        ),
        gate.at_most(
            f"basis/{case}/rounding", one["basis/rounding_worst"], 100.0, "exact",
            "in the worst record the fits differ by no more than rounding times the condition",
        ),
        gate.at_least(
            f"basis/{case}/condition", one["basis/thesis"] / one["basis/bspline"], 1e3, "relative",
            "B-splines are local, cubes of distances are not",
        ),
        gate.exact(
            f"table-4.1/{case}/never-ends", one["printed/stopped-at-minimum_worst"], 0.0,
            "started at the minimum the printed loop goes on for ever",
        ),
    ]  # fmt: skip


def statement_gates(numbers: Found) -> list[Gate]:
    """Check the lemma, the constraints, Example 4.1 and the initialisation."""
    found = [
        gate.exact(
            f"lemma-4.1/deficit/n_g={n_g}", numbers[f"lemma/deficit/n_g={n_g}"], n_g,
            "every further block of F repeats the constant",
        )
        for n_g in (0, 1, 2)
    ]  # fmt: skip
    found += [
        gate.exact(
            f"overlap/n_b={n_b}", numbers[f"overlap/deficit/n_b={n_b}"], expected,
            "B + lambda G D hides one number at most, and none while B lacks a lag of G D",
        )
        for n_b, expected in ((0, 0), (1, 1), (2, 1))
    ]  # fmt: skip
    found += [
        gate.at_most(
            "example-4.1", numbers["example-4.1/shifted"], 1e-12, "exact", "shifted, both systems are one"
        ),
        gate.at_most(
            "undetermined/sign-of-d", numbers["undetermined/sign-of-d"], 1e-10, "exact",
            "-d with the mirrored map is the same model",
        ),
        gate.exact(
            "undetermined/offset", numbers["undetermined/offset-deficit"], 1.0,
            "a constant beside the map says what its offset says",
        ),
        gate.at_most(
            "initialisation/shared-lags", numbers["initialisation/shared-lags"], 1e-9, "exact",
            "step 3 regresses on what step 1 has taken out when B has the lags of z",
        ),
        gate.at_least(
            "table-4.1/excess", numbers["4.3/theory/printed/excess_worst"], 1e-2, "relative",
            "the printed test stops percents above the minimum",
        ),
        gate.at_least(
            "table-4.1/uphill", numbers["4.4/theory/printed/worst-rise_worst"], 1.2, "relative",
            "steps uphill are kept: from g1 within 3 of zero the cost rises by a fifth and more in one step",
        ),
    ]  # fmt: skip
    return found


def consistency_gates(numbers: Found, n_runs: list[int]) -> list[Gate]:
    """Errors of the Hammerstein systems fall like the square root of N, whatever the rank of F."""
    spread = slope_std_error(SIZES, n_runs)
    return [
        gate.slope(
            name.replace("/slope", ""), value, -0.5, 0.05 + 4.0 * spread,
            "consistent at the usual rate; four standard errors of the exponent, and 0.05 for 250 samples",
        )
        for name, value in numbers.items()
        if name.startswith("hammerstein/") and "/slope/" in name
    ]  # fmt: skip
