"""Effects of the actuator: the input is not what reaches the plant."""

import numpy as np

from sysid.diagnosis.effects.base import Effect, EffectParameter, Floats, Form, Grid, Map

LEVELS = Grid("input quantile", (0.1, 0.25, 0.4, 0.55, 0.7, 0.8, 0.9, 0.96))
WIDTHS = Grid("input quantile", (0.03, 0.08, 0.15, 0.25, 0.4, 0.55, 0.7))
THRESHOLDS = Grid("input quantile", (0.0, 0.05, 0.12, 0.2, 0.3, 0.42, 0.55, 0.7, 0.82, 0.92))
# Effects that put out one of a few values.
SWITCHES = ("in_relay", "in_hysteresis")
BOOK = "Nordin & Gutman (2002), Automatica 38; Bai (2002), Automatica 38"


def _two_sided(kernel: str) -> tuple[Map, Map]:
    """Return a map of one parameter for both sides, and of one for each."""

    def symmetric(u: Floats, p: Floats, period: float) -> Floats:
        from sysid.diagnosis.effects import maps

        return np.asarray(getattr(maps, kernel)(u, p[0], p[0]))

    def two_sided(u: Floats, p: Floats, period: float) -> Floats:
        from sysid.diagnosis.effects import maps

        return np.asarray(getattr(maps, kernel)(u, p[0], p[1]))

    return symmetric, two_sided


def _sided(
    kernel: str, name: str, meaning: str, grid: Grid | None, *, smooth: bool = True
) -> tuple[Form, ...]:
    """Return the symmetric and the two-sided form of a map with one width in units of the input."""
    one, two = _two_sided(kernel)
    low = 0.0 if grid is not None else -np.inf

    def parameter(label: str, side: str) -> EffectParameter:
        return EffectParameter(label, "[u]", meaning + side, grid, minimum=low)

    return (
        Form("symmetric", (parameter(name, ""),), one, smooth=smooth),
        Form(
            "two-sided",
            (
                parameter(f"{name}_negative", ", negative side"),
                parameter(f"{name}_positive", ", positive side"),
            ),
            two,
            smooth=smooth,
        ),
    )


def _relay(u: Floats, p: Floats, period: float) -> Floats:
    from sysid.diagnosis.effects.maps import relay

    return np.asarray(relay(u, p[0], p[0], 1.0))


def _relay_two_sided(u: Floats, p: Floats, period: float) -> Floats:
    from sysid.diagnosis.effects.maps import relay

    return np.asarray(relay(u, p[0], p[1], 1.0 + p[2]))


def _rate_limit(u: Floats, p: Floats, period: float) -> Floats:
    """Limit the rate down, ``p[0]``, and up, ``p[-1]``, of an actuator that has reached the first value."""
    from sysid.diagnosis.effects.maps import rate_limit

    return np.asarray(rate_limit(u, p[0] * period, p[-1] * period, u[0] if u.size else 0.0))


def _rate_limit_from_rest(u: Floats, p: Floats, period: float) -> Floats:
    """Limit the rate of an actuator that was at zero before the start."""
    from sysid.diagnosis.effects.maps import rate_limit

    return np.asarray(rate_limit(u, p[0] * period, p[-1] * period, 0.0))


def delayed(u: Floats, p: Floats, period: float) -> Floats:
    """Delay a sequence by ``p[0]`` seconds, from rest."""
    from sysid.diagnosis.effects.maps import delay

    return np.asarray(delay(u, p[0] / period, 0.0))


def delayed_in_motion(u: Floats, p: Floats, period: float) -> Floats:
    """Delay a sequence by ``p[0]`` seconds, before which it was as at first."""
    from sysid.diagnosis.effects.maps import delay

    return np.asarray(delay(u, p[0] / period, u[0]))


def delays(points: tuple[float, ...], slope: str) -> tuple[Form, ...]:
    """Return the forms of a dead time, tried first at so many samples."""
    dead_time = EffectParameter("delay", "s", "dead time", Grid("period", points), minimum=0.0)
    return (
        Form("delay", (dead_time,), delayed, slope=slope),
        Form("delay in motion", (dead_time,), delayed_in_motion, slope=slope, in_motion=True),
    )


def _at_first(u: Floats) -> float:
    """Return how a switch stands at first if nothing else is known."""
    return 1.0 if u.size and u[0] > 0.0 else -1.0


def _hysteresis(u: Floats, p: Floats, period: float) -> Floats:
    from sysid.diagnosis.effects.maps import hysteresis_relay

    return np.asarray(hysteresis_relay(u, p[0], p[0], _at_first(u)))


def _hysteresis_two_sided(u: Floats, p: Floats, period: float) -> Floats:
    from sysid.diagnosis.effects.maps import hysteresis_relay

    return np.asarray(hysteresis_relay(u, p[0], p[1], _at_first(u)))


def _hysteresis_left(u: Floats, p: Floats, period: float) -> Floats:
    from sysid.diagnosis.effects.maps import hysteresis_relay

    return np.asarray(hysteresis_relay(u, p[0], p[1], p[2]))


def _threshold(name: str, side: str) -> EffectParameter:
    return EffectParameter(name, "[u]", f"threshold of switching{side}", THRESHOLDS, minimum=0.0)


RISES = Grid("input rise", (0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9))


def _rise(name: str, side: str) -> EffectParameter:
    return EffectParameter(name, "[u]/s", f"largest rate{side}", RISES, minimum=0.0)


