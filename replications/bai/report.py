"""Tables and sentences of the chapter on Bai's paper, made from the results; the notebook calls these."""

from collections.abc import Mapping
from typing import Any

from replications.bai import example_2, setting
from replications.bai.example_1 import one_parameter_map
from replications.bai.figures import block_diagram, consistency, cost_curves, example_2_bands, maps
from replications.bai.worked import WORKED
from replications.errata import show_errata
from sysid.reporting import display
from sysid.reporting.display import Display, Markdown

__all__ = [
    "block_diagram", "confirmed", "consistency", "cost_curves", "errata", "example_2_bands",
    "example_2_plausibility", "example_2_table", "maps", "minima", "precision", "slopes", "studies",
    "table_1", "table_1_plausibility", "worked",
]  # fmt: skip

Results = Mapping[str, Any]


def _numbers(results: Results) -> Mapping[str, float]:
    numbers: Mapping[str, float] = results["papers"]["bai"]["numbers"]
    return numbers


def _title(case: str) -> str:
    return one_parameter_map(case).title


def _row(values: list[float] | None) -> str | None:
    return None if values is None else ", ".join(f"{value:.3g}".replace("-", "−") for value in values)


def table_1(results: Results) -> Display:
    """Show Table 1: printed, one draw of ours, the mean of all runs."""
    rows = [
        [row["title"], _row(row["printed"]), _row(row["first_run"]), _row(row["mean"])]
        for row in results["papers"]["bai"]["tables"]["table-1"]
    ]
    runs = results["papers"]["bai"]["monte_carlo"]["preload"]["n_runs"]
    return display.table(
        rows,
        ["map", "printed", "our first run", f"mean of {runs} runs"],
        caption=r"Table 1 regenerated: $a$, $\alpha_1$, $\alpha_2$, $\beta_1$, $\beta_2$ from 100 samples; "
        "true values 1, −0.8333, −0.1667, 1, 1. The last two rows are physical readings that the paper does "
        "not print.",
    )


def table_1_plausibility(results: Results) -> Display:
    """Show whether each printed row is one draw of the stated protocol, and whether it is too good."""
    numbers = _numbers(results)
    rows = [
        [
            _title(case),
            numbers[f"plausibility/{case}/mahalanobis"],
            numbers[f"plausibility/{case}/p_value"],
            numbers[f"plausibility/{case}/closer_share"],
            numbers[f"plausibility/{case}/closer_share_of_a"],
        ]
        for case in setting.TABLE_ROWS
    ]
    probability = numbers["plausibility/table-1/probability"]
    all_a = numbers["plausibility/table-1/all_a_as_close"]
    return display.group(
        display.table(
            rows,
            ["row", "distance", "share farther", "share as good", "share as good in $a$"],
            formats={
                "distance": ".2f",
                "share farther": ".3f",
                "share as good": ".3f",
                "share as good in $a$": ".3f",
            },
            caption="Printed rows among the runs. Distance: Mahalanobis distance from the mean of the runs. "
            "As good: share of runs that, rounded like the print, come as close to the true values.",
        ),
        display.prose(
            f"Each row is a plausible draw. As a set the table is too good: six independent rows that are "
            f"all this close to the truth have a probability of {display.number(probability, digits=2)} "
            f"(Fisher's combination); that all six $a$ come as close as printed has the probability "
            f"{display.number(all_a, digits=2)}. One draw of each experiment does not look like that: the "
            "rows may have been selected from several."
        ),
    )


def precision(results: Results) -> Display:
    """Show spread and efficiency of every parameter."""
    monte_carlo = results["papers"]["bai"]["monte_carlo"]
    rows = []
    for case in setting.CASES:
        parameters = monte_carlo[case]["parameters"]
        cells = []
        for name in setting.PARAMETERS:
            quality = parameters[name]
            efficiency = quality["efficiency"]
            spread = display.number(quality["std"], digits=2)
            cells.append(spread if efficiency is None else f"{spread} ({100 * efficiency:.0f} %)")
        rows.append([_title(case), *cells])
    return display.table(
        rows,
        ["map", *(display.symbol(name) for name in setting.PARAMETERS)],
        caption="Standard deviation over the runs at $N = 100$; in brackets the efficiency against the "
        "asymptotic least-squares bound. The threshold of a relay has no such bound; the other parameters of "
        "the relays are held against the bound for a known threshold.",
        align="lrrrrr",
    )


def minima(results: Results) -> Display:
    """Show mean cost and local minima."""
    numbers = _numbers(results)
    variance = setting.EXAMPLE_1_NOISE**2 / 3
    rows = [
        [
            _title(case),
            display.with_error(
                numbers[f"ej/{case}/100"] / variance, numbers[f"ej_std_error/{case}/100"] / variance
            ),
            f"{100 * numbers[f'local_minima_share/{case}']:.1f} %",
            display.number(numbers[f"local_minima_mean/{case}"], digits=3),
        ]
        for case in setting.CASES
    ]
    return display.table(
        rows,
        ["map", r"$\mathrm{E}J/\sigma^2$", "runs with several minima", "local minima, mean"],
        caption=r"Mean cost at the minimum (five fitted parameters leave $1 - 5/100$) and the number of "
        "local minima of $J$ over $[0, 3.5]$.",
        align="lrrr",
    )


