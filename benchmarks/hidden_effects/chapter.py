"""Tables and figures of the report's chapter on the bench; the notebook calls these."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sysid.reporting import display
from sysid.reporting.display import Display, Verdict

Results = Mapping[str, Any]


def _tables(results: Results) -> Mapping[str, Any]:
    tables: Mapping[str, Any] = results["papers"]["hidden-effects"]["tables"]
    return tables


def _tiers(results: Results) -> Mapping[str, Any]:
    tiers: Mapping[str, Any] = _tables(results)["summary"]
    return tiers


def _percent(share: float | None) -> str | None:
    return None if share is None else f"{100 * share:.1f} %"


def _interval(score: Mapping[str, Any]) -> str:
    return f"{100 * score['low']:.1f} to {100 * score['high']:.1f} %"


def scores(results: Results) -> Display:
    """Show every share with its interval and target."""
    parts = []
    for tier, figures in _tiers(results).items():
        rows = []
        for score in figures["scores"].values():
            if not score["n"]:
                continue
            wanted = (
                f"≥ {100 * score['least']:.0f} %"
                if score["least"] is not None
                else f"≤ {100 * score['most']:.0f} %"
                if score["most"] is not None
                else None
            )
            met = score["met"]
            verdict = (
                None if met is None else Verdict("met" if met else "missed", "passed" if met else "failed")
            )
            rows.append(
                [score["meaning"], _percent(score["share"]), _interval(score), score["n"], wanted, verdict]
            )
        failed = len(figures["failed"])
        parts.append(
            display.table(
                rows,
                ["", "share", "95 % interval", "cases", "wanted", ""],
                caption=f"The tier *{tier}*: {figures['cases']} cases, {failed} of which gave no answer.",
                align="lrrrrl",
            )
        )
    return display.group(*parts)


def times(results: Results) -> Display:
    """Show how long an answer takes."""
    rows = [
        [tier, *(figures["seconds"][key] for key in ("median", "q95", "max"))]
        for tier, figures in _tiers(results).items()
    ]
    heads = ["tier", "median [s]", "95 % quantile [s]", "longest [s]"]
    return display.table(
        rows,
        heads,
        formats=dict.fromkeys(heads[1:], ".1f"),
        caption="Wall-clock time of an answer, one process.",
    )


def effects(results: Results) -> Display:
    """Show for each effect how often it leads the ranking, and what it is taken for."""
    parts = []
    for tier, figures in _tiers(results).items():
        rows = []
        for name, share in figures["effects"].items():
            counts = figures["confusion"][name]
            wrong = [f"{said} {n}" for said, n in sorted(counts.items(), key=_rarer) if said != name]
            rows.append(
                [name, share["n"], _percent(share["share"]), _interval(share), ", ".join(wrong) or None]
            )
        parts.append(
            display.table(
                rows,
                ["effect", "cases", "ranked first", "95 % interval", "accepted first instead"],
                caption=f"Effect by effect, tier *{tier}*. The last column counts the cases in which "
                "something else was accepted first, or the verdict where nothing was.",
                align="lrrrl",
            )
        )
    return display.group(*parts)


def _rarer(entry: tuple[str, int]) -> tuple[int, str]:
    return -entry[1], entry[0]


def families(results: Results) -> Display:
    """Show the shares by family of plants."""
    rows = [
        [tier, family, share["n"], _percent(share["share"]), _interval(share)]
        for tier, figures in _tiers(results).items()
        for family, share in figures["families"].items()
    ]
    return display.table(
        rows,
        ["tier", "family", "cases", "ranked first", "95 % interval"],
        caption="True effect ranked first, by family of plants.",
        align="llrrr",
    )


def power(results: Results) -> Display:
    """Draw the share of accepted true effects against effect size and noise."""
    drawing, axes = display.subplots(1, 2, height=3.0, sharey=True)
    for index, (tier, figures) in enumerate(_tiers(results).items()):
        for panel, what in zip(axes, ("share", "snr"), strict=True):
            points = [point for point in figures["power"][what] if point["n"]]
            middle = [
                float(np.sqrt(p["from"] * p["to"])) if what == "share" else 0.5 * (p["from"] + p["to"])
                for p in points
            ]
            value = np.array([p["share"] for p in points])
            bars = [value - [p["low"] for p in points], [p["high"] for p in points] - value]
            look = display.series(index, marker=True)
            panel.errorbar(middle, value, np.maximum(bars, 0.0), capsize=2, label=tier, **look)
    axes[0].set_xscale("log")
    ticks = [0.01, 0.02, 0.05, 0.1, 0.2]
    axes[0].set_xticks(ticks, [f"{100 * tick:.0f} %" for tick in ticks])
    axes[0].minorticks_off()
    axes[0].set_xlabel("share of the variance beyond linear models")
    axes[1].set_xlabel("signal-to-noise ratio [dB]")
    axes[0].set_ylabel("true effect accepted")
    axes[0].set_ylim(-0.02, 1.02)
    axes[1].legend()
    return display.figure(
        drawing,
        "Detection power: share of the single effects that are accepted, with 95 % intervals.",
        "Left against the size of the effect, right against the noise.",
    )


def errors(results: Results) -> Display:
    """Draw the final error against the baseline's, both over that of the true structure."""
    drawing, axes = display.subplots(1, 1, height=3.4)
    rows = _tables(results)["errors"]
    for index, tier in enumerate(_tiers(results)):
        chosen = [row for row in rows if row["tier"] == tier and row["test_true"] > 0.0]
        x = [row["test_baseline"] / row["test_true"] for row in chosen]
        y = [row["test_final"] / row["test_true"] for row in chosen]
        look = {"color": display.series(index)["color"]}
        axes.loglog(x, y, "o", markersize=3.0, alpha=0.6, label=tier, **look)
    low, high = 0.5, max([2.0, *axes.get_xlim()])
    axes.plot([low, high], [low, high], color="0.6", linewidth=0.7)
    axes.axhline(1.0, color="0.6", linewidth=0.7)
    axes.set_xlabel("error of the baseline / error of the true structure")
    axes.set_ylabel("final error / error of the true structure")
    axes.legend()
    return display.figure(
        drawing,
        "Free-run errors on the test rows against the noise-free output, over the error of the true "
        "structure fitted to the same rows.",
        "On the diagonal nothing was gained, on the horizontal line all that can be had.",
    )


