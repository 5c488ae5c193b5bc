"""Simulated records with one known map at one port, by plain difference equations."""

import numpy as np

from sysid.data import make_record

A1, A2, B1, B2 = -1.5, 0.7, 0.1, 0.1
PERIOD = 0.1
SETTLING = 200

INPUT_MAPS = {
    "saturation": lambda x: np.clip(x, -1.0, 1.0),
    "dead zone": lambda x: np.sign(x) * np.maximum(np.abs(x) - 0.4, 0.0),
    "arctan": np.arctan,
}
OUTPUT_MAPS = {"saturation": lambda x: np.clip(x, -1.0, 1.0), "quadratic": lambda x: x + 0.3 * x**2}
POSITION_MAPS = {"cubic stiffness": lambda x: 0.3 * x**3}
VELOCITY_MAPS = {"quadratic drag": lambda v: 0.05 * v * np.abs(v)}
MAPS = {"input": INPUT_MAPS, "output": OUTPUT_MAPS, "position": POSITION_MAPS, "velocity": VELOCITY_MAPS}


def simulate(port=None, name=None, *, n=1600, noise=0.01, colour=0.0, seed=0):
    """Return a record of a second-order system with a map, and the signal that the map sees."""
    rng = np.random.default_rng(seed)
    function = MAPS[port][name] if port else None
    u = np.convolve(rng.standard_normal(n + SETTLING), np.ones(4) / 2.0, "same")
    x, v, s = np.zeros(u.size), np.zeros(u.size), np.zeros(u.size)
    for k in range(u.size):
        if k > 1:
            x[k] = -A1 * x[k - 1] - A2 * x[k - 2] + B1 * s[k - 1] + B2 * s[k - 2]
            v[k] = (x[k] - x[k - 1]) / PERIOD
        s[k] = function(u[k]) if port == "input" else u[k]
        if port == "position":
            s[k] -= function(x[k])
        if port == "velocity":
            s[k] -= function(v[k])
    y = function(x) if port == "output" else x
    white = rng.standard_normal(u.size)
    e = np.zeros(u.size)
    for k in range(1, u.size):
        e[k] = colour * e[k - 1] + np.sqrt(1.0 - colour**2) * white[k]
    kept = slice(SETTLING, None)
    seen = {"input": u, "output": x, "position": x, "velocity": v, None: u}[port][kept]
    return make_record(u[kept], (y + noise * y.std() * e)[kept], period=PERIOD), seen


def deviation(port, name, seen, value):
    """Return the map less its straight line over the data, in the scale of the linear part, at places.

    In front of the plant the line's slope becomes the plant's gain; behind it, the plant's output is
    the line itself; in a loop the line goes into the poles and the level.
    """
    function = MAPS[port][name]
    slope, level = np.polyfit(seen, function(seen), 1)
    if port == "input":
        return (function(value) - level - slope * value) / slope
    if port == "output":
        return function((value - level) / slope) - value
    return function(value) - level - slope * value
