"""Parameters with which the physical models are tested."""

from sysid.physics import load_model

VALUES = {
    "mass-spring-damper": {"m": 1.3, "c": 0.4, "k": 7.0},
    "dc-motor": {"J": 0.39, "b": 0.26, "K": 1.12, "L": 0.105, "R": 1.2},
    "two-mass": {"m1": 1.3, "c1": 0.4, "k1": 7.0, "m2": 0.6, "c2": 0.2, "k2": 4.0},
    "two-tanks": {"a1": 0.12, "a2": 0.07, "b": 0.5},
    "two-tanks-offset": {"a1": 0.12, "a2": 0.07, "b": 0.5, "offset": 0.4},
    "positioning-stage": {"M": 2.0, "F_v": 3.0, "gain": 1.5, "offset": 0.3},
    "oscillator": {"w0": 3.0, "zeta": 0.1, "gain": 0.7},
    "thermal-first-order": {"C": 5.0, "G": 0.8, "ambient": 0.4, "delay": 0.23},
    "thermal-second-order": {"lag": 2.0, "C": 5.0, "G": 0.4, "ambient": 0.4, "delay": 0.23},
}


def free_model(name):
    """The model with all its parameters free but the cubic stiffness."""
    return load_model(name).with_parameters(start=VALUES[name])


def duffing():
    values = {"w0": 3.0, "zeta": 0.1, "gain": 0.7, "cubic": 20.0}
    return load_model("oscillator").with_parameters(start=values)
