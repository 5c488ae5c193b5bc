"""Directions in which an effect would change the free run of a linear model."""

import numpy as np

from sysid.diagnosis.effects.base import Effect, Floats
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.drives import too_many_drives
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.linear.search import EffectSearch
from sysid.diagnosis.structures.structure import WHITE, Choice


def directions_of(chain: Chain, data: Data, point: Floats, effect: Effect) -> list[Floats]:
    """Return how an effect, added to a chain, would change its free run, at a grid of its shapes.

    Each of shape (n_columns, n_rows): one line for each strength, or the change itself.
    """
    base = chain.run(data, point)
    beside = (*chain.choices, Choice(effect, effect.forms[0]))
    if base is None or effect.port == "noise" or too_many_drives(beside):
        return []
    found = []
    for form in effect.found_by:
        choices = (*chain.choices, Choice(effect, form))
        extended = Chain(chain.order, choices, chain.constant, chain.free_start)
        search = EffectSearch(extended, data, WHITE, [point])
        strengths = [i for i, p in enumerate(form.parameters) if p.is_strength]
        if len(search.grids) > 1 and not strengths and len(effect.forms) > 1:
            continue  # the symmetric form stands for the two-sided one
        for shapes in search.grid_points():
            start = search.joined(point, shapes)
            run = extended.run(data, start)
            if run is None:
                continue
            if strengths:
                found.append(extended.jacobian(data, start, run)[-len(form.parameters) :][strengths])
            else:
                found.append((run.y - base.y)[np.newaxis])
    return found
