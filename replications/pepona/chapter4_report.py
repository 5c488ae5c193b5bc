"""Tables and sentences of Chapter 4; the notebook calls these."""

from collections.abc import Mapping
from typing import Any

from replications.errata import show_errata
from replications.pepona import setting
from replications.pepona.chapter import printed_values
from replications.pepona.chapter4_figures import (
    block_diagram,
    consistency,
    initialisation,
    map_of,
    stages,
    vaf,
)
from replications.pepona.chapter4_study import FEWER, readings
from sysid.reporting import display
from sysid.reporting.display import Display, Markdown

__all__ = [
    "bases", "block_diagram", "conditions", "consistency", "errata", "example_table", "fewer_samples",
    "identifiability", "initialisation", "iteration", "lemma", "map_of", "searches", "shift", "signs",
    "stages", "studies", "theorem_1", "vaf", "vaf_table",
]  # fmt: skip

Results = Mapping[str, Any]


def _numbers(results: Results) -> Mapping[str, float]:
    numbers: Mapping[str, float] = results["papers"]["pepona"]["numbers"]
    return numbers


def _runs(results: Results, case: str) -> int:
    return int(results["papers"]["pepona"]["monte_carlo"][case]["n_runs"])


def theorem_1(results: Results) -> Display:
    """Say that the critical points coincide."""
    numbers = _numbers(results)
    cosine = max(numbers[f"{case}/theory/gradient/joint_worst"] for case in setting.EXAMPLES)
    off = max(numbers[f"{case}/theory/joint_cost_off_worst"] for case in setting.EXAMPLES)
    return display.prose(
        "At the minimum of the separated problem no column of the joint Jacobian makes a cosine of more than "
        f"{display.number(cosine, digits=1)} with the residual, in any example and record; a joint search "
        f"from the same start ends at the same cost to {display.number(off, digits=1)}. (Theorem 4.1.)"
    )


def conditions(results: Results) -> Display:
    """Show the condition numbers of both problems."""
    numbers = _numbers(results)
    heads = [
        "example",
        "separated",
        "joint",
        "joint, basis (4.16)",
        "steps: separated",
        "steps: joint",
        "steps: joint, (4.16)",
    ]
    keys = ("condition/kaufman", "condition/joint", "condition/joint-thesis-basis", "steps/separated",
            "steps/joint", "steps/joint-thesis-basis")  # fmt: skip
    rows = [
        [case, *(display.number(numbers[f"{case}/theory/{key}"], digits=3) for key in keys)]
        for case in setting.EXAMPLES
    ]
    return display.table(
        rows,
        heads,
        align="lrrrrrr",
        caption="Condition numbers of the Jacobians at the minimum (Theorem 4.2), with B-splines and with "
        "the printed basis, and steps of Levenberg-Marquardt from the start of 4.3.1; medians over records. "
        "In 4.4 one parameter is searched, hence 1.",
    )


def bases(results: Results) -> Display:
    """Show the condition numbers of the two bases."""
    numbers = _numbers(results)
    rows = [
        [
            case,
            numbers[f"{case}/theory/basis/thesis"],
            numbers[f"{case}/theory/basis/thesis-scaled"],
            numbers[f"{case}/theory/basis/bspline"],
            numbers[f"{case}/theory/basis/bspline-scaled"],
            numbers[f"{case}/theory/basis/difference"],
        ]
        for case in setting.EXAMPLES
    ]
    heads = [
        "example",
        "(4.16)",
        "(4.16), columns scaled",
        "B-splines",
        "B-splines, scaled",
        "fits differ by",
    ]
    formats = dict.fromkeys(heads[1:3], ".2e") | dict.fromkeys(heads[3:5], ".1f") | {heads[5]: ".0e"}
    return display.table(
        rows,
        heads,
        formats=formats,
        caption="Condition numbers of two bases of one space at the data, and the largest difference of "
        "their residuals at the same $d$ and $g$, relative to the root mean square; medians.",
    )


def iteration(results: Results) -> Display:
    """Say what Table 4.1 does as printed."""
    numbers = _numbers(results)
    return display.prose(
        "Run letter for letter from the start of 4.3.1, Table 4.1 stops after its first step (median; the "
        "test is "
        "met as soon as a step helps), with Example 4.3 "
        f"{100 * numbers['4.3/theory/printed/excess']:.1f} % above the minimum in the median and "
        f"{100 * numbers['4.3/theory/printed/excess_worst']:.0f} % at worst, with Example 4.4 "
        f"{100 * numbers['4.4/theory/printed/excess']:.1f} % and "
        f"{100 * numbers['4.4/theory/printed/excess_worst']:.0f} %. Started at the minimum it never stops. "
        "And a "
        "step uphill stays: from $g_1$ drawn within 3 of zero "
        f"{100 * numbers['4.4/theory/printed/uphill-share']:.0f} % of the searches of Example 4.4 take one "
        "that raises the "
        f"cost by more than 1 %, by up to {numbers['4.4/theory/printed/worst-rise_worst']:.1f} times. The "
        "iteration "
        "used here rejects such steps and ends when the cost no longer falls by $10^{-10}$."
    )


