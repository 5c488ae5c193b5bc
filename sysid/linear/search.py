"""Levenberg-Marquardt over the poles, kept inside the unit circle."""

from dataclasses import dataclass

import numpy as np

from sysid.linear.forms import Floats
from sysid.linear.reduction import Projection, Reduction, Segment, Structure

COST_FLOOR = 1e-24
K2_RANGE = (-0.999, 1.0)
LARGEST_DAMPING = 1e12


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
        if now.cost <= COST_FLOOR * total or gain <= smallest_step**2 * structure.order * noise:
            return Search(k, now, True, iteration, "converged: the next step is far below a standard error")
        while True:
            step = _damped_step(J / scale, r, damping) / scale
            trial = np.clip(k + step, lower, upper)
            candidate = Reduction(segments, structure, trial)
            then = candidate.project()
            if then.cost < now.cost:
                break
            damping *= 4.0
            if damping > LARGEST_DAMPING or np.abs(trial - k).max() < 1e-15:
                return Search(k, now, True, iteration, "converged: no step lowers the error further")
        predicted = float(r @ r - np.sum((r - J @ (trial - k)) ** 2))
        damping = damping / 5.0 if now.cost - then.cost > 0.5 * predicted else damping * 2.0
        damping = max(damping, 1e-12)
        k, reduction, now = trial, candidate, then
    return Search(k, now, False, max_iterations, f"stopped after {max_iterations} iterations, still improving")


def _box(order: int) -> tuple[Floats, Floats]:
    lower, upper = -np.ones(order), np.ones(order)
    lower[1::2], upper[1::2] = K2_RANGE
    return lower, upper


def _possible_gain(J: Floats, r: Floats) -> float:
    """Return how much a full step could lower the cost if the model were linear."""
    left, values, _ = np.linalg.svd(J)
    seen = values > 1e-10 * max(values.max(initial=0.0), 1e-300)
    return float(np.sum((left.T @ r)[: values.size][seen] ** 2))


def _damped_step(J: Floats, r: Floats, damping: float) -> Floats:
    n = J.shape[1]
    stacked = np.vstack([J, np.sqrt(damping) * np.eye(n)])
    return np.asarray(np.linalg.lstsq(stacked, np.concatenate([r, np.zeros(n)]), rcond=None)[0])
