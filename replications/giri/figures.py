"""Figures of the chapter, drawn from the results."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from replications import diagrams
from replications.giri import setting
from replications.giri.disturbance import AMPLITUDES, BEYOND, KINDS
from replications.giri.excitation import lost_pole, plant_with_pole
from replications.giri.identifiability import OTHER
from replications.giri.precision import NOISES, SIZES
from sysid.excitation import impulse_levels
from sysid.linear.simulation import simulate_polynomial
from sysid.recursive import interpolation_polynomial
from sysid.reporting import display
from sysid.reporting.display import Display
from sysid.reporting.style import COLOURS, GREY

Results = Mapping[str, Any]


def block_diagram() -> Display:
    """Draw figure 1: the structure that is identified."""
    drawing = diagrams.block_diagram(
        blocks=[
            (2.6, r"$F(\cdot)$", 10),
            (5.6, r"$\frac{B(q^{-1})}{A(q^{-1})}$", 13),
        ],
        sums=[8.2],
        arrows=[
            ((0.6, 0.8), (2.05, 0.8)),
            ((3.15, 0.8), (4.95, 0.8)),
            ((6.25, 0.8), (7.95, 0.8)),
            ((8.45, 0.8), (9.6, 0.8)),
            ((8.2, 1.8), (8.2, 1.1)),
        ],
        signals=[(0.9, 1.0, "v(t)"), (4.0, 1.0, "u(t)"), (9.1, 1.0, "y(t)"), (8.45, 1.6, "z(t)")],
    )
    return display.figure(
        drawing,
        "Figure 1 regenerated: the structure as it is implemented.",
        "Only $v$ and $y$ are measured. The disturbance $z$ acts on the output, so the regression sees "
        r"$\eta = A(q^{-1})z$.",
    )


def segment_map() -> Display:
    """Draw figure 2 from the implemented map, with the polynomial that stands in for it."""
    drawing, axes = display.subplots(height=3.0)
    v = np.linspace(-7, 7, 1401)
    levels = np.array(setting.LEVELS)
    axes.axhline(0, color=GREY, linewidth=0.5)
    axes.axvline(0, color=GREY, linewidth=0.5)
    polynomial = interpolation_polynomial(v, levels, setting.gains())
    axes.plot(v, polynomial, "-", color=COLOURS[1], linewidth=0.9, label="polynomial $P$")
    for segments, look, name in (
        (OTHER, {"color": COLOURS[2], "linestyle": (0, (1.2, 1.4))}, "same $K$, $H$; other $D$, $L$"),
        (setting.SEGMENTS, {"color": COLOURS[0], "linewidth": 1.8}, "$F$ of the example"),
    ):
        x = segments(v)
        axes.plot(v, np.where(np.abs(np.diff(x, append=x[-1])) > 0.3, np.nan, x), label=name, **look)
    axes.plot([0.0, *levels], [0.0, *setting.SEGMENTS(levels)], "o", color="black", markersize=4,
              label="levels")  # fmt: skip
    axes.set(xlabel="input $v$", ylabel="$F(v)$", ylim=(-13, 9))
    axes.legend(loc="lower right", fontsize=8)
    return display.figure(
        drawing,
        "Figure 2 regenerated from the implemented map, with the polynomial of (3.3).",
        "At the four levels and at zero the polynomial, the map of the example and a map with other dead "
        "zones and preloads all agree: an input that takes only these values cannot tell them apart.",
    )


def figure_3a(results: Results) -> Display:
    """Draw figure 3a: the estimates of a and b against time."""
    data = results["papers"]["giri"]["tables"]["figure-3"]
    true = setting.theta_star()
    drawing, panels = display.subplots(1, 2, height=2.7)
    for index, name in enumerate(("a_1", "a_2")):
        panels[0].plot(
            data["samples"], data["theta"][index], label=f"$\\hat {name}$", **display.series(index)
        )
        panels[0].axhline(true[index], color=GREY, linewidth=0.6)
    names = [f"\\mu_{{{i + 1}{j + 1}}}" for j in range(4) for i in range(setting.ORDER)]
    for index, name in enumerate(names):
        # The seven looks repeat; the eighth curve is a thin one.
        look = display.series(index) if index < len(COLOURS) else {"color": GREY, "linewidth": 0.8}
        values = data["theta"][setting.ORDER + index]
        panels[1].plot(data["samples"], values, label=f"$\\hat {name}$", **look)
        panels[1].axhline(true[setting.ORDER + index], color=GREY, linewidth=0.6)
    for panel in panels:
        panel.set_xlabel("samples")
    panels[0].legend(fontsize=8)
    panels[1].legend(fontsize=7, ncols=4, loc="lower right")
    panels[1].set_ylim(-6, 2.2)
    return display.figure(
        drawing,
        r"Figure 3a regenerated: $\hat\theta$ at the end of each period by (4.1), $z = 0$, from zero; grey: "
        r"$\theta^*$.",
        "The estimates converge to the exact values, over thousands of samples.",
    )


def figure_3b(results: Results) -> Display:
    """Draw figure 3b: the estimates of the nonlinearity against time."""
    data = results["papers"]["giri"]["tables"]["figure-3"]
    drawing, panels = display.subplots(1, 2, height=2.7)
    true = {**setting.TRUE}
    for index, (name, values) in enumerate(data["segments"].items()):
        label = f"$\\hat {name[0]}_{name[1]}$"
        panels[0].plot(data["samples"], values, label=label, **display.series(index))
        panels[0].axhline(true[name], color=GREY, linewidth=0.6)
    panels[0].set_ylim(-4, 6)
    panels[0].set_xlabel("samples")
    panels[0].legend(fontsize=8, ncols=2)
    for index, (name, values) in enumerate(data["relative_error"].items()):
        panels[1].semilogy(data["samples"], values, label=name, **display.series(index))
    panels[1].set_xlabel("samples")
    panels[1].set_ylabel(r"$\|\hat\theta - \theta^*\| / \|\theta^*\|$")
    panels[1].legend(fontsize=8)
    return display.figure(
        drawing,
        "Figure 3b regenerated as far as it can be: slopes and offsets (left), recovered with $b_1 = 1$; and "
        "the parameter error beside that of recursive least squares (right).",
        "Slopes $K$ and offsets $H$ converge. Dead zones $D$ and preloads $L$ are not shown: no data at "
        "these levels can give them. Least squares needs one period.",
    )


def excitation(results: Results) -> Display:
    """Draw the input, even and uneven, and the response of a plant that the even one does not excite."""
    a = plant_with_pole(lost_pole())
    drawing, panels = display.subplots(2, 2, height=3.4, sharex=True, sharey="row")
    for column, (even, title) in enumerate(((False, "as printed (5.1)"), (True, "evenly spaced"))):
        u = impulse_levels(setting.LEVELS, setting.ORDER, 40, even=even)
        y = simulate_polynomial([0.0, *setting.B], [1.0, *a], setting.SEGMENTS(u))
        shown = slice(-2 * setting.PERIOD, None)
        time = np.arange(2 * setting.PERIOD)
        panels[0, column].stem(time, u[shown], basefmt=" ", markerfmt="o")
        panels[0, column].set_title(title, fontsize=9)
        panels[1, column].plot(time, y[shown], "o-", color=COLOURS[0], markersize=3, linewidth=0.8)
        panels[1, column].axhline(0, color=GREY, linewidth=0.5)
        panels[1, column].set_xlabel("samples of two periods")
    panels[0, 0].set_ylabel("input $v$")
    panels[1, 0].set_ylabel("output $y$")
    pole = results["papers"]["giri"]["numbers"]["excitation/lost_pole"]
    return display.figure(
        drawing,
        f"Steady state of a plant with the poles {pole:.4f} and 0.5 under the paper's nonlinearity.",
        "With even spacing the slow pole has rung down to nothing when the input rests: the four impulses "
        "cancel it, and the free response that should show it holds the fast pole alone.",
    )


def disturbance(results: Results) -> Display:
    """Draw the parameter error against the size of the disturbance."""
    numbers = results["papers"]["giri"]["numbers"]
    drawing, panels = display.subplots(1, 2, height=3.0)
    sizes = np.array([float(name) for name in (*AMPLITUDES, BEYOND)])
    for index, kind in enumerate(KINDS):
        errors = [numbers[f"disturbance/{kind}/error/{name}"] for name in (*AMPLITUDES, BEYOND)]
        eta = [numbers[f"disturbance/{kind}/eta/{name}"] for name in (*AMPLITUDES, BEYOND)]
        panels[0].loglog(eta, errors, label=kind, **display.series(index, marker=True))
        panels[1].semilogx(sizes, np.divide(errors, eta), **display.series(index, marker=True))
    panels[0].set(xlabel=r"mean $|\eta|$", ylabel=r"mean $\|\hat\theta - \theta^*\|$")
    panels[1].set(xlabel="amplitude of $z$", ylabel="ratio", ylim=(0, 2.5))
    panels[0].legend(fontsize=8)
    return display.figure(
        drawing,
        "Proposition 5.2: parameter error against the disturbance, and their ratio.",
        "The error is proportional to the disturbance; the factor depends on its spectrum more than on its "
        "distribution.",
    )


def precision(results: Results) -> Display:
    """Draw RMSE against the length of the experiment for every method."""
    paper = results["papers"]["giri"]
    methods = ("gradient", "least-squares", "structured")
    drawing, panels = display.subplots(2, 2, height=4.6, sharex=True)
    for row, noise in enumerate(NOISES):
        for column, parameter in enumerate(("a1", "K1")):
            panel = panels[row, column]
            for index, method in enumerate(methods):
                rmse = [paper["numbers"][f"rmse/{noise}/{method}/{parameter}/{n}"] for n in SIZES]
                look = display.series(index, marker=True)
                panel.loglog(SIZES, rmse, label=method.replace("-", " "), **look)
            bound = [
                paper["monte_carlo"][f"{noise}/structured/periods={n}"]["parameters"][parameter]["crlb_std"]
                for n in SIZES
            ]
            panel.loglog(SIZES, bound, "-", color=GREY, linewidth=0.8, label="Cramér-Rao bound")
            kind = "white equation error" if noise == "equation" else "white output disturbance"
            panel.set_title(f"${parameter[0]}_{parameter[1]}$, {kind}", fontsize=9)
            panel.set_xticks(SIZES, [str(n) for n in SIZES])
            panel.minorticks_off()
    for panel in panels[1]:
        panel.set_xlabel("periods")
    for panel in panels[:, 0]:
        panel.set_ylabel("RMSE")
    panels[0, 1].legend(fontsize=7.5, loc="center left")
    return display.figure(
        drawing,
        "Root-mean-square error against the length of the experiment, noise of standard deviation 0.1.",
        "The printed algorithm stops gaining once its start is forgotten. Least squares gains with every "
        "period; with the structure $\\mu_{ij} = b_id_j$ it lies on the bound. Under a white disturbance of "
        "the output every least-squares estimate keeps a bias.",
    )