def searches(results: Results) -> Display:
    """Show how the searches end."""
    numbers = _numbers(results)
    rows = [
        [
            case,
            f"{100 * numbers[f'{case}/converged_share']:.0f} %",
            f"{100 * numbers[f'{case}/reached_share']:.0f} %",
            f"{numbers[f'{case}/iterations/kaufman_median']:.0f}",
            f"{numbers[f'{case}/iterations/exact_median']:.0f}",
        ]
        for case in setting.EXAMPLES
    ]
    return display.table(
        rows,
        ["example", "converged", "at the minimum found from the truth", "steps, (4.31)", "steps, exact"],
        align="lrrrr",
        caption="Searches from the start of 4.3.1: share that converges, share that ends where a search from "
        "the true parameters ends, and median steps with Kaufman's (4.31) and the exact Jacobian.",
    )


def example_table(results: Results, case: str) -> Display:
    """Show Table 4.2, 4.3 or 4.4 beside the runs."""
    numbers, printed, example = _numbers(results), printed_values(), setting.EXAMPLES[case]
    study = results["papers"]["pepona"]["monte_carlo"][case]["parameters"]
    rows: list[list[object]] = []
    for name in example.parameters:
        quality = study[name]
        first = printed.get(f"{case}/initial/{name}")
        final = printed[f"{case}/final/{name}"]
        rows.append(
            [
                Markdown(display.symbol(name)),
                _plain(example.true[name]),
                None if first is None else _plain(first),
                _z(numbers.get(f"{case}/z/initial/{name}")),
                _plain(final),
                _z(numbers[f"{case}/z/final/{name}"]),
                f"{quality['mean']:.4f} ± {quality['std']:.4f}".replace("-", "−"),
                f"{quality['crlb_std']:.4f}",
                f"{numbers[f'{case}/bound/known/{name}']:.4f}",
            ]
        )
    heads = ["", "true", "initial", "z", "final", "z", "mean ± std", "bound", "bound, map known"]
    words = {
        "4.3": " The printed initial $a_1$ has the sign of (4.33).",
        "4.4": " The printed $g_1 = 0.5178$ is held against the runs with its sign turned.",
    }.get(case, "")
    return display.table(
        rows,
        heads,
        align="lrrrrrrrr",
        caption=f"Table {case} beside {_runs(results, case)} runs: printed estimates with their distance "
        "from the median of the runs in standard deviations (z), our mean and standard deviation, and the "
        f"standard deviation at the bound of the spline model and with the map known.{words}",
    )


def _plain(value: float) -> str:
    return f"{value:.4f}".rstrip("0").rstrip(".").replace("-", "−")


def _z(value: float | None) -> str | None:
    return None if value is None else f"{value:+.1f}".replace("-", "−")


def fewer_samples(results: Results) -> Display:
    """Say with how many samples Table 4.2 would be ordinary."""
    numbers = _numbers(results)
    prefix = f"4.2/n={FEWER}/z/"
    there = max(
        (abs(value) for name, value in numbers.items() if name.startswith(prefix)), default=float("nan")
    )
    here = max(
        abs(numbers[f"4.2/z/{name}"])
        for name in (*(f"{stage}/d{i}" for stage in ("initial", "final") for i in (1, 2, 3)), "vaf_one_step")
    )
    return display.prose(
        f"Of its seven numbers the farthest lies {here:.1f} standard deviations out. With {FEWER} samples to "
        f"identify and {FEWER} to validate, in place of 1000 and 1000, it would be {there:.1f}: the table "
        "looks like one from far fewer samples than the text says. Its columns also miss the constraint: "
        f"$\\|d\\|$ is {numbers['table-4.2/initial-norm']:.4f} for the initial and "
        f"{numbers['table-4.2/final-norm']:.4f} for the final estimate, where Table 4.3 has "
        f"{numbers['table-4.3/initial-norm']:.4f} and {numbers['table-4.3/final-norm']:.4f}."
    )


def signs(results: Results, case: str) -> Display:
    """Show what every reading of the signs gives."""
    numbers = _numbers(results)
    rows = []
    for name, example in readings(case).items():
        prefix = f"{case}/signs/{name}"
        row: list[object] = [
            f"{_signed(example.a)} y(k−1)",
            f"{_signed(example.g)} w(k−1)",
            f"{100 * numbers[f'{prefix}/diverged_share']:.0f} %",
            f"{100 * numbers[f'{prefix}/diverged_long_share']:.0f} %",
        ]
        for score in ("vaf_one_step", "vaf_free_run"):
            value = numbers.get(f"{prefix}/{score}_median")
            below = numbers.get(f"{prefix}/{score}_share_below")
            row += [
                None if value is None else f"{value:.2f}",
                None if below is None else f"{100 * below:.0f} %",
            ]
        if case == "4.3":
            row += [f"{numbers[f'{prefix}/initial/a1_median']:.3f}", _z(numbers[f"{prefix}/initial/a1_z"])]
        rows.append(row)
    heads = ["", "", "diverge", "in the long run", "one-step VAF [%]", "runs below", "free-run VAF [%]",
             "runs below"]  # fmt: skip
    heads += ["initial $a_1$", "z"] if case == "4.3" else []
    printed = {"4.3": "VAF 98.32 %, initial $a_1$ −0.4472", "4.4": "VAF 97.85 %"}[case]
    return display.table(
        rows,
        heads,
        align="llr" + "r" * (len(heads) - 3),
        caption=f"Example {case} with every sign of the two coefficients: share of records that diverge, of "
        "the example's length and of 100 000 samples; medians of the VAF of fitted models and the share of "
        f"runs below the printed one ({printed}).",
    )


