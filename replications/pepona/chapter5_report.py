"""Tables and sentences of Chapter 5; the notebook calls these."""

from collections.abc import Mapping
from typing import Any

from replications.pepona.chapter5_figures import bias, clouds, first_iteration, sequence
from replications.pepona.chapter5_pwarx import PAIRS, PRINTED_TABLE_5_3
from replications.pepona.chapter5_runs import SMALLEST_MODE, STAGES, THRESHOLDS
from replications.pepona.chapter5_setting import BOUNDARY, EXAMPLES, PRINTED
from sysid.reporting import display
from sysid.reporting.display import Display

__all__ = [
    "bias", "clouds", "creeping", "estimates", "first_iteration", "identifiability", "pwarx", "sequence",
    "smoothing", "stages", "table_5_3", "thresholds",
]  # fmt: skip

Results = Mapping[str, Any]


def _numbers(results: Results) -> Mapping[str, Any]:
    numbers: Mapping[str, Any] = results["papers"]["pepona"]["numbers"]
    return numbers


def _entry(results: Results, case: str) -> Mapping[str, Any]:
    entry: Mapping[str, Any] = results["papers"]["pepona"]["monte_carlo"][case]
    return entry


def identifiability(results: Results) -> Display:
    """Say what the check finds for both forms of Example 5.1 (5.14)."""
    from replications.pepona.chapter5_errata import NOT_NECESSARY
    from replications.pepona.chapter5_theory import AS_IN_5_14, AS_IN_5_15
    from sysid.lft import identifiability as check

    rows = [
        ["(5.14), z = (y(k-1), u(k-1))", str(check(AS_IN_5_14))],
        ["(5.15), z = (y(k-2), u(k-2))", str(check(AS_IN_5_15))],
        ["y = b u(k-2) + w(k) + g w(k-1), z = u(k-1)", str(check(NOT_NECESSARY, [0.5]))],
    ]
    difference = _numbers(results)["identifiability/5.15/difference"]
    return display.group(
        display.table(rows, ["structure", "what the check says"], align="ll"),
        display.prose(
            f"The outputs of (5.14) and (5.15) differ by {display.number(difference, digits=1)} at most, "
            f"by rounding."
        ),
    )


def smoothing(results: Results) -> Display:
    """Show what recursion and least norm do with zeros inside and outside the circle."""
    numbers = _numbers(results)
    rows = [
        [
            name,
            numbers[f"smoothing/{side}/growth"],
            numbers[f"smoothing/{side}/recursion_error"],
            numbers[f"smoothing/{side}/least_norm_error"],
        ]
        for name, side in (("zeros of Example 5.3, modulus 0.9", "inside"), ("zero at 2", "outside"))
    ]
    return display.table(
        rows,
        ["$G(q)$", "growth a sample", "error of the recursion", "error of least norm"],
        formats={"growth a sample": ".2g", "error of the recursion": ".1e", "error of least norm": ".1e"},
        align="lrrr",
        caption="Recovery of $v$ between samples 300 and 400 from its beginning.",
    )


def estimates(results: Results, case: str) -> Display:
    """Show the printed estimates with their z-scores, and alternating and joint estimates beside them."""
    numbers = _numbers(results)
    alternating = _entry(results, case)["parameters"]
    joint = _entry(results, f"{case}/joint")["parameters"]
    rows: list[list[object]] = []
    for name, true in EXAMPLES[case].true.items():
        printed = PRINTED.get(f"{case}/{name}")
        bound = joint[name]["crlb_std"]
        rows.append(
            [
                name.replace("theta", "θ").replace("alpha", "α").replace("tau", "τ"),
                true,
                printed[2] if printed else None,
                numbers.get(f"z/{case}/{name}"),
                alternating[name]["bias"],
                alternating[name]["rmse"],
                joint[name]["bias"],
                joint[name]["rmse"],
                bound,
                joint[name]["rmse"] / bound if bound else None,
            ]
        )
    heads = ["", "true", "printed", "z", "bias", "RMSE", "bias, joint", "RMSE, joint", "bound", "ratio"]
    formats = {"z": ".1f", "ratio": ".2f", **dict.fromkeys(["bias", "bias, joint"], ".4f")}
    formats |= dict.fromkeys(["RMSE", "RMSE, joint", "bound"], ".4f")
    what = "of a continuous map" if case == "5.1" else "with the partition known"
    share = 100 * _entry(results, f"{case}/joint")["success_share"]
    return display.table(
        rows,
        heads,
        formats=formats,
        align="lrrrrrrrrr",
        caption=f"Example {case}, {_entry(results, case)['n_runs']} records of {EXAMPLES[case].samples} "
        "samples. z: distance of the printed value from the mean of the alternating scheme, in standard "
        f"deviations of single runs. Bound: Cramér-Rao {what}; ratio: RMSE of the joint fit over it. The "
        f"joint fit finds the modes in {share:.0f} % of the records.",
    )


