"""Thresholds of jumping maps: a record tells only between which two of its inputs they lie."""

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.structures.structure import Choice


def is_switched_by_input(choice: Choice) -> bool:
    """Tell whether an effect jumps at thresholds of the input."""
    return choice.effect.port == "input" and not choice.form.smooth


def middle_of_cell(levels: Floats, value: float) -> float:
    """Return the middle between the two levels around a threshold: other rows are least often misjudged.

    Parameters
    ----------
    levels : ndarray
        Sizes of the input, in rising order.
    value : float

    Examples
    --------
    >>> levels = np.array([0.1, 0.4, 0.8])
    >>> round(middle_of_cell(levels, 0.41), 3), round(middle_of_cell(levels, 0.4), 3)
    (0.6, 0.6)
    >>> middle_of_cell(levels, 0.05), middle_of_cell(levels, 0.9)
    (0.05, 0.9)
    """
    place = int(np.searchsorted(levels, value, side="right"))
    if not 0 < place < levels.size:
        return value
    return float(0.5 * (levels[place - 1] + levels[place]))
