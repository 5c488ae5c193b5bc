"""Thresholds of jumping maps: a record tells only between which two of its inputs they lie."""

from collections.abc import Callable, Sequence

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.structures.plain_errors import UNSEEN
from sysid.diagnosis.structures.structure import Choice
from sysid.diagnosis.wording import NORMAL_95

# Cells in which a threshold may lie are tried one by one, farther away each so many times as far as the last.
FARTHER = 1.2
# The 95 % interval of a threshold reaches so many noise variances above the least sum of squares: the rise to
# the true threshold has the distribution (1 - exp(-x / 2))^2.
RISE = float(-2.0 * np.log(1.0 - np.sqrt(0.95)))
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


def threshold_error(levels: Floats, value: float, rise: Callable[[float], float]) -> float:
    """Return the standard error of a threshold whose 95 % interval spans the cells in which it may lie.

    From cell to cell the sum of squares wanders, as rows are judged otherwise: its least value over all cells
    is lower than that at the true one by more than where it is a parabola, and behind a cell that is less
    likely there may be others.

    Parameters
    ----------
    levels : ndarray
        Sizes of the input, in rising order.
    value : float
    rise : callable
        By how many noise variances the sum of squares at a threshold is above that at ``value``.

    References
    ----------
    Hansen (2000), Sample splitting and threshold estimation, Econometrica 68, 575-603, theorem 2.

    Examples
    --------
    >>> levels = np.array([1.0, 2.0, 3.0, 4.0])
    >>> round(1.96 * threshold_error(levels, 2.5, lambda threshold: 9.0 * (threshold > 4.0)), 2)
    2.5
    """
    edges = np.concatenate([[0.0], levels[levels > 0.0]])
    place = int(np.clip(np.searchsorted(edges, value, side="right"), 1, edges.size - 1))
    away = np.unique(np.rint(FARTHER ** np.arange(np.log(edges.size) / np.log(FARTHER))).astype(np.intp))
    places = np.concatenate([place - away[::-1], [place], place + away])
    places = places[(places > 0) & (places < edges.size)]
    rises = np.array([rise(middle) for middle in (0.5 * (edges[places - 1] + edges[places])).tolist()])
    may_be = (rises < RISE) | (places == place)
    first, last = np.flatnonzero(may_be)[[0, -1]]
    low = edges[places[first - 1]] if first > 0 else edges[0]
    high = edges[places[last + 1] - 1] if last + 1 < places.size else edges[-1]
    return float(max(value - low, high - value)) / NORMAL_95


def threshold_errors(
    places: Sequence[int], levels: Floats, point: Floats, cost: Callable[[Floats], float], freedom: int
) -> list[tuple[int, float]]:
    """Return where thresholds stand and their standard errors.

    Slopes say nothing of them: the output changes only where a row is judged otherwise.

    Parameters
    ----------
    places : sequence of int
        Of the thresholds among the unknowns.
    levels : ndarray
        Sizes of what the effect is given, in rising order.
    point : ndarray, shape (n_unknowns,)
    cost : callable
        Sum of squares at a point, once what the output follows smoothly has followed.
    freedom : int
        Number of rows less that of unknowns.
    """
    best = cost(point)
    variance = max(best / max(freedom, 1), 1e-300)
    found = []
    for place in places:

        def rise(value: float, place: int = place) -> float:
            moved = point.copy()
            moved[place] = value
            return (cost(moved) - best) / variance

        found.append((place, threshold_error(levels, float(point[place]), rise)))
    return found


def threshold_places(choice: Choice, place: slice) -> list[int]:
    """Return where the shapes of an effect that are sizes of the input stand among the unknowns."""
    parameters = choice.form.parameters
    return [place.start + shape for shape in choice.form.shapes if parameters[shape].unit == "[u]"]


def with_threshold_errors(
    errors: Floats, J: Floats, free: Mask, thresholds: Sequence[tuple[int, float]]
) -> Floats:
    """Return standard errors with those of thresholds, and what these leave open in other unknowns.

    A dead zone before a jump may be wider by as much as the jump is higher.

    Parameters
    ----------
    errors : ndarray, shape (n_unknowns,)
        With the thresholds held.
    J : ndarray, shape (n_rows, n_unknowns)
        Slopes, those by thresholds inside their cells.
    free : ndarray of bool, shape (n_unknowns,)
        Unknowns that the output follows smoothly.
    thresholds : sequence of (int, float)
        Where they stand, and their standard errors.

    Examples
    --------
    >>> J = np.array([[1.0, -1.0], [1.0, -1.0]])
    >>> with_threshold_errors(np.array([0.3, np.nan]), J, np.array([True, False]), [(1, 0.4)]).round(9)
    array([0.5, 0.4])
    """
    errors, scale = errors.copy(), np.linalg.norm(J, axis=0)
    free = free & (scale > 0.0)
    for place, error in thresholds:
        follows = np.linalg.lstsq(J[:, free] / scale[free], J[:, place], rcond=UNSEEN)[0] / scale[free]
        errors[free] = np.hypot(errors[free], follows * error)
        errors[place] = error
    return errors
