"""Maximum feasible subsystem by randomised thermal relaxation, compiled.

Each point asks |w - f(z)| <= delta of an affine f.  One submodel cannot satisfy all of them; that which
satisfies most is searched for, as Amaldi and Mattavelli (2002) do, by correcting f for one violated point
after the other, with corrections that die out as the temperature falls and, at any temperature,
count for little where the violation is large, so that hopeless points do not pull.
"""

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled
from sysid.nonlinearities.piecewise_affine.kernels import fit_modes

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]


@compiled
def put(source: Floats, target: Floats) -> None:
    """Copy a submodel; loops are far quicker to compile than an assignment of slices."""
    for j in range(source.shape[0]):
        for c in range(source.shape[1]):
            target[j, c] = source[j, c]


@compiled
def misfit(z: Floats, w: Floats, theta: Floats, k: int) -> float:
    """Return the largest residual, over the outputs, of point ``k``."""
    n_z = z.shape[1]
    worst = 0.0
    for c in range(w.shape[1]):
        value = w[k, c] - theta[n_z, c]
        for j in range(n_z):
            value -= theta[j, c] * z[k, j]
        worst = max(worst, abs(value))
    return worst


@compiled
def satisfied(z: Floats, w: Floats, theta: Floats, delta: float) -> int:
    """Return how many points lie within the bound."""
    count = 0
    for k in range(z.shape[0]):
        count += misfit(z, w, theta, k) <= delta
    return count


@compiled
def relax(z: Floats, w: Floats, theta: Floats, delta: float, orders: Labels, hot: float) -> int:
    """Improve ``theta`` in place, shape (n_z + 1, n_w); return how many points it satisfies.

    ``orders`` (cycles, n_points) says in which order each cycle visits the points; the temperature falls
    from ``hot`` to zero.
    """
    n_z = z.shape[1]
    cycles = orders.shape[0]
    now = theta.copy()
    best = satisfied(z, w, theta, delta)
    for cycle in range(cycles):
        temperature = hot * (1.0 - cycle / cycles)
        for k in orders[cycle]:
            norm = 1.0
            for j in range(n_z):
                norm += z[k, j] * z[k, j]
            for c in range(w.shape[1]):
                residual = w[k, c] - now[n_z, c]
                for j in range(n_z):
                    residual -= now[j, c] * z[k, j]
                violation = abs(residual) - delta
                if violation <= 0.0:
                    continue
                step = temperature / hot * np.exp(-violation / temperature) / norm
                step = min(step, violation / norm)
                if residual < 0.0:
                    step = -step
                now[n_z, c] += step
                for j in range(n_z):
                    now[j, c] += step * z[k, j]
        count = satisfied(z, w, now, delta)
        if count > best:
            best = count
            put(now, theta)
    return best


@compiled
def grow(z: Floats, w: Floats, theta: Floats, delta: float) -> int:
    """Fit ``theta`` by least squares to the points it satisfies, as long as these become more."""
    labels = np.empty(z.shape[0], np.intp)
    counts = np.empty(1, np.intp)
    trial = np.empty((1, theta.shape[0], theta.shape[1]))
    best = satisfied(z, w, theta, delta)
    while best > z.shape[1]:
        for k in range(z.shape[0]):
            labels[k] = 0 if misfit(z, w, theta, k) <= delta else -1
        fit_modes(z, w, labels, trial, counts)
        count = satisfied(z, w, trial[0], delta)
        if count <= best:
            break
        best = count
        put(trial[0], theta)
    return best


@compiled
def largest_subsystem(
    z: Floats, w: Floats, delta: float, members: Labels, orders: Labels, theta: Floats
) -> int:
    """Fill the submodel that satisfies the most points, of several starts; return how many.

    The first start is the fit of all points, the others are those of ``members`` (n_starts, size).
    """
    n = z.shape[0]
    now = np.zeros((1, theta.shape[0], theta.shape[1]))
    labels, counts = np.empty(n, np.intp), np.empty(1, np.intp)
    best = -1
    for start in range(-1, members.shape[0]):
        labels[:] = 0 if start < 0 else -1
        if start >= 0:
            for k in members[start]:
                labels[k] = 0
        fit_modes(z, w, labels, now, counts)
        count, total = 0, 0.0
        for k in range(n):
            violation = misfit(z, w, now[0], k) - delta
            if violation > 0.0:
                total += violation
                count += 1
        if count > 0:
            relax(z, w, now[0], delta, orders, total / count)
        found = grow(z, w, now[0], delta)
        if found > best:
            best = found
            put(now[0], theta)
    return best
