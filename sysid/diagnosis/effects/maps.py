"""Compiled loops of the effects that act on a sequence; arguments are trusted."""

import numpy as np

from sysid._compile import compiled
from sysid.diagnosis.effects.base import Floats


@compiled
def saturation(u: Floats, lower: float, upper: float) -> Floats:
    """Clip to -lower and upper."""
    x = np.empty_like(u)
    for k in range(u.size):
        x[k] = min(max(u[k], -lower), upper)
    return x


@compiled
def dead_zone(u: Floats, lower: float, upper: float) -> Floats:
    """Return what lies beyond -lower and upper."""
    x = np.empty_like(u)
    for k in range(u.size):
        x[k] = u[k] - upper if u[k] > upper else (u[k] + lower if u[k] < -lower else 0.0)
    return x


@compiled
def preload(u: Floats, lower: float, upper: float) -> Floats:
    """Return the input with a jump at zero."""
    x = np.empty_like(u)
    for k in range(u.size):
        x[k] = u[k] + (upper if u[k] > 0.0 else (-lower if u[k] < 0.0 else 0.0))
    return x


@compiled
def relay(u: Floats, lower: float, upper: float, ratio: float) -> Floats:
    """Return 1 above the upper threshold, -ratio below the lower one, 0 between."""
    x = np.empty_like(u)
    for k in range(u.size):
        x[k] = 1.0 if u[k] > upper else (-ratio if u[k] < -lower else 0.0)
    return x


@compiled
def play(u: Floats, lower: float, upper: float) -> Floats:
    """Return the play operator: the output is dragged along at u + lower and u - upper."""
    x = np.empty_like(u)
    output = 0.0
    for k in range(u.size):
        if output < u[k] - upper:
            output = u[k] - upper
        elif output > u[k] + lower:
            output = u[k] + lower
        x[k] = output
    return x


@compiled
def hysteresis_relay(u: Floats, lower: float, upper: float, before: float) -> Floats:
    """Return +1 after the input rose above upper, -1 after it fell below -lower; ``before`` at first."""
    x = np.empty_like(u)
    output = before
    for k in range(u.size):
        if u[k] > upper:
            output = 1.0
        elif u[k] < -lower:
            output = -1.0
        x[k] = output
    return x


@compiled
def rate_limit(u: Floats, fall: float, rise: float, before: float) -> Floats:
    """Follow the input by at most so much a sample, from where it was ``before`` the start."""
    x = np.empty_like(u)
    output = before
    for k in range(u.size):
        output += min(max(u[k] - output, -fall), rise)
        x[k] = output
    return x


@compiled
def delay(u: Floats, samples: float, before: float) -> Floats:
    """Delay by a number of samples, fractions by linear interpolation, with what was before the start."""
    x = np.full_like(u, before)
    whole = int(samples)
    part = samples - whole
    for k in range(whole, u.size):
        earlier = u[k - whole - 1] if k > whole else before
        x[k] = (1.0 - part) * u[k - whole] + part * earlier
    return x


@compiled
def low_pass(y: Floats, pole: float, state: float) -> Floats:
    """Filter by (1 - pole) / (1 - pole q^-1), from a given state."""
    x = np.empty_like(y)
    for k in range(y.size):
        state = pole * state + (1.0 - pole) * y[k]
        x[k] = state
    return x


@compiled
def low_pass_straight(y: Floats, ratio: float, state: float) -> Floats:
    """Follow a sequence that is straight between samples with a lag, from a state at which it stood.

    ``ratio`` is the sampling period over the time constant; exact (first-order hold).
    """
    x = np.empty_like(y)
    pole = np.exp(-ratio)
    past = (1.0 - pole) / ratio - pole
    before = state
    for k in range(y.size):
        state = pole * state + past * before + (1.0 - pole - past) * y[k]
        before = y[k]
        x[k] = state
    return x


@compiled
def second_order(u: Floats, radius: float, angle: float, first: float, second: float) -> Floats:
    """Filter by (first q^-1 + second q^-2) / (1 - 2 r cos(angle) q^-1 + r^2 q^-2), from rest."""
    x = np.zeros_like(u)
    a1, a2 = -2.0 * radius * np.cos(angle), radius * radius
    for k in range(1, u.size):
        value = first * u[k - 1] - a1 * x[k - 1]
        if k > 1:
            value += second * u[k - 2] - a2 * x[k - 2]
        x[k] = value
    return x
