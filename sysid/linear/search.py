"""Descent over the poles, kept inside the unit circle."""

from dataclasses import dataclass

import numpy as np

from sysid.linear.forms import Floats
from sysid.linear.reduction import Projection, Reduction, Segment, Structure
from sysid.separable.descent import descend

COST_FLOOR = 1e-24
K2_RANGE = (-0.999, 1.0)


@dataclass(frozen=True)
class Search:
    """Where a search over the poles ended, and why."""

    reflections: Floats
    projection: Projection
    converged: bool
    message: str

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return self.projection.cost


def search_poles(
    segments: tuple[Segment, ...],
    structure: Structure,
    start: Floats,
    smallest_step: float,
    max_evaluations: int = 80,
) -> Search:
    """Minimise the sum of squared free-run errors from one start.

    The unknowns are reflection coefficients in a box, so that no iterate is unstable; a
    coefficient at its bound stays there while the step would leave the box.

    Parameters
    ----------
    segments : tuple of Segment
    structure : Structure
    start : ndarray, shape (order,)
        Reflection coefficients.
    smallest_step : float
        Share of a standard error below which a step is not worth taking.
    max_evaluations : int

    Returns
    -------
    Search
    """
    bounds = _box(structure.order)
    total = sum(float(segment.y[segment.used] @ segment.y[segment.used]) for segment in segments)
    n_rows = sum(int(segment.used.sum()) for segment in segments)
    freedom = max(n_rows - structure.n_parameters(segments[0].u.shape[1]), 1)
    minimum = descend(
        lambda reflections: Reduction(segments, structure, reflections),
        np.clip(start, *bounds),
        bounds=bounds,
        tolerance=0.0,  # near an integrator the scales are too far apart for a tolerance on the step
        # A step of one standard error in every parameter is worth one noise variance each.
        negligible=smallest_step**2 * structure.order / freedom,
        zero=COST_FLOOR * total,
        max_evaluations=max_evaluations,
    )
    converged = minimum.status.converged
    message = (
        "converged: the next step is far below a standard error"
        if converged
        else f"stopped after {minimum.n_evaluations} evaluations, still improving"
    )
    return Search(minimum.x, minimum.point.projection, converged, message)


def _box(order: int) -> tuple[Floats, Floats]:
    lower, upper = -np.ones(order), np.ones(order)
    lower[1::2], upper[1::2] = K2_RANGE
    return lower, upper
