"""Tables and sentences of the chapter, made from the results; the notebook calls these."""

from collections.abc import Mapping
from typing import Any

from replications.errata import show_errata
from replications.giri import setting
from replications.giri.convergence import OUTPUT_UNITS, RADII, STEPS, TARGETS
from replications.giri.figures import (
    block_diagram,
    disturbance,
    excitation,
    figure_3a,
    figure_3b,
    precision,
    segment_map,
)
from replications.giri.noise_tables import (
    disturbance_table,
    numbers_of,
    precision_tables,
    speed,
    studies,
    symbol,
)
from sysid.reporting import display
from sysid.reporting.display import Display, Markdown

__all__ = [
    "block_diagram", "confirmed", "convergence", "disturbance", "disturbance_table", "errata", "excitation",
    "excitation_table", "figure_3a", "figure_3b", "identifiability", "precision", "precision_tables",
    "proposition_4_1", "segment_map", "settings", "speed", "studies", "theta_star",
]  # fmt: skip

Results = Mapping[str, Any]


def theta_star(results: Results) -> Display:
    """Show theta*: exact, and as printed."""
    numbers = numbers_of(results)
    names = [name for name in numbers if name.startswith("theta-star/") and "difference" not in name]
    printed = dict(zip(names, setting.PRINTED_THETA, strict=True))
    printed["theta-star/a1"], printed["theta-star/a2"] = printed["theta-star/a2"], printed["theta-star/a1"]
    rows = [
        [
            Markdown(symbol(name.removeprefix("theta-star/"))),
            display.number(numbers[name], digits=8),
            printed[name],
        ]
        for name in names
    ]
    difference = numbers["theta-star/difference_from_print"]
    return display.group(
        display.table(
            rows,
            ["", "exact", "printed"],
            caption=r"The vector $\theta^*$ of the example in the order of (3.8c).",
            align="crr",
        ),
        display.prose(
            "The print lists $a_2$ before $a_1$, cuts the decimals off instead of rounding, and keeps "
            r"$b = (1, -2)$, which does not satisfy the paper's normalisation (3.10). Listed in that way our "
            f"vector differs from the printed one by {display.number(difference)}."
        ),
    )


def convergence(results: Results) -> Display:
    """Show rate, what averaging makes of it, and the periods needed."""
    numbers = numbers_of(results)
    rows: list[list[str]] = [
        [
            "rate per period: eigenvalue of the period's map",
            display.number(numbers["rate_per_period"], digits=7),
        ],
        [
            "rate per period: fitted to a simulated run",
            display.number(numbers["rate_per_period/simulated"], digits=7),
        ],
        [
            "rate per period: promised by the averaged matrix",
            display.number(numbers["rate_from_averaged_matrix"], digits=7),
        ],
        *(
            [f"periods to a relative error of {target}", display.number(numbers[f"periods_to_{target}"])]
            for target in TARGETS
        ),
        ["samples to 1e-6 by recursive least squares", display.number(numbers["rls_samples_to_1e-6"])],
        [
            "rate per period of Kaczmarz's method",
            display.number(numbers["kaczmarz/rate_per_period"], digits=5),
        ],
    ]
    exact, averaged = numbers["time_constant"], numbers["time_constant/averaged"]
    return display.group(
        display.table(
            rows,
            ["", "value"],
            caption=r"Speed of the printed algorithm on the example ($z = 0$, zero start, $\rho^*$ large). "
            "Least squares: $P_0 = 10^6 I$, nothing forgotten.",
            align="lr",
        ),
        display.prose(
            f"The slowest direction shrinks by a factor e in {exact:.0f} periods. The averaged information "
            f"matrix says {averaged:.0f}: each step of (4.1) nearly removes the part of the error along its "
            "regressor, so the steps are far from small and their order matters."
        ),
    )


def settings(results: Results) -> Display:
    """Show the effect of step, projection radius and unit of the output."""
    numbers = numbers_of(results)
    steps = [[step, numbers[f"step/{step:g}/rate"], numbers[f"step/{step:g}/averaged"]] for step in STEPS]
    radii = [
        [radius, numbers[f"radius/{radius:g}/periods_to_1e-2"], numbers[f"radius/{radius:g}/last_error"]]
        for radius in RADII
    ]
    units = [
        [
            unit,
            numbers[f"output-unit/{unit:g}/rate"],
            numbers[f"output-unit/{unit:g}/periods_to_1e-2"],
            numbers[f"output-unit/{unit:g}/kaczmarz_rate"],
        ]
        for unit in OUTPUT_UNITS
    ]
    norm = display.number(numbers["theta_star_norm"])
    return display.group(
        display.table(
            steps,
            ["step", "rate per period", "by averaging"],
            formats={"rate per period": ".5f", "by averaging": ".5f"},
            caption="Step size $s$ in $s\\,\\Phi e/(1 + \\Phi^T\\Phi)$; the paper has 1.",
            align="rrr",
        ),
        display.table(
            radii,
            [r"radius $\rho^*$", "periods to 1e-2", "error after 1500 periods"],
            formats={"error after 1500 periods": ".1e"},
            caption=f"Projection radius; $\\|\\theta^*\\| = {norm}$. Projection is on a ball.",
            align="rrr",
        ),
        display.table(
            units,
            ["unit of the output", "rate per period", "periods to 1e-2", "rate of Kaczmarz"],
            formats={"rate per period": ".4f", "rate of Kaczmarz": ".4f"},
            caption="The same experiment with the output measured in a larger unit (relative errors in the "
            "parameters of that unit).",
            align="rrrr",
        ),
        display.prose(
            "A bound that holds changes nothing; one below the norm of the truth makes it unreachable. What "
            "matters is the scale of the regressor: the lagged outputs are ten times the input, and the "
            "algorithm spends its steps on them. Measuring the output in a unit ten times as large, which "
            "costs nothing, makes the same algorithm some twenty times as fast. In a unit a hundred times as "
            "large the 1 in the denominator of (4.1) dominates; Kaczmarz's method, which has none, goes on "
            "gaining."
        ),
    )