def _signed(value: float) -> str:
    return f"{value:+.1f}".replace("-", "−")


def vaf_table(results: Results) -> Display:
    """Show both VAF with their ceilings."""
    numbers, printed = _numbers(results), printed_values()
    rows = [
        [
            case,
            f"{printed[f'{case}/vaf']:.2f}",
            *(
                cell
                for kind in ("one_step", "free_run")
                for cell in (
                    f"{numbers[f'{case}/vaf_{kind}_median']:.2f}",
                    f"{numbers[f'{case}/ceiling_{kind}_median']:.2f}",
                    f"{100 * numbers[f'{case}/share_below/vaf_{kind}']:.0f} %",
                )
            ),
        ]
        for case in setting.EXAMPLES
    ]
    heads = [
        "example",
        "printed",
        "one-step",
        "of the truth",
        "runs below",
        "free run",
        "of the truth",
        "runs below",
    ]
    return display.table(
        rows,
        heads,
        align="lrrrrrrr",
        caption="Validation VAF [%]: printed, medians of the fitted models and of the true system as a "
        "model, and the share of runs below the printed value. Free runs of fitted models of Example 4.4 "
        f"diverge in {100 * numbers['4.4/free_run_diverges_share']:.0f} % of the runs, which count as "
        "undefined.",
    )


def lemma(results: Results) -> Display:
    """Say what becomes of the rank condition."""
    numbers = _numbers(results)
    rows = [
        [n_g, int(numbers[f"lemma/columns/n_g={n_g}"]), int(numbers[f"lemma/deficit/n_g={n_g}"])]
        for n_g in (0, 1, 2)
    ]
    slopes = ", ".join(
        f"{numbers[f'hammerstein/n_g={n_g}/slope/{name}']:.2f} ({symbol}, $n_g = {n_g}$)".replace("-", "−")
        for n_g, names in ((0, ("a1", "map")), (1, ("a1", "g1", "map")))
        for name, symbol in ((name, "map" if name == "map" else display.symbol(name)) for name in names)
    )
    return display.group(
        display.table(
            rows,
            ["$n_g$", "entries of $F_k$", "rank missing"],
            align="rrr",
            caption="Lemma 4.1 by 4000 samples of a Hammerstein system with uniform input: the rows $F_k$ "
            "cannot have full rank for $n_g \\ge 1$.",
        ),
        consistency(results),
        display.prose(f"The exponents are {slopes}."),
    )


def identifiability(results: Results) -> Display:
    """Say what the constraints fix, what they take too much, and what stays open."""
    numbers = _numbers(results)
    overlap = [int(numbers[f"overlap/deficit/n_b={n_b}"]) for n_b in (0, 1, 2)]
    return display.prose(
        "- *Sign of d.* Turning $d$ round and mirroring the map changes the one-step predictions by "
        f"{display.number(numbers['undetermined/sign-of-d'], digits=1)}: the constraints leave it open, and "
        "the estimator says which sign it takes.\n- *Offset of the map.* (4.10) has no constant but "
        "$\\lambda_0$, so that the mean of the output is the map's offset; a constant beside it costs one "
        "rank.\n- *$b_i c_i = 0$.* With two lags in $D$ and one, two or three in $B$, all of them different "
        f"from zero, {overlap[0]}, {overlap[1]} and {overlap[2]} parameters are not determined: the "
        "constraint takes away 1, 2 and 2.\n- *Start.* When $B$ has the lags of $z$, step 3 of 4.3.1 "
        "regresses on what step 1 has taken out: the first $d$ has "
        f"{display.number(numbers['initialisation/shared-lags'], digits=1)} of its proper length."
    )


def shift(results: Results) -> Display:
    """Say what Example 4.1 shows."""
    numbers = _numbers(results)
    return display.prose(
        "Example 4.1 moves a delay from $G$ to the input of the map. Shifted, the largest difference of the "
        f"outputs is {display.number(numbers['example-4.1/shifted'], digits=1)}; as printed it is "
        f"{numbers['example-4.1/printed']:.2f}."
    )


def errata(results: Results) -> Display:
    """Show every printing error with its numbers."""
    return show_errata(results, "pepona")


def studies(results: Results) -> Display:
    """Show the Monte-Carlo tables of the examples."""
    return display.group(
        *(
            display.monte_carlo(
                results,
                "pepona",
                case,
                caption=f"Example {case}, {one.title}: {_runs(results, case)} runs of {one.samples} samples; "
                "bound of the spline model.",
            )
            for case, one in setting.EXAMPLES.items()
        )
    )
