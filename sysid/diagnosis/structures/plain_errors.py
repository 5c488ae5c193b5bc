"""Standard errors of a fit that minimised plain errors although these have a memory from row to row."""

from collections.abc import Sequence

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.linear.uncertainty import backwards

# Singular values below this share of the largest belong to directions that the output does not show,
# unknowns with more than this share in such a direction have no standard error.
UNSEEN, LOOSE = 1e-9, 1e-2


def plain_errors(J: Floats, residual: Floats, runs: Sequence[slice], noise: Floats) -> Floats:
    """Return the standard error of each unknown of a plain least-squares fit under coloured noise.

    The covariance is (J'J)^-1 J'VJ (J'J)^-1 with V that of the noise, and J'VJ = sigma^2 |F'J|^2 where F'
    runs 1/D backwards in time.  That of a fit weighed by the colour, (J'V^-1 J)^-1, would be too small: of a
    slow residual plain errors use much less of what a record holds.

    Parameters
    ----------
    J : ndarray, shape (n_rows, n_unknowns)
        Derivatives of the free run.
    residual : ndarray, shape (n_rows,)
    runs : sequence of slice
        Rows that follow one another.
    noise : ndarray, shape (order + 1,)
        D(q), leading 1 included: the residual is white noise through 1/D.

    Returns
    -------
    ndarray, shape (n_unknowns,)
        Infinite where the output does not tell.

    Examples
    --------
    The mean of white noise; of one with r(k) = 0.8 r(k-1) + e(k) it is known as if by a ninth of the rows:

    >>> rng = np.random.default_rng(0)
    >>> r, one = rng.standard_normal(10_000), np.ones((10_000, 1))
    >>> for k in range(1, r.size):
    ...     r[k] += 0.8 * r[k - 1]
    >>> rows = [slice(0, r.size)]
    >>> white, coloured = (plain_errors(one, r, rows, np.array(d))[0] for d in ([1.0], [1.0, -0.8]))
    >>> round(float(coloured / white), 1)
    3.0
    """
    with np.errstate(over="ignore"):
        scale = np.linalg.norm(J, axis=0)
    lost = (scale == 0.0) | ~np.isfinite(scale)  # a slope beyond all bounds tells as little as none
    left, sizes, right = np.linalg.svd(
        np.where(lost, 0.0, J) / np.where(lost, 1.0, scale), full_matrices=False
    )
    seen = sizes > UNSEEN * sizes.max(initial=0.0)
    innovations, forward = [np.empty(0)], np.empty((residual.size, int(seen.sum())))
    for rows in runs:
        innovations.append(np.convolve(residual[rows], noise)[noise.size - 1 : residual[rows].size])
        forward[rows] = backwards(left[rows][:, seen].T, noise).T
    driving = np.concatenate(innovations)
    spread = np.linalg.norm(driving) / np.sqrt(max(driving.size - J.shape[1], 1))
    errors = spread * np.linalg.norm(forward @ (right[seen] / sizes[seen, np.newaxis]), axis=0)
    errors /= np.where(lost, 1.0, scale)
    errors[lost | (np.abs(right[~seen]).max(axis=0, initial=0.0) > LOOSE)] = np.inf
    return np.asarray(errors)
