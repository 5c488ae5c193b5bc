"""From the outcomes of all cases to shares with intervals, tables, curves and calibration."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from sysid.statistics import wilson_interval

Outcome = Mapping[str, Any]
NOISE = "coloured_noise"

TARGETS = {
    "normal": {
        "first": (0.95, None),
        "first_three": (0.99, None),
        "exact": (0.92, None),
        "false_alarm": (None, 0.02),
        "reduction": (0.97, None),
        "both": (0.80, None),
        "unexplained": (0.80, None),
        "wrongly_unexplained": (None, 0.05),
    },
    "hard": {"first": (0.88, None)},
}
"""Tier -> figure -> (at least, at most)."""

MEANINGS = {
    "first": "true effect ranked first",
    "first_three": "true effect among the first three",
    "exact": "accepted list exactly right",
    "false_alarm": "physical effect accepted though nothing is missing",
    "reduction": "at least 90 % of the true structure's error reduction",
    "both": "both of two effects accepted",
    "unexplained": "effect outside the list called unexplained",
    "wrongly_unexplained": "effect of the list called unexplained",
}


def first(outcome: Outcome) -> bool:
    """Tell whether the true effect leads, among equals where noise is coloured by nature."""
    return _ranked(outcome)[:1] == outcome["truth"][:1]


def first_three(outcome: Outcome) -> bool:
    """Tell whether the true effect is among the first three."""
    return outcome["truth"][0] in _ranked(outcome)[:3]


def exact(outcome: Outcome) -> bool:
    """Tell whether exactly what is there was accepted."""
    return sorted(_accepted(outcome)) == sorted(outcome["truth"])


def false_alarm(outcome: Outcome) -> bool:
    """Tell whether a physical effect was accepted."""
    return any(name != NOISE for name in outcome["accepted"])


def reduced(outcome: Outcome) -> bool:
    """Tell whether nine tenths of what the true structure gains were gained."""
    return bool(outcome["reduction"] >= 0.9)


def both(outcome: Outcome) -> bool:
    """Tell whether all true effects were accepted."""
    return set(outcome["truth"]) <= set(outcome["accepted"])


def unexplained(outcome: Outcome) -> bool:
    """Tell whether the verdict is that no candidate explains what is missing."""
    return bool(outcome["verdict"] == "unexplained")


SCORES: dict[str, tuple[tuple[str, ...], Callable[[Outcome], bool]]] = {
    "first": (("single",), first),
    "first_three": (("single",), first_three),
    "exact": (("single", "null"), exact),
    "false_alarm": (("null",), false_alarm),
    "reduction": (("single", "two"), reduced),
    "both": (("two",), both),
    "unexplained": (("outside",), unexplained),
    "wrongly_unexplained": (("single", "two", "null"), unexplained),
}


def summarise(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return all figures of a finished bench, tier by tier.

    A case whose diagnosis failed counts as wrong in every share, and as a false alarm in none.
    """
    tiers = sorted({outcome["tier"] for outcome in outcomes})
    return {tier: _tier([outcome for outcome in outcomes if outcome["tier"] == tier], tier) for tier in tiers}


def _tier(outcomes: Sequence[Outcome], tier: str) -> dict[str, Any]:
    answered = [outcome for outcome in outcomes if outcome["error"] is None]
    singles = [o for o in outcomes if o["kind"] == "single"]
    seconds = np.array([outcome["seconds"] for outcome in outcomes])
    return {
        "cases": len(outcomes),
        "kinds": dict(Counter(outcome["kind"] for outcome in outcomes)),
        "failed": [{"id": o["id"], "error": o["error"]} for o in outcomes if o["error"] is not None],
        "scores": {name: _score(outcomes, name, tier) for name in SCORES},
        "families": {
            family: _share(first, [o for o in singles if o["family"] == family])
            for family in sorted({o["family"] for o in singles})
        },
        "effects": {
            name: _share(first, [o for o in singles if o["truth"] == [name]])
            for name in sorted({o["truth"][0] for o in singles})
        },
        "confusion": confusion(singles),
        "power": {
            "share": _curve(singles, "share", np.geomspace(0.01, 0.3, 6)),
            "snr": _curve(singles, "snr", np.linspace(10.0, 40.0, 7)),
        },
        "p_values": calibration([o["p_value"] for o in answered if o["kind"] == "null"]),
        "intervals": coverage([z["z"] for o in answered for z in o["intervals"]]),
        "plant_intervals": {
            family: coverage(
                [z["z"] for o in answered if o["family"] == family for z in o.get("plant_intervals", [])]
            )
            for family in sorted({o["family"] for o in answered})
        },
        "seconds": {
            "median": float(np.median(seconds)),
            "q95": float(np.quantile(seconds, 0.95)),
            "max": float(seconds.max()),
        },
    }


