"""The colour of a residual: an autoregression, its order chosen by the information criterion."""

from dataclasses import dataclass

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.structures.structure import WHITE

LARGEST_ORDER = 12
ROWS_PER_LAG = 20
# Share of the rows that must have a past as long as the largest order.
LEAST_WITH_PAST = 0.5


@dataclass(frozen=True, eq=False)
class Noise:
    """An autoregressive model of a residual.

    Attributes
    ----------
    polynomial : ndarray, shape (order + 1,)
        D(q) with D r = white, leading 1 included.
    variance : float
        Of the innovations.
    gain : float
        How much lower the information criterion is than that of white noise.
    """

    polynomial: Floats
    variance: float
    gain: float

    @property
    def order(self) -> int:
        """Number of lags; 0 for white noise."""
        return int(self.polynomial.size) - 1


# By which the plain sum of squares of a residual is taken.
WHITE_NOISE = Noise(WHITE, 0.0, 0.0)


def noise_of(residual: Floats, rows: Mask, largest_order: int = LARGEST_ORDER) -> Noise:
    """Fit an autoregression to the chosen rows of a residual.

    Examples
    --------
    >>> import numpy as np
    >>> r = np.zeros(4000)
    >>> e = np.random.default_rng(0).standard_normal(4000)
    >>> for k in range(1, 4000):
    ...     r[k] = 0.8 * r[k - 1] + e[k]
    >>> noise = noise_of(r, np.ones(4000, dtype=bool))
    >>> noise.order, bool(abs(noise.polynomial[1] + 0.8) < 0.03)
    (1, True)
    """
    past, target = _with_past(residual, rows, min(largest_order, int(rows.sum()) // ROWS_PER_LAG))
    n_rows, largest = past.shape
    R: Floats = np.asarray(np.linalg.qr(np.column_stack([past, target]), mode="r"))
    found, best = Noise(WHITE, float(np.mean(target**2)), 0.0), np.inf
    white = np.inf
    for order in range(largest + 1):
        tail = R[order:, -1]
        variance = float(tail @ tail) / n_rows
        criterion = n_rows * np.log(max(variance, 1e-300)) + order * np.log(n_rows)
        white = criterion if order == 0 else white
        if criterion < best:
            best = criterion
            coefficients = np.linalg.solve(R[:order, :order], R[:order, -1]) if order else np.empty(0)
            found = Noise(np.concatenate([[1.0], -coefficients]), variance, white - criterion)
    return found


def _with_past(residual: Floats, rows: Mask, largest: int) -> tuple[Floats, Floats]:
    """Return lagged rows, shape (n_rows, largest), and the rows that have as long a past.

    A row without one would be foreseen from zeros: of noise with a long memory it has the size of the noise,
    and few of them would count more than all innovations.
    """
    index = np.flatnonzero(rows)
    breaks = np.flatnonzero(np.diff(index, prepend=index[:1] - 2) != 1)
    position = np.arange(index.size) - np.repeat(breaks, np.diff(np.append(breaks, index.size)))
    while largest and np.sum(position >= largest) < LEAST_WITH_PAST * index.size:
        largest //= 2
    kept = index[position >= largest]
    lags = np.arange(1, largest + 1)
    return residual[kept[:, np.newaxis] - lags], residual[kept]
