"""Compiled parts of the Wiener criterion: elimination of theta, bounded descent over y."""

import math

import numpy as np

from sysid._compile import compiled
from sysid.nonlinearities.base import Floats
from sysid.nonlinearities.preimages import Indices

FREE, DC_GAIN, SUM_B = 0, 1, 2
"""Normalisations of theta: none, G(1) = 1 by eq. (28), sum(b) = 1.  The last two remove b0."""

_DEPENDENT = 1e-12


@compiled
def fill_regression(u: Floats, y: Floats, order: int, mode: int, columns: Floats, target: Floats) -> None:
    """Fill the regressors, shape (n_theta, p), and the target, shape (p,), of eq. (9) and (10).

    With a normalisation b0 is replaced, so that u(k) moves to the target and, for G(1) = 1, into the
    columns of the a's.
    """
    for row in range(target.shape[0]):
        now = order + row
        first = u[now] if mode != FREE else 0.0
        target[row] = y[now] - first
        for i in range(order):
            columns[i, row] = -y[now - 1 - i] + (first if mode == DC_GAIN else 0.0)
        if mode == FREE:
            columns[order, row] = u[now]
        skip = 1 if mode == FREE else 0
        for i in range(1, order + 1):
            columns[order + skip + i - 1, row] = u[now - i] - first


@compiled
def eliminate(columns: Floats, residual: Floats, factor: Floats, theta: Floats) -> float:
    """Project the residual off the columns, which become orthonormal; return its square.

    Gram-Schmidt with a second pass for every column and for the residual: orthogonal to rounding, and for
    these few short columns faster than a library call.  A dependent column becomes zero, its parameter 0.
    """
    n, p = columns.shape
    coefficient = np.zeros(n)
    for j in range(n):
        before = 0.0
        for k in range(p):
            before += columns[j, k] * columns[j, k]
        for i in range(n):
            factor[i, j] = 0.0
        for _ in range(2):
            for i in range(j):
                s = 0.0
                for k in range(p):
                    s += columns[i, k] * columns[j, k]
                factor[i, j] += s
                for k in range(p):
                    columns[j, k] -= s * columns[i, k]
        s = 0.0
        for k in range(p):
            s += columns[j, k] * columns[j, k]
        kept = s > _DEPENDENT * _DEPENDENT * before
        factor[j, j] = math.sqrt(s) if kept else 0.0
        for k in range(p):
            columns[j, k] = columns[j, k] / factor[j, j] if kept else 0.0
    for _ in range(2):
        for i in range(n):
            s = 0.0
            for k in range(p):
                s += columns[i, k] * residual[k]
            coefficient[i] += s
            for k in range(p):
                residual[k] -= s * columns[i, k]
    for i in range(n - 1, -1, -1):
        s = coefficient[i]
        for j in range(i + 1, n):
            s -= factor[i, j] * theta[j]
        theta[i] = s / factor[i, i] if factor[i, i] > 0.0 else 0.0
    total = 0.0
    for k in range(p):
        total += residual[k] * residual[k]
    return total


@compiled
def equation_error_gradient(theta: Floats, residual: Floats, order: int, gradient: Floats) -> None:
    """Fill 2 A(theta)^T r, the gradient of J_y^2: the residual filtered backwards by A."""
    gradient[:] = 0.0
    for row in range(residual.shape[0]):
        gradient[order + row] += 2.0 * residual[row]
        for i in range(order):
            gradient[order + row - 1 - i] += 2.0 * theta[i] * residual[row]


@compiled
def solve_positive(matrix: Floats, right: Floats, solution: Floats) -> bool:
    """Solve by Cholesky in place; False when the matrix is not positive definite."""
    n = right.shape[0]
    for j in range(n):
        s = matrix[j, j]
        for k in range(j):
            s -= matrix[j, k] * matrix[j, k]
        if not s > 0.0:
            return False
        matrix[j, j] = math.sqrt(s)
        for i in range(j + 1, n):
            s = matrix[i, j]
            for k in range(j):
                s -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = s / matrix[j, j]
    for i in range(n):
        s = right[i]
        for k in range(i):
            s -= matrix[i, k] * solution[k]
        solution[i] = s / matrix[i, i]
    for i in range(n - 1, -1, -1):
        s = solution[i]
        for k in range(i + 1, n):
            s -= matrix[k, i] * solution[k]
        solution[i] = s / matrix[i, i]
    return True