def p_values(results: Results) -> Display:
    """Draw the distribution of the family-wise p-value where nothing is missing."""
    drawing, axes = display.subplots(1, 1, height=3.0, width=3.6)
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=0.7)
    sentences = []
    for index, (tier, figures) in enumerate(_tiers(results).items()):
        found = figures["p_values"]
        if found["n"] < 2:
            continue
        p = np.array(found["sorted"])
        share = np.arange(1, p.size + 1) / p.size
        axes.step(p, share, where="post", label=tier, **display.series(index))
        sentences.append(
            f"{tier}: largest distance from uniform {found['kolmogorov']:.2f} (p = {found['p']:.2g}, "
            f"{found['n']} records), {100 * found['below']['0.01']:.1f} % below 0.01."
        )
    axes.set_xlabel("family-wise p-value")
    axes.set_ylabel("share of the records")
    if sentences:
        axes.legend()
    return display.figure(
        drawing,
        "Smallest p-value of a physical effect on records with nothing missing; right of the diagonal is "
        "cautious.",
        " ".join(sentences),
        width=0.6,
    )


def intervals(results: Results) -> Display:
    """Show how often the 95 % intervals hold the true parameter."""
    rows = []
    for tier, figures in _tiers(results).items():
        parts = {"effects": figures["intervals"], **figures["plant_intervals"]}
        rows += [
            [tier, part, _percent(found["share"]), _interval(found), found["n"]]
            for part, found in parts.items()
            if found["n"]
        ]
    return display.table(
        rows,
        ["tier", "parameters of", "true value inside", "95 % interval of that share", "parameters"],
        caption="Coverage of the 95 % intervals of parameters: of a single effect, and of the plants, family "
        "by family, where their structure was found.",
        align="llrrr",
    )


def peers(results: Results) -> Display:
    """Show what other tools reach on the same cases."""
    found = _tables(results)["peers"]
    if not found:
        return display.prose(
            "Other tools were not run on these cases; `tox -e bench-effects-peers` runs them into the same "
            "folder."
        )
    rows = [
        [
            tool,
            total["cases"],
            total["failed"],
            total["ratio_median"],
            total["ratio_q90"],
            _percent(total["within_double"]),
            total["seconds_median"],
            total["told"],
            total["names"],
        ]
        for tool, total in found.items()
    ]
    heads = ["tool", "cases", "failed", "median", "90 %", "within double", "s", "is told", "answers with"]
    return display.table(
        rows,
        heads,
        formats={"median": ".2f", "90 %": ".2f", "s": ".1f"},
        caption="Free-run error on the test rows over that of the true structure: median and 90 % quantile, "
        "share of the cases within twice the true structure's error; seconds a case.",
        align="lrrrrrrll",
    )
