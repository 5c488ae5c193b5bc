"""The compiled free run of an LFT model; with measured outputs fed back it is the one-step prediction."""

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled
from sysid.nonlinearities.spline_kernels import clamped, local_basis

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


@compiled
def run_experiment(
    u: Floats,
    fed: Floats,
    free: bool,
    first: int,
    a: Floats,
    b: Floats,
    b_channel: Indices,
    b_delay: Indices,
    g: Floats,
    d: Floats,
    z_channel: Indices,
    z_delay: Indices,
    knots: Floats,
    degree: int,
    extrapolation: int,
    coefficients: Floats,
    limit: float,
    y: Floats,
    z: Floats,
) -> int:
    """Fill output and z of one experiment from row ``first`` on; return the row that leaves, or -1.

    ``fed`` holds the outputs that are fed back; a free run writes its own ones there.  Signals before
    row 0 are zero.
    """
    n = u.shape[0]
    full = clamped(knots, degree)
    values, slopes = np.empty(degree + 1), np.empty(degree + 1)
    w = np.zeros(n + g.size)  # w[k + n_g] is w(k); before the experiment the map's value at rest
    n_g = g.size - 1
    longest = 0
    for i in range(z_delay.size):
        longest = max(longest, z_delay[i])
    start = max(first - n_g, 0)
    before = local_basis(0.0, knots, full, degree, extrapolation, values, slopes)
    rest = 0.0
    for r in range(degree + 1):
        rest += values[r] * coefficients[before + r]
    for k in range(n_g):
        w[k] = rest
    for k in range(start, n):
        place = 0.0
        for i in range(z_delay.size):
            row = k - z_delay[i]
            if row >= 0:
                place += d[i] * (fed[row] if z_channel[i] < 0 else u[row, z_channel[i]])
        z[k] = place
        begin = local_basis(place, knots, full, degree, extrapolation, values, slopes)
        value = 0.0
        for r in range(degree + 1):
            value += values[r] * coefficients[begin + r]
        w[k + n_g] = value
        if k < first:
            continue
        total = 0.0
        for i in range(g.size):
            total += g[i] * w[k + n_g - i]
        for i in range(1, a.size):
            if k - i >= 0:
                total -= a[i] * fed[k - i]
        for i in range(b.size):
            row = k - b_delay[i]
            if row >= 0:
                total += b[i] * u[row, b_channel[i]]
        y[k] = total
        if free:
            fed[k] = total
            if not abs(total) <= limit:
                return k
    return -1
