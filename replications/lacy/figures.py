"""Figures of the chapter on the paper of Lacy, Erwin and Bernstein, drawn from the results."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from replications import diagrams
from replications.lacy import setting
from sysid.reporting import display
from sysid.reporting.display import Display
from sysid.reporting.style import COLOURS, GREY

Results = Mapping[str, Any]

LOOKS: Mapping[str, tuple[str, str, str]] = {
    "true": ("actual", "black", "-"),
    "paper": ("paper's method", COLOURS[0], "--"),
    "ml": ("maximum likelihood", COLOURS[1], "-."),
    "naive": ("z taken for y", GREY, ":"),
}


def block_diagram() -> Display:
    """Draw figure 1: the structure that is identified."""
    drawing = diagrams.block_diagram(
        blocks=[
            (2.7, r"$\frac{b_0+b_1q^{-1}+b_2q^{-2}}{1+a_1q^{-1}+a_2q^{-2}}$", 13),
            (7.5, r"$\mathcal{N}(\cdot)$", 10),
        ],
        sums=[5.4],
        arrows=[
            ((0.3, 0.8), (1.3, 0.8)),
            ((4.1, 0.8), (5.15, 0.8)),
            ((5.65, 0.8), (6.85, 0.8)),
            ((8.15, 0.8), (9.6, 0.8)),
            ((5.4, 1.8), (5.4, 1.1)),
        ],
        signals=[(0.7, 1.0, "u(k)"), (4.6, 1.0, "y(k)"), (9.1, 1.0, "z(k)"), (5.7, 1.6, "w(k)")],
    )
    return display.figure(
        drawing,
        "Figure 1 regenerated: the structure as it is implemented, with the noise of (30).",
        r"Only $u$ and $z$ are measured; $\mathcal N$ is known and need not be invertible.",
    )


def nonlinearity(results: Results, case: str) -> Display:
    """Draw figure 2, 4, 6 or 8: the nonlinearity with data and estimates."""
    example = setting.EXAMPLES[case]
    shown = _shown(results, case)
    drawing, panel = display.subplots(height=2.9)
    curve_y, curve_z = (np.array(shown[name], dtype=float) for name in ("curve_y", "curve_z"))
    jumps = np.abs(np.diff(curve_z)) > 0.5
    panel.plot(curve_y, np.where(np.append(jumps, False), np.nan, curve_z), color=GREY, linewidth=1.0)
    panel.plot(shown["y"], shown["z"], "*", color=COLOURS[0], markersize=7, label=r"data $(y + w,\; z)$")
    panel.plot(shown["y_hat"], shown["z_hat"], "o", color=COLOURS[1], markersize=7, markerfacecolor="none",
               label=r"estimates $(\hat y^*,\; \hat z)$")  # fmt: skip
    panel.set_xlabel("y")
    panel.set_ylabel("z")
    panel.legend(loc="best", fontsize=8)
    recovered = round(100 * float(shown["recovered"]))
    reading = {
        "sine": f"Every estimate lies on one of the branches; {recovered} % lie on the right one.",
        "dead-zone": f"{recovered} % of the values are known from the slopes; the fit places the others in "
        "the dead zone.",
        "quantisation": "Every estimate lies in the cell of its datum; where in the cell, the fit decides.",
        "sign": "Only signs are known. The sizes of the estimates are free up to a common factor.",
    }[case]
    return display.figure(
        drawing,
        f"Figure {example.figures[0]} regenerated: {example.title.lower()}, {example.samples} samples, "
        "one record.",
        reading,
    )


def response(results: Results, case: str) -> Display:
    """Draw figure 3, 5, 7 or 9: the frequency responses."""
    example = setting.EXAMPLES[case]
    shown = _shown(results, case)
    drawing, (upper, lower) = display.subplots(2, 1, height=4.0, sharex=True)
    for name, (label, colour, line) in LOOKS.items():
        width = 1.6 if name == "true" else 1.2
        upper.plot(
            shown["omega"], shown["magnitude_db"][name], line, color=colour, linewidth=width, label=label
        )
        lower.plot(shown["omega"], shown["phase_deg"][name], line, color=colour, linewidth=width)
    for panel in (upper, lower):
        panel.axvline(2.0, color=GREY, linewidth=0.6)
        panel.set_xlim(0, np.pi)
    upper.set_ylim(-40, 30)
    upper.set_ylabel("magnitude [dB]")
    lower.set_ylabel("phase [degrees]")
    lower.set_xlabel("frequency [rad a sample]")
    upper.legend(fontsize=8, loc="lower left")
    matched = " Gains are matched: signs do not tell them." if case == "sign" else ""
    return display.figure(
        drawing,
        f"Figure {example.figures[1]} regenerated: frequency response of the actual and the identified "
        "systems.",
        "Errors are scored left of the line at 2 rad; beyond it the zero of G at −0.966 makes them "
        f"meaningless.{matched}",
    )


def spread(results: Results) -> Display:
    """Draw the medians of the error in dB for every example and method."""
    numbers = results["papers"]["lacy"]["numbers"]
    drawing, axes = display.subplots(1, 2, height=2.9)
    methods = {
        "naive": "z taken for y",
        "paper": "paper",
        "ml": "maximum likelihood",
        "bound": "at the bound",
    }
    colours = {"naive": GREY, "paper": COLOURS[0], "ml": COLOURS[1], "bound": "black"}
    for panel, name, label in zip(
        axes, ("rms_db", "rms_deg"), ("error of magnitude [dB]", "error of phase [degrees]"), strict=True
    ):
        for row, method in enumerate(methods):
            place = np.arange(len(setting.EXAMPLES)) + 0.18 * (row - 1.5)
            values = [numbers[f"{case}/{method}/{name}_median"] for case in setting.EXAMPLES]
            panel.bar(place, values, 0.16, color=colours[method], label=methods[method])
        panel.set_yscale("log")
        panel.set_xticks(
            range(len(setting.EXAMPLES)), [one.title for one in setting.EXAMPLES.values()], fontsize=8
        )
        panel.set_ylabel(label)
        low, high = panel.get_ylim()
        panel.set_ylim(low, 3 * high)
    axes[0].legend(fontsize=7, ncols=2, loc="upper center")
    return display.figure(
        drawing,
        "Medians of the root-mean-square errors of the frequency response on 0.01 … 2 rad.",
        "The paper's method removes most of the error of ignoring the nonlinearity; maximum likelihood "
        "comes close to the bound.",
    )


def consistency(results: Results) -> Display:
    """Draw RMSE against N behind the dead zone."""
    paper = results["papers"]["lacy"]
    numbers, sizes = paper["numbers"], paper["tables"]["sizes"]
    drawing, axes = display.subplots(1, 2, height=3.0)
    for panel, name, symbol in zip(axes, ("a2", "b1"), ("a_2", "b_1"), strict=True):
        for method, label, colour in (
            ("paper", "paper's method", COLOURS[0]),
            ("ml", "maximum likelihood", COLOURS[1]),
        ):
            rmse = [numbers[f"rmse/{method}/{name}/{n}"] for n in sizes]
            panel.loglog(sizes, rmse, "o-", color=colour, markersize=4, label=label)
        bound = [numbers[f"crlb/{name}/{n}"] for n in sizes]
        panel.loglog(sizes, bound, "k--", linewidth=1.0, label="Cramér-Rao bound")
        bias = abs(numbers[f"bias/paper/{name}"])
        panel.plot(sizes[-1], bias, "_", color=COLOURS[0], markersize=14, label="bias of the paper's method")
        panel.set_xticks(sizes, [str(n) for n in sizes])
        panel.minorticks_off()
        panel.set_xlabel("samples")
        panel.set_title(f"error of ${symbol}$")
    axes[0].set_ylabel("RMSE")
    axes[1].legend(fontsize=8)
    return display.figure(
        drawing,
        "Behind the dead zone: root-mean-square error against the number of samples, S/N = 10.",
        "Maximum likelihood follows the bound. The preimage method minimises an equation error whose "
        "regressors carry the noise: in $a_2$ its error stops falling at the bias (bar).",
    )


def _shown(results: Results, case: str) -> Mapping[str, Any]:
    shown: Mapping[str, Any] = results["papers"]["lacy"]["tables"]["figures"][case]
    return shown
