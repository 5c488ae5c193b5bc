"""Standard errors where the sum of squares is no parabola: as far as the likelihood reaches.

What a record hardly shows - a pole that a zero all but cancels, a damper that dry friction outdoes - may lie
anywhere along a bent valley of the error, or in several; slopes at the deepest point tell nothing of that.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.wording import NORMAL_95

# So many noise variances above its minimum the sum of squares is at the end of a 95 % interval, the other
# unknowns following: the quantile of a chi-squared variable with one degree of freedom.
RISE = NORMAL_95**2
# The slopes are believed where they foretell that rise and it is within these: then a parabola through it
# tells the longer side of the interval.
STRAIGHT = (2.5, 5.5)
# Points of a walk to one side, and its first step as a share of the foretold half interval.
MOST_POINTS, FIRST_STEP = 16, 0.5
# After a smaller rise from point to point the steps are doubled; a larger one is gone again in part.
GENTLE, STEEP, SHORTER = 0.7, 6.0, 0.4
# A minimum so many noise variances lower is another model; nearer, chance decides which of them is the lower.
PLAINLY_LOWER = 12.0


@dataclass(frozen=True, eq=False)
class End:
    """Where a search ended.

    Attributes
    ----------
    point : ndarray, shape (n_unknowns,)
    cost : float
        Sum of squares there.
    """

    point: Floats
    cost: float


@dataclass(eq=False)
class Profile:
    """The likelihood around the point of a fit.

    Attributes
    ----------
    best : End
        Where the fit ended.
    inverse : ndarray, shape (n_unknowns, n_unknowns)
        (J'J)^-1 of the slopes; NaN for unknowns that are not followed.
    variances : ndarray, shape (n_unknowns,)
        Of the noise; larger for an unknown of which a record tells less because the noise has a memory that
        the fit did not weigh.
    logarithmic : ndarray of bool, shape (n_unknowns,)
        Unknowns that are logarithms of what a reader is given an interval of.
    smooth : ndarray of bool, shape (n_unknowns,)
        Unknowns that may follow: their slopes say how the output changes.
    cost_at : callable
        Sum of squares at a point, infinite where the model diverges.
    follow : callable
        Searches from a point over the unknowns that are free; None where that cannot be.
    elsewhere : callable
        Ends of searches in other valleys.
    reached : list of End
        Points that are within a 95 % interval or lower than where the fit ended, as far as they were met.
    """

    best: End
    inverse: Floats
    variances: Floats
    logarithmic: Mask
    smooth: Mask
    cost_at: Callable[[Floats], float]
    follow: Callable[[Floats, Mask], End | None]
    elsewhere: Callable[[], Iterable[End]] = tuple
    reached: list[End] = field(default_factory=list)

    @property
    def lower(self) -> Floats | None:
        """The lowest point that was met, if it lies far below the fit's."""
        found = min(self.reached, key=lambda end: end.cost, default=self.best)
        fallen = (self.best.cost - found.cost) / float(np.min(self.variances))
        return found.point if fallen > PLAINLY_LOWER else None

    def standard_errors(self, asked: Mask) -> Floats:
        """Return the standard errors of all unknowns; those asked for hold where slopes do not.

        Half the longer side of a 95 % interval, over 1.96.  That of a logarithm is relative to the value.
        """
        with np.errstate(invalid="ignore"):  # of what the output does not tell there is none
            errors = np.sqrt(np.diag(self.inverse) * self.variances)
        asked = asked & np.isfinite(errors)
        bent = []
        for i in np.flatnonzero(asked).tolist():
            lowest, highest = self._rises(i, float(errors[i]))
            if STRAIGHT[0] < lowest and highest < STRAIGHT[1]:
                errors[i] *= max(NORMAL_95 / np.sqrt(lowest), 1.0)
            else:
                bent.append(i)
        if not bent:
            return errors
        for end in self.elsewhere():
            if self._rise(end.cost, bent[0]) < RISE:
                self.reached.append(end)
        ends = {i: [self._end(i, sign) for sign in (-1.0, 1.0)] for i in bent}
        for i in np.flatnonzero(asked).tolist():
            met = [*(end.point[i] for end in self.reached), *ends.get(i, [])]
            side = max((self._length(i, value) for value in met), default=0.0) / NORMAL_95
            errors[i] = side if i in ends else max(errors[i], side)
        return errors

    def _length(self, i: int, coordinate: float) -> float:
        """Return how far a value is from the fit's, relative to it where it is known by its logarithm."""
        moved = coordinate - float(self.best.point[i])
        return abs(float(np.expm1(moved)) if self.logarithmic[i] else moved)

    def _rises(self, i: int, error: float) -> tuple[float, float]:
        """Return the lower and the higher rise at the ends that the slopes foretell for an unknown."""
        ahead = np.nan_to_num(self.inverse[:, i] / self.inverse[i, i])
        rises = []
        for half in (-NORMAL_95 * error, NORMAL_95 * error):
            if self.logarithmic[i] and half <= -1.0:
                return -np.inf, np.inf
            moved = float(np.log1p(half)) if self.logarithmic[i] else half
            rises.append(self._rise(self.cost_at(self.best.point + moved * ahead), i))
        return min(rises), max(rises)

    def _rise(self, cost: float, i: int) -> float:
        return (cost - self.best.cost) / float(self.variances[i])

    def _end(self, i: int, sign: float) -> float:
        """Walk along an unknown, the others following, to where the rise is that of 95 %.

        Each step begins where the last two points lead.
        """
        free = np.isfinite(np.diag(self.inverse)) & self.smooth
        free[i] = False
        ahead = np.nan_to_num(self.inverse[:, i] / self.inverse[i, i])
        step = sign * FIRST_STEP * NORMAL_95 * np.sqrt(self.inverse[i, i] * self.variances[i])
        here, rise = self.best.point, 0.0
        for _ in range(MOST_POINTS):
            there = self.follow(here + step * ahead, free)
            risen = np.inf if there is None else self._rise(there.cost, i)
            if there is None or risen > max(RISE, rise + STEEP):
                step *= SHORTER
                continue
            moved = float(there.point[i] - here[i])
            if moved == 0.0:
                break  # at its bound
            if risen > RISE:
                before, after = np.sqrt(max(rise, 0.0)), np.sqrt(risen)
                return float(here[i] + moved * (NORMAL_95 - before) / (after - before))
            self.reached.append(there)
            ahead = (there.point - here) / moved
            step *= 2.0 if risen - rise < GENTLE else 1.0
            here, rise = there.point, risen
        return float(here[i])
