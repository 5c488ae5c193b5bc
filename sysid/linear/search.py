"""Levenberg-Marquardt over the poles, kept inside the unit circle."""

from dataclasses import dataclass

import numpy as np

from sysid.linear.forms import Floats
from sysid.linear.reduction import Projection, Reduction, Segment, Structure

COST_FLOOR = 1e-24
K2_RANGE = (-0.999, 1.0)


@dataclass(frozen=True)
class Search:
    """Where a search over the poles ended, and why."""

    reflections: Floats
    projection: Projection
    converged: bool
    iterations: int
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
    max_iterations: int = 60,
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
    max_iterations : int

    Returns
    -------
    Search
    """
    lower, upper = _box(structure.order)
    k = np.clip(start, lower, upper)
    total = sum(float(segment.y[segment.used] @ segment.y[segment.used]) for segment in segments)
    n_rows = sum(int(segment.used.sum()) for segment in segments)
    reduction = Reduction(segments, structure, k)
    now = reduction.project()
    damping = 1e-3
    for iteration in range(max_iterations):
        J, r = reduction.linearise(now)
        gradient = J.T @ r
        stuck = ((k <= lower) & (gradient < 0.0)) | ((k >= upper) & (gradient > 0.0))
        J[:, stuck] = 0.0
        scale = np.linalg.norm(J, axis=0)
        scale[scale == 0.0] = 1.0
        gain = _possible_gain(J / scale, r)
        noise = now.cost / max(n_rows - structure.n_parameters(segments[0].u.shape[1]), 1)
        negligible = max(smallest_step**2 * structure.order * noise, COST_FLOOR * total)
        if now.cost <= COST_FLOOR * total or gain <= negligible:
            return Search(k, now, True, iteration, "converged: the next step is far below a standard error")
        while True:
            trial = k + _step_in_box(J, r, scale, damping, lower - k, upper - k)
            candidate = Reduction(segments, structure, trial)
            then = candidate.project()
            if then.cost < now.cost:
                break
            damping *= 4.0
            if _decrease(J, r, trial - k) < negligible:
                return Search(k, now, True, iteration, "converged: no step lowers the error further")
        better_than_half = now.cost - then.cost > 0.5 * _decrease(J, r, trial - k)
        damping = damping / 5.0 if better_than_half else damping * 2.0
        damping = max(damping, 1e-12)
        k, reduction, now = trial, candidate, then
    return Search(
        k, now, False, max_iterations, f"stopped after {max_iterations} iterations, still improving"
    )


def _box(order: int) -> tuple[Floats, Floats]:
    lower, upper = -np.ones(order), np.ones(order)
    lower[1::2], upper[1::2] = K2_RANGE
    return lower, upper


def _possible_gain(J: Floats, r: Floats) -> float:
    """Return how much a full step could lower the cost if the model were linear."""
    left, values, _ = np.linalg.svd(J)
    seen = values > 1e-10 * max(values.max(initial=0.0), 1e-300)
    return float(np.sum((left.T @ r)[: values.size][seen] ** 2))


def _decrease(J: Floats, r: Floats, step: Floats) -> float:
    """Return how much a step would lower the cost if the model were linear."""
    return float(r @ r - np.sum((r - J @ step) ** 2))


def _step_in_box(
    J: Floats, r: Floats, scale: Floats, damping: float, lowest: Floats, highest: Floats
) -> Floats:
    """Return the damped step; what would leave the box ends at its bound, the rest is solved anew."""
    step = np.zeros(J.shape[1])
    free = np.ones(J.shape[1], dtype=bool)
    while free.any():
        scaled = J[:, free] / scale[free]
        left = r - J[:, ~free] @ step[~free]
        stacked = np.vstack([scaled, np.sqrt(damping) * np.eye(scaled.shape[1])])
        target = np.concatenate([left, np.zeros(scaled.shape[1])])
        step[free] = np.linalg.lstsq(stacked, target, rcond=None)[0] / scale[free]
        inside = np.clip(step, lowest, highest)
        out = free & (inside != step)
        if not out.any():
            break
        step[out] = inside[out]
        free &= ~out
    return step
