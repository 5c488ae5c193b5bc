"""What the paper's four examples are made of, and what had to be chosen where the paper is silent."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sysid.linear import simulate_polynomial
from sysid.nonlinearities import DEAD_ZONE, SIGN, KnownMap, PiecewiseAffine, Quantiser, sine

ORDER = 2
B = (0.0, 0.4450, 0.4299)
"""Numerator of (29) by rising powers of q^-1; the paper lists it for descending powers of q."""
A = (1.0, -1.0300, 0.9048)
SIGNAL_TO_NOISE = 10.0
"""||y - mean(y)|| / ||w||, eq. (31)."""

PARAMETERS = ("a1", "a2", "b0", "b1", "b2")
TRUE = np.array([*A[1:], *B])
"""[a1, a2, b0, b1, b2]."""

DEAD_ZONE_HALF_WIDTH = 1.0
QUANTISER_STEP = 1.0
SINE_DOMAIN = (-2 * math.pi, 2 * math.pi)
"""Not in the paper."""


@dataclass(frozen=True)
class Example:
    """One example of Section 7.

    Attributes
    ----------
    title : str
        Name for figures.
    number : int
        Example number in the text.
    samples : int
        Input-output pairs.
    figures : (int, int)
        Numbers of its two figures.
    printed_example : int
        Example number in the caption of the second figure.
    """

    title: str
    number: int
    samples: int
    figures: tuple[int, int]
    printed_example: int


EXAMPLES: Mapping[str, Example] = {
    "sine": Example("Sine", 1, 20, (2, 3), 3),
    "dead-zone": Example("Dead zone", 2, 30, (4, 5), 5),
    "quantisation": Example("Quantisation", 3, 50, (6, 7), 6),
    "sign": Example("Sign", 4, 60, (8, 9), 7),
}


def nonlinearity(case: str) -> KnownMap:
    """Return the nonlinearity of an example."""
    known: Mapping[str, KnownMap] = {
        "sine": sine(SINE_DOMAIN),
        "dead-zone": PiecewiseAffine.of(DEAD_ZONE, DEAD_ZONE_HALF_WIDTH),
        "quantisation": Quantiser(QUANTISER_STEP),
        "sign": SIGN,
    }
    return known[case]


@dataclass(frozen=True, eq=False)
class Experiment:
    """Simulated signals of one experiment: input, y, noise w, and z = N(y + w)."""

    u: np.ndarray
    y: np.ndarray
    w: np.ndarray
    z: np.ndarray

    @property
    def noise_level(self) -> float:
        """Root mean square of w."""
        return float(np.sqrt(np.mean(self.w**2)))


def experiment(case: str, samples: int, rng: np.random.Generator, noisy: bool = True) -> Experiment:
    """Draw an experiment from rest: u and w standard normal, w scaled to the S/N of (31), z by (30).

    For the sine it is drawn again until y + w stays in the domain, as the paper assumes of the domain.
    """
    known = nonlinearity(case)
    for _ in range(10_000):
        u = rng.standard_normal(samples)
        w = rng.standard_normal(samples)
        y = simulate_polynomial(B, A, u)
        w *= np.linalg.norm(y - y.mean()) / np.linalg.norm(w) / SIGNAL_TO_NOISE if noisy else 0.0
        if case != "sine" or float(np.max(np.abs(y + w))) <= SINE_DOMAIN[1]:
            return Experiment(u, y, w, known(y + w))
    raise ArithmeticError(f"{samples} samples never stayed in the domain of the sine")
