"""The colour of a residual: an autoregression, its order chosen by the information criterion."""

from dataclasses import dataclass

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.structures.rows import runs_of
from sysid.diagnosis.structures.structure import WHITE, filtered

LARGEST_ORDER = 12
ROWS_PER_LAG = 20
# Share of the rows that must have a past as long as the largest order.
LEAST_WITH_PAST = 0.5
# How often columns and a colour are brought to agree, and when they do: change of the log-likelihood.
ROUNDS, AGREED = 8, 0.05


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


def noise_of(
    residual: Floats, rows: Mask, largest_order: int = LARGEST_ORDER, hidden: Floats | None = None
) -> Noise:
    """Fit an autoregression to the chosen rows of a residual.

    Parameters
    ----------
    residual : ndarray, shape (n_samples,)
    rows : ndarray of bool, shape (n_samples,)
    largest_order : int
    hidden : ndarray, shape (n_rows, n_columns), optional
        C, where C C' is the covariance of the noise that is missing from the residual, because what was
        fitted has followed it.

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
    equations = np.column_stack([past, target])
    if hidden is not None:
        equations = np.vstack([equations, _lagged_root(hidden, rows, largest)])
    R: Floats = np.asarray(np.linalg.qr(equations, mode="r"))
    found, best, white = Noise(WHITE, 0.0, 0.0), np.inf, np.inf
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


def noise_beside(residual: Floats, columns: Floats, rows: Mask, rounds: int = ROUNDS) -> tuple[Noise, float]:
    """Return the colour of the noise beside columns that a residual may hold, and what they leave of it.

    What a fit of many columns leaves is coloured even if the noise is white: the columns follow the noise as
    they follow anything, and most of it where they are, as at low frequencies.  What noise of the colour
    found so far is expected to have in the columns is put back, until the colour stays (maximum likelihood
    with the columns' weights integrated out, by expectation-maximisation).

    Parameters
    ----------
    residual : ndarray, shape (n_samples,)
    columns : ndarray, shape (n_rows, n_columns)
        On the chosen rows; of full rank.
    rows : ndarray of bool, shape (n_samples,)
    rounds : int
        How often at most.  The first takes the noise for white; few rounds leave more of what is slow to the
        columns than many, which end where most of it is noise.

    Returns
    -------
    noise : Noise
        With the variance of the innovations.
    left : float
        Sum of squares of the whitened residual less its part in the columns.

    References
    ----------
    Harville (1977), J. Amer. Statist. Assoc. 72, 320-338; Dempster, Laird, Rubin (1977), J. Roy. Statist.
    Soc. B 39, 1-38.

    Examples
    --------
    >>> import numpy as np
    >>> white, k = np.random.default_rng(0).standard_normal(400), np.arange(400)
    >>> slow = np.column_stack([np.cos(np.pi * i * (k + 0.5) / 400) for i in range(80)])
    >>> rows = np.ones(400, dtype=bool)
    >>> Q = np.linalg.qr(slow)[0]
    >>> noise_of(white - Q @ (Q.T @ white), rows).order > 0, noise_beside(white, Q, rows)[0].order
    (True, 0)
    """
    from scipy.linalg import solve_triangular

    n_rows, n_columns = columns.shape
    freedom = n_rows - n_columns
    if freedom < 1:  # nothing is left that could have a colour
        return Noise(WHITE, 0.0, 0.0), 0.0
    found, before = Noise(WHITE, 0.0, 0.0), np.inf
    whole, rest = np.zeros((residual.size, n_columns)), np.zeros(residual.size)
    whole[rows] = columns
    left = 0.0
    for _ in range(rounds):
        whitened = (filtered(part, rows, found.polynomial) for part in (whole, residual))
        R: Floats = np.asarray(np.linalg.qr(np.column_stack([*whitened]), mode="r"))
        by_columns, along, left = R[:-1, :-1], R[:-1, -1], float(R[-1, -1] ** 2)
        rest[rows] = residual[rows] - columns @ solve_triangular(by_columns, along)
        hidden = np.sqrt(left / freedom) * solve_triangular(by_columns, columns.T, trans="T").T
        found = noise_of(rest, rows, hidden=hidden)
        likelihood = n_rows * float(np.log(max(found.variance, 1e-300)))
        if found.order == 0 or abs(likelihood - before) < AGREED:
            break
        before = likelihood
    return found, left


def _lagged_root(hidden: Floats, rows: Mask, largest: int) -> Floats:
    """Return a root of the sum over columns of the moments of their lags, shape (largest + 1, largest + 1).

    In the order in which a regression has them: lags from one to the largest, then none.  From one lag to
    the next only the ends of each run of rows come in or go out.
    """
    moments = np.zeros((largest + 1, largest + 1))
    for run in runs_of(rows):
        z = hidden[run]
        if z.shape[0] > largest:
            moments += _lag_moments(z, largest)
    lags = [*range(1, largest + 1), 0]
    values, vectors = np.linalg.eigh(moments[np.ix_(lags, lags)])
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, np.newaxis] * vectors.T)


def _lag_moments(z: Floats, largest: int) -> Floats:
    """Return the sum over k and columns of z(k - i) z(k - j), for k from ``largest`` on."""
    n = z.shape[0]
    moments = np.empty((largest + 1, largest + 1))
    moments[0] = [np.vdot(z[largest:], z[largest - lag : n - lag]) for lag in range(largest + 1)]
    entering, leaving = z[:largest][::-1], z[n - largest :][::-1]
    change = entering @ entering.T - leaving @ leaving.T
    for i in range(largest):
        moments[i + 1, i + 1 :] = moments[i, i:-1] + change[i, i:]
    return np.asarray(np.triu(moments) + np.triu(moments, 1).T)


def _with_past(residual: Floats, rows: Mask, largest: int) -> tuple[Floats, Floats]:
    """Return lagged rows, shape (n_rows, largest), and the rows that have as long a past.

    A row without one would be foreseen from zeros: of noise with a long memory it has the size of the noise,
    and few of them would count more than all innovations.
    """
    index = np.flatnonzero(rows)
    lengths = [run.stop - run.start for run in runs_of(rows)]
    position = np.concatenate([np.empty(0, dtype=np.intp), *map(np.arange, lengths)])
    while largest and np.sum(position >= largest) < LEAST_WITH_PAST * index.size:
        largest //= 2
    kept = index[position >= largest]
    lags = np.arange(1, largest + 1)
    return residual[kept[:, np.newaxis] - lags], residual[kept]
