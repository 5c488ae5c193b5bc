"""What the search for missing effects hands on: candidates with their evidence, and the verdict."""

from dataclasses import dataclass

import numpy as np

from sysid.diagnosis.decide.noise_colour import Noise
from sysid.diagnosis.structures.structure import StructureFit

# The memory of the noise is a candidate beside the effects.
NOISE_EFFECT = "coloured_noise"


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate, fitted, with the evidence for it.

    Attributes
    ----------
    name : str
    fit : StructureFit or None
        On the estimation rows; None if it was screened out.
    noise : Noise
        Colour of its residual.
    criterion : float
        Information criterion under the colour of what the probes leave: lower is better.
    gain : float
        How much lower the criterion is than that of the model without it.
    p_value : float
        Chance that the best of all candidates looks as good with nothing missing.
    validation : float
        Root mean square of the free-run error on the validation rows.
    looks : int
        Places at which all candidates were tried.
    """

    name: str
    fit: StructureFit | None
    noise: Noise
    criterion: float
    gain: float = 0.0
    p_value: float = 1.0
    validation: float = np.inf
    looks: int = 1


@dataclass(frozen=True, eq=False)
class Decision:
    """What was decided.

    Attributes
    ----------
    verdict : str
    baseline : StructureFit
        On the estimation rows.
    fits : tuple of StructureFit
        With one, two, ... accepted effects, on the estimation rows.
    accepted : tuple of str
    trials : tuple of Trial
        All single candidates, best first.
    ties : tuple of tuple of Trial
        For each accepted effect that others cannot be told from: it and these, beside all other effects.
    noise : Noise
        Colour of the final residual.
    left_p_value, left_share : float
        Whether anything is left: chance, and share of the explainable squared error.
    floor : float
        Root mean square of what neither the final model nor any probe explains.
    rejected : tuple of str
        What came closest where nothing explains.
    given : tuple of str
        Effects that were asked for whatever the evidence.
    fed_back : bool
        Whether what goes with the input of the same row was put down to a controller, not to the plant.
    cut_short : bool
        Whether the search ended before all its stages were tried.
    stands_in : bool
        Whether what came closest is, where it ended, something else than its name says.
    resembled_at : str
        Port at which one curve of free form does as much as all that was found; empty if none does.
    size_foretold : bool
        Whether what is left looks like noise but for its size, which goes with the input or the motion.
    """

    verdict: str
    baseline: StructureFit
    fits: tuple[StructureFit, ...]
    accepted: tuple[str, ...]
    trials: tuple[Trial, ...]
    ties: tuple[tuple[Trial, ...], ...]
    noise: Noise
    left_p_value: float
    left_share: float
    floor: float
    rejected: tuple[str, ...] = ()
    given: tuple[str, ...] = ()
    fed_back: bool = False
    cut_short: bool = False
    stands_in: bool = False
    resembled_at: str = ""
    size_foretold: bool = False

    @property
    def tie(self) -> tuple[str, ...]:
        """Names of the first tie; empty where each accepted effect can be told from all candidates."""
        return tuple(trial.name for trial in self.ties[0]) if self.ties else ()

    @property
    def final(self) -> StructureFit:
        """The model with all effects that were kept; the baseline if none was."""
        return self.fits[-1] if self.fits else self.baseline