def slopes(results: Results) -> Display:
    """Show the exponents of RMSE against N."""
    numbers = _numbers(results)
    rows = [
        [_title(case), *(numbers[f"slope/{case}/{name}"] for name in setting.PARAMETERS)]
        for case in setting.CASES
    ]
    heads = [display.symbol(name) for name in setting.PARAMETERS]
    return display.table(
        rows,
        ["map", *heads],
        formats=dict.fromkeys(heads, ".3f"),
        caption=f"Exponent of the error in $N$ over 100 to 6400 samples; standard error "
        f"{display.number(numbers['slope_std_error'], digits=1)}.",
    )


def studies(results: Results) -> Display:
    """Show the full Monte-Carlo tables of Example 1."""
    monte_carlo = results["papers"]["bai"]["monte_carlo"]
    return display.group(
        *(
            display.monte_carlo(
                results,
                "bai",
                case,
                caption=f"{_title(case)}: {monte_carlo[case]['n_runs']} runs of 100 samples.",
            )
            for case in setting.CASES
        )
    )


def example_2_table(results: Results) -> Display:
    """Show what every reading of Example 2 gives."""
    numbers, monte_carlo = _numbers(results), results["papers"]["bai"]["monte_carlo"]
    rows = []
    for name in (*example_2.variants(), "separable"):
        a, beta = (monte_carlo[f"example-2/{name}"]["parameters"][key] for key in ("a", "beta1"))
        rows.append(
            [
                name,
                _band(a),
                _band(beta),
                None
                if name == "separable"
                else f"{100 * numbers[f'example-2/{name}/negative_square_share']:.1f} %",
                None if name == "separable" else numbers[f"example-2/{name}/band_over_separable/a"],
            ]
        )
    return display.table(
        rows,
        [
            "reading",
            "95 % band of $a$",
            r"95 % band of $\beta_1$",
            "negative square",
            "band of $a$ over least squares",
        ],
        formats={"band of $a$ over least squares": ".0f"},
        caption="Example 2 under every reading: m correlations, c averaged or from one coefficient, "
        "inputs drawn independently or one the multiple of the other. Negative square: share of runs in "
        "which (3.14) takes the root of a negative number (the paper takes its absolute value).",
        align="lrrrr",
    )


def _band(quality: Mapping[str, float]) -> str:
    return f"{display.number(round(quality['q025'], 3))} … {display.number(round(quality['q975'], 3))}"


def example_2_plausibility(results: Results) -> Display:
    """Show how (3.20) lies among the runs of each reading."""
    numbers = _numbers(results)
    rows = [
        [
            name,
            numbers[f"plausibility/example-2/{name}/mahalanobis"],
            numbers[f"plausibility/example-2/{name}/p_value"],
        ]
        for name in example_2.variants()
    ]
    independent = [name for name in example_2.variants() if name.endswith("independent")]
    missed = [numbers[f"example-2/{name}/a_off_by_a_tenth_share"] for name in independent]
    close = [numbers[f"example-2/{name}/a_as_close_share"] for name in independent]
    return display.group(
        display.table(
            rows,
            ["reading", "distance of (3.20)", "share of runs farther"],
            formats={"distance of (3.20)": ".2f", "share of runs farther": ".3f"},
            caption="Joint plausibility of the printed estimates (3.20) under each reading.",
        ),
        display.prose(
            "The estimates (3.20) lie among the runs with independent inputs and far outside those with "
            r"shared inputs: an error of 9 % in $\beta$ beside one of 0.5 % in $a$ hardly happens when one "
            "input is a multiple of the other. So the inputs were drawn independently, and the printed "
            r"$\hat a = 1.005$ was luck: depending on the reading, "
            f"{100 * min(missed):.0f} to {100 * max(missed):.0f} % of such experiments miss $a$ by more "
            f"than a tenth, and {100 * min(close):.1f} to {100 * max(close):.1f} % come as close "
            "as the printed one."
        ),
    )


def worked(results: Results) -> Display:
    """Show the worked nonlinearities identified from data."""
    monte_carlo = results["papers"]["bai"]["monte_carlo"]
    rows = []
    for name, case in WORKED.items():
        for parameter, quality in monte_carlo[f"worked/{name}"]["parameters"].items():
            rows.append(
                [
                    f"{name} {case.where}",
                    Markdown(display.symbol(parameter)),
                    quality["true"],
                    display.with_error(quality["mean"], quality["bias_std_error"]),
                    display.number(quality["std"], digits=2),
                ]
            )
    return display.table(
        rows,
        ["nonlinearity", "", "true", "mean of the runs", "std"],
        caption="The worked nonlinearities of section 3 and the even one of Remark 3.2, identified from "
        "20,000 samples an input.",
        align="lcrrr",
    )


def errata(results: Results) -> Display:
    """Show every printing error with its numbers."""
    return show_errata(results, "bai")


def confirmed(results: Results) -> Display:
    """Show the printed formulas that are right."""
    numbers = _numbers(results)
    rows = [
        [name.removeprefix("confirmed/"), value]
        for name, value in numbers.items()
        if name.startswith("confirmed/") and "root" not in name
    ]
    share = numbers["confirmed/(3.16) root intervals"]
    spread = numbers["erratum/nonzero-mean-input/centred_covariance_spread"]
    return display.group(
        display.table(
            rows,
            ["formula", "largest difference from quadrature"],
            formats={"largest difference from quadrature": ".1e"},
            caption="Printed moments that are right.",
        ),
        display.prose(
            f"The statement after (3.16), one root of the cubic below zero, one in $(0, b_1)$ and one above, "
            f"held in {100 * share:.0f} % of 36 cases. Centring does not repair (3.10): with $a_1 + a_2$ "
            f"kept, the covariance of $x$ and $u$ changed by {display.number(spread, digits=1)}."
        ),
    )
