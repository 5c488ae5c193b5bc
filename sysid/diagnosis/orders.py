"""The order of a linear model, when effects are looked for: a higher one can stand in for what is missing.

And where no linear model follows the output, as behind a sensor that shows the size alone, none of its orders
means anything.
"""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from sysid.diagnosis.decide.acceptance import is_better_held_out
from sysid.diagnosis.decide.decision import NOISE_EFFECT, Decision
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.structures.structure import WHITE, Structure

if TYPE_CHECKING:
    from sysid.diagnosis.ports import PortCurve

# Orders below the chosen one that are tried.
LOWER = 2
# A baseline that leaves this share of the output's deviation on held-out rows follows nothing; the order of
# the plant behind what is missing is then looked for up to this one.
BLIND, HIGHEST = 0.9, 4
# In so few rows a higher order can take up all that an effect does, and seem to lack nothing.
SHORT = 400
# What a higher order does as well, or a constant and a slope.
LINEAR = frozenset(
    {
        "extra_mode",
        "feedthrough",
        "in_delay",
        "out_delay",
        "out_lowpass",
        "out_offset",
        "out_drift",
        NOISE_EFFECT,
    }
)


# A structure, what was decided on it, and the curves that the decision needed.
Curves: TypeAlias = "tuple[PortCurve, ...] | None"
Decided = tuple[Structure, Decision, Curves]


def with_effects(
    first: Decided, decide: Callable[[Structure], tuple[Decision, Curves]], alpha: float
) -> Decided:
    """Return the best of the order that was chosen without effects and of others with effects.

    The order is chosen by the validation error of the model without effects.  Where that leaves something
    that nothing explains, or the record is so short that a higher order can hide it, a lower one is taken if
    with effects that no order does it comes closer, on held-out rows and by the information criterion; a
    higher one, too, where the model without effects follows nothing.

    Parameters
    ----------
    first : Decided
        At the order that was chosen.
    decide : callable
        The same decision for another order.
    alpha : float
    """
    structure, decision, _ = first
    record = structure.record
    if not isinstance(structure, LinearStructure):
        return first
    evidence = Evidence(structure, record.estimation, record.validation, alpha)
    blind = decision.verdict != "missing-effect" and _follows_nothing(evidence, decision)
    short = int(record.learning.sum()) < SHORT and decision.verdict in ("nothing-missing", "coloured-noise")
    if not (blind or short or decision.verdict == "unexplained"):
        return first
    for order in _others(structure.order, blind):
        other = structure.of_order(order)
        found, curves = decide(other)
        named = found.verdict == "missing-effect" and not LINEAR.intersection(found.final.names)
        if named and not found.cut_short and is_better_held_out(evidence, found.final, decision.final):
            return other, found, curves
    return first


def _follows_nothing(evidence: Evidence, decision: Decision) -> bool:
    """Tell whether the model without effects is lost on held-out rows."""
    y = evidence.structure.record.y[evidence.held_out, 0]
    return evidence.held_out_error(decision.baseline, WHITE) > BLIND * float(np.nanstd(y))


def _others(order: int, blind: bool) -> Iterator[int]:
    """Return the orders to be tried: the next lower ones, and higher ones before where all are alike.

    Examples
    --------
    >>> list(_others(4, False)), list(_others(1, False)), list(_others(2, True))
    ([3, 2], [], [3, 4, 1])
    """
    if blind:
        yield from range(order + 1, HIGHEST + 1)
    yield from range(order - 1, max(order - 1 - LOWER, 0), -1)
