"""The order of a linear model, when effects are looked for.

It is chosen without effects, where a higher one can stand in for what is missing.  And where no linear model
follows the output, as behind a sensor that shows the size alone, none of its orders means anything.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from sysid.diagnosis.decide.acceptance import is_better_held_out
from sysid.diagnosis.decide.allowance import GivenUpError
from sysid.diagnosis.decide.decision import NOISE_EFFECT, Decision
from sysid.diagnosis.decide.evidence import TIED, block_separation
from sysid.diagnosis.decide.modes import LAG, MODE
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.linear.order import HIGHEST_ORDER
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort, Structure, StructureFit

if TYPE_CHECKING:
    from sysid.diagnosis.ports import PortCurve

# Orders below the chosen one that are tried.
LOWER = 2
# A baseline that leaves half of the output's variance on held-out rows follows nothing much: the order of the
# plant is then looked for with effects, from this one down.
BLIND, HIGHEST = 0.7, 4
# In so few rows a higher order can take up all that an effect does, and seem to lack nothing.
SHORT = 400
# An information criterion that differs by no more says nothing.
EVEN = 2.0
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
Decide = Callable[[Structure], tuple[Decision, Curves]]


def decided_with_order(structure: LinearStructure, decide: Decide, alpha: float) -> Decided:
    """Return what is missing, and the order of the plant that it is missing in.

    The order is chosen by the validation error of the model without effects.  That says nothing where this
    model follows nothing: then the order is chosen with the effects that were found at a high one.  Where it
    leaves something that nothing explains, or the record is so short that a higher order can hide it, one
    near it is taken if with effects that no order does it comes closer, on held-out rows and by the
    information criterion.  What was found may itself ask for another order, and is then looked for again at
    that one.

    Parameters
    ----------
    structure : LinearStructure
        Of the order that was chosen.
    decide : callable
        What is missing at an order.
    alpha : float
    """
    orders = _Orders(structure, decide, alpha)
    blind = orders.is_lost(structure.baseline(orders.evidence.rows))
    found = orders.from_above() if blind else None
    found = orders.near(orders.decided(structure.order), blind) if found is None else found
    return orders.beside_effects(found)


class _Orders:
    """The search for an order of one record."""

    def __init__(self, structure: LinearStructure, decide: Decide, alpha: float) -> None:
        self.first, self._decide = structure, decide
        self._known: dict[tuple[int, bool], Decided] = {}
        record = structure.record
        self.evidence = Evidence(structure, record.estimation, record.validation, alpha)

    def at(self, order: int) -> LinearStructure:
        """Return the structure of an order."""
        first = self.first
        if order == first.order:
            return first
        return LinearStructure(first.record, order, initial_state=first.initial_state)

    def decided(self, order: int, spared: bool = False) -> Decided:
        """Return what is missing at an order, by a search that is given less work if it is to be spared."""
        if (order, spared) not in self._known:
            structure = self.first.of_order(order) if spared else self.at(order)
            self._known[order, spared] = (structure, *self._decide(structure))
        return self._known[order, spared]

    def is_lost(self, fit: StructureFit) -> bool:
        """Tell whether a model is lost on held-out rows."""
        y = self.first.record.y[self.evidence.held_out, 0]
        return self.evidence.held_out_error(fit, WHITE) > BLIND * float(np.nanstd(y))

    def from_above(self) -> Decided | None:
        """Return the decision at a high order if its effects make the model follow, or one below it.

        What a plant of lower order lacks is lacking in one of higher order, too: where that has no effects to
        offer no lower one is tried, unless nothing can be said of it.
        """
        for order in range(HIGHEST, 0, -1):
            found = self.decided(order)
            decision = found[1]
            if decision.verdict == "not-identifiable":
                continue
            if not set(decision.final.names) - LINEAR or self.is_lost(decision.final):
                return None
            below = self._best_order(decision.final.choices, range(order - 1, 0, -1), decision.final)
            lower = None if below is None else self._named(below)
            return lower if lower is not None and self._as_good(lower[1].final, decision.final) else found
        return None

    def near(self, first: Decided, blind: bool) -> Decided:
        """Return the decision at a near order if it names what the first does not, and comes closer."""
        structure, decision, _ = first
        assert isinstance(structure, LinearStructure)
        short = int(structure.record.learning.sum()) < SHORT
        short = short and decision.verdict in ("nothing-missing", "coloured-noise")
        if blind or not (short or decision.verdict == "unexplained"):
            return first
        for order in dict.fromkeys(
            (*self._asked_by_leader(structure.order, decision), *_near(structure.order))
        ):
            found = self._named(order, spared=True)
            if found is not None and is_better_held_out(self.evidence, found[1].final, decision.final):
                return found
        return first

    def _asked_by_leader(self, order: int, decision: Decision) -> Iterator[int]:
        """Yield the order at which the leading candidate fits best, where it is a higher one.

        An order too low by more than one is left over beside the true effect, and nothing explains it.
        """
        leader = decision.trials[0].fit if decision.trials else None
        if leader is not None and not LINEAR.intersection(leader.names):
            asked = self._best_order(leader.choices, range(order + 1, HIGHEST + 1), leader, -EVEN)
            if asked is not None:
                yield asked

    def beside_effects(self, found: Decided) -> Decided:
        """Return the decision at the order that the effects that were found ask for.

        An order that was chosen without them takes up a part of what they do, or too little of the plant
        behind them; what a higher order does as well, as a mode, is then found beside them as an effect.
        """
        structure, decision, _ = found
        final = decision.final
        choices = tuple(choice for choice in final.choices if choice.name not in LINEAR)
        if not isinstance(structure, LinearStructure) or not choices:
            return found
        highest = max(HIGHEST, min(structure.order + 2 * (MODE in final.names), HIGHEST_ORDER))
        orders = [n for n in range(1, highest + 1) if n != structure.order or choices != final.choices]
        lag = LAG in _matter_of_order(final.names)
        order = self._best_order(choices, orders, final, EVEN if lag or MODE in final.names else 0.0)
        if order is None and lag and structure.order < HIGHEST_ORDER:
            order = structure.order + 1  # beside a wrong order effects may be at values that lead nowhere
        if order is None or order == structure.order:
            return found
        other = self._named(order)
        return other if other is not None and self._holds(other[1].final, final) else found

    def _holds(self, fit: StructureFit, other: StructureFit) -> bool:
        """Tell whether a fit is as good as another by its criterion, and on held-out rows but for chance."""
        after, before = (self.evidence.residual(each)[self.evidence.held_out] for each in (fit, other))
        return self._as_good(fit, other) and block_separation(before, after) < TIED

    def _named(self, order: int, spared: bool = False) -> Decided | None:
        """Return what is missing at an order if that is known, and no matter of the order.

        A spared search that would have to stop before its end says nothing.
        """
        try:
            found = self.decided(order, spared)
        except GivenUpError:
            return None
        decision = found[1]
        named = decision.verdict == "missing-effect" and not _matter_of_order(decision.final.names)
        return found if named else None

    def _best_order(
        self, choices: Sequence[Choice], orders: Sequence[int], than: StructureFit, margin: float = EVEN
    ) -> int | None:
        """Return the order at which these effects fit best by the criterion, if no worse than a fit."""
        rows, found = self.evidence.rows, {}
        for order in orders:
            structure = self.at(order)
            fit = structure.fit(choices, rows, WHITE, structure.baseline(rows), effort=Effort.FINE)
            if fit.usable and self._as_good(fit, than, margin):
                found[order] = self.evidence.own_criterion(fit)
        return min(found, key=lambda order: found[order], default=None)

    def _as_good(self, fit: StructureFit, other: StructureFit, margin: float = EVEN) -> bool:
        """Tell whether a fit is as good as another by its criterion.

        A slow sensor is a pole of the plant that costs fewer parameters, its zero being known: where nobody
        gave the order, a plant of a higher one that explains as much does not pay for that knowledge.
        """
        criteria = [self.evidence.own_criterion(each) for each in (fit, other)]
        if LAG in _matter_of_order(other.names) and LAG not in fit.names:
            criteria[0] -= max(fit.n_parameters - other.n_parameters, 0) * np.log(self.evidence.rows.sum())
        return bool(criteria[0] < criteria[1] + margin)


def _matter_of_order(names: Sequence[str]) -> frozenset[str]:
    """Return which of the effects a model of higher order does as well.

    Behind a sensor that bends the output no order of the plant does what comes after it.

    Examples
    --------
    >>> sorted(_matter_of_order(("in_saturation", "out_lowpass")))
    ['out_lowpass']
    >>> sorted(_matter_of_order(("out_rectify", "out_lowpass")))
    []
    """
    bent = any(name.startswith("out_") and name not in LINEAR for name in names)
    linear = LINEAR.intersection(names)
    return frozenset(name for name in linear if not name.startswith("out_")) if bent else linear


def _near(order: int) -> Iterator[int]:
    """Return the next lower orders, and the next higher one.

    Examples
    --------
    >>> list(_near(4)), list(_near(1)), list(_near(HIGHEST_ORDER))
    ([3, 2, 5], [2], [5, 4])
    """
    yield from range(order - 1, max(order - 1 - LOWER, 0), -1)
    if order < HIGHEST_ORDER:
        yield order + 1
