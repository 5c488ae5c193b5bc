"""Whether a residual is noise, coloured or not, or holds something that goes with the record's signals."""

from collections.abc import Sequence

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.decide.evidence import Remainder, remainder
from sysid.diagnosis.decide.noise_colour import noise_beside
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.structures.projection import orthonormal, without

# Together, probes are asked in no more than one direction for so many rows.
ROWS_PER_DIRECTION = 8


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

    bases = [orthonormal(columns[rows]) for columns in (tangent, np.hstack([tangent, probes]))]
    alone, beside = (noise_beside(residual, basis, rows)[1] for basis in bases)
    n_alone, n_beside = (basis.shape[1] for basis in bases)
    n, q = int(rows.sum()), n_beside - n_alone
    if q <= 0 or n - n_beside < 10 or beside <= 0.0:
        return 1.0
    ratio = (alone / beside - 1.0) * (n - n_beside) / q
    return float(fdtrc(q, n - n_beside, max(ratio, 0.0)))


def leading(tangent: Floats, probes: Floats, rows: Mask) -> Floats:
    """Return the directions in which probes vary most beside what the model can follow.

    Of few rows many directions leave so little that the colour of the noise is lost with them.

    Parameters
    ----------
    tangent : ndarray, shape (n_samples, n_parameters)
    probes : ndarray, shape (n_samples, n_probes)
    rows : ndarray of bool, shape (n_samples,)

    Returns
    -------
    ndarray, shape (n_samples, n_directions)
        The probes themselves where they are few enough.
    """
    most = int(rows.sum()) // ROWS_PER_DIRECTION
    if probes.shape[1] <= most:
        return probes
    size = np.linalg.norm(probes[rows], axis=0)
    scaled = probes[:, size > 0.0] / size[size > 0.0]
    beside = without(scaled[rows], orthonormal(tangent[rows]))
    axes = np.linalg.svd(beside, full_matrices=False)[2][:most]
    return np.asarray(scaled @ axes.T)


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
