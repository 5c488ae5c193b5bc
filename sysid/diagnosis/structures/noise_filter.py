"""Filter of many lines at once by the polynomial of the noise."""

from typing import Any

import numpy as np

from sysid._compile import compiled
from sysid.diagnosis.effects.base import Floats


@compiled
def filtered_lines(lines: Floats, edges: Any, noise: Floats, opening: Floats) -> Floats:
    """Return lines made white by D(q), the first rows of each run by what there is of their past.

    Parameters
    ----------
    lines : ndarray, shape (n_lines, n_rows)
    edges : ndarray of int, shape (n_runs + 1,)
        Where the runs of rows that follow one another begin, and where the last one ends.
    noise : ndarray, shape (n_noise + 1,)
        D(q), leading 1 included.
    opening : ndarray, shape (n_noise, n_noise)
        Weights of the first rows; see `sysid.diagnosis.structures.whitening.opening`.

    Returns
    -------
    ndarray, shape (n_lines, n_rows)
    """
    out = np.empty(lines.shape)
    for i in range(lines.shape[0]):
        for k in range(lines.shape[1]):
            out[i, k] = lines[i, k]
        for run in range(edges.shape[0] - 1):
            first, last = edges[run], edges[run + 1]
            for lag in range(1, min(noise.shape[0], last - first)):
                factor = noise[lag]
                for k in range(first + lag, last):
                    out[i, k] += factor * lines[i, k - lag]
            for k in range(min(noise.shape[0] - 1, last - first)):
                total = 0.0
                for j in range(k + 1):
                    total += opening[k, j] * lines[i, first + j]
                out[i, first + k] = total
    return out
