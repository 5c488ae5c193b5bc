"""What the search over cells and its refinement share: the rows of the regression, the form of a minimum."""

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

DEPENDENT = 1e-13
"""A pivot this small relative to its squared column norm is rounding."""

# Columns of a point on the profile of the cost: the parameter range it stands for (a point or a flat
# cell), the cost, the cell it lies in and the number of events applied in that cell.
LOW, HIGH, COST, CELL_LEFT, CELL_RIGHT, EVENTS, FLAT = range(7)
POINT = 7


@compiled
def fill_row(
    fixed: Floats, y: Floats, times: Indices, lags: Indices, p: Floats, q: Floats, row: int, z: Floats
) -> None:
    """Fill ``z`` with one row of [fixed, p lagged, q lagged, y]."""
    n_fixed, n_lags = fixed.shape[1], lags.size
    for i in range(n_fixed):
        z[i] = fixed[row, i]
    for j in range(n_lags):
        sample = times[row] - lags[j]
        z[n_fixed + j] = p[sample]
        z[n_fixed + n_lags + j] = q[sample]
    z[n_fixed + 2 * n_lags] = y[row]
