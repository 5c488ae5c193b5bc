"""Design of the experiment that would tell two tied candidates apart."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.structures.projection import orthonormal, without
from sysid.diagnosis.structures.structure import StructureFit

LONGEST = 1000


@runtime_checkable
class Responding(Protocol):
    """A structure that can be run with an input of one's choice."""

    def respond(self, fit: StructureFit, u: Floats) -> tuple[Floats, Floats]:
        """Return the free run from rest for an input, and its derivative by all parameters."""
        ...


@dataclass(frozen=True)
class Experiment:
    """The best of some inputs within the limits of the record.

    Attributes
    ----------
    design : str
        What the input is.
    n_samples : int
    separation : float
        Distance of the two models' outputs in standard deviations of the noise, over the whole
        experiment and after one of them has been refitted to the other.
    """

    design: str
    n_samples: int
    separation: float


def separating_experiment(
    structure: Responding, first: StructureFit, second: StructureFit, u: Floats, noise: float
) -> Experiment | None:
    """Return the input that separates two fits best, within the range of the measured input.

    Parameters
    ----------
    structure : Responding
    first, second : StructureFit
    u : ndarray
        Measured input: its range is the limit.
    noise : float
        Standard deviation of the noise.
    """
    n, best = min(u.size, LONGEST), None
    for design, signal in _inputs(float(u.min()), float(u.max()), n):
        (y, tangent), (other, _) = structure.respond(first, signal), structure.respond(second, signal)
        difference = other - y
        if not np.isfinite(difference).all():
            continue
        Q = orthonormal(tangent)
        apart = float(np.linalg.norm(without(difference, Q))) / max(noise, 1e-300)
        if best is None or apart > best.separation:
            best = Experiment(design, n, apart)
    return best


def _inputs(low: float, high: float, n: int) -> Iterator[tuple[str, Floats]]:
    """Yield inputs of different size, speed and shape; they are always the same."""
    rng = np.random.default_rng(0)
    middle = 0.5 * (low + high)
    for share in (1.0, 0.3):
        bottom, top = middle + share * (low - middle), middle + share * (high - middle)
        size = "over the whole range" if share == 1.0 else f"over {100 * share:.0f} % of the range"
        for hold in (1, 5, 25):
            levels = rng.uniform(bottom, top, n // hold + 1)
            often = "sample" if hold == 1 else f"{hold} samples"
            yield f"random levels, a new one every {often}, {size}", np.repeat(levels, hold)[:n]
            switch = np.where(rng.random(n // hold + 1) < 0.5, bottom, top)
            yield f"random switching every {often} {size}", np.repeat(switch, hold)[:n]
        phase = np.cumsum(np.geomspace(2 * np.pi / n, 2.0, n))
        yield f"a sweep {size}", middle + 0.5 * (top - bottom) * np.sin(phase)
