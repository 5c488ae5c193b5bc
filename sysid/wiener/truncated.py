"""Moments of a standard normal variable on a union of points or intervals, far into its tails."""

import math

import numpy as np

from sysid._compile import compiled
from sysid.nonlinearities.base import Floats

_LOG_SQRT_2PI = 0.9189385332046727
_NARROW = 2.0  # below this the exponent hardly changes over the interval: quadrature instead of differences
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


@compiled
def scaled_tail(x: float) -> float:
    """Return Q(x) / phi(x) for x >= 0, the Mills ratio."""
    if x < 8.0:
        return math.sqrt(0.5 * math.pi) * math.exp(0.5 * x * x) * math.erfc(x / math.sqrt(2.0))
    # Laplace's continued fraction; 20 terms leave less than 1e-16 from x = 8 on.
    value = x
    for k in range(20, 0, -1):
        value = x + k / value
    return 1.0 / value


@compiled
def interval_moments(low: float, high: float, moments: Floats) -> float:
    """Fill E[t], ..., E[t^4] of t ~ N(0, 1) on [low, high]; return the logarithm of its probability."""
    if high <= low:
        return -np.inf
    flipped = low + high < 0.0
    near, far = (-high, -low) if flipped else (low, high)  # near is the end closer to zero, or negative
    size = 1.0 + (min(abs(near), abs(far)) if near > 0.0 else 0.0)
    if (far - near) * size < _NARROW:
        centre, half = 0.5 * (near + far), 0.5 * (far - near)
        top = max(near, 0.0)
        total = 0.0
        moments[:] = 0.0
        for i in range(_NODES.shape[0]):
            t = centre + half * _NODES[i]
            share = half * _WEIGHTS[i] * math.exp(0.5 * (top * top - t * t))
            total += share
            for power in range(4):
                share *= t
                moments[power] += share
        log_mass = math.log(total) - 0.5 * top * top - _LOG_SQRT_2PI
        for power in range(4):
            moments[power] /= total
    else:
        if near > 0.0:
            mills = scaled_tail(near)
            drop = math.exp(-0.5 * (far - near) * (far + near)) if far < np.inf else 0.0
            inside = 1.0 - (drop * scaled_tail(far) / mills if drop > 0.0 else 0.0)
            log_mass = math.log(mills * inside) - 0.5 * near * near - _LOG_SQRT_2PI
            at_near = 1.0 / (mills * inside)
            at_far = at_near * drop
        else:
            mass = 1.0 - 0.5 * math.erfc(far / math.sqrt(2.0)) - 0.5 * math.erfc(-near / math.sqrt(2.0))
            log_mass = math.log(mass)
            at_near = math.exp(-0.5 * near * near - _LOG_SQRT_2PI) / mass if near > -np.inf else 0.0
            at_far = math.exp(-0.5 * far * far - _LOG_SQRT_2PI) / mass if far < np.inf else 0.0
        # An infinite end has no density, however high the power it is multiplied with.
        if at_near == 0.0:
            near = 0.0
        if at_far == 0.0:
            far = 0.0
        moments[0] = at_near - at_far
        moments[1] = 1.0 + near * at_near - far * at_far
        moments[2] = 2.0 * moments[0] + near * near * at_near - far * far * at_far
        moments[3] = 3.0 * moments[1] + near**3 * at_near - far**3 * at_far
    if flipped:
        moments[0], moments[2] = -moments[0], -moments[2]
    return log_mass


@compiled
def union_moments(
    lower: Floats, upper: Floats, weight: Floats, y: float, sigma: float, moments: Floats, work: Floats
) -> float:
    """Fill the moments of t = (x - y) / sigma for x ~ N(y, sigma^2) on a union; return the log-likelihood.

    Intervals have a probability, points a density: where a union holds both, the intervals alone count.
    """
    intervals = False
    for i in range(lower.shape[0]):
        if upper[i] > lower[i]:
            intervals = True
    moments[:] = 0.0
    log_total = -np.inf
    for i in range(lower.shape[0]):
        if upper[i] > lower[i]:
            log_mass = interval_moments((lower[i] - y) / sigma, (upper[i] - y) / sigma, work)
        elif intervals:
            continue
        else:
            t = (lower[i] - y) / sigma
            log_mass = math.log(weight[i] / sigma) - 0.5 * t * t - _LOG_SQRT_2PI
            for power in range(4):
                work[power] = t ** (power + 1)
        if log_mass == -np.inf:
            continue
        largest = max(log_total, log_mass)
        old, new = math.exp(log_total - largest), math.exp(log_mass - largest)
        log_total = largest + math.log(old + new)
        for power in range(4):
            moments[power] = (old * moments[power] + new * work[power]) / (old + new)
    return log_total