def _score(outcomes: Sequence[Outcome], name: str, tier: str) -> dict[str, Any]:
    kinds, judge = SCORES[name]
    asked = [outcome for outcome in outcomes if outcome["kind"] in kinds]
    if name == "reduction":  # where there is something to be gained
        asked = [outcome for outcome in asked if outcome.get("reduction", 0.0) is not None]
    share = _share(judge, asked)
    least, most = TARGETS[tier].get(name, (None, None))
    value = share["share"]
    met = None
    if value is not None and (least is not None or most is not None):
        met = (least is None or value >= least) and (most is None or value <= most)
    return {"meaning": MEANINGS[name], **share, "least": least, "most": most, "met": met}


def _share(judge: Callable[[Outcome], bool], outcomes: Iterable[Outcome]) -> dict[str, Any]:
    verdicts = [outcome["error"] is None and judge(outcome) for outcome in outcomes]
    hits, n = sum(verdicts), len(verdicts)
    low, high = wilson_interval(hits, n)
    return {"hits": hits, "n": n, "share": hits / n if n else None, "low": low, "high": high}


def confusion(singles: Sequence[Outcome]) -> dict[str, dict[str, int]]:
    """Return how often each effect was taken for which: the one accepted first, else the verdict."""
    table: dict[str, Counter[str]] = {}
    for outcome in singles:
        if outcome["error"] is not None:
            said = "failed"
        else:
            said = outcome["accepted"][0] if outcome["accepted"] else outcome["verdict"]
        table.setdefault(outcome["truth"][0], Counter())[said] += 1
    return {name: dict(counts) for name, counts in sorted(table.items())}


def _curve(singles: Sequence[Outcome], what: str, edges: Any) -> list[dict[str, Any]]:
    """Return the share of accepted true effects in each bin of the effect's size or of the noise."""
    points = []
    for low, high in pairwise(edges):
        share = _share(both, [o for o in singles if low <= o[what] < high])
        points.append({"from": float(low), "to": float(high), **share})
    return points


def calibration(p_values: Sequence[float | None]) -> dict[str, Any]:
    """Compare the p-values on nulls with the uniform distribution.

    Returns
    -------
    dict
        ``kolmogorov`` is the largest distance of the distribution functions, ``p`` its p-value;
        ``below`` maps a level to the share of nulls below it.
    """
    from scipy.stats import kstest

    known = np.sort(np.array([p for p in p_values if p is not None]))
    if known.size < 2:
        return {"n": int(known.size), "sorted": known.tolist(), "kolmogorov": None, "p": None, "below": {}}
    test = kstest(known, "uniform")
    return {
        "n": int(known.size),
        "sorted": known.tolist(),
        "kolmogorov": float(test.statistic),
        "p": float(test.pvalue),
        "below": {str(level): float(np.mean(known <= level)) for level in (0.01, 0.05, 0.1, 0.5)},
    }


def coverage(errors: Sequence[float]) -> dict[str, Any]:
    """Return how often the 95 % intervals hold the true value, from errors in standard errors."""
    z = np.array([error for error in errors if math.isfinite(error)])
    inside = int(np.count_nonzero(np.abs(z) <= 1.959964))
    low, high = wilson_interval(inside, int(z.size))
    share = inside / z.size if z.size else None
    return {"hits": inside, "n": int(z.size), "share": share, "low": low, "high": high}


def _ranked(outcome: Outcome) -> list[str]:
    """Return the ranking; where the noise is coloured by nature, without the noise's colour."""
    if outcome["tier"] == "hard" and NOISE not in outcome["truth"]:
        return [name for name in outcome["ranked"] if name != NOISE]
    return list(outcome["ranked"])


def _accepted(outcome: Outcome) -> list[str]:
    if outcome["tier"] == "hard" and NOISE not in outcome["truth"]:
        return [name for name in outcome["accepted"] if name != NOISE]
    return list(outcome["accepted"])
