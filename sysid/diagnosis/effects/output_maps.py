"""Effects of the sensor: the measured output is not the plant's."""

import numpy as np

from sysid.diagnosis.effects.base import Effect, EffectParameter, Floats, Form, Grid
from sysid.diagnosis.effects.input_maps import delays

LEVELS = Grid("output quantile", (0.4, 0.55, 0.7, 0.8, 0.88, 0.94, 0.98, 1.0))
SENSORS = "Fraden (2016), Handbook of Modern Sensors"


def _saturation(y: Floats, p: Floats, period: float) -> Floats:
    return np.clip(y, -p[0], p[0])


def _saturation_two_sided(y: Floats, p: Floats, period: float) -> Floats:
    return np.clip(y, -p[0], p[1])


def _offset(y: Floats, p: Floats, period: float) -> Floats:
    return np.asarray(y + p[0])


def _drift(y: Floats, p: Floats, period: float) -> Floats:
    return np.asarray(y + p[0] * period * np.arange(y.size))


def _quantisation(y: Floats, p: Floats, period: float) -> Floats:
    return np.asarray(p[0] * np.round(y / p[0])) if p[0] > 0.0 else y


def _rectify(y: Floats, p: Floats, period: float) -> Floats:
    return np.abs(y)


def _half_wave(y: Floats, p: Floats, period: float) -> Floats:
    return np.maximum(y, 0.0)


def _quadratic(y: Floats, p: Floats, period: float) -> Floats:
    return np.asarray(y + p[0] * y**2)


def _periods_per_lag(p: Floats, period: float) -> float:
    """Return the sampling period over the time constant, which is not let vanish."""
    return float(period / max(p[0], 1e-3 * period))


def _low_pass(y: Floats, p: Floats, period: float) -> Floats:
    from sysid.diagnosis.effects.maps import low_pass

    return np.asarray(low_pass(y, np.exp(-_periods_per_lag(p, period)), 0.0))


def _low_pass_in_motion(y: Floats, p: Floats, period: float) -> Floats:
    from sysid.diagnosis.effects.maps import low_pass

    return np.asarray(low_pass(y, np.exp(-_periods_per_lag(p, period)), y[0]))


def _low_pass_straight(y: Floats, p: Floats, period: float) -> Floats:
    from sysid.diagnosis.effects.maps import low_pass_straight

    return np.asarray(low_pass_straight(y, _periods_per_lag(p, period), 0.0))


def _low_pass_straight_in_motion(y: Floats, p: Floats, period: float) -> Floats:
    from sysid.diagnosis.effects.maps import low_pass_straight

    return np.asarray(low_pass_straight(y, _periods_per_lag(p, period), y[0]))


LAG = EffectParameter(
    "time_constant",
    "s",
    "of the filter",
    Grid("period", (0.3, 0.7, 1.5, 3.0, 6.0, 12.0, 25.0)),
    minimum=0.0,
)


def _level(name: str, side: str) -> EffectParameter:
    return EffectParameter(name, "[y]", f"largest value shown{side}", LEVELS, minimum=0.0)


EFFECTS = (
    Effect(
        "out_saturation",
        "output",
        "The sensor or its converter reaches the end of its range.",
        "y = min(max(w, -level), level)",
        "the measured output has flat tops at one value; the model overshoots them",
        "in_saturation rounds the response to large inputs but leaves no flat top; overflow caps a state",
        SENSORS,
        (
            Form("symmetric", (_level("level", ""),), _saturation),
            Form(
                "two-sided",
                (_level("level_negative", ", negative side"), _level("level_positive", ", positive side")),
                _saturation_two_sided,
            ),
        ),
    ),
    Effect(
        "out_offset",
        "output",
        "The sensor's zero is not zero.",
        "y = w + offset",
        "the residual has a mean that depends on nothing",
        "constant_force passes through the dynamics first; out_drift grows with time",
        SENSORS,
        (Form("offset", (EffectParameter("offset", "[y]", "reading at zero"),), _offset, slope="identity"),),
    ),
    Effect(
        "out_drift",
        "output",
        "The sensor's zero wanders: warming up, ageing, an integrator's bias.",
        "y = w + rate t",
        "the residual is a straight line in time",
        "out_offset is constant; time_variation scales with the signal",
        SENSORS,
        (Form("linear", (EffectParameter("rate", "[y]/s", "drift"),), _drift, slope="identity"),),
    ),
    Effect(
        "out_quantisation",
        "output",
        "The converter or encoder shows only multiples of its step.",
        "y = step round(w / step)",
        "few distinct values; the residual is a sawtooth over the output",
        "coloured_noise does not depend on the output",
        "Widrow & Kollár (2008), Quantization Noise",
        (
            Form(
                "round",
                (
                    EffectParameter(
                        "step",
                        "[y]",
                        "one count",
                        Grid("output count", tuple(float(v) for v in np.geomspace(0.1, 4.0, 48))),
                        minimum=0.0,
                    ),
                ),
                _quantisation,
                slope="identity",
                smooth=False,
            ),
        ),
    ),
    Effect(
        "out_rectify",
        "output",
        "The sensor shows the size and not the sign: a rectifier, a flow meter, a speed from pulses.",
        "y = |w| (full wave) or max(w, 0) (half wave)",
        "the measured output never goes below zero and is reflected there",
        "out_saturation at zero is flat, not reflected; out_quadratic bends smoothly",
        SENSORS,
        (Form("full-wave", (), _rectify, lowest=0.0), Form("half-wave", (), _half_wave, lowest=0.0)),
    ),
    Effect(
        "out_quadratic",
        "output",
        "The sensor's characteristic is bent.",
        "y = w + c w^2",
        "the residual over the modelled output is a parabola, whatever the frequency",
        "op_gain and cubic_stiffness act before the dynamics; out_saturation has a knee",
        SENSORS,
        (Form("quadratic", (EffectParameter("c", "1/[y]", "curvature"),), _quadratic),),
    ),
    Effect(
        "out_delay",
        "output",
        "The measurement arrives late: a gas analyser's line, a network.",
        "y(t) = w(t - delay), between samples by linear interpolation",
        "the residual follows the slope of the output",
        "for a linear model it equals in_delay; a second sensor tells them apart",
        "Richard (2003), Time-delay systems, Automatica 39",
        delays((0.3, 0.7, 1.0, 1.4, 1.7, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0), "linear"),
    ),
    Effect(
        "out_lowpass",
        "output",
        "The sensor is slow or filtered: a thermowell, an anti-aliasing filter.",
        "time_constant dy/dt = w - y, where w is held or straight between samples",
        "the residual grows with frequency, the output comes late and smaller",
        "out_delay comes late at full size; extra_mode rings",
        SENSORS,
        (
            Form("first order", (LAG,), _low_pass, slope="linear"),
            Form("first order in motion", (LAG,), _low_pass_in_motion, slope="linear", in_motion=True),
            Form("straight between samples", (LAG,), _low_pass_straight, slope="linear"),
            Form(
                "straight between samples in motion",
                (LAG,),
                _low_pass_straight_in_motion,
                slope="linear",
                in_motion=True,
            ),
        ),
    ),
)
