"""Effects a linear model of higher order would hold, or one whose gain moves with time."""

import numpy as np

from sysid.diagnosis.effects.base import Effect, EffectParameter, Floats, Form, Grid


def _mode(u: Floats, p: Floats, period: float) -> Floats:
    from sysid.diagnosis.effects.maps import second_order

    damping = min(max(p[1], 0.0), 0.999)
    radius = np.exp(-damping * p[0] * period)
    angle = min(p[0] * period * np.sqrt(1.0 - damping**2), np.pi)
    return np.asarray(second_order(u, radius, angle, p[2], p[3]))


def _feedthrough(u: Floats, p: Floats, period: float) -> Floats:
    return np.asarray(p[0] * u)


def _ramp(u: Floats, p: Floats, period: float) -> Floats:
    return np.asarray(u * (1.0 + p[0] * period * np.arange(u.size)))


def _step(u: Floats, p: Floats, period: float) -> Floats:
    # Between two samples the change is shared, so that the time of the step can be searched smoothly.
    passed = np.clip(period * np.arange(u.size) - p[1] + period, 0.0, period) / period
    return np.asarray(u * (1.0 + p[0] * passed))


MODE_PARAMETERS = (
    EffectParameter(
        "frequency",
        "rad/s",
        "natural frequency",
        Grid("rate", tuple(float(v) for v in np.geomspace(0.04, 3.0, 24))),
        minimum=0.0,
    ),
    EffectParameter("damping", "1", "damping ratio", Grid("plain", (0.02, 0.1)), 0.0, 0.9),
    EffectParameter("gain_1", "[y]/[u]", "numerator at one sample"),
    EffectParameter("gain_2", "[y]/[u]", "numerator at two samples"),
)
DIRECT_GAIN = EffectParameter("d", "[y]/[u]", "direct gain")

EFFECTS = (
    Effect(
        "extra_mode",
        "parallel",
        "A lightly damped vibration of the structure beside the modelled dynamics.",
        "y = w + mode of second order (frequency, damping) driven by u",
        "the residual rings at one frequency; a narrow peak in its spectrum that follows the input",
        "in_delay shifts without ringing; coloured_noise does not follow the input",
        "Ljung (1999), System Identification",
        (
            Form("second order", MODE_PARAMETERS, _mode),
            Form(
                "second order behind",
                MODE_PARAMETERS,
                _mode,
                refines=True,
                behind=True,
                equation="y = w + mode of second order (frequency, damping) driven by x, as the model is",
            ),
        ),
    ),
    Effect(
        "feedthrough",
        "parallel",
        "Part of the input reaches the output at once: cross-talk, a resistance, a rigid path.",
        "y = w + d u; behind the actuator y = w + d x; inside y = w + d (x - forces), which follow y",
        "the residual correlates with the input at lag zero",
        "in_delay correlates at later lags",
        "Ljung (1999), System Identification",
        (
            Form("direct", (DIRECT_GAIN,), _feedthrough),
            Form("inside", (DIRECT_GAIN,), _feedthrough, refines=True, inside=True, families=("linear",)),
            Form(
                "behind",
                (DIRECT_GAIN,),
                _feedthrough,
                refines=True,
                behind=True,
                equation="y = w + d x, where x drives the model",
            ),
        ),
    ),
    Effect(
        "time_variation",
        "input",
        "The gain changes with time: heating, wear, a supply that sags or is switched.",
        "x = u (1 + rate t), or u (1 + size) after a time",
        "the residual grows (or sets in) with time and scales with the signal",
        "out_drift does not scale with the signal; op_gain follows the output",
        "Niedźwiecki (2000), Identification of Time-varying Processes",
        (
            Form("ramp", (EffectParameter("rate", "1/s", "relative change of the gain in a second"),), _ramp),
            Form(
                "step",
                (
                    EffectParameter("size", "1", "relative change of the gain"),
                    EffectParameter(
                        "time",
                        "s",
                        "when it changes",
                        Grid("duration", tuple(i / 20 for i in range(1, 20))),
                        minimum=0.0,
                    ),
                ),
                _step,
                smooth=False,
            ),
        ),
    ),
    Effect(
        "coloured_noise",
        "noise",
        "The disturbance has a memory: wind, waves, drift of the supply.",
        "y = w + e / D(q), white e",
        "the residual is correlated in time but follows neither input nor output",
        "every missing effect colours the residual: it counts only when none explains it",
        "Ljung (1999), System Identification",
        (Form("autoregressive", ()),),
    ),
)