@compiled
def minimise_in_box(
    u: Floats,
    start: Floats,
    lower: Floats,
    upper: Floats,
    order: int,
    mode: int,
    relative: bool,
    zero: float,
    max_iterations: int,
    tolerance: float,
) -> tuple[Floats, Floats, float, int, bool]:
    """Minimise J_y^2, or J_y^2 / ||Q y||^2, over a box by projected Levenberg-Marquardt steps.

    The Jacobian is that of Kaufman: I - P applied to the filter matrix A(theta).  Values at a bound that the
    gradient pushes outwards are held.  Returns y, theta, the criterion, iterations and convergence.
    """
    n_samples = start.shape[0]
    p = n_samples - order
    n_theta = 2 * order + 1 if mode == FREE else 2 * order
    y = np.minimum(np.maximum(start, lower), upper)
    q, r, factor, theta = np.empty((n_theta, p)), np.empty(p), np.empty((n_theta, n_theta)), np.zeros(n_theta)
    q_new, r_new, theta_new = np.empty_like(q), np.empty_like(r), np.zeros(n_theta)
    gradient = np.empty(n_samples)
    free = np.empty(n_samples, dtype=np.int64)

    fill_regression(u, y, order, mode, q, r)
    cost = eliminate(q, r, factor, theta)
    energy = np.sum(y[order:] ** 2) if relative else 1.0
    value = cost / energy if energy > 0.0 else np.inf
    damping = 1e-3
    for iteration in range(max_iterations):
        if value <= zero:
            return y, theta, value, iteration, True
        filtered = np.zeros((p, n_samples))
        for row in range(p):
            filtered[row, order + row] = 1.0
            for i in range(order):
                filtered[row, order + row - 1 - i] = theta[i]
        equation_error_gradient(theta, r, order, gradient)
        jacobian = (filtered - q.T @ (q @ filtered)) / math.sqrt(energy)
        gradient /= energy
        if relative:
            for row in range(p):
                gradient[order + row] -= 2.0 * value * y[order + row] / energy
                share = r[row] / (energy * math.sqrt(energy))
                for other in range(p):
                    jacobian[row, order + other] -= share * y[order + other]
        n_free = 0
        steepest = 0.0
        for i in range(n_samples):
            outwards = (y[i] <= lower[i] and gradient[i] >= 0.0) or (y[i] >= upper[i] and gradient[i] <= 0.0)
            if lower[i] < upper[i] and not outwards:
                free[n_free] = i
                n_free += 1
                steepest = max(steepest, abs(gradient[i]))
        if n_free == 0 or steepest * math.sqrt(energy) <= tolerance * math.sqrt(value):
            return y, theta, value, iteration, True
        part = np.ascontiguousarray(jacobian[:, free[:n_free]])
        normal = part.T @ part
        largest = 0.0
        right = np.empty(n_free)
        for i in range(n_free):
            largest = max(largest, normal[i, i])
            right[i] = -0.5 * gradient[free[i]]
        step = np.empty(n_free)
        accepted = False
        growth = 2.0
        while damping < 1e15:
            damped = normal.copy()
            for i in range(n_free):
                damped[i, i] += damping * (normal[i, i] + 1e-6 * largest)
            trial = y.copy()
            if solve_positive(damped, right, step):
                for i in range(n_free):
                    j = free[i]
                    trial[j] = min(max(y[j] + step[i], lower[j]), upper[j])
                fill_regression(u, trial, order, mode, q_new, r_new)
                cost = eliminate(q_new, r_new, factor, theta_new)
                energy_new = np.sum(trial[order:] ** 2) if relative else 1.0
                value_new = cost / energy_new if energy_new > 0.0 else np.inf
                if value_new < value:
                    accepted = True
                    break
            damping *= growth
            growth *= 2.0
        if not accepted:
            return y, theta, value, iteration, True
        fall = (value - value_new) / value
        y, value, energy = trial, value_new, energy_new
        q, q_new = q_new, q
        r, r_new = r_new, r
        theta, theta_new = theta_new, theta
        damping = max(damping / 3.0, 1e-9)
        if fall < tolerance * tolerance:
            return y, theta, value, iteration + 1, True
    return y, theta, value, max_iterations, False


