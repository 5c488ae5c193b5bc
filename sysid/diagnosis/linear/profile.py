"""The likelihood of a linear model around the point of a fit."""

from collections.abc import Iterator

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.levenberg import Minimum, minimise
from sysid.diagnosis.linear.restarts import exchanged_poles, from_poles
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.structures.profile import End, Profile

ITERATIONS, TOLERANCE = 15, 1e-6
# Of longer records a walk takes too long.
MOST_ROWS = 20_000


def profile_of(
    chain: Chain, data: Data, noise: Floats, best: Minimum, inverse: Floats, variance: float
) -> Profile:
    """Return the likelihood of a chain around the point of a fit; ``inverse`` as for `Profile`."""
    none = np.zeros(best.point.size, dtype=bool)

    def cost_at(point: Floats) -> float:
        run = chain.run(data, np.clip(point, *chain.bounds(data)))
        if run is None:
            return np.inf
        error = chain.error(data, run, noise)
        return float(error @ error)

    def follow(point: Floats, free: Mask) -> End | None:
        end = minimise(chain, data, point, noise, free=free, iterations=ITERATIONS, tolerance=TOLERANCE)
        return None if end is None else End(end.point, end.cost)

    def elsewhere() -> Iterator[End]:
        """Search from exchanged poles."""
        for poles in exchanged_poles(best.point, chain.order):
            end = from_poles(chain, data, best.point, poles, noise)
            if end is not None:
                yield End(end.point, end.cost)

    variances = np.full(best.point.size, variance)
    end = End(best.point, best.cost)
    return Profile(end, inverse, variances, none, chain.smooth(data), cost_at, follow, elsewhere)
