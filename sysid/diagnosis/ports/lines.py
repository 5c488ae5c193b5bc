"""Directions in which a map may differ from what the linear part already has."""

from dataclasses import replace

import numpy as np

from sysid.diagnosis.ports.loop import DEGREE, Loop, Stretch
from sysid.diagnosis.ports.plants import Port
from sysid.linear.forms import Floats
from sysid.nonlinearities.spline import spline_basis

# A straight line of which less than this share is left beside the linear part's derivatives is absorbed.
ABSORBED = 0.05
# Prior spread of the second differences of the coefficients, in standard deviations of the changed signal:
# decides only where there are no data.
PRIOR_SPREAD = 3.0


def loop_without_lines(
    port: Port,
    baseline: tuple[Loop, Floats],
    knots: Floats,
    z: Floats,
    feed: tuple[Floats, ...],
    error: float,
) -> tuple[Loop, Floats]:
    """Return the problem whose map leaves out the straight lines that the linear part absorbs.

    Parameters
    ----------
    port : Port
    baseline : tuple of Loop and ndarray
        The plant alone, and its point.
    knots : ndarray
    z : ndarray
        What the map is fed with on the fitted rows.
    feed : tuple of ndarray
        The known signals that feed it; empty where the loop does.
    error : float
        Sum of squared errors to be expected: the measure of the prior's weight.

    Returns
    -------
    Loop
    ndarray, shape (2, n_lines)
        The absorbed lines: weights on 1 and z.
    """
    alone, base_point = baseline
    n_map = knots.size - 1 + DEGREE
    free = replace(
        alone, port=port, knots=knots, directions=np.eye(n_map), prior=np.zeros((0, n_map)), fed=feed
    )
    lines = _absorbed_lines(free, base_point, z)
    # Orthogonal over the data: the mean of f(z) times each absorbed line is zero.
    moments = lines.T @ np.vstack([np.ones(z.size), z]) @ spline_basis(z, knots, degree=DEGREE) / z.size
    directions = _orthogonal_complement(moments, n_map)
    weight = np.sqrt(error / z.size) / (PRIOR_SPREAD * _signal_size(port, alone.stretches))
    return replace(free, directions=directions, prior=weight * np.diff(directions, 2, axis=0)), lines


def _absorbed_lines(free: Loop, base_point: Floats, z: Floats) -> Floats:
    """Return the lines (columns of weights on 1 and z) whose effect the linear part can have as well."""
    n_plant, n_map = free.n_plant, free.n_weights
    point = np.concatenate([base_point[:n_plant], np.zeros(n_map), base_point[n_plant:]])
    J = free.jacobian(point)
    nodes = _greville(free.knots)
    others = np.delete(J, np.s_[n_plant : n_plant + n_map], axis=1)
    scale = np.linalg.norm(others, axis=0)
    left, values, _ = np.linalg.svd(others / np.where(scale > 0.0, scale, 1.0), full_matrices=False)
    span = left[:, values > 1e-10 * values[0]]

    def absorbed(shape: Floats) -> bool:
        effect = J[:, n_plant : n_plant + n_map] @ shape
        rest = effect - span @ (span.T @ effect)
        return bool(np.linalg.norm(rest) < ABSORBED * np.linalg.norm(effect))

    lines = []
    if absorbed(np.ones(n_map)):
        lines.append([1.0, 0.0])
    origin = float(z.mean()) if lines else 0.0
    if absorbed(nodes - origin):
        lines.append([-origin, 1.0])
    return np.array(lines).reshape(-1, 2).T


def _greville(knots: Floats) -> Floats:
    """Return the coefficients of f(z) = z."""
    full = np.concatenate([np.full(DEGREE, knots[0]), knots, np.full(DEGREE, knots[-1])])
    return np.array([full[i + 1 : i + 1 + DEGREE].mean() for i in range(full.size - DEGREE - 1)])


def _orthogonal_complement(rows: Floats, size: int) -> Floats:
    if rows.shape[0] == 0:
        return np.eye(size)
    q, _ = np.linalg.qr(rows.T, mode="complete")
    return np.ascontiguousarray(q[:, rows.shape[0] :])


def _signal_size(port: Port, stretches: tuple[Stretch, ...]) -> float:
    """Return the standard deviation of the signal that the map changes."""
    if port.kind == "output":
        values = np.concatenate([s.y[s.fitted] for s in stretches])
    else:
        values = np.concatenate([s.u[s.fitted, port.channel] for s in stretches])
    return max(float(np.std(values)), float(np.abs(values).max()) * 1e-3, 1e-300)
