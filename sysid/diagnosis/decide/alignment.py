"""Whether an effect follows the motion of its record: it must explain less at any other time."""

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.structures.projection import orthonormal, without

# Other times at which the same motion is laid beside the residual, and how near to its own at least.
SHIFTS, NEAREST = 99, 0.05
# A motion that repeats itself, or stands still, is not another one: its squared correlation with the shifted.
SAME_MOTION = 0.5
# Fewer other motions than this say nothing.
FEWEST = 60
# Columns that the others span to this share of their square are left out.
DEPENDENT = 1e-10


def chance_at_other_times(residual: Floats, tangent: Floats, change: Floats, slopes: Floats) -> float:
    """Return the chance that an effect explains so much of a residual that does not follow the motion.

    A disturbance of its own, such as the steps of an ambient temperature, has few turns in a record: a
    slow effect with a handful of parameters resembles it by luck, and no model of stationary noise says
    how well.  The same directions at another time resemble it as well by the same luck, and they
    cannot explain what does follow the motion.

    Parameters
    ----------
    residual : ndarray, shape (n_rows,)
        Of the model without the effect.
    tangent : ndarray, shape (n_rows, n_parameters)
        Derivative of the output by that model's parameters.
    change : ndarray, shape (n_rows,)
        By which the fit with the effect differs.
    slopes : ndarray, shape (n_rows, n_slopes)
        Derivative of the output by the parameters of the model with the effect: directions that a fit may
        follow.  They make the comparison fair, for the fit was chosen at its own time alone.

    Returns
    -------
    float
        Rank of the true time among all that were tried, a multiple of 0.01; 0 where there are not enough
        others because the motion repeats itself or stands still.

    References
    ----------
    Theiler et al. (1992), Testing for nonlinearity in time series: the method of surrogate data, Physica D
    58; here with shifts in the place of random phases.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> motion, noise = rng.standard_normal((2, 600))
    >>> constant, slopes = np.ones((600, 1)), motion[:, np.newaxis]
    >>> chance_at_other_times(0.5 * motion + noise, constant, motion, slopes)
    0.01
    >>> chance_at_other_times(noise, constant, motion, slopes) > 0.1
    True
    """
    n, Q = residual.size, orthonormal(tangent)
    own = without(change, Q)
    size = float(own @ own)
    if size == 0.0:
        return 0.0
    columns = np.column_stack([change, slopes])
    lengths = np.linalg.norm(columns, axis=0)
    kept = np.isfinite(lengths) & (lengths > 0.0)
    columns = columns[:, kept] / lengths[kept]
    least = _share(residual, columns, Q)
    larger = others = 0
    for shift in np.unique(np.linspace(NEAREST * n, (1.0 - NEAREST) * n, SHIFTS).astype(int)):
        moved = without(np.roll(change, shift), Q)
        if float(moved @ own) ** 2 > SAME_MOTION * size * float(moved @ moved):
            continue
        others += 1
        # What the model itself can follow counts at neither time.
        followed = orthonormal(np.column_stack([tangent, np.roll(tangent, shift, axis=0)]))
        larger += _share(residual, np.roll(columns, shift, axis=0), followed) >= least
    return (1 + larger) / (1 + others) if others >= FEWEST else 0.0


def _share(residual: Floats, columns: Floats, Q: Floats) -> float:
    """Return the share of a residual that columns explain, beyond what an orthonormal basis does."""
    # Eigenvectors of the small matrix are had four times as fast as a basis, which counts at 99 times.
    left, columns = without(residual, Q), without(columns, Q)
    values, vectors = np.linalg.eigh(columns.T @ columns)
    kept = values > DEPENDENT * values[-1]
    explained = np.sum((vectors[:, kept].T @ (columns.T @ left)) ** 2 / values[kept])
    return float(explained / max(float(left @ left), 1e-300))
