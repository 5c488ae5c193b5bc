"""Outputs of a model in the well-conditioned form it was fitted in."""

import numpy as np

from sysid.linear.forms import Floats
from sysid.linear.reduction import Columns, Projection, Segment, Structure


def fitted_output(
    segment: Segment, structure: Structure, reflections: Floats, projection: Projection, number: int
) -> tuple[Floats, Floats]:
    """Return the output of an experiment of the fit and the responses to its initial state."""
    forced, starts = responses(segment.u, structure, reflections, projection.shared)
    if structure.free_start:
        return forced + projection.starts[number] @ starts, starts
    return forced, starts


def responses(u: Floats, structure: Structure, reflections: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Return the response to input and constant, and those to the initial state, shape (order, n_rows)."""
    n_rows = u.shape[0]
    columns = Columns(structure, reflections, u)
    shared = np.empty((weights.size, n_rows))
    columns.fill_shared(0, n_rows, shared)
    starts = np.empty((structure.order if structure.free_start else 0, n_rows))
    if structure.free_start:
        columns.fill_start(0, n_rows, starts)
    return weights @ shared, starts
