"""The step of the converter or of the print-out in which a signal was written down."""

import numpy as np

from sysid.data.labels import Floats

# A grid counts when every value lies this near to it, in steps; few levels are a staircase by design.
GRID_TOLERANCE = 0.05
FEWEST_LEVELS = 12
FEWEST_ROWS = 100
# Two levels of which the greatest common step is this part of their smallest distance are still recognised.
LARGEST_PART = 4
# Rounding to a step q leaves an error of q / sqrt(12).
ROUNDING = 1.0 / np.sqrt(12.0)
# Share of the signal's standard deviation from which the rounding error is worth a word.
NOTABLE_SHARE = 0.005


def quantisation_step(values: Floats) -> float | None:
    """Return the step of the grid on which all values lie, or None if there is none.

    Parameters
    ----------
    values : ndarray, shape (n_samples,)
        NaN where nothing was measured.

    Returns
    -------
    float or None
        In the unit of the values.

    Examples
    --------
    >>> import numpy as np
    >>> level = np.sin(np.arange(300.0))
    >>> round(quantisation_step(np.round(level / 0.04) * 0.04), 9)
    0.04
    >>> quantisation_step(level) is None
    True
    """
    levels = np.unique(values[np.isfinite(values)])
    if levels.size < FEWEST_LEVELS:
        return None
    gaps = np.diff(levels)
    # Levels that differ by the last digits of a float are one level.
    gaps = gaps[gaps > 1e-12 * max(abs(levels[0]), abs(levels[-1]))]
    if gaps.size < FEWEST_LEVELS - 1:
        return None
    smallest = float(gaps.min())
    for part in range(1, LARGEST_PART + 1):
        counts = np.cumsum(np.round(gaps * part / smallest))
        step = float(np.sum(gaps) / counts[-1])
        if np.abs(np.cumsum(gaps) - step * counts).max() <= GRID_TOLERANCE * step:
            return step
    return None


def quantisation_warnings(values: Floats, name: str, unit: str, *, is_input: bool = False) -> list[str]:
    """Say where rounding alone leaves an error worth a word; an input may have been set in steps."""
    measured = values[np.isfinite(values)]
    if measured.size < FEWEST_ROWS:
        return []
    step, spread = quantisation_step(measured), float(np.std(measured))
    if step is None or step * ROUNDING < NOTABLE_SHARE * spread:
        return []
    unit = f" {unit}" if unit else ""
    rounded = "unless it was set so, rounding" if is_input else "rounding"
    return [
        f"{name!r} moves in steps of {step:.3g}{unit}, {100.0 * step / spread:.2g} % of its standard "
        f"deviation: {rounded} alone leaves an error of {step * ROUNDING:.2g}{unit} that no model explains; "
        "measure in a finer range, or write more digits"
    ]
