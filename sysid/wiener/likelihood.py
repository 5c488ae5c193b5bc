"""Likelihood of a Wiener model with noise before the nonlinearity, with score and observed information.

The measured z says that x = y + w lies in the preimage of z.  With w ~ N(0, sigma^2) the log-likelihood of
a sample depends on y and s = log sigma alone, and its derivatives are moments of t = (x - y) / sigma on the
preimage: score (E t / sigma, E t^2 - 1), and the observed information is the complete-data one less the
variance of the complete-data score (Louis 1982).
"""

import math

import numpy as np

from sysid._compile import compiled
from sysid.nonlinearities.base import Floats
from sysid.nonlinearities.preimages import Indices
from sysid.wiener.kernels import solve_positive
from sysid.wiener.truncated import union_moments

_FAR = 1e100


@compiled
def simulate(u: Floats, theta: Floats, state: Floats, order: int) -> tuple[Floats, Floats]:
    """Run y = B/A u from a state of the transposed direct form.

    Returns y and its derivatives by (a1 ... an, b0 ... bn, state), shape (3 order + 1, n_samples).
    """
    n_samples, n_parameters = u.shape[0], 3 * order + 1
    y, sensitivity = np.zeros(n_samples), np.zeros((n_parameters, n_samples))
    x = state.copy()
    dx = np.zeros((n_parameters, order))
    for i in range(order):
        dx[2 * order + 1 + i, i] = 1.0
    for k in range(n_samples):
        y[k] = x[0] + theta[order] * u[k]
        if abs(y[k]) > _FAR:  # diverged; the caller sees it by the size
            y[k:] = _FAR
            return y, sensitivity
        for j in range(n_parameters):
            sensitivity[j, k] = dx[j, 0]
        sensitivity[order, k] += u[k]
        for i in range(order):
            after = x[i + 1] if i + 1 < order else 0.0
            x[i] = after + theta[order + 1 + i] * u[k] - theta[i] * y[k]
        for j in range(n_parameters):
            slope = sensitivity[j, k]
            for i in range(order):
                after = dx[j, i + 1] if i + 1 < order else 0.0
                value = after - theta[i] * slope
                if j == i:
                    value -= y[k]
                elif j == order + 1 + i:
                    value += u[k]
                dx[j, i] = value
    return y, sensitivity


@compiled
def log_likelihood(
    u: Floats, first: Indices, lower: Floats, upper: Floats, weight: Floats, parameters: Floats, order: int
) -> tuple[float, Floats, Floats, Floats]:
    """Return log-likelihood, score, observed information and a positive scale of every parameter.

    ``parameters`` are theta, the initial state and log sigma, (3 order + 2,).
    """
    n = parameters.shape[0]
    sigma = math.exp(parameters[n - 1])
    y, sensitivity = simulate(u, parameters[: 2 * order + 1], parameters[2 * order + 1 : n - 1], order)
    total = 0.0
    score, information, scale = np.zeros(n), np.zeros((n, n)), np.zeros(n)
    moments, work = np.empty(4), np.empty(4)
    if abs(y[-1]) >= _FAR or not math.isfinite(y[-1]):
        return -np.inf, score, information, scale
    for k in range(u.shape[0]):
        part = slice(first[k], first[k + 1])
        total += union_moments(lower[part], upper[part], weight[part], y[k], sigma, moments, work)
        m1, m2, m3, m4 = moments[0], moments[1], moments[2], moments[3]
        score_y, score_s = m1 / sigma, m2 - 1.0
        info_yy = (1.0 - (m2 - m1 * m1)) / (sigma * sigma)
        info_ys = (2.0 * m1 - (m3 - m1 * m2)) / sigma
        info_ss = 2.0 * m2 - (m4 - m2 * m2)
        for i in range(n - 1):
            si = sensitivity[i, k]
            score[i] += score_y * si
            scale[i] += si * si / (sigma * sigma)
            information[i, n - 1] += info_ys * si
            for j in range(i, n - 1):
                information[i, j] += info_yy * si * sensitivity[j, k]
        score[n - 1] += score_s
        information[n - 1, n - 1] += info_ss
        scale[n - 1] += 2.0
    for i in range(n):
        for j in range(i):
            information[i, j] = information[j, i]
    return total, score, information, scale


@compiled
def maximise(
    u: Floats,
    first: Indices,
    lower: Floats,
    upper: Floats,
    weight: Floats,
    start: Floats,
    order: int,
    fixed_noise: bool,
    least_log_sigma: float,
    max_iterations: int,
    tolerance: float,
) -> tuple[Floats, float, int, int]:
    """Maximise by Newton steps on the observed information, damped until it is positive definite.

    Returns the parameters, log-likelihood, iterations and why it stopped: 0 the score vanishes, 1 the
    likelihood is one and cannot rise (the data are separated), 2 the noise reached its floor, 3 the limit,
    4 no step raises it, 5 the start diverges.
    """
    n = start.shape[0]
    used = n - 1 if fixed_noise else n
    point = start.copy()
    value, score, information, scale = log_likelihood(u, first, lower, upper, weight, point, order)
    if not math.isfinite(value):
        return point, -np.inf, 0, 5
    damping, growth = 1e-2, 2.0
    step = np.zeros(used)
    floor = False
    for iteration in range(max_iterations):
        if value > -1e-7 * u.shape[0] and value <= 0.0 and score @ score < 1e-6:
            return point, value, iteration, 1
        accepted = False
        while damping < 1e16:
            damped = information[:used, :used].copy()
            for i in range(used):
                damped[i, i] += damping * max(scale[i], 1e-300)
            if solve_positive(damped, score[:used], step):
                decrement = 0.0
                for i in range(used):
                    decrement += step[i] * score[i]
                if damping < 1.0 and decrement < tolerance:
                    return point, value, iteration, 2 if floor else 0
                trial = point.copy()
                trial[:used] += step
                if not fixed_noise:
                    trial[n - 1] = min(max(trial[n - 1], point[n - 1] - 1.0), point[n - 1] + 1.0)
                    floor = trial[n - 1] <= least_log_sigma
                    trial[n - 1] = max(trial[n - 1], least_log_sigma)
                new, new_score, new_information, new_scale = log_likelihood(
                    u, first, lower, upper, weight, trial, order
                )
                if new > value:
                    accepted = True
                    break
                if decrement < tolerance:
                    return point, value, iteration, 2 if floor else 0
            damping *= growth
            growth *= 2.0
        if not accepted:
            return point, value, iteration, 4
        small = new - value < tolerance * 1e-3
        point, value, score, information, scale = trial, new, new_score, new_information, new_scale
        damping, growth = max(damping / 5.0, 1e-12), 2.0
        if small:
            return point, value, iteration + 1, 2 if floor else 0
    return point, value, max_iterations, 3