def creeping(results: Results) -> Display:
    """Say what (5.23) does in Example 5.1."""
    n = _numbers(results)
    return display.prose(
        "With (5.23) as printed the scheme takes "
        f"{n['5.1/as_printed/iterations']:.0f} iterations, and after five of them $\\hat a_1$ is "
        f"{n['5.1/as_printed/a1_after_5']:.2f}, far from the printed $-0.778$: the vertical shift of $w$ "
        f"and $a_1$ "
        r"move together, and each iteration leaves the share $\bar y^2/\overline{y^2}$ "
        f"({n['threshold/5.1/as_printed/rate']:.2f}) of the error. "
        "With a constant in the regression, which the map's offset makes redundant, it takes "
        f"{n['stage/5.1/global/iterations']:.1f} iterations on the average "
        f"({n['stage/5.1/bounded-error/iterations']:.1f} with the bounded-error stage), "
        f"and the shift falls from {n['5.1/shift/first']:.2f} to {n['5.1/shift/last']:.2f}. "
        "The printed five iterations, from 1.2 to 0.1, can only come from such a regression."
    )


def thresholds(results: Results) -> Display:
    """Show iterations and the distance that is left for several thresholds."""
    n = _numbers(results)
    rows: list[list[object]] = []
    for case in EXAMPLES:
        for how, label in (("as_printed", "as printed"), ("constant", "with a constant")):
            cells: list[object] = [case, label, n[f"threshold/{case}/{how}/rate"]]
            for gamma in THRESHOLDS:
                start = f"threshold/{case}/{how}/{gamma:g}"
                cells.append(f"{n[f'{start}/iterations']:.0f}; {n[f'{start}/distance']:.1g}")
            rows.append(cells)
    return display.table(
        rows,
        ["example", "(5.23)", "rate", *(f"$\\gamma = {gamma:g}$" for gamma in THRESHOLDS)],
        formats={"rate": ".2f"},
        align="llrrrr",
        caption="Iterations, and distance to the fixed point relative to the parameters, at the stop; "
        "medians, the partition known. Where the rate is near one the stop comes early.",
    )


def stages(results: Results) -> Display:
    """Show the three map stages side by side."""
    paper = results["papers"]["pepona"]
    n, timings = _numbers(results), paper["timings"]
    rows: list[list[object]] = []
    for case, example in EXAMPLES.items():
        for stage in STAGES:
            start = f"stage/{case}/{stage}"
            parameters = _entry(results, f"{case}/{stage}")["parameters"]
            inner = [name for name in parameters if name not in BOUNDARY[case]]
            errors = [parameters[name]["rmse"] for name in inner]
            total = sum(e**2 for e in errors) ** 0.5 if None not in errors else None
            rows.append(
                [
                    case if stage == STAGES[0] else "",
                    stage,
                    n[f"{start}/runs"],
                    f"{100 * n[f'{start}/success']:.0f} %",
                    f"{100 * n[f'{start}/two_modes']:.0f} %",
                    f"{100 * n[f'{start}/settled']:.0f} %",
                    n[f"{start}/iterations"],
                    total,
                    timings.get(f"{start}/seconds"),
                ]
            )
        assert example.deltas
    bounds = "; ".join(
        f"{case}: {', '.join(f'{d:g}' for d in example.deltas)}" for case, example in EXAMPLES.items()
    )
    return display.table(
        rows,
        ["", "map stage", "runs", "success", "two modes", "settled", "iterations", "error", "time [s]"],
        formats={"runs": ".0f", "iterations": ".1f", "error": ".3f", "time [s]": ".2f"},
        align="llrrrrrrr",
        caption="Table 5.1 with each map stage. Success: two modes, at most 5 % of the samples in the wrong "
        "one. Error: root of the sum of the mean squared errors of all parameters but the boundary, where "
        f"there are two modes. Time: one record. Bounds by iteration, {bounds} (5.2 as in the text; of 5.3 "
        f"the text gives the first and the third); modes hold {100 * SMALLEST_MODE:.0f} % of the samples or "
        "more. At most 15 iterations with bounds.",
    )


