"""The order of a linear model, when effects are looked for: a higher one can stand in for what is missing.

And where no linear model follows the output, as behind a sensor that shows the size alone, none of its orders
means anything.
"""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from sysid.diagnosis.decide.acceptance import is_better_held_out
from sysid.diagnosis.decide.decision import NOISE_EFFECT, Decision
from sysid.diagnosis.decide.evidence import TIED, block_separation
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.structures.structure import WHITE, Effort, Structure, StructureFit

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
    higher one, too, where the model without effects follows nothing.  What was found may itself ask for
    another order, and is then looked for again at that one.

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
    better = _order_beside(evidence, decision)
    if better is None and not (blind or short or decision.verdict == "unexplained"):
        return first
    for order in dict.fromkeys([*([] if better is None else [better]), *_others(structure.order, blind)]):
        if order != better and decision.verdict == "missing-effect":
            break
        other = LinearStructure(record, order, initial_state=structure.initial_state)
        found, curves = decide(other)
        named = found.verdict == "missing-effect" and not LINEAR.intersection(found.final.names)
        better_by = _is_likelier if order == better else is_better_held_out
        if named and better_by(evidence, found.final, decision.final):
            return other, found, curves
    return first


def _order_beside(evidence: Evidence, decision: Decision) -> int | None:
    """Return the order that the effects that were found ask for, if it is another than the chosen one.

    An order that was chosen without them takes up a part of what they do, or too little of the plant behind
    them; what a higher order does as well is then found beside them as an effect of its own.
    """
    structure, rows = evidence.structure, evidence.rows
    choices = tuple(choice for choice in decision.final.choices if choice.name not in LINEAR)
    if not isinstance(structure, LinearStructure) or not choices:
        return None
    chosen, best = None, decision.final
    for order in range(1, max(HIGHEST, structure.order) + 1):
        if order == structure.order and choices == decision.final.choices:
            continue
        other = LinearStructure(structure.record, order, initial_state=structure.initial_state)
        fit = other.fit(choices, rows, WHITE, other.baseline(rows), effort=Effort.COARSE)
        if fit.usable and _is_likelier(evidence, fit, best):
            chosen, best = order, fit
    return None if chosen == structure.order else chosen


def _is_likelier(evidence: Evidence, fit: StructureFit, other: StructureFit) -> bool:
    """Tell whether a fit is better by its criterion, and no farther from held-out rows than by chance."""
    after, before = (evidence.residual(each)[evidence.held_out] for each in (fit, other))
    likelier = evidence.own_criterion(fit) < evidence.own_criterion(other)
    return likelier and block_separation(before, after) < TIED


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
