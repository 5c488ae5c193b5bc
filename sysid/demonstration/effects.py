"""Effects to hide: what each does to input, plant and output, and how its strength is drawn.

Written apart from the catalogue that the diagnosis uses; only the names are the same.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sysid.demonstration.kernels import backlash, hysteresis_relay, rate_limit
from sysid.demonstration.plants import Inside

Floats = NDArray[np.float64]
Values = Mapping[str, float]

_LONGEST_DELAY = 8.0  # samples


@dataclass(frozen=True)
class Scales:
    """Sizes of the signals of the plant without effects, by which strengths are measured."""

    u_rms: float
    u_peak: float
    u_step: float
    y_rms: float
    y_peak: float
    position: float
    velocity: float
    force: float
    bandwidth: float
    n_samples: int


@dataclass(frozen=True)
class Hidden:
    """One hidden effect with its true parameters."""

    name: str
    parameters: Values


Size = Callable[[float], dict[str, float]]
"""Strength from 0 (absent) to 1 (strong) -> parameters."""


def sizes(rng: np.random.Generator, name: str, s: Scales) -> Size:
    """Draw the shape of an effect; its strength is left open.

    Parameters
    ----------
    rng : numpy.random.Generator
    name : str
        A name of `NAMES`.
    s : Scales

    Returns
    -------
    callable
        Strength in [0, 1] -> parameters.
    """
    sign = float(rng.choice([-1.0, 1.0]))
    side = float(rng.uniform(0.6, 1.4)) if rng.random() < 0.5 else 1.0
    a, b, c = map(float, rng.uniform(size=3))
    laws: dict[str, Size] = {
        "in_saturation": lambda x: _sides(s.u_peak * (1.0 - 0.97 * x), side),
        "in_deadzone": lambda x: _sides(0.95 * s.u_peak * x, side),
        "in_preload": lambda x: _sides(2.5 * s.u_rms * x, side),
        "in_relay": lambda x: {"level": s.u_rms, "threshold": 0.6 * s.u_peak * x},
        "in_backlash": lambda x: _sides(0.9 * s.u_peak * x, side),
        "in_delay": lambda x: {"delay": min(6.0 / s.bandwidth, _LONGEST_DELAY) * x},
        "in_rate_limit": lambda x: {"rate": s.u_step * 10.0 ** (-3.0 * x)},
        "in_hysteresis": lambda x: {"level": s.u_rms, "threshold": 0.9 * s.u_peak * x},
        "out_saturation": lambda x: _sides(s.y_peak * (1.0 - 0.97 * x), side),
        "out_offset": lambda x: {"offset": sign * 3.0 * s.y_rms * x},
        "out_drift": lambda x: {"rate": sign * 5.0 * s.y_rms * x / s.n_samples},
        "out_quantisation": lambda x: {"step": 3.0 * s.y_rms * x},
        "out_rectify": lambda x: {
            "bias": sign * 4.0 * s.u_rms * (1.0 - x),
            "half": float(sign > 0.0 and c < 0.5),
        },
        "out_quadratic": lambda x: {"c": sign * 1.5 / s.y_rms * x},
        "out_delay": lambda x: {"delay": min(6.0 / s.bandwidth, _LONGEST_DELAY) * x},
        "out_lowpass": lambda x: {"pole": 0.98 * x},
        "coulomb": lambda x: {"friction": 2.0 * s.force * x},
        "asymmetric_friction": lambda x: {
            "forwards": 2.0 * s.force * x,
            "backwards": 2.0 * s.force * x * (0.1 + 0.5 * a),
        },
        "stribeck": lambda x: {
            "friction": 1.6 * s.force * x,
            "excess": 0.3 + 0.7 * a,
            "velocity": s.velocity * (0.1 + 0.3 * b),
        },
        "quad_drag": lambda x: {"drag": 6.0 * s.force / s.velocity**2 * x},
        "cubic_stiffness": lambda x: {"stiffness": 6.0 * s.force / s.position**3 * x},
        "cubic_damping": lambda x: {"damping": 8.0 * s.force / s.velocity**3 * x},
        "gravity_sine": lambda x: {"torque": sign * 3.0 * s.force * x},
        "constant_force": lambda x: {"force": sign * 3.0 * s.force * x},
        "hysteresis_force": lambda x: {"force": 2.0 * s.force * x, "length": s.position * (0.1 + 0.4 * a)},
        "op_gain": lambda x: {"gain": sign * 0.95 * x, "scale": s.y_rms * (0.3 + 1.2 * a)},
        "sqrt_outflow": lambda x: {"swing": x},
        "overflow": lambda x: {"rim": s.y_peak * (1.05 - 0.8 * x)},
        "extra_mode": lambda x: {
            "gain": sign * 1.5 * s.y_rms / s.u_rms * x,
            "frequency": float(np.clip(s.bandwidth * (0.3 + 1.2 * a), 0.05, 1.5)),
            "damping": 0.01 + 0.05 * b,
        },
        "feedthrough": lambda x: {"d": sign * 2.0 * s.y_rms / s.u_rms * x},
        "time_variation": lambda x: {
            "change": 2.0 * x if sign > 0.0 else -0.95 * x,
            "start": 0.0 if c < 0.5 else 0.15 + 0.5 * a,
            "step": 0.0 if c < 0.5 else 1.0,
            "n": float(s.n_samples),
        },
        "quadratic_input": lambda x: {"c": sign * 2.0 / s.u_rms * x},
        "preisach": lambda x: {"weight": 20.0 * x, "spread": s.u_peak * (0.5 + 0.4 * a)},
        "input_memory_gain": lambda x: {"c": sign * 4.0 * x / s.u_rms**2, "pole": 0.8 + 0.15 * a},
    }
    return laws[name]


def _sides(upper: float, ratio: float) -> dict[str, float]:
    return {"upper": upper, "lower": upper * ratio}


def map_input(u: Floats, effects: tuple[Hidden, ...]) -> Floats:
    """Apply the effects at the input, in their order."""
    for effect in effects:
        if effect.name in INPUT:
            u = INPUT[effect.name](u, effect.parameters)
    return u


def inside(effects: tuple[Hidden, ...]) -> Inside:
    """Collect the effects inside the plant."""
    collected = Inside()
    for effect in effects:
        p = effect.parameters
        if effect.name in FORCE:
            collected = replace(collected, force=collected.force + FORCE[effect.name](p))
        elif effect.name == "op_gain":
            collected = replace(collected, gain=p["gain"], scale=p["scale"])
        elif effect.name == "sqrt_outflow":
            collected = replace(collected, root=True)
        elif effect.name == "overflow":
            collected = replace(collected, rim=p["rim"])
    return collected


def map_output(y: Floats, u: Floats, effects: tuple[Hidden, ...]) -> Floats:
    """Add what runs in parallel to the plant, then apply the effects at the sensor."""
    for effect in effects:
        if effect.name == "feedthrough":
            y = y + effect.parameters["d"] * u
        elif effect.name == "extra_mode":
            y = y + _mode(u, effect.parameters)
    for effect in effects:
        if effect.name in OUTPUT:
            y = OUTPUT[effect.name](y, effect.parameters)
    return y


def _delayed(signal: Floats, delay: float) -> Floats:
    """Delay from rest; parts of a sample by linear interpolation."""
    whole = int(delay)
    part = delay - whole
    padded = np.r_[np.zeros(whole + 1), signal]
    n = signal.size
    return np.asarray((1.0 - part) * padded[1 : n + 1] + part * padded[:n])


def _relay(u: Floats, p: Values) -> Floats:
    return np.asarray(p["level"] * np.sign(u) * (np.abs(u) > p["threshold"]))


def _dead_zone(u: Floats, p: Values) -> Floats:
    return np.maximum(u - p["upper"], 0.0) + np.minimum(u + p["lower"], 0.0)


def _varied(u: Floats, p: Values) -> Floats:
    """Gain 1, from the start on 1 + change (a step) or rising to it at the end (a ramp)."""
    share = np.arange(u.size) / p["n"]
    return np.asarray(u * (1.0 + p["change"] * (share >= p["start"] if p["step"] else share)))


def _preisach(u: Floats, p: Values) -> Floats:
    """Add play operators of many widths: a smooth hysteresis loop with memory of its turning points."""
    widths = p["spread"] * np.linspace(0.05, 1.0, 12)
    weights = np.linspace(1.0, 0.2, 12)
    loops = [weight * backlash(u, width, width) for width, weight in zip(widths, weights, strict=True)]
    return np.asarray(u + p["weight"] * np.sum(loops, axis=0) / weights.sum())


def _memory_gain(u: Floats, p: Values) -> Floats:
    """Multiply the input by a gain that follows the mean power of the input before."""
    from scipy.signal import lfilter

    return np.asarray(u * (1.0 + p["c"] * lfilter([0.0, 1.0 - p["pole"]], [1.0, -p["pole"]], u**2)))


def _mode(u: Floats, p: Values) -> Floats:
    """Return a second-order mode sampled with held input; its gain at rest is `gain`."""
    from scipy.signal import lfilter

    w, z = p["frequency"], p["damping"]
    decay, turn = math.exp(-z * w), w * math.sqrt(1.0 - z * z)
    slope = z * w / turn
    b1 = 1.0 - decay * (math.cos(turn) + slope * math.sin(turn))
    b2 = decay * decay + decay * (slope * math.sin(turn) - math.cos(turn))
    return np.asarray(p["gain"] * lfilter([0.0, b1, b2], [1.0, -2.0 * decay * math.cos(turn), decay**2], u))


def _lowpass(y: Floats, p: Values) -> Floats:
    from scipy.signal import lfilter

    return np.asarray(lfilter([1.0 - p["pole"]], [1.0, -p["pole"]], y))


INPUT: dict[str, Callable[[Floats, Values], Floats]] = {
    "in_saturation": lambda u, p: np.clip(u, -p["lower"], p["upper"]),
    "in_deadzone": _dead_zone,
    "in_preload": lambda u, p: u + np.where(u > 0.0, p["upper"], np.where(u < 0.0, -p["lower"], 0.0)),
    "in_relay": _relay,
    "in_backlash": lambda u, p: backlash(u, p["upper"], p["lower"]),
    "in_delay": lambda u, p: _delayed(u, p["delay"]),
    "in_rate_limit": lambda u, p: rate_limit(u, p["rate"]),
    "in_hysteresis": lambda u, p: p["level"] * hysteresis_relay(u, p["threshold"]),
    "time_variation": _varied,
    "quadratic_input": lambda u, p: u + p["c"] * u**2,
    "preisach": _preisach,
    "input_memory_gain": _memory_gain,
}

FORCE: dict[str, Callable[[Values], Floats]] = {
    "quad_drag": lambda p: _force({0: p["drag"]}),
    "cubic_stiffness": lambda p: _force({1: p["stiffness"]}),
    "gravity_sine": lambda p: _force({2: p["torque"]}),
    "constant_force": lambda p: _force({3: p["force"]}),
    "cubic_damping": lambda p: _force({4: p["damping"]}),
    "hysteresis_force": lambda p: _force({5: p["force"], 6: p["length"]}),
    "coulomb": lambda p: _force({7: p["friction"], 8: p["friction"]}),
    "asymmetric_friction": lambda p: _force({7: p["forwards"], 8: p["backwards"]}),
    "stribeck": lambda p: _force({7: p["friction"], 8: p["friction"], 9: p["excess"], 10: p["velocity"]}),
}


def _force(entries: Mapping[int, float]) -> Floats:
    force = np.zeros_like(Inside().force)
    for place, value in entries.items():
        force[place] = value
    return force


OUTPUT: dict[str, Callable[[Floats, Values], Floats]] = {
    "out_saturation": lambda y, p: np.clip(y, -p["lower"], p["upper"]),
    "out_offset": lambda y, p: y + p["offset"],
    "out_drift": lambda y, p: y + p["rate"] * np.arange(y.size),
    "out_quantisation": lambda y, p: p["step"] * np.round(y / p["step"]),
    "out_rectify": lambda y, p: np.maximum(y, 0.0) if p["half"] else np.abs(y),
    "out_quadratic": lambda y, p: y + p["c"] * y**2,
    "out_delay": lambda y, p: _delayed(y, p["delay"]),
    "out_lowpass": _lowpass,
}
INNER = ("op_gain", "sqrt_outflow", "overflow")
PARALLEL = ("extra_mode", "feedthrough")

FOREIGN = ("quadratic_input", "preisach", "input_memory_gain", "cubic_damping")
"""Effects that no catalogue entry describes."""

NAMES = (*INPUT, *OUTPUT, *FORCE, *INNER, *PARALLEL, "coloured_noise")

LINEAR = (
    "in_delay",
    "out_delay",
    "out_lowpass",
    "extra_mode",
    "feedthrough",
    "out_offset",
    "out_drift",
    "constant_force",
)
"""Effects that a larger linear model, or a constant and a trend, would explain."""

UNSIZED = ("in_relay", "in_hysteresis")
"""Effects that are whole or absent: their strength is drawn, their share falls where it may."""