ONE_RATE = (_rise("rate", ""),)
TWO_RATES = (_rise("rate_falling", ", falling"), _rise("rate_rising", ", rising"))

EFFECTS = (
    Effect(
        "in_saturation",
        "input",
        "The actuator reaches its limit: a larger command brings no more.",
        "x = min(max(u, -level), level)",
        "residual grows with |u| beyond a level and pulls back towards zero; small inputs are modelled well",
        "out_saturation flattens peaks of the output; in_rate_limit depends on how fast u moves",
        "Hippe (2006), Windup in Control",
        _sided("saturation", "level", "largest effective input", LEVELS),
    ),
    Effect(
        "in_deadzone",
        "input",
        "Commands below a threshold do nothing: valve overlap, stiction of a spool, a diode's knee.",
        "x = u - width sign(u) for |u| > width, otherwise 0",
        "no response to small inputs; linear gain falls as the amplitude falls",
        "in_backlash depends on the direction of u; coulomb acts on the speed, not on the input",
        "Tao & Kokotović (1996), Adaptive Control of Systems with Actuator and Sensor Nonlinearities",
        _sided("dead_zone", "width", "threshold below which nothing happens", WIDTHS),
    ),
    Effect(
        "in_preload",
        "input",
        "The input jumps at zero: a pretensioned spring, an over-compensated dead zone.",
        "x = u + jump sign(u)",
        "linear gain rises as the amplitude falls; residual has the sign of u at any size",
        "coulomb has the sign of the speed; in_relay has no slope outside zero",
        BOOK,
        _sided("preload", "jump", "jump at zero", None),
    ),
    Effect(
        "in_relay",
        "input",
        "The actuator only switches: full on, off, full reverse.",
        "x = sign(u) for |u| > threshold, otherwise 0; the level is in the model's gain",
        "the response does not depend on the size of u, only on its sign",
        "in_saturation with a small level has a slope near zero; in_preload keeps the slope outside",
        BOOK,
        (
            Form(
                "symmetric",
                (EffectParameter("threshold", "[u]", "input at which it switches", THRESHOLDS, minimum=0.0),),
                _relay,
                smooth=False,
            ),
            Form(
                "two-sided",
                (
                    EffectParameter("threshold_negative", "[u]", "negative switch", THRESHOLDS, minimum=0.0),
                    EffectParameter("threshold_positive", "[u]", "positive switch", THRESHOLDS, minimum=0.0),
                    EffectParameter("excess_negative", "1", "negative level over the positive one, less 1"),
                ),
                _relay_two_sided,
                smooth=False,
            ),
        ),
    ),
    Effect(
        "in_backlash",
        "input",
        "Play in gears or linkages: after a reversal the input moves freely over a gap.",
        "play operator: x stays while |u - x| <= width, otherwise it is dragged along",
        "the output lags after each reversal of u by a fixed amount; the loop of y over u has flat ends",
        "in_deadzone does not depend on the direction; in_delay lags by a time, not by an amount",
        "Nordin & Gutman (2002), Controlling mechanical systems with backlash, Automatica 38",
        _sided(
            "play",
            "width",
            "half the gap",
            Grid("input swing quantile", (0.05, 0.12, 0.2, 0.3, 0.45, 0.6, 0.75, 0.88)),
        ),
    ),
    Effect(
        "in_delay",
        "input",
        "Transport, communication or computation delays the input.",
        "x(t) = u(t - delay), between samples by linear interpolation",
        "residual correlates with the input at early lags; worse at high frequencies",
        "out_lowpass also loses amplitude; extra_mode rings",
        "Richard (2003), Time-delay systems, Automatica 39",
        delays((0.3, 0.7, 1.0, 1.4, 1.7, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0), "pointwise"),
    ),
    Effect(
        "in_rate_limit",
        "input",
        "The actuator can move only so fast: a valve motor, a hydraulic flow limit.",
        "x follows u by at most rate in a second, from its first value or from zero",
        "large steps become ramps; fast large inputs are followed late, slow ones exactly",
        "in_saturation limits the size; in_delay lags small inputs too",
        "Hippe (2006), Windup in Control",
        (
            Form("symmetric", ONE_RATE, _rate_limit),
            Form("symmetric from rest", ONE_RATE, _rate_limit_from_rest),
            Form("two-sided", TWO_RATES, _rate_limit),
            Form("two-sided from rest", TWO_RATES, _rate_limit_from_rest),
        ),
    ),
    Effect(
        "in_hysteresis",
        "input",
        "A switch with memory: on above one threshold, off below another (thermostat, Schmitt trigger).",
        "x = 1 after u > width, -1 after u < -width, held between, at first with the sign of u or as it was "
        "left; the level is in the model's gain",
        "the output jumps at different inputs on the way up and on the way down",
        "in_relay switches at the same input both ways; in_backlash keeps a slope",
        "Visintin (1994), Differential Models of Hysteresis",
        (
            Form("symmetric", (_threshold("width", ""),), _hysteresis, smooth=False),
            Form(
                "two-sided",
                (
                    _threshold("width_negative", ", negative side"),
                    _threshold("width_positive", ", positive side"),
                ),
                _hysteresis_two_sided,
                smooth=False,
            ),
            Form(
                "left as it was",
                (
                    _threshold("width_negative", ", negative side"),
                    _threshold("width_positive", ", positive side"),
                    EffectParameter(
                        "before", "1", "where it stood before the first switch, -1 to 1", None, -1.0, 1.0
                    ),
                ),
                _hysteresis_left,
                smooth=False,
            ),
        ),
    ),
)
