"""Standard errors where the sum of squares is no parabola: as far as the likelihood reaches.

A pole that a record hardly shows, since a zero all but cancels it or the input does not excite it, may lie
anywhere along a bent valley of the error, or in several; slopes at the deepest point tell nothing of that.
"""

from dataclasses import dataclass, field

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.levenberg import Minimum, minimise
from sysid.diagnosis.linear.restarts import exchanged_poles, from_poles
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.wording import NORMAL_95

# So many noise variances above its minimum the sum of squares is at the end of a 95 % interval, the other
# unknowns following: the quantile of a chi-squared variable with one degree of freedom.
RISE = NORMAL_95**2
# The slopes are believed where they foretell that rise and it is within these.
STRAIGHT = (2.5, 5.5)
# Points of a walk to one side, and its first step as a share of the foretold half interval.
MOST_POINTS, FIRST_STEP = 16, 0.5
# After a smaller rise from point to point the steps are doubled; a larger one is gone again in part.
GENTLE, STEEP, SHORTER = 0.7, 6.0, 0.4
ITERATIONS, TOLERANCE = 15, 1e-6
# A minimum so many noise variances lower is another model; nearer, chance decides which of them is the lower.
PLAINLY_LOWER = 12.0
# Of longer records a walk takes too long.
MOST_ROWS = 20_000


@dataclass(eq=False)
class Profile:
    """The likelihood of a chain around the point of a fit.

    Attributes
    ----------
    chain : Chain
    data : Data
    noise : ndarray
        D(q) of the noise.
    best : Minimum
        Where the fit ended.
    variance : float
        Of the noise.
    covariance : ndarray, shape (n_unknowns, n_unknowns)
        As the slopes tell it; NaN for unknowns that are not followed.
    reached : list of Minimum
        Points that are within a 95 % interval or lower than where the fit ended, as far as they were met.
    """

    chain: Chain
    data: Data
    noise: Floats
    best: Minimum
    variance: float
    covariance: Floats
    reached: list[Minimum] = field(default_factory=list)

    @property
    def lower(self) -> Minimum | None:
        """The lowest point that was met, if it lies far below the fit's."""
        found = min(self.reached, key=lambda end: end.cost, default=self.best)
        return found if self._rise(found.cost) < -PLAINLY_LOWER else None

    def standard_errors(self, asked: Mask) -> Floats:
        """Return the standard errors of all unknowns; those asked for hold where slopes do not.

        Half the longer side of a 95 % interval, over 1.96.
        """
        errors = np.sqrt(np.diag(self.covariance))
        asked = asked & np.isfinite(errors)
        bent = [i for i in np.flatnonzero(asked).tolist() if not self._is_straight(i)]
        if not bent or self.data.u.size > MOST_ROWS:
            return errors
        point = self.best.point
        self._look_elsewhere()
        ends = np.array([[self._end(i, sign) for sign in (-1.0, 1.0)] for i in bent])
        met = np.array([point, *(end.point for end in self.reached)])
        far = np.abs(met - point).max(axis=0)
        straight = np.setdiff1d(np.flatnonzero(asked), bent)
        errors[straight] = np.fmax(errors[straight], far[straight] / NORMAL_95)
        errors[bent] = np.fmax(np.abs(ends - point[bent, np.newaxis]).max(axis=1), far[bent]) / NORMAL_95
        return errors

    def _is_straight(self, i: int) -> bool:
        """Tell whether the sum of squares rises along an unknown as its slopes foretell."""
        ahead = NORMAL_95 * np.nan_to_num(self.covariance[:, i] / np.sqrt(self.covariance[i, i]))
        rises = (self._rise_at(self.best.point + sign * ahead) for sign in (-1.0, 1.0))
        return all(STRAIGHT[0] < rise < STRAIGHT[1] for rise in rises)

    def _rise_at(self, point: Floats) -> float:
        run = self.chain.run(self.data, np.clip(point, *self.chain.bounds(self.data)))
        if run is None:
            return np.inf
        error = self.chain.error(self.data, run, self.noise)
        return self._rise(float(error @ error))

    def _rise(self, cost: float) -> float:
        return (cost - self.best.cost) / self.variance

    def _look_elsewhere(self) -> None:
        """Search from exchanged poles."""
        for poles in exchanged_poles(self.best.point, self.chain.order):
            end = from_poles(self.chain, self.data, self.best.point, poles, self.noise)
            if end is not None and self._rise(end.cost) < RISE:
                self.reached.append(end)

    def _end(self, i: int, sign: float) -> float:
        """Walk along an unknown, the others following, to where the rise is that of 95 %.

        Each step begins where the last two points lead.
        """
        free = np.isfinite(np.diag(self.covariance)) & self.chain.smooth(self.data)
        free[i] = False
        ahead = np.nan_to_num(self.covariance[:, i] / self.covariance[i, i])
        step = sign * FIRST_STEP * NORMAL_95 * np.sqrt(self.covariance[i, i])
        here, rise = self.best.point, 0.0
        for _ in range(MOST_POINTS):
            there = minimise(
                self.chain,
                self.data,
                here + step * ahead,
                self.noise,
                free=free,
                iterations=ITERATIONS,
                tolerance=TOLERANCE,
            )
            risen = np.inf if there is None else self._rise(there.cost)
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
