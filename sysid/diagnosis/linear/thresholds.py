"""Thresholds of maps that jump: on rows that they were not searched on, and how well they are known."""

from dataclasses import replace

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.levenberg import Minimum, minimise
from sysid.diagnosis.linear.narrowing import Narrowing
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.structures.plain_errors import UNSEEN
from sysid.diagnosis.structures.projection import orthonormal, without
from sysid.diagnosis.structures.thresholds import (
    is_switched_by_input,
    middle_of_cell,
    threshold_errors,
    threshold_places,
    with_threshold_errors,
)


def cells_around(chain: Chain, data: Data, minimum: Minimum, noise: Floats) -> Minimum:
    """Go on from cell to cell of the thresholds of the input, for as long as the next one is better.

    What was searched on some rows is known only to lie between two of their inputs; others may lie between
    these.

    Parameters
    ----------
    chain : Chain
    data : Data
    minimum : Minimum
    noise : ndarray
        D(q) of the noise.
    """
    places, free = chain.places(data), chain.smooth(data)

    def fit(point: Floats) -> Minimum | None:
        return minimise(chain, data, point, noise, free=free)

    for number, (place, choice) in enumerate(zip(places, chain.choices, strict=True)):
        if not is_switched_by_input(chain.choices, number):
            continue
        levels = _levels(chain, data, minimum.point, number)
        shapes = np.array(choice.form.shapes, dtype=np.intp) + place.start
        narrowing = Narrowing(minimum, shapes, [levels] * shapes.size, fit, lambda point: None)
        narrowing.walk(levels)
        point = narrowing.best.point.copy()
        point[shapes] = [middle_of_cell(levels, value) for value in point[shapes].tolist()]
        middle = fit(point) if choice.form.smooth else None  # where it moves, what is behind it moves as much
        minimum = replace(narrowing.best, point=point) if middle is None else middle
    return minimum


def with_errors_of_thresholds(
    chain: Chain, data: Data, point: Floats, noise: Floats, errors: Floats
) -> Floats:
    """Return standard errors with those of the thresholds of the input.

    Parameters
    ----------
    chain : Chain
    data : Data
    point : ndarray, shape (n_unknowns,)
    noise : ndarray
        D(q) of the noise, that of the residual also where the fit did not weigh by it.
    errors : ndarray, shape (n_unknowns,)
        With the thresholds held.
    """
    run = chain.run(data, point)
    if run is None:
        return errors
    J, free = chain.slopes(data, point, run, noise).T, chain.smooth(data)

    def cost(other: Floats) -> float:
        there = chain.run(data, other)
        if there is None:
            return np.inf
        tangent = orthonormal(chain.slopes(data, other, there, noise, free).T, least=UNSEEN)
        left = without(chain.error(data, there, noise), tangent)
        return float(left @ left)

    found = []
    for number, (place, choice) in enumerate(zip(chain.places(data), chain.choices, strict=True)):
        if is_switched_by_input(chain.choices, number):
            own = threshold_places(choice, place)
            levels = _levels(chain, data, point, number)
            found += threshold_errors(own, levels, point, cost, J.shape[0] - point.size)
    return with_threshold_errors(errors, J, free, found)


def _levels(chain: Chain, data: Data, point: Floats, number: int) -> Floats:
    """Return the sizes of what a map of the input is given, in rising order."""
    before = Chain(chain.order, chain.choices[:number], chain.constant, chain.free_start)
    return np.unique(np.abs(before.mapped(data, point)))
