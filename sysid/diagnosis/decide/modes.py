"""Whether an added mode is one: beside an effect, other paths stand for what is unknown."""

import numpy as np

from sysid.diagnosis.structures.structure import Complexes, StructureFit

MODE, LAG = "extra_mode", "out_lowpass"
# A mode of more damping has no peak to speak of in its response.
LIGHTLY = 0.4
# Logarithms of poles that differ by this share of their size are at one place.
SAME_PLACE = 0.1


def rings(fit: StructureFit) -> bool:
    """Tell whether the added mode, or the model's own that it may have changed places with, rings.

    Parameters
    ----------
    fit : StructureFit
        With the effect ``extra_mode``.
    """
    damping = next((p.value for p in fit.parameters_of(MODE) if p.name == "damping"), 0.0)
    return damping <= LIGHTLY or least_damping(_denominator(fit)) <= LIGHTLY


def swings(fit: StructureFit, seconds: float) -> bool:
    """Tell whether an added mode, if there is one, swings once in a time.

    One that does not is a drift, which a small error of the plant's own slow part asks for.

    Parameters
    ----------
    fit : StructureFit
    seconds : float
    """
    frequency = next((p.value for p in fit.parameters_of(MODE) if p.name == "frequency"), np.inf)
    return bool(frequency * seconds >= 2.0 * np.pi)


def settles(fit: StructureFit, seconds: float) -> bool:
    """Tell whether a slow sensor, if there is one, comes to rest within a time.

    One that does not adds up what it is given: with a zero of the sensor it makes a drift.

    Parameters
    ----------
    fit : StructureFit
    seconds : float
    """
    return all(p.value < seconds for p in fit.parameters_of(LAG) if p.name == "time_constant")


def is_the_plant_again(fit: StructureFit, poles: Complexes) -> bool:
    """Tell whether the added mode is where a mode of the model is.

    Two like paths, one of them behind a map of the input, are one path behind another map: a limit is the
    input less what a dead zone passes.

    Parameters
    ----------
    fit : StructureFit
        With the effect ``extra_mode``.
    poles : ndarray of complex
        Of the model without effects [1/s].
    """
    values = {p.name: p.value for p in fit.parameters_of(MODE)}
    damping = min(values["damping"], 1.0)
    added = values["frequency"] * complex(-damping, np.sqrt(1.0 - damping**2))
    own = poles[poles.imag > 0.0]
    return bool((np.abs(own - added) < SAME_PLACE * np.abs(own)).any())


def least_damping(denominator: list[float]) -> float:
    """Return the smallest damping ratio of the complex poles of 1 + a1 q^-1 + ...; 1 without any.

    Examples
    --------
    >>> round(least_damping([-2.0 * 0.9 * np.cos(0.3), 0.81]), 3)
    0.331
    >>> least_damping([-0.5])
    1.0
    """
    logarithms = _logarithms(denominator)
    return float(np.min(-logarithms.real / np.abs(logarithms), initial=1.0))


def _logarithms(denominator: list[float]) -> Complexes:
    """Return the logarithms of the complex poles."""
    poles = np.roots([1.0, *denominator]).astype(complex)
    return np.asarray(np.log(poles[(poles.imag != 0.0) & (poles != 0.0)]))


def _denominator(fit: StructureFit) -> list[float]:
    """Return a1, a2, ... of a difference equation; none of a physical model."""
    own = {p.name: p.value for p in fit.parameters if not p.owner}
    names = [f"a{i}" for i in range(1, len(own) + 1)]
    return [own[name] for name in names if name in own] if "b1" in own else []
