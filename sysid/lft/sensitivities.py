"""The compiled free run of an LFT model together with its derivatives by all parameters."""

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled
from sysid.nonlinearities.spline_kernels import clamped, local_basis

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


@compiled
def run_with_sensitivities(
    u: Floats,
    fed: Floats,
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
    by: Floats,
) -> None:
    """Write the free run into ``fed`` and its derivatives into ``by``, shape (n_samples, n_parameters).

    Parameters stand as a1.., b.., g1.., d.., c..; the knots are held.  The first rows of ``fed`` are
    measured lags; before row 0 all signals are zero.
    """
    n, n_a, n_b, n_g, n_d = u.shape[0], a.size - 1, b.size, g.size - 1, d.size
    at_g, at_d = n_a + n_b, n_a + n_b + n_g
    at_c = at_d + n_d
    n_all = by.shape[1]
    full = clamped(knots, degree)
    values, slopes = np.empty(degree + 1), np.empty(degree + 1)
    # Rows of w and its derivatives are shifted by n_g: the first ones hold the map at rest.
    w, w_by = np.zeros(n + n_g), np.zeros((n + n_g, n_all))
    begin = local_basis(0.0, knots, full, degree, extrapolation, values, slopes)
    for k in range(n_g):
        for r in range(degree + 1):
            w[k] += values[r] * coefficients[begin + r]
            w_by[k, at_c + begin + r] = values[r]
    for k in range(max(first - n_g, 0), n):
        z = 0.0
        here = w_by[k + n_g]
        for i in range(n_d):
            row = k - z_delay[i]
            if row < 0:
                continue
            tap = fed[row] if z_channel[i] < 0 else u[row, z_channel[i]]
            z += d[i] * tap
            here[at_d + i] += tap
            if z_channel[i] < 0 and row >= first:
                for p in range(n_all):
                    here[p] += d[i] * by[row, p]
        begin = local_basis(z, knots, full, degree, extrapolation, values, slopes)
        value, slope = 0.0, 0.0
        for r in range(degree + 1):
            value += values[r] * coefficients[begin + r]
            slope += slopes[r] * coefficients[begin + r]
        for p in range(n_all):
            here[p] *= slope
        for r in range(degree + 1):
            here[at_c + begin + r] += values[r]
        w[k + n_g] = value
        if k < first:
            continue
        total = 0.0
        now = by[k]
        for i in range(n_g + 1):
            total += g[i] * w[k + n_g - i]
            before = w_by[k + n_g - i]
            for p in range(n_all):
                now[p] += g[i] * before[p]
            if i > 0:
                now[at_g + i - 1] += w[k + n_g - i]
        for i in range(1, n_a + 1):
            if k - i >= 0:
                total -= a[i] * fed[k - i]
                now[i - 1] -= fed[k - i]
                if k - i >= first:
                    before = by[k - i]
                    for p in range(n_all):
                        now[p] -= a[i] * before[p]
        for i in range(n_b):
            row = k - b_delay[i]
            if row >= 0:
                total += b[i] * u[row, b_channel[i]]
                now[n_a + i] += u[row, b_channel[i]]
        fed[k] = total
