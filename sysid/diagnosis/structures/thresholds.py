"""Thresholds of jumping maps: a record tells only between which two of its inputs they lie."""

from collections.abc import Callable, Sequence

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.structures.structure import Choice
from sysid.diagnosis.wording import NORMAL_95

# So many cells to each side are tried as the place of a threshold.
MOST_CELLS = 24
# What has a jump at its edges is a relay but for its slope.
DEAD_ZONE, JUMP, RELAY = "in_deadzone", "in_preload", "in_relay"


def jumps(choices: Sequence[Choice], which: int) -> bool:
    """Tell whether the output follows the shapes of an effect by jumps: its own, or one that it moves."""
    return not choices[which].form.smooth or moves_a_jump(choices, which)


def is_switched_by_input(choices: Sequence[Choice], which: int) -> bool:
    """Tell whether the shapes of an effect are thresholds of the input at which the output jumps."""
    return choices[which].effect.port == "input" and jumps(choices, which)


def followed_smoothly(choices: Sequence[Choice], places: Sequence[slice], size: int) -> Mask:
    """Tell which unknowns the output follows smoothly: all but the shapes of what jumps.

    Parameters
    ----------
    choices : sequence of Choice
    places : sequence of slice
        Where the parameters of each of them stand among the unknowns.
    size : int
        Number of unknowns.
    """
    found = np.ones(size, dtype=bool)
    for which, place in enumerate(places):
        if jumps(choices, which):
            found[[place.start + shape for shape in choices[which].form.shapes]] = False
    return found


def moves_a_jump(choices: Sequence[Choice], which: int) -> bool:
    """Tell whether an effect is a dead zone before a jump, which is then at its edges, thresholds of u.

    Examples
    --------
    >>> from sysid.diagnosis.effects.catalogue import find_effects
    >>> names = ["in_deadzone", "in_preload"]
    >>> zone, jump = (Choice(effect, effect.forms[0]) for effect in find_effects(names))
    >>> moves_a_jump([zone, jump], 0), moves_a_jump([jump, zone], 1)
    (True, False)
    """
    behind = (choice.name for choice in choices[which + 1 :])
    return choices[which].name == DEAD_ZONE and JUMP in behind


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


def threshold_error(levels: Floats, value: float, rises: Callable[[Floats], Floats]) -> float:
    """Return the standard error of a threshold whose 95 % interval is the cells in which it may lie.

    Parameters
    ----------
    levels : ndarray
        Sizes of the input, in rising order.
    value : float
    rises : callable
        For thresholds, by how many noise variances the sum of squares is above that of ``value``.

    Examples
    --------
    >>> levels = np.array([1.0, 2.0, 3.0, 4.0])
    >>> round(1.96 * threshold_error(levels, 2.5, lambda values: 9.0 * (values > 4.0)), 2)
    2.5
    """
    edges = np.concatenate([[0.0], levels[levels > 0.0]])
    place = int(np.clip(np.searchsorted(edges, value, side="right"), 1, edges.size - 1))
    first, last = max(place - MOST_CELLS, 1), min(place + MOST_CELLS, edges.size - 1)
    places = np.arange(first, last + 1)
    may_be = rises(0.5 * (edges[places - 1] + edges[places])) < NORMAL_95**2
    may_be[place - first] = True
    excluded = places[~may_be]
    low = max(excluded[excluded < place], default=first - 1)
    high = min(excluded[excluded > place], default=last + 1)
    return float(max(value - edges[low], edges[high - 1] - value)) / NORMAL_95
