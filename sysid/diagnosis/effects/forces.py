"""Effects inside the dynamics: forces that depend on motion, gains that depend on the operating point."""

from sysid.diagnosis.effects.base import Effect, EffectParameter, Form, Grid

SPEEDS = Grid("speed deviation", (0.05, 0.15, 0.4, 1.0))
FRICTION = "Armstrong-Hélouvry, Dupont & Canudas de Wit (1994), Automatica 30"
DUFFING = "Kerschen et al. (2006), Mechanical Systems and Signal Processing 20"
PHYSICS = ("physics",)
COULOMB = EffectParameter("Fc", "[F]", "dry friction")
SIGMA = EffectParameter(
    "sigma", "[F]/[x]", "stiffness of the contact", Grid("plain", (1.0, 10.0, 100.0)), minimum=0.0
)
FC = EffectParameter("Fc", "[F]", "force at which it slips", Grid("plain", (0.1, 1.0)), minimum=0.0)
# What both branches of a loop share, relative to what opens it: beyond this there is no loop to speak of, and
# the law is that of an elastic spring of some shape.  The benchmark of Noël & Schoukens (2016) has -1.4.
MOST_SHARED = 3.0


def _power(name: str, tank: str) -> EffectParameter:
    """Return a power of a level: 1/2 through a hole, 1 through a narrow pipe, 3/2 through a slot."""
    grid = Grid("plain", (0.5,))
    return EffectParameter(name, "1", f"power of the {tank} level", grid, minimum=0.2, maximum=1.5)


