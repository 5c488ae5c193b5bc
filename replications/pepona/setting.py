"""What the examples of Chapter 4 are made of: systems, signals, structures, and how their signs are read.

Every system here is written as it runs, ``y(k) = a y(k-1) + b u(k-1) + w(k) + g w(k-1) + e(k)``.  The
tables of the thesis name the same numbers with signs of their own, which `Example.true` keeps.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled

Floats = NDArray[np.float64]


def wiener_map(z: Floats) -> Floats:
    """Return the map of Example 4.2, eq. (4.38a)."""
    return z / np.sqrt(0.1 + 0.9 * z**2)


def wiener_slope(z: Floats) -> Floats:
    """Return the derivative of `wiener_map`."""
    return 0.1 / (0.1 + 0.9 * z**2) ** 1.5


def arctangent(z: Floats) -> Floats:
    """Return the map of Example 4.3, eq. (4.40b)."""
    return np.arctan(z - 1.0)


def arctangent_slope(z: Floats) -> Floats:
    """Return the derivative of `arctangent`."""
    return 1.0 / (1.0 + (z - 1.0) ** 2)


def bent(z: Floats) -> Floats:
    """Return the map of Example 4.4, eq. (4.41c)."""
    return np.abs(z - 2.0) + 0.8 * np.arctan(z)


def bent_slope(z: Floats) -> Floats:
    """Return the derivative of `bent`; at its bend any value will do."""
    return np.sign(z - 2.0) + 0.8 / (1.0 + z**2)


@dataclass(frozen=True)
class Example:
    """One example of Section 4.4.

    Attributes
    ----------
    case : str
        Its number in the text.
    title : str
    function, slope : callable
        The static map and its derivative.
    d : tuple of float
        Coefficients of u(k-1), u(k-2), ... in z; empty for z = y(k-2).
    a, b, g : float
        Coefficients of y(k-1), u(k-1), w(k-1) of the system as it runs.
    knots : int
        Knots of the cubic spline.
    samples : int
        Samples for identification; as many validate.
    inputs : (float, float)
        Range of the uniform input.
    noise : float
        Standard deviation of the noise.
    uniform : bool
        Whether the noise is uniform; normal otherwise.
    a_sign : int
        Sign of a1 of its table in A(q) = 1 + a1/q: 1, or -1 where the table means a1 y(k-1).
    true : mapping
        The true values in the signs of the table.
    """

    case: str
    title: str
    function: Callable[[Floats], Floats]
    slope: Callable[[Floats], Floats]
    d: tuple[float, ...]
    a: float
    b: float
    g: float
    knots: int
    samples: int
    inputs: tuple[float, float]
    noise: float
    uniform: bool
    a_sign: int
    true: Mapping[str, float]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters of its table."""
        return tuple(self.true)


UNIFORM_NOISE = 0.25
"""Half width of the uniform noise of Example 4.4."""

EXAMPLES: Mapping[str, Example] = {
    "4.2": Example(
        "4.2", "Wiener system", wiener_map, wiener_slope, (-0.8944, 0.2683, -0.3578), 0.0, 0.0, 0.0,
        12, 1000, (-0.7, 2.5), 0.1, False, 1, {"d1": -0.8944, "d2": 0.2683, "d3": -0.3578},
    ),
    # a1 is that of A(q) = 1 + a1/q, so that the system has +0.4 y(k-1).
    "4.3": Example(
        "4.3", "Wiener-Hammerstein system", arctangent, arctangent_slope, (0.53, -0.848), 0.4, 0.0, -0.5,
        15, 1000, (-2.5, 2.5), 0.1, False, 1, {"a1": -0.4, "d1": 0.53, "d2": -0.848, "g1": -0.5},
    ),
    # a1 is that of (4.41a); g1 has the other sign than in print, where the system diverges.
    "4.4": Example(
        "4.4", "general LFT", bent, bent_slope, (), 0.4, 1.2, -0.5,
        13, 500, (-2.5, 2.5), UNIFORM_NOISE / np.sqrt(3.0), True, -1, {"a1": 0.4, "b1": 1.2, "g1": -0.5},
    ),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Signals:
    """One experiment, shape (n_samples,) each: input, output, and what is not measured."""

    u: Floats
    y: Floats
    z: Floats
    w: Floats
    e: Floats


def experiment(example: Example, samples: int, rng: np.random.Generator) -> Signals:
    """Draw an experiment that starts from rest; input and noise as the example states them."""
    low, high = example.inputs
    u = rng.uniform(low, high, samples)
    if example.uniform:
        e = rng.uniform(-UNIFORM_NOISE, UNIFORM_NOISE, samples)
    else:
        e = example.noise * rng.standard_normal(samples)
    return respond(example, u, e)


def respond(example: Example, u: Floats, e: Floats) -> Signals:
    """Run the system of an example from rest."""
    if example.d:
        z = np.convolve(u, [0.0, *example.d])[: u.size]
        w = example.function(z)
        driven = w + example.g * delayed(w) + example.b * delayed(u) + e
        return Signals(u, recursion(driven, example.a), z, w, e)
    rest = np.zeros(4)
    y, z, w = _looped(u, e, example.a, example.b, example.g, rest)
    return Signals(u, y, z, w, e)


def delayed(signal: Floats) -> Floats:
    """Return the signal one sample later, zero before its beginning."""
    return np.concatenate([[0.0], signal[:-1]])


@compiled
def recursion(driven: Floats, a: float) -> Floats:
    """Return y(k) = a y(k-1) + driven(k)."""
    y = np.empty_like(driven)
    last = 0.0
    for k in range(driven.shape[0]):
        last = a * last + driven[k]
        y[k] = last
    return y


@compiled
def _looped(
    u: Floats, e: Floats, a: float, b: float, g: float, past: Floats
) -> tuple[Floats, Floats, Floats]:
    """Run Example 4.4 after y(-2), y(-1), u(-1), w(-1); z(k) = y(k-2) closes a loop around (4.41c)."""
    n = u.shape[0]
    y, z, w = np.zeros(n), np.zeros(n), np.zeros(n)
    y2, y1, u1, w1 = past[0], past[1], past[2], past[3]
    for k in range(n):
        z[k] = y2
        w[k] = np.abs(y2 - 2.0) + 0.8 * np.arctan(y2)
        y[k] = a * y1 + b * u1 + w[k] + g * w1 + e[k]
        y2, y1, u1, w1 = y1, y[k], u[k], w[k]
    return y, z, w


def respond_after(example: Example, signals: Signals, n: int) -> Floats:
    """Return the free run of the true system from sample n on, after measured signals and without noise."""
    quiet = np.zeros(signals.u.size - n)
    if example.d:
        driven = (signals.w + example.g * delayed(signals.w))[n:]
        driven[0] += example.a * signals.y[n - 1]
        return recursion(driven, example.a)
    past = np.array([signals.y[n - 2], signals.y[n - 1], signals.u[n - 1], signals.w[n - 1]])
    return _looped(signals.u[n:], quiet, example.a, example.b, example.g, past)[0]


def vaf(measured: Floats, modelled: Floats) -> float:
    """Return the variance accounted for [%], eq. (4.39)."""
    return float(100.0 * (1.0 - np.var(modelled - measured) / np.var(measured)))
