"""Whether a residual is noise, coloured or not, or holds something that goes with the record's signals."""

from collections.abc import Sequence

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.decide.evidence import Remainder, orthonormal, remainder
from sysid.diagnosis.decide.noise_colour import Noise, noise_of
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.structures.structure import WHITE, filtered

# How often directions and a colour are brought to agree, and when they do: change of the log-likelihood.
ROUNDS, AGREED = 8, 0.05


def chance_by_likelihood(residual: Floats, tangent: Floats, probes: Floats, rows: Mask) -> float:
    """Return the chance that noise of any colour lets probes raise its likelihood as much.

    Either all of the residual is coloured noise, or part of it goes with the probes and the rest is coloured
    noise; each has the colour that suits it best.  Of the two tests that need one colour alone, that by the
    colour of what the probes leave takes slow noise for an effect, and that by the colour of the whole takes
    an effect for noise.

    Parameters
    ----------
    residual : ndarray, shape (n_samples,)
    tangent : ndarray, shape (n_samples, n_parameters)
        What the model itself can follow.
    probes : ndarray, shape (n_samples, n_probes)
    rows : ndarray of bool, shape (n_samples,)

    Returns
    -------
    float
        Of the F distribution, which for white noise is exact.

    References
    ----------
    Davidson & MacKinnon (1993), Estimation and Inference in Econometrics, chapters 8 and 10.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> u, e = rng.standard_normal((2, 900))
    >>> slow = np.zeros(900)
    >>> for k in range(1, 900):
    ...     slow[k] = 0.9 * slow[k - 1] + e[k]
    >>> u = np.cumsum(u) / 10.0
    >>> lags = np.column_stack([np.roll(u, lag) for lag in range(1, 30)])
    >>> rows, constant = np.ones(900, dtype=bool), np.ones((900, 1))
    >>> chance_by_likelihood(slow, constant, lags, rows) > 0.01
    True
    >>> chance_by_likelihood(slow + 5.0 * np.roll(u, 3), constant, lags, rows) < 1e-4
    True
    """
    from scipy.special import fdtrc

    (alone, n_alone), (beside, n_beside) = (
        _settled(residual, columns, rows) for columns in (tangent, np.hstack([tangent, probes]))
    )
    n, q = int(rows.sum()), n_beside - n_alone
    if q <= 0 or n - n_beside < 10 or beside.variance <= 0.0:
        return 1.0
    ratio = (alone.variance / beside.variance - 1.0) * (n - n_beside) / q
    return float(fdtrc(q, n - n_beside, max(ratio, 0.0)))


def _settled(residual: Floats, columns: Floats, rows: Mask) -> tuple[Noise, int]:
    """Return the colour of what columns leave, weighted by that colour, and how many columns count."""
    basis = orthonormal(columns[rows])
    whole, rest = np.zeros((residual.size, basis.shape[1])), np.zeros(residual.size)
    whole[rows] = basis
    weights = basis.T @ residual[rows]
    found, before, n = Noise(WHITE, np.inf, 0.0), np.inf, int(rows.sum())
    for _ in range(ROUNDS):
        rest[rows] = residual[rows] - basis @ weights
        found = noise_of(rest, rows)
        likelihood = n * float(np.log(max(found.variance, 1e-300)))
        if found.order == 0 or abs(likelihood - before) < AGREED:
            break
        before = likelihood
        Q, R = np.linalg.qr(filtered(whole, rows, found.polynomial))
        weights = np.linalg.solve(R, Q.T @ filtered(residual, rows, found.polynomial))
    return found, basis.shape[1]


def clearest(
    residual: Floats, tangent: Floats, probes: Floats, families: Sequence[slice]
) -> tuple[float, Remainder]:
    """Return what the family of probes finds that finds most, with its chance among all of them.

    What one question answers is lost among the chances of a hundred: so each is asked for itself, too.

    Parameters
    ----------
    residual : ndarray, shape (n_rows,)
        Whitened.
    tangent : ndarray, shape (n_rows, n_parameters)
        Whitened.
    probes : ndarray, shape (n_rows, n_probes)
        Whitened.
    families : sequence of slice
        Which of them ask the same.
    """
    found = [remainder(residual, tangent, probes[:, family]) for family in families]
    best = min(found, key=lambda one: one.p_value, default=Remainder(1.0, 0.0, 0.0))
    return min(best.p_value * len(found), 1.0), best