EFFECTS = (
    Effect(
        "coulomb",
        "force",
        "Dry friction: a constant force against the motion, which can hold the body still.",
        "F = Fc sign(v); at rest any force up to Fc",
        "the body stops earlier and sticks at reversals; free decay is linear, not exponential",
        "quad_drag grows with the speed; in_deadzone acts on the input whatever the speed",
        FRICTION,
        (Form("coulomb", (COULOMB,), expression="Fc*sign(v)"),),
        PHYSICS,
        dry=True,
    ),
    Effect(
        "stribeck",
        "force",
        "Dry friction that falls as the film of lubricant builds up.",
        "F = (Fc + Fs exp(-(v/vs)^2)) sign(v)",
        "stick-slip at low speed, friction smaller once moving",
        "coulomb has the same friction at all speeds",
        FRICTION,
        (
            Form(
                "stribeck",
                (
                    COULOMB,
                    EffectParameter("Fs", "[F]", "friction at breakaway over that in motion"),
                    EffectParameter("vs", "[v]", "Stribeck speed", SPEEDS, minimum=0.0),
                ),
                expression="(Fc + Fs*exp(-(v/vs)**2))*sign(v)",
            ),
        ),
        PHYSICS,
        dry=True,
    ),
    Effect(
        "asymmetric_friction",
        "force",
        "Dry friction that differs between the directions.",
        "F = Fp for v > 0, -Fn for v < 0",
        "one direction is slower than the other for equal inputs",
        "constant_force with coulomb has the same curve: gravity tells them apart",
        FRICTION,
        (
            Form(
                "two-sided",
                (
                    EffectParameter("Fp", "[F]", "friction in forward motion"),
                    EffectParameter("Fn", "[F]", "friction in backward motion"),
                ),
                expression="where(v > 0, Fp, where(v < 0, -Fn, 0))",
            ),
        ),
        PHYSICS,
        dry=True,
    ),
    Effect(
        "hysteresis_force",
        "force",
        "Friction with presliding: the contact gives elastically before it slips (Dahl, Bouc-Wen).",
        "F = z, z' = sigma v (1 - z/Fc sign(v) - g |z|/Fc) (Dahl: g = 0)",
        "loops of force over position that do not depend on the speed",
        "coulomb jumps at reversal; cubic_stiffness has no loop",
        "Dahl (1976), AIAA Journal 14; Wen (1976), Journal of the Engineering Mechanics Division 102",
        (
            Form(
                "Dahl",
                (
                    SIGMA,
                    FC,
                ),
                expression="z",
                state="sigma*v*(1 - z/Fc*sign(v))",
            ),
            Form(
                "Bouc-Wen",
                (
                    SIGMA,
                    FC,
                    EffectParameter(
                        "g",
                        "1",
                        "softening (stiffening below 0) on both branches of the loop",
                        minimum=-MOST_SHARED,
                        maximum=MOST_SHARED,
                    ),
                ),
                expression="z",
                state="sigma*v*(1 - z/Fc*sign(v) - g*abs(z)/Fc)",
            ),
        ),
        PHYSICS,
    ),
    Effect(
        "quad_drag",
        "force",
        "Drag of a fluid in turbulent flow, against the motion and with the square of the speed.",
        "F = c v |v|",
        "the residual is largest at the largest speeds; damping grows with the amplitude",
        "coulomb does not grow with the speed; cubic_stiffness follows the position",
        "Batchelor (1967), An Introduction to Fluid Dynamics",
        (Form("drag", (EffectParameter("c", "[F]/[v]^2", "drag"),), expression="c*v*abs(v)"),),
    ),
    Effect(
        "cubic_stiffness",
        "force",
        "A spring that stiffens (or softens) with its deflection.",
        "F = k3 x^3",
        "the resonance moves with the amplitude; third harmonics",
        "quad_drag changes damping, not frequency; op_gain changes the gain of the input",
        DUFFING,
        (Form("cubic", (EffectParameter("k3", "[F]/[x]^3", "cubic stiffness"),), expression="k3*x**3"),),
    ),
    Effect(
        "gravity_sine",
        "force",
        "Gravity on a lever or pendulum.",
        "F = g sin(x / scale)",
        "stiffness changes sign with the angle; with a scale of 1 rad it is an angle",
        "cubic_stiffness is the first term of its series: large angles tell them apart",
        "Khalil (2002), Nonlinear Systems",
        (
            Form(
                "sine",
                (
                    EffectParameter("g", "[F]", "force at a quarter turn"),
                    EffectParameter(
                        "scale",
                        "[x]",
                        "position of one radian",
                        Grid("output deviation", (0.3, 0.5, 0.8, 1.3)),
                        minimum=0.0,
                    ),
                ),
                expression="g*sin(x/scale)",
            ),
        ),
    ),
    Effect(
        "constant_force",
        "force",
        "A constant load: gravity on a slope, a bias of the drive.",
        "F = F0",
        "drifts to one side without input",
        "out_offset does not pass through the dynamics and is there from the first sample",
        "Khalil (2002), Nonlinear Systems",
        (Form("constant", (EffectParameter("F0", "[F]", "constant force"),), expression="F0"),),
    ),
    Effect(
        "op_gain",
        "gain",
        "The gain of the actuator depends on the operating point.",
        "x = u (1 + g tanh(y / scale))",
        "the same input moves the output more at one end of the range than at the other",
        "out_quadratic bends the reading only; time_variation follows the clock, not the output",
        "Rugh & Shamma (2000), Research on gain scheduling, Automatica 36",
        (
            Form(
                "tanh",
                (
                    EffectParameter(
                        "g", "1", "largest relative change of the gain", minimum=-1.0, maximum=1.0
                    ),
                    EffectParameter(
                        "scale",
                        "[y]",
                        "output at which it has changed",
                        Grid("output deviation", (0.3, 0.8, 2.0, 4.0)),
                        minimum=0.0,
                    ),
                ),
                expression="1 + g*tanh(y/scale)",
            ),
        ),
    ),
    Effect(
        "sqrt_outflow",
        "flow",
        "A tank empties with the square root of its level (Torricelli).",
        "outflow a x becomes a sqrt(x), or a x^power where the outlet is no hole",
        "fast at high levels, slow at low ones compared with the linear tank",
        "overflow acts only at the top; out_quadratic bends the reading only",
        "Wigren & Schoukens (2013), European Control Conference",
        (
            Form("square root", ()),
            Form("power", (_power("power_1", "upper"), _power("power_2", "lower")), refines=True),
        ),
        PHYSICS,
    ),
    Effect(
        "overflow",
        "flow",
        "A tank is full: what comes in runs over.",
        "level <= limit",
        "flat tops of the output that last as long as the inflow is large",
        "out_saturation forgets at once; an overflowing tank starts to fall from its limit",
        "Wigren & Schoukens (2013), European Control Conference",
        (
            Form(
                "limit",
                (
                    EffectParameter(
                        "limit",
                        "[x]",
                        "highest level",
                        Grid("output quantile", (0.8, 0.9, 0.97, 1.0)),
                        minimum=0.0,
                    ),
                ),
            ),
            Form(
                "cascade",
                (
                    EffectParameter(
                        "limit_1",
                        "[x]",
                        "highest level of the upper tank",
                        Grid("output deviation", (2.0, 4.0, 8.0, 16.0)),
                        minimum=0.0,
                    ),
                    EffectParameter(
                        "limit_2",
                        "[x]",
                        "highest level of the lower tank",
                        Grid("output quantile", (0.9, 1.0)),
                        minimum=0.0,
                    ),
                    EffectParameter(
                        "caught",
                        "1",
                        "share of the upper tank's overflow that the lower one catches",
                        Grid("plain", (0.0, 0.5, 0.9)),
                        minimum=0.0,
                        maximum=1.0,
                    ),
                ),
            ),
        ),
        PHYSICS,
    ),
)
