"""Whether an added mode is one: beside an effect, a path that does not ring stands for what is unknown."""

import numpy as np

from sysid.diagnosis.structures.structure import StructureFit

MODE = "extra_mode"
# A mode of more damping has no peak to speak of in its response.
LIGHTLY = 0.4


def rings(fit: StructureFit) -> bool:
    """Tell whether the added mode, or the model's own that it may have changed places with, rings.

    Parameters
    ----------
    fit : StructureFit
        With the effect ``extra_mode``.
    """
    damping = next((p.value for p in fit.parameters_of(MODE) if p.name == "damping"), 0.0)
    return damping <= LIGHTLY or least_damping(_denominator(fit)) <= LIGHTLY


def least_damping(denominator: list[float]) -> float:
    """Return the smallest damping ratio of the complex poles of 1 + a1 q^-1 + ...; 1 without any.

    Examples
    --------
    >>> round(least_damping([-2.0 * 0.9 * np.cos(0.3), 0.81]), 3)
    0.331
    >>> least_damping([-0.5])
    1.0
    """
    poles = np.roots([1.0, *denominator]).astype(complex)
    logarithms = np.log(poles[(poles.imag != 0.0) & (poles != 0.0)])
    return float(np.min(-logarithms.real / np.abs(logarithms), initial=1.0))


def _denominator(fit: StructureFit) -> list[float]:
    """Return a1, a2, ... of a difference equation; none of a physical model."""
    own = {p.name: p.value for p in fit.parameters if not p.owner}
    names = [f"a{i}" for i in range(1, len(own) + 1)]
    return [own[name] for name in names if name in own] if "b1" in own else []