def table_5_3(results: Results) -> Display:
    """Show Table 5.3 with both columns."""
    n = _numbers(results)
    direct = {pair: PRINTED[f"5.2/direct/{pair}"][2] for pair in PRINTED_TABLE_5_3}
    rows: list[list[object]] = []
    for i, j in PAIRS:
        pair = f"{i},{j}"
        rows.append(
            [
                f"({i}, {j})",
                direct[pair],
                n[f"table_5.3_direct/median/{pair}"],
                n[f"z/5.2/direct/{pair}"],
                PRINTED_TABLE_5_3[pair],
                n[f"table_5.3_lft/{pair}"],
                n[f"table_5.3_lft/slack/{pair}"],
                n[f"table_5.3_lft/median/{pair}"],
            ]
        )
    heads = [
        "mode",
        "direct, printed",
        "median",
        "z",
        "LFT, printed",
        "from Table 5.2",
        "its rounding",
        "LFT median",
    ]
    formats = dict.fromkeys(heads[1:], ".4f") | {"z": ".1f", "median": ".2f", "LFT median": ".2f"}
    return display.table(
        rows,
        heads,
        formats=formats,
        align="lrrrrrrr",
        caption="Table 5.3, relative errors [%]. The printed last column follows from the printed Table 5.2 "
        "within the rounding of its entries, and one set of unrounded estimates gives all four. In "
        f"{100 * n['table_5.3/better_share']:.0f} % of modes and records the LFT estimate is the better one, "
        f"in {100 * n['table_5.3/all_better_share']:.0f} % of the records in all four modes.",
    )


def pwarx(results: Results) -> Display:
    """Say what direct fits find, and how many modes are visited."""
    n = _numbers(results)

    def score(count: str) -> str:
        return display.number(n[f"z/5.3/{count}"], digits=2)

    rows = [
        [
            case.split("/")[0],
            delta,
            printed,
            n[f"{case}/modes_median"],
            f"{100 * n[f'{case}/misplaced_median']:.0f} %",
            f"{100 * n[f'{case}/outliers_median']:.0f} %",
        ]
        for case, delta, printed in (
            ("5.2/pwarx-0.4", 0.4, "2"),
            ("5.2/pwarx-0.25", 0.25, "fails"),
            ("5.3/pwarx-0.5", 0.5, "8"),
        )
    ]
    return display.group(
        display.table(
            rows,
            ["example", r"$\delta$", "modes, printed", "modes, median", "misplaced", "outliers"],
            align="lrrrrr",
            caption="The bounded-error procedure on the whole system, its structure ignored. Misplaced: "
            "samples in a wrong mode of the equivalent PWARX model, which has 4 and 32.",
        ),
        display.prose(
            f"Of the 32 modes of Example 5.3 a record visits {n['count/5.3/visited']:.0f} (median; 26 "
            f"printed, $z = {score('visited')}$). That eight have enough samples for eleven parameters "
            f"holds with three samples a parameter: {n['count/5.3/enough']:.0f} (median; "
            f"$z = {score('enough')}$)."
        ),
    )
