"""A level that wanders away with time while the inputs do not."""

import numpy as np

from sysid.data.labels import Floats

BLOCKS = 12
FEWEST_ROWS = 240
# The line must rise by this many standard deviations of what is left, and be this sure (two-sided, one
# chance in ten thousand with independent blocks).
SMALLEST_RISE = 1.0
SIGNIFICANCE = 1e-4


def drift_warnings(u: Floats, y: Floats, name: str, unit: str, first_row: int) -> list[str]:
    """Say where the level of an output rises or falls steadily and the inputs do not explain it.

    Means over a dozen blocks are explained by those of the inputs and by a straight line in time.

    Parameters
    ----------
    u : ndarray, shape (n_rows, n_inputs)
        One experiment.
    y : ndarray, shape (n_rows,)
        NaN on rows that are not looked at.
    name, unit : str
    first_row : int
        Row of the experiment's first sample, counted from 1.
    """
    rows = np.flatnonzero(np.isfinite(y))
    if rows.size < FEWEST_ROWS or u.shape[1] > BLOCKS // 3:
        return []
    blocks = np.array_split(rows, BLOCKS)
    level = np.array([y[block].mean() for block in blocks])
    moved = np.array([u[block].mean(axis=0) for block in blocks])
    time = np.linspace(-0.5, 0.5, BLOCKS)
    rise, error = _slope(level, np.column_stack([time, np.ones(BLOCKS), moved]))
    spread = float(np.std(y[rows] - rise * (rows - rows.mean()) / np.ptp(rows)))
    if abs(rise) < SMALLEST_RISE * spread:
        return []
    from scipy.special import stdtrit

    if abs(rise) < float(stdtrit(BLOCKS - 2 - u.shape[1], 1.0 - 0.5 * SIGNIFICANCE)) * error:
        return []
    unit = f" {unit}" if unit else ""
    return [
        f"{name!r} drifts: from row {first_row + rows[0]} to {first_row + rows[-1]} its level "
        f"{'rises' if rise > 0.0 else 'falls'} by {abs(rise):.3g}{unit} while the inputs do not explain it: "
        "a sensor that warms up, a slow disturbance or an integrating plant; take off the trend if it is not "
        "the plant's, or take rows where the level is steady"
    ]


def _slope(level: Floats, columns: Floats) -> tuple[float, float]:
    """Return the coefficient of the first column and its standard error."""
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0.0] = 1.0
    left, sizes, right = np.linalg.svd(columns / scale, full_matrices=False)
    seen = sizes > 1e-10 * sizes[0]
    inverse = (right[seen].T / sizes[seen]) / scale[:, np.newaxis]
    coefficients = inverse @ (left[:, seen].T @ level)
    residual = level - columns @ coefficients
    freedom = max(level.size - int(seen.sum()), 1)
    return float(coefficients[0]), float(
        np.linalg.norm(inverse[0]) * np.linalg.norm(residual) / np.sqrt(freedom)
    )
