"""Which two effects promise to explain most together, by the slopes of one beside the fit of the other."""

from collections.abc import Sequence

import numpy as np

from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.effects.base import Effect, Floats
from sysid.diagnosis.structures.projection import orthonormal, without
from sysid.diagnosis.structures.structure import StructureFit


def most_promising(
    evidence: Evidence, fits: Sequence[StructureFit], candidates: Sequence[Effect], count: int
) -> list[tuple[StructureFit, Effect]]:
    """Return fits of single effects, each with another one that promises to explain most beside it.

    Of two effects that together explain everything each may explain little alone, so that neither leads nor
    runs up; but beside the fit of the one the other's slope points at what is left.

    Parameters
    ----------
    evidence : Evidence
    fits : sequence of StructureFit
        With the given effects and one more.
    candidates : sequence of Effect
    count : int
        Of pairs.

    Returns
    -------
    list of (StructureFit, Effect)
        The most promising first; of two that hold the same effects, the better one.
    """
    found = [
        (promise, fit, effect)
        for fit in fits
        for effect, promise in _promises(evidence, fit, [e for e in candidates if e.name not in fit.names])
    ]
    pairs: dict[frozenset[str], tuple[StructureFit, Effect]] = {}
    for _, fit, effect in sorted(found, key=lambda item: item[0]):
        pairs.setdefault(frozenset((*fit.names, effect.name)), (fit, effect))
    return list(pairs.values())[:count]


def _promises(evidence: Evidence, fit: StructureFit, effects: Sequence[Effect]) -> list[tuple[Effect, float]]:
    """Return the information criterion that each effect reaches beside a fit as far as its slopes tell."""
    structure, rows = evidence.structure, evidence.rows
    Q, n = orthonormal(_known(structure.tangent(fit)[rows])), int(rows.sum())
    residual = without(evidence.residual(fit)[rows], Q)

    def criterion(block: Floats) -> float:
        basis = orthonormal(_known(block[rows]), Q)
        left = float(np.sum(without(residual, basis) ** 2))
        return float(n * np.log(max(left / n, 1e-300)) + (fit.n_parameters + basis.shape[1]) * np.log(n))

    return [
        (effect, min(map(criterion, structure.directions(fit, effect)), default=np.inf)) for effect in effects
    ]


def _known(columns: Floats) -> Floats:
    """Return directions, those along which the run diverges as nothing: they say nothing."""
    return np.where(np.isfinite(columns).all(axis=0), columns, 0.0)