@compiled
def branch_and_bound(
    u: Floats,
    first: Indices,
    points: Floats,
    order: int,
    mode: int,
    bound: float,
    keep: int,
    node_limit: int,
) -> tuple[Floats, Floats, int, int]:
    """Find the `keep` sequences of points with the smallest J_y^2 below a bound, exactly.

    Samples are fixed one after another.  A sample adds one row to the regression; Givens rotations carry
    the triangular factor along, and what the rotations leave of the row is what the partial sum of squares
    grows by: it never falls, so a partial sum above the best complete one ends a branch.  The row does not
    hold the newest sample, so one rotation serves all its candidates: the leftover is affine in it.

    Returns costs and sequences (best first; infinite where fewer were found), the number of sequences
    found and the nodes visited; more nodes than the limit mean that the search stopped there.
    """
    n_samples = u.shape[0]
    n_theta = 2 * order + 1 if mode == FREE else 2 * order
    skip = 1 if mode == FREE else 0
    widest = 0
    for k in range(n_samples):
        widest = max(widest, first[k + 1] - first[k])
    factor = np.zeros((n_samples + 1, n_theta, n_theta))
    rotated = np.zeros((n_samples + 1, n_theta))  # the rotated target
    constant, slope = np.zeros((n_samples, n_theta)), np.zeros((n_samples, n_theta))
    cost = np.zeros(n_samples + 1)
    y = np.zeros(n_samples)
    child = np.zeros((n_samples, widest), dtype=np.int64)
    child_cost = np.zeros((n_samples, widest))
    n_children, position = np.zeros(n_samples, dtype=np.int64), np.zeros(n_samples, dtype=np.int64)
    best = np.full(keep, bound)
    leaves = np.zeros((keep, n_samples))
    row = np.zeros(n_theta)
    found = nodes = depth = 0
    opening = True
    while depth >= 0:
        if opening:
            nodes += 1
            if nodes > node_limit:
                break
            gain = shift = 0.0
            for i in range(n_theta):
                constant[depth, i], slope[depth, i] = rotated[depth, i], 0.0
                for j in range(i, n_theta):
                    factor[depth + 1, i, j] = factor[depth, i, j]
            if depth >= order:
                now = u[depth] if mode != FREE else 0.0
                gain, shift = 1.0, -now
                for i in range(order):
                    row[i] = -y[depth - 1 - i] + (now if mode == DC_GAIN else 0.0)
                if mode == FREE:
                    row[order] = u[depth]
                for i in range(1, order + 1):
                    row[order + skip + i - 1] = u[depth - i] - now
                for i in range(n_theta):
                    if row[i] == 0.0:
                        continue
                    diagonal = math.hypot(factor[depth, i, i], row[i])
                    c, s = factor[depth, i, i] / diagonal, row[i] / diagonal
                    factor[depth + 1, i, i] = diagonal
                    for j in range(i + 1, n_theta):
                        above = factor[depth, i, j]
                        factor[depth + 1, i, j] = c * above + s * row[j]
                        row[j] = c * row[j] - s * above
                    constant[depth, i] = c * rotated[depth, i] + s * shift
                    slope[depth, i] = s * gain
                    shift = c * shift - s * rotated[depth, i]
                    gain *= c
            count = 0
            for j in range(first[depth + 1] - first[depth]):
                leftover = gain * points[first[depth] + j] + shift
                total = cost[depth] + leftover * leftover
                if total < best[keep - 1]:
                    place = count
                    while place > 0 and child_cost[depth, place - 1] > total:
                        child_cost[depth, place] = child_cost[depth, place - 1]
                        child[depth, place] = child[depth, place - 1]
                        place -= 1
                    child_cost[depth, place], child[depth, place] = total, j
                    count += 1
            n_children[depth], position[depth] = count, 0
            opening = False
        here = position[depth]
        if here >= n_children[depth] or child_cost[depth, here] >= best[keep - 1]:
            depth -= 1
            continue
        position[depth] += 1
        y[depth] = points[first[depth] + child[depth, here]]
        total = child_cost[depth, here]
        if depth == n_samples - 1:
            place = keep - 1
            while place > 0 and best[place - 1] > total:
                best[place] = best[place - 1]
                leaves[place] = leaves[place - 1]
                place -= 1
            best[place] = total
            leaves[place] = y
            found += 1
            continue
        for i in range(n_theta):
            rotated[depth + 1, i] = constant[depth, i] + slope[depth, i] * y[depth]
        cost[depth + 1] = total
        depth += 1
        opening = True
    for i in range(keep):
        if i >= found:
            best[i] = np.inf
    return best, leaves, found, nodes
