"""Figures of the chapter on Bai's paper, drawn from the results."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from replications import diagrams
from replications.bai import example_2, setting
from replications.bai.example_1 import one_parameter_map
from sysid.reporting import display
from sysid.reporting.display import Display
from sysid.reporting.style import COLOURS, GREY

Results = Mapping[str, Any]

SHORT_TITLES = {
    **{case: one_parameter_map(case).title for case in setting.CASES},
    "hysteresis-relay": "Hysteresis relay",
    "hysteresis": "Hysteresis",
    "hysteresis-relay-schmitt": "Schmitt trigger",
    "hysteresis-play": "Play operator",
}


def block_diagram() -> Display:
    """Draw figure 1: the structure that is identified."""
    drawing = diagrams.block_diagram(
        blocks=[
            (2.6, r"$\mathcal{N}(\cdot,\,a)$", 10),
            (5.6, r"$\frac{\beta_1 q^{-1}+\beta_2q^{-2}}{1-\alpha_1q^{-1}-\alpha_2q^{-2}}$", 13),
        ],
        sums=[8.2],
        arrows=[
            ((0.6, 0.8), (1.85, 0.8)),
            ((3.35, 0.8), (4.45, 0.8)),
            ((6.75, 0.8), (7.95, 0.8)),
            ((8.45, 0.8), (9.6, 0.8)),
            ((8.2, 1.8), (8.2, 1.1)),
        ],
        signals=[(0.9, 1.0, "u(k)"), (3.9, 1.0, "x(k)"), (9.1, 1.0, "y(k)"), (8.45, 1.6, "w(k)")],
    )
    return display.figure(
        drawing,
        "Figure 1 regenerated: the structure as it is implemented; $A(q)w = v$.",
        "Only $u$ and $y$ are measured. The noise $v$ is an equation error, so it passes through $1/A$.",
    )


def maps() -> Display:
    """Draw figure 2 from the implemented maps: the output against the input along a sweep."""
    drawing, axes = display.subplots(2, 4, height=3.6, sharex=True, sharey=True)
    sweep = np.concatenate([np.linspace(0, 3, 300), np.linspace(3, -3, 600), np.linspace(-3, 3, 600)])
    for panel, case in zip(axes.flat, setting.CASES, strict=True):
        nonlinearity = one_parameter_map(case)
        x = nonlinearity(sweep, setting.THRESHOLD)
        jump = np.abs(np.diff(x)) > 0.3
        drawn = np.where(np.append(jump, False), np.nan, x)
        panel.axhline(0, color=GREY, linewidth=0.5)
        panel.axvline(0, color=GREY, linewidth=0.5)
        panel.plot(sweep[300:], drawn[300:], color=COLOURS[0])
        panel.set_title(SHORT_TITLES[case], fontsize=9)
    for panel in axes[-1]:
        panel.set_xlabel("input u")
    for panel in axes[:, 0]:
        panel.set_ylabel("output x")
    return display.figure(
        drawing,
        "Figure 2 regenerated from the implemented maps, $a = 1$: output along a slow sweep up and down.",
        "The last two are physical readings of the hysteretic maps. Along a slow sweep the Schmitt trigger "
        "and the printed relay agree; the play operator holds its output after a reversal, where the printed "
        "rule jumps.",
    )


def cost_curves(results: Results) -> Display:
    """Draw figure 3: J(a) of one experiment for every map."""
    curves = results["papers"]["bai"]["tables"]["figure-3"]
    drawing, axes = display.subplots(2, 4, height=3.9, sharex=True)
    for panel, case in zip(axes.flat, setting.CASES, strict=True):
        curve = curves[case]
        step = case in setting.RELAYS
        panel.plot(
            curve["a"], curve["j"], color=COLOURS[0], linewidth=1.0, drawstyle="steps-mid" if step else None
        )
        panel.plot(curve["minima"], curve["minima_j"], "v", color=COLOURS[1], markersize=3.5)
        panel.plot(curve["found"], curve["found_j"], "o", color="black", markersize=5, markerfacecolor="none")
        panel.set_yscale("log")
        panel.set_title(SHORT_TITLES[case], fontsize=9)
    for panel in axes[-1]:
        panel.set_xlabel("a")
    for panel in axes[:, 0]:
        panel.set_ylabel("J(a)")
    counts = ", ".join(f"{SHORT_TITLES[case].lower()} {curves[case]['n_minima']}" for case in setting.CASES)
    return display.figure(
        drawing,
        "Figure 3 regenerated: $J(a)$ of one experiment of 100 samples. Circle: minimum found; triangles: "
        "local minima.",
        f"The neighbourhood of the minimum is easily seen, as the paper says, but $J$ is not unimodal. "
        f"Local minima here: {counts}.",
    )


def consistency(results: Results) -> Display:
    """Draw RMSE against N."""
    paper = results["papers"]["bai"]
    numbers, sizes = paper["numbers"], paper["tables"]["sizes"]
    drawing, axes = display.subplots(1, 2, height=3.3, sharey=True)
    for panel, parameter, name in zip(axes, ("a", "alpha1"), ("a", r"\alpha_1"), strict=True):
        for index, case in enumerate(setting.CASES):
            rmse = [numbers[f"rmse/{case}/{parameter}/{n}"] for n in sizes]
            look = display.series(index, marker=True)
            if index >= len(COLOURS):
                look |= {"color": GREY, "marker": "*"}
            panel.loglog(sizes, rmse, label=SHORT_TITLES[case], **look, linewidth=1.0)
        panel.set_xlabel("samples N")
        panel.set_title(f"error of ${name}$")
    reference = np.array(sizes, dtype=float)
    for panel, line, power in (
        (axes[0], 1.5 / reference, "-1"),
        (axes[1], 0.45 / np.sqrt(reference), "-1/2"),
    ):
        panel.loglog(sizes, line, "-", color=GREY, linewidth=0.8)
        panel.annotate(f"$N^{{{power}}}$", (sizes[-1], line[-1]), xytext=(2, -3), textcoords="offset points",
                       color=GREY, annotation_clip=False)  # fmt: skip
        panel.set_xticks(sizes, [str(n) for n in sizes], fontsize=7.5)
        panel.minorticks_off()
    axes[0].set_ylabel("RMSE")
    axes[0].legend(fontsize=7, loc="lower left")
    return display.figure(
        drawing,
        "Root-mean-square error against the number of samples.",
        "Every parameter is consistent. The threshold of a relay converges like $1/N$, all others like "
        r"$1/\sqrt N$.",
    )


def example_2_bands(results: Results) -> Display:
    """Draw the 95 % bands of a for every reading of Example 2."""
    monte_carlo = results["papers"]["bai"]["monte_carlo"]
    names = [*example_2.variants(), "separable"]
    drawing, panel = display.subplots(height=3.6)
    for row, name in enumerate(names):
        found = monte_carlo[f"example-2/{name}"]["parameters"]["a"]
        median = results["papers"]["bai"]["numbers"].get(f"example-2/{name}/median/a", found["mean"])
        colour = COLOURS[1] if "shared" in name else COLOURS[2] if name == "separable" else COLOURS[0]
        panel.plot([found["q025"], found["q975"]], [row, row], "-", color=colour, linewidth=3)
        panel.plot(median, row, "|", color="black", markersize=9)
    panel.axvline(example_2.PRINTED[0], color=GREY, linewidth=0.9)
    panel.text(example_2.PRINTED[0], len(names) - 0.35, "printed 1.005", ha="center", fontsize=8, color=GREY)
    panel.set_yticks(range(len(names)), names, fontsize=8)
    panel.set_ylim(-0.6, len(names) + 0.1)
    panel.set_xlabel("estimate of a: central 95 % of the runs, median marked")
    return display.figure(
        drawing,
        "Example 2: spread of $a$ under every reading the paper leaves open, and by separable least squares "
        "on the same data.",
        "Independent inputs leave the ratio of two noisy moments nearly useless; least squares on the same "
        "samples is so narrow that its band is a tick.",
    )
