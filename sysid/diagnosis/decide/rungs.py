"""The rungs of the ladder: fits with one, two, ... of the effects that were found."""

from collections.abc import Sequence

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.decide.decision import Decision
from sysid.diagnosis.structures.structure import WHITE, Effort, Structure, StructureFit


def rungs_to(
    structure: Structure, rows: Mask, fit: StructureFit, baseline: StructureFit, n_given: int
) -> list[StructureFit]:
    """Return fits with one, two, ... of the effects of a fit, the one that explains most first.

    The first ``n_given`` effects stay in front, in their order.
    """
    chosen, rest = list(fit.choices[:n_given]), list(fit.choices[n_given:])
    rungs: list[StructureFit] = []
    for count in range(1, n_given + 1):
        rungs.append(structure.fit(chosen[:count], rows, WHITE, baseline, effort=Effort.COARSE))
    while len(rest) > 1:
        start = rungs[-1] if rungs else baseline
        options = [
            structure.fit((*chosen, choice), rows, WHITE, start, effort=Effort.COARSE) for choice in rest
        ]
        best = int(np.argmin([option.cost for option in options]))
        chosen.append(rest.pop(best))
        rungs.append(options[best])
    return [*rungs, fit] if rest else rungs


def rungs_of(structure: Structure, decision: Decision, kept: Sequence[str]) -> list[StructureFit]:
    """Return the fits of a decision with one, two, ... of the effects that were kept."""
    if not decision.fits or not kept:
        return []
    if len(kept) == len(decision.fits):
        return list(decision.fits)
    choices = [choice for choice in decision.fits[-1].choices if choice.name in kept]
    fits, current = [], decision.baseline
    for count in range(1, len(choices) + 1):
        current = structure.fit(choices[:count], decision.baseline.rows, WHITE, current, effort=Effort.FINE)
        fits.append(current)
    return fits