def proposition_4_1(results: Results) -> Display:
    """Show Proposition 4.1 by numbers, with excitation and without."""
    numbers = numbers_of(results)
    labels = {
        "largest_growth_of_error": "largest growth of the parameter error in a step",
        "sum_of_squared_increments": "sum of squared increments",
        "sum_of_squared_posterior_errors": "sum of squared posterior errors",
        "last_increment": "largest increment of the last period",
        "last_prediction_error": "largest prediction error of the last period",
        "last_relative_error": "relative parameter error at the end",
    }
    rows = [
        [
            label,
            display.number(numbers[f"proposition-4.1/excited/{name}"], digits=3),
            display.number(numbers[f"proposition-4.1/not-excited/{name}"], digits=3),
        ]
        for name, label in labels.items()
    ]
    bound = display.number(numbers["proposition-4.1/bound"])
    return display.table(
        rows,
        ["", "input (5.1)", "one level only"],
        caption=f"Proposition 4.1 on the noise-free example, 1500 periods from zero. Both sums are bounded "
        f"by $\\|\\theta^*\\|^2 = {bound}$. Without excitation all that the proposition promises holds, and "
        "the parameters are wrong.",
        align="lrr",
    )


def excitation_table(results: Results) -> Display:
    """Show rank and smallest singular value for both spacings."""
    numbers = numbers_of(results)
    names = {
        "example": "example, (5.1)",
        "example/even": "example, even spacing",
        "hidden-pole": f"pole at {numbers['excitation/lost_pole']:.4f}, (5.1)",
        "hidden-pole/even": f"pole at {numbers['excitation/lost_pole']:.4f}, even spacing",
        "zero-at-V1": "F(V1) = 0, (5.1)",
        "zero-at-V1/V1-moved": "the same map, V1 moved to −7, (5.1)",
    }
    rows = [
        [
            label,
            display.number(int(numbers[f"excitation/{name}/rank"])),
            display.number(_cut(numbers[f"excitation/{name}/smallest_singular_value"]), digits=3),
            display.number(numbers[f"excitation/{name}/rate"], digits=4),
        ]
        for name, label in names.items()
    ]
    return display.table(
        rows,
        ["plant and input", "rank (of 10)", "smallest singular value", "rate per period"],
        caption="Regressors of one period in the steady state.",
        align="lrrr",
    )


def _cut(value: float) -> float:
    """Return zero for what is zero up to rounding."""
    return 0.0 if abs(value) < 1e-12 else value


def identifiability(results: Results) -> Display:
    """Show what each rule of (3.18) makes of the example."""
    numbers = numbers_of(results)
    segments = setting.SEGMENTS.__dict__
    rows: list[list[object]] = [["true", *(segments[name] for name in ("D1", "D2", "L1", "L2"))]]
    for rule, label in (
        ("dead-zone", "(3.18a), dead zone"),
        ("preload", "(3.18b), preload"),
        ("symmetric", "(3.18c), symmetric"),
    ):
        values = [round(numbers[f"rule/{rule}/{name}"], 6) + 0.0 for name in ("D1", "D2", "L1", "L2")]
        rows.append([label, *values])
    slopes = ", ".join(
        f"${name[0]}_{name[1]} = {display.number(round(numbers[f'recovered/{name}'], 6) + 0.0)}$"
        for name in ("K1", "K2", "H1", "H2")
    )
    unit = ", ".join(
        f"${name[0]}_{name[1]} = {display.number(round(numbers[f'recovered/unit-norm/{name}'], 4) + 0.0)}$"
        for name in ("K1", "K2")
    )
    inside = display.number(numbers["identifiability/difference_inside"], digits=2)
    return display.group(
        display.table(
            rows,
            ["rule", "$D_1$", "$D_2$", "$L_1$", "$L_2$"],
            caption="The rules (3.18) applied to the example, which belongs to none of their classes.",
            align="lrrrr",
        ),
        display.prose(
            f"Recovered with $b_1 = 1$: {slopes}. Under the printed normalisation (3.10): {unit}. "
            "Four points of $F$ determine four numbers; the six unknowns leave a family "
            "$L_i = H_i + K_iD_i$ of two free parameters. Two members of it, drawn in figure 2, give outputs "
            f"that differ by {display.number(numbers['identifiability/difference_at_levels'])} for every "
            f"input at the levels, and by {inside} once a level lies inside a dead zone. So $\\hat D$ and "
            "$\\hat L$ of figure 3b cannot come from the described scheme: `recover` returns them for the "
            "three classes and says *not identifiable* otherwise."
        ),
    )


def errata(results: Results) -> Display:
    """Show every printing error with its numbers."""
    return show_errata(results, "giri")


def confirmed(results: Results) -> Display:
    """Show the printed formulas that are right."""
    numbers = numbers_of(results)
    rows = [
        [name.removeprefix("confirmed/"), value]
        for name, value in numbers.items()
        if name.startswith("confirmed/(")
    ]
    share = numbers["confirmed/Proposition 5.1, random plants"]
    return display.group(
        display.table(
            rows,
            ["formula", "largest difference"],
            formats={"largest difference": ".1e"},
            caption="Printed formulas that are right: the parameters of a map of the class against what the "
            "formula gives from its values at the levels.",
        ),
        display.prose(
            f"With $F(V_1) \\ne 0$ Proposition 5.1 held for {100 * share:.0f} % of 200 random plants of "
            "orders 1 to 4."
        ),
    )
