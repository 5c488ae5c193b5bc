"""Finer laws of effects that were found, where what was found does not explain all."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

from sysid.diagnosis.decide.acceptance import is_better_held_out
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.decide.revision import freed
from sysid.diagnosis.effects.base import Form
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort, StructureFit


def refined(evidence: Evidence, fits: Sequence[StructureFit], n_given: int) -> StructureFit | None:
    """Return the smallest model in which a finer law explains more than all effects did without it.

    A law that is only roughly right makes further effects look real that mend what it does wrong: so before
    these are believed, the ones before them get the chance to be more exact.

    Parameters
    ----------
    evidence : Evidence
    fits : sequence of StructureFit
        With one, two, ... effects.
    n_given : int
        How many of these are there whatever the evidence.

    Returns
    -------
    StructureFit or None
        None where no finer law is better both by its criterion and on held-out rows.
    """
    for fit in fits[n_given:]:
        found = [
            evidence.structure.fit(choices, evidence.rows, WHITE, fit, effort=Effort.FINE)
            for choices in _finer(fit.choices)
        ]
        better = [other for other in found if other.usable and is_better_held_out(evidence, other, fits[-1])]
        if better:
            return min(better, key=evidence.own_criterion)
    return None


def with_sides(evidence: Evidence, fit: StructureFit, n_given: int) -> StructureFit | None:
    """Return the effects with sides of their own where all rows that may be learnt from ask for them.

    Rows of a search that hardly reach one of the sides say that one number does for both.

    Parameters
    ----------
    evidence : Evidence
    fit : StructureFit
    n_given : int
        How many of the effects are there whatever the evidence.

    Returns
    -------
    StructureFit or None
        On the rows of the search; None where no effect asks for another form.
    """
    structure, rows = evidence.structure, evidence.structure.record.learning
    whole = structure.fit(fit.choices, rows, WHITE, fit, effort=Effort.REFIT)
    found = freed(replace(evidence, rows=rows), whole, n_given) if whole.usable else whole
    if found.choices == fit.choices:
        return None
    other = structure.fit(found.choices, evidence.rows, WHITE, found, effort=Effort.REFIT)
    return other if other.usable else None


def _finer_forms(choice: Choice) -> list[Form]:
    """Return finer forms of an effect, but for another place among the others, which is tried by itself."""
    return [form for form in choice.effect.refinements if form != choice.form and not form.behind]


def _finer(choices: Sequence[Choice]) -> list[tuple[Choice, ...]]:
    """Return the effects with one or more of them in a finer form, where that makes a difference."""
    options = [
        (choice, *(Choice(choice.effect, form) for form in _finer_forms(choice))) for choice in choices
    ]
    inner = any(choice.effect.port in ("force", "gain") for choice in choices)
    return [
        chosen
        for chosen in product(*options)
        if chosen != tuple(choices) and (inner or not any(choice.form.inside for choice in chosen))
    ]
