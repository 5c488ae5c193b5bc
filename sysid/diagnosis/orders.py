"""The order of a linear model, when effects are looked for: a higher one can stand in for what is missing."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, TypeAlias

from sysid.diagnosis.decide.acceptance import is_better_held_out
from sysid.diagnosis.decide.decision import NOISE_EFFECT, Decision
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.structures.structure import Structure

if TYPE_CHECKING:
    from sysid.diagnosis.ports import PortCurve

# Orders below the chosen one that are tried.
LOWER = 2
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
    """Return the best of the order that was chosen without effects and of lower ones with effects.

    The order is chosen by the validation error of the model without effects.  Where that leaves something
    that nothing explains, or the record is so short that a higher order can hide it, a lower one is taken if
    with effects that no order does it comes closer, on held-out rows and by the information criterion.

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
    short = int(record.learning.sum()) < SHORT and decision.verdict in ("nothing-missing", "coloured-noise")
    if not (short or decision.verdict == "unexplained"):
        return first
    evidence = Evidence(structure, record.estimation, record.validation, alpha)
    for lower in _lower(structure):
        found, curves = decide(lower)
        named = found.verdict == "missing-effect" and not LINEAR.intersection(found.final.names)
        if named and is_better_held_out(evidence, found.final, decision.final):
            return lower, found, curves
    return first


def _lower(structure: LinearStructure) -> Iterator[LinearStructure]:
    for order in range(structure.order - 1, max(structure.order - 1 - LOWER, 0), -1):
        yield LinearStructure(structure.record, order, initial_state=structure.initial_state)
