"""Compiled values of a smooth curve through samples."""

import numpy as np

from sysid._compile import compiled
from sysid.linear.forms import Floats


@compiled
def between_samples(lines: Floats, places: Floats) -> Floats:
    """Return the natural cubic spline through each line, at the same places between all samples.

    Shapes (n_lines, n_samples) and (n_lines, n_samples * n_places); the last sample is held.  Its second
    derivatives solve a tridiagonal system with 1, 4, 1 in each row.
    """
    n_lines, n = lines.shape
    count = places.shape[0]
    out = np.empty((n_lines, n * count))
    bend, factor = np.zeros(n), np.zeros(n)
    for i in range(1, n - 1):
        factor[i] = 1.0 / (4.0 - factor[i - 1])
    for line in range(n_lines):
        y, values = lines[line], out[line]
        bend[0] = bend[n - 1] = 0.0
        for i in range(1, n - 1):
            bend[i] = (6.0 * (y[i + 1] - 2.0 * y[i] + y[i - 1]) - bend[i - 1]) * factor[i]
        for i in range(n - 2, 0, -1):
            bend[i] -= factor[i] * bend[i + 1]
        for j in range(count):
            t, s = places[j], 1.0 - places[j]
            at_left, at_right = (s * s * s - s) / 6.0, (t * t * t - t) / 6.0
            for i in range(n - 1):
                values[i * count + j] = s * y[i] + t * y[i + 1] + at_left * bend[i] + at_right * bend[i + 1]
            values[(n - 1) * count + j] = y[n - 1]
    return out
