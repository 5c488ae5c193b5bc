"""An unknown nonlinearity from step tests of a system with G(1) != 0."""

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import DataError, IdentifiabilityError
from sysid.nonlinearities.known import PiecewiseAffine

FLAT = 1e-3
"""Rises between neighbouring steps below this share of the whole rise count as none."""


def nonlinearity_from_steps(
    amplitudes: ArrayLike, settled: ArrayLike, *, flat: float = FLAT, name: str = "measured nonlinearity"
) -> PiecewiseAffine:
    """Return the nonlinearity that step tests show: piecewise linear, flat where it hardly rises.

    Section 6 of Lacy, Erwin and Bernstein (2001): after a step of amplitude u the output settles at
    N(G(1) u), and as gain can be moved between the two blocks G(1) = 1 may be taken; identify the linear
    system with ``normalisation="dc-gain"``, eq. (28). A system with G(1) = 0 settles at N(0) for every step.

    Parameters
    ----------
    amplitudes : array_like, shape (n_steps,)
        Amplitudes of the steps, in any order, no two equal.
    settled : array_like, shape (n_steps,)
        Outputs after the transient.
    flat : float
        A segment that rises by no more than this share of the whole range of the outputs is made constant:
        otherwise rounding or noise would give a constant region the preimage of a point.
    name : str

    Returns
    -------
    PiecewiseAffine
        Its domain is the range of the amplitudes.

    Raises
    ------
    DataError
        If there are fewer than two steps, two are equal, or a value is not finite.
    IdentifiabilityError
        If the outputs do not depend on the amplitude.

    Examples
    --------
    >>> found = nonlinearity_from_steps([-2, -1, 0, 1, 2], [-1, 0, 1e-6, 0, 1])
    >>> found.slope.tolist()
    [1.0, 0.0, 0.0, 1.0]
    >>> found.preimage([0.0]).lower, found.preimage([0.0]).upper
    (array([-1.]), array([1.]))
    """
    u, z = np.array(amplitudes, dtype=np.float64), np.array(settled, dtype=np.float64)
    if u.shape != z.shape or u.ndim != 1 or u.size < 2:
        raise DataError(
            f"{u.size} amplitudes and {z.size} settled outputs: give one output a step, two steps or more"
        )
    if not np.all(np.isfinite(u)) or not np.all(np.isfinite(z)):
        k = int(np.flatnonzero(~(np.isfinite(u) & np.isfinite(z)))[0])
        raise DataError(f"step {k} has amplitude {u[k]} and output {z[k]}: leave it out")
    order = np.argsort(u)
    u, z = u[order], z[order]
    if np.any(np.diff(u) == 0):
        twice = u[:-1][np.diff(u) == 0][0]
        raise DataError(f"two steps have the amplitude {twice:g}: average their outputs")
    whole = float(np.ptp(z))
    if whole == 0.0:
        raise IdentifiabilityError(
            f"all {u.size} steps settle at {z[0]:g}: G(1) is zero or every step lies in one constant "
            "region; step tests cannot show this nonlinearity"
        )
    # Runs of flat segments share one level, the mean of their ends, so that the region stays one.
    level = z.copy()
    is_flat = np.abs(np.diff(z)) <= flat * whole
    start = 0
    while start < is_flat.size:
        if not is_flat[start]:
            start += 1
            continue
        stop = start
        while stop < is_flat.size and is_flat[stop]:
            stop += 1
        # A slow slope made of many small rises is no constant region.
        if np.ptp(z[start : stop + 1]) <= 2 * flat * whole:
            level[start : stop + 1] = float(np.median(z[start : stop + 1]))
        start = stop
    return PiecewiseAffine.interpolating(name, u, level)
