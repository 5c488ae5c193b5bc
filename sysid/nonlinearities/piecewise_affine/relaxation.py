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
            theta[:] = now
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
        theta[:] = trial[0]
    return best


@compiled
def neighbourhood(z: Floats, w: Floats, seed: int, near: int, theta: Floats) -> None:
    """Fill the least-squares submodel of the ``near`` points nearest to point ``seed``."""
    distance = np.zeros(z.shape[0])
    for k in range(z.shape[0]):
        for j in range(z.shape[1]):
            distance[k] += (z[k, j] - z[seed, j]) ** 2
    bound = np.partition(distance, near - 1)[near - 1]
    labels = np.empty(z.shape[0], np.intp)
    for k in range(z.shape[0]):
        labels[k] = 0 if distance[k] <= bound else -1
    one = np.zeros((1, theta.shape[0], theta.shape[1]))
    fit_modes(z, w, labels, one, np.empty(1, np.intp))
    theta[:] = one[0]


@compiled
def largest_subsystem(
    z: Floats, w: Floats, delta: float, seeds: Labels, near: int, orders: Labels, theta: Floats
) -> int:
    """Fill the submodel that satisfies the most points, of one start a seed; return how many.

    A seed < 0 starts from the fit of all points, another one from that of its neighbourhood.
    """
    n = z.shape[0]
    now = np.zeros(theta.shape)
    violations = np.empty(n)
    best = -1
    for seed in seeds:
        neighbourhood(z, w, max(seed, 0), n if seed < 0 else near, now)
        count = 0
        for k in range(n):
            violation = misfit(z, w, now, k) - delta
            if violation > 0.0:
                violations[count] = violation
                count += 1
        if count > 0:
            relax(z, w, now, delta, orders, np.median(violations[:count]))
        found = grow(z, w, now, delta)
        if found > best:
            best = found
            theta[:] = now
    return best
