"""Figures of Chapter 4, drawn from the results."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from replications import diagrams
from replications.pepona import setting
from sysid.reporting import display
from sysid.reporting.display import Display
from sysid.reporting.style import COLOURS, GREY

Results = Mapping[str, Any]
RMSE_TICKS = (0.002, 0.005, 0.01, 0.02, 0.05)
PRINTED_VAF = {"4.2": 98.11, "4.3": 98.32, "4.4": 97.85}


def _tables(results: Results) -> Mapping[str, Any]:
    tables: Mapping[str, Any] = results["papers"]["pepona"]["tables"]["chapter-4"]
    return tables


def _numbers(results: Results) -> Mapping[str, float]:
    numbers: Mapping[str, float] = results["papers"]["pepona"]["numbers"]
    return numbers


def block_diagram() -> Display:
    """Draw the structure (4.10)."""
    drawing = diagrams.block_diagram(
        blocks=[
            (1.7, r"$D(q)$", 10),
            (3.9, r"$\mathcal{N}(\cdot)$", 10),
            (6.0, r"$G(q)$", 10),
            (8.4, r"$\frac{1}{A(q)}$", 12),
        ],
        sums=[7.2],
        arrows=[
            ((0.2, 0.8), (1.1, 0.8)),
            ((2.3, 0.8), (3.2, 0.8)),
            ((4.6, 0.8), (5.4, 0.8)),
            ((6.6, 0.8), (6.97, 0.8)),
            ((7.43, 0.8), (7.85, 0.8)),
            ((8.95, 0.8), (9.8, 0.8)),
            ((7.2, 1.8), (7.2, 1.1)),
        ],
        signals=[
            (0.5, 1.0, "u, y"),
            (2.75, 1.0, "z_k"),
            (5.0, 1.0, "w_k"),
            (8.0, 1.55, "B(q)u_k + e_k"),
            (9.5, 1.0, "y_k"),
        ],
    )
    return display.figure(
        drawing,
        "The structure (4.10): a static map between the linear parts; $D$ weighs lags of the input, or of "
        "the output, which closes a loop.",
    )


def map_of(results: Results, case: str, number: str) -> Display:
    """Draw figure 4.1 or 4.4: map, estimate with its band, and where the data lie."""
    shown = _tables(results)["shown"][case]
    drawing, panel = display.subplots(height=3.2)
    panel.plot(shown["samples_z"], shown["samples_w"], ".", color=GREY, markersize=2.5, alpha=0.6,
               label="map and noise in the data")  # fmt: skip
    panel.fill_between(shown["z"], shown["low"], shown["high"], color=COLOURS[1], alpha=0.25, linewidth=0,
                       label="95 % band of the spline")  # fmt: skip
    panel.plot(shown["z"], shown["true"], "k-", linewidth=1.6, label="true map")
    panel.plot(shown["z"], shown["fitted"], "--", color=COLOURS[1], label="spline")
    _knots(panel, shown)
    panel.set_xlabel("z")
    panel.set_ylabel("w")
    panel.set_ylim(*_limits(shown))
    panel.legend(loc="upper left", fontsize=8)
    reading = {
        "4.2": "The spline follows the map to a fifth of the noise; at the steep flank twelve knots are few.",
        "4.4": "The bend at z = 2 is rounded. Large z are rare: equal knots leave the right end to few "
        "samples, and the band opens there.",
    }[case]
    return display.figure(
        drawing,
        f"Figure {number} regenerated: the map of Example {case} and its cubic spline, {shown['n_knots']} "
        "knots (ticks at the bottom), one record.",
        reading,
    )


def _knots(panel: Any, shown: Mapping[str, Any]) -> None:
    panel.plot(shown["knots"], np.full(len(shown["knots"]), 0.015), "|", color="black", markersize=8,
               transform=panel.get_xaxis_transform(), label="knots")  # fmt: skip


def _limits(shown: Mapping[str, Any]) -> tuple[float, float]:
    values = np.concatenate([shown["true"], shown["fitted"], shown["samples_w"]])
    low, high = float(values.min()), float(values.max())
    return low - 0.08 * (high - low), high + 0.12 * (high - low)


def initialisation(results: Results) -> Display:
    """Draw figure 4.2: the samples at initialisation."""
    shown = _tables(results)["shown"]["4.3"]
    drawing, panel = display.subplots(height=2.9)
    panel.plot(shown["initial_samples_z"], shown["initial_samples_v"], ".", color=GREY, markersize=2.5,
               alpha=0.6, label=r"samples $(\hat z_k, v_k)$")  # fmt: skip
    panel.plot(shown["initial_z"], shown["initial_true"], "k-", linewidth=1.6, label="true map")
    panel.plot(shown["initial_z"], shown["initial_map"], "--", color=COLOURS[1], label="first spline")
    panel.set_xlabel("z")
    panel.set_ylabel("w, v")
    panel.legend(loc="upper left", fontsize=8)
    return display.figure(
        drawing,
        "Figure 4.2 regenerated: samples at initialisation in Example 4.3, steps 4 and 5 of 4.3.1.",
        "The first spline is not the map yet: it takes in what the neglected linear parts do.",
    )


def stages(results: Results) -> Display:
    """Draw figure 4.3: before and after the last update of the map."""
    shown = _tables(results)["shown"]["4.3"]
    drawing, axes = display.subplots(1, 2, height=2.9, sharey=True)
    for panel, curve, label in zip(
        axes, ("initial_on_grid", "fitted"), ("first spline", "final spline"), strict=True
    ):
        panel.plot(shown["samples_z"], shown["samples_w"], ".", color=GREY, markersize=2.5, alpha=0.6)
        panel.plot(shown["z"], shown["true"], "k-", linewidth=1.6, label="true map")
        panel.plot(shown["z"], shown[curve], "--", color=COLOURS[1], label=label)
        panel.set_xlabel("z")
        panel.legend(loc="upper left", fontsize=8)
    axes[0].set_ylabel("w")
    axes[0].set_title("d, g, a final; map as initialised")
    axes[1].set_title("map updated by (4.27)")
    return display.figure(
        drawing,
        "Figure 4.3 regenerated: Example 4.3 once (4.30) is solved, left with the first spline, right with "
        "the spline of (4.27).",
        "With the nonlinear parameters right the samples fall on the map; the last linear step puts the "
        "spline there.",
    )


def vaf(results: Results) -> Display:
    """Draw the distributions of both VAF with the printed value."""
    tables = _tables(results)["vaf"]
    drawing, axes = display.subplots(1, 3, height=2.7)
    for panel, case in zip(axes, setting.EXAMPLES, strict=True):
        kinds = (("vaf_one_step", "one-step", "-"), ("vaf_free_run", "free run", (0, (4, 1.5))))
        columns = {name: np.array([x for x in tables[case][name] if x is not None]) for name, _, _ in kinds}
        both = np.concatenate(list(columns.values()))
        low, high = np.quantile(both, [0.06 if case == "4.4" else 0.0, 1.0])
        for (name, label, line), colour in zip(kinds, (COLOURS[0], COLOURS[1]), strict=True):
            if case == "4.2" and name == "vaf_free_run":
                continue
            shown = "one-step = free run" if case == "4.2" else label
            values = np.sort(columns[name])
            share = np.arange(1, values.size + 1) / values.size
            panel.plot(values, share, linestyle=line, color=colour, label=shown)
        printed = PRINTED_VAF[case]
        panel.axvline(printed, color="black", linewidth=1.0, linestyle=(0, (1, 1.2)), label="printed")
        panel.set_xlim(low - 0.05 * (high - low), max(high, printed) + 0.05 * (high - low))
        panel.set_ylim(0, 1.42)
        panel.set_yticks([0, 0.5, 1])
        panel.set_xlabel("VAF [%]")
        panel.set_title(f"Example {case}")
        panel.legend(fontsize=7, loc="upper left")
    axes[0].set_ylabel("share of runs below")
    return display.figure(
        drawing,
        "Which VAF is printed: distribution over the runs of the validation VAF of one-step predictions and "
        "of free runs, beside the printed value.",
        "98.32 % of Example 4.3 is a one-step VAF, 97.85 % of Example 4.4 a free run; 98.11 % of Example 4.2 "
        "is more than the noise admits but for rare records. (In 4.4 the lowest values lie outside the "
        "panel.)",
    )


def consistency(results: Results) -> Display:
    """Draw RMSE against N for the Hammerstein systems of Lemma 4.1."""
    numbers, sizes = _numbers(results), _tables(results)["sizes"]
    drawing, axes = display.subplots(1, 2, height=2.9)
    for panel, n_g in zip(axes, (0, 1), strict=True):
        for place, (name, symbol) in enumerate((("a1", "$a_1$"), ("g1", "$g_1$"), ("map", "map, rms"))):
            if f"hammerstein/n_g={n_g}/slope/{name}" not in numbers:
                continue
            rmse = [numbers[f"hammerstein/n_g={n_g}/rmse/{name}/{n}"] for n in sizes]
            panel.loglog(sizes, rmse, **display.series(place, marker=True), label=symbol)
        guide = numbers[f"hammerstein/n_g={n_g}/rmse/map/{sizes[0]}"] * 1.9
        panel.loglog(sizes, guide * np.sqrt(sizes[0] / np.array(sizes)), color=GREY, linewidth=0.8,
                     linestyle="-", label="$N^{-1/2}$")  # fmt: skip
        panel.set_xticks(sizes, [str(n) for n in sizes], fontsize=8)
        panel.tick_params(axis="x", which="minor", labelbottom=False)
        panel.set_yticks(RMSE_TICKS, [f"{tick:g}" for tick in RMSE_TICKS])
        panel.tick_params(axis="y", which="minor", labelleft=False)
        panel.set_xlabel("N [samples]")
        panel.set_title(f"$n_g = {n_g}$")
        panel.legend(fontsize=8, loc="lower left")
    axes[0].set_ylabel("RMSE")
    return display.figure(
        drawing,
        "Consistency with $D(q) = 1$: error against the number of samples; for $n_g = 1$ the condition of "
        "Lemma 4.1 cannot hold.",
        "Both fall like $N^{-1/2}$: the lemma's condition is not needed.",
    )
