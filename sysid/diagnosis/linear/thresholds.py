"""Thresholds of maps that jump, on rows that they were not searched on."""

from dataclasses import replace

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.levenberg import Minimum, minimise
from sysid.diagnosis.linear.narrowing import Narrowing
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.structures.thresholds import is_switched_by_input, middle_of_cell


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
        before = Chain(chain.order, chain.choices[:number], chain.constant, chain.free_start)
        levels = np.unique(np.abs(before.mapped(data, minimum.point)))
        shapes = np.array(choice.form.shapes, dtype=np.intp) + place.start
        narrowing = Narrowing(minimum, shapes, [levels] * shapes.size, fit, lambda point: None)
        narrowing.walk(levels)
        point = narrowing.best.point.copy()
        point[shapes] = [middle_of_cell(levels, value) for value in point[shapes].tolist()]
        middle = fit(point) if choice.form.smooth else None  # where it moves, what is behind it moves as much
        minimum = replace(narrowing.best, point=point) if middle is None else middle
    return minimum
