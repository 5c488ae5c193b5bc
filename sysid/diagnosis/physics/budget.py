"""How much simulation one fit may take."""

from dataclasses import dataclass

import numpy as np

# Poles beyond the sampling frequency leave no trace of their own in a record: a search does not follow a
# plant there, unless its start values, known within some 20 %, or the fit that is started from are as fast.
SAMPLING_RATE, AS_FAST = 2.0 * np.pi, 2.0


@dataclass
class Budget:
    """Steps that the simulations of one fit may still take: not seconds, so that results repeat.

    Attributes
    ----------
    left : float
    spent : bool
        Whether a search was cut short.
    work : int
        Of all simulations so far, in steps of a run without laws.
    fastest : float
        Rate in a sample; a plant that is faster counts as one that diverges.
    """

    left: float = np.inf
    spent: bool = False
    work: int = 0
    fastest: float = np.inf

    def evaluations(self, wanted: int, steps: float) -> int:
        """Return how many evaluations of so many steps may be made: what is wanted, or at least two."""
        allowed = max(int(min(self.left / max(steps, 1.0), wanted)), 2)
        self.spent |= allowed < wanted
        return min(allowed, wanted)


def fastest_followed(given: float, started: float = 0.0) -> float:
    """Return the fastest rate in a sample, in radians, that a search follows a plant to.

    Parameters
    ----------
    given : float
        Rate at the start values.
    started : float
        Rate at the fit that a search starts from.
    """
    return max(SAMPLING_RATE, AS_FAST * given, started)
