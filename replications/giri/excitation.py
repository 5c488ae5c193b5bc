"""Why the impulses of (5.1) are unevenly spaced, and what Proposition 5.1 leaves out."""

import numpy as np

from replications.giri import setting
from replications.giri.setting import Floats
from sysid.excitation import impulse_levels
from sysid.nonlinearities import Segments
from sysid.recursive import (
    Excitation,
    convergence_rate,
    excitation_of,
    interpolation_coefficients,
    stationary_period,
)

COUNTER_POLE = 0.8
"""Pole of the plant of the counter-example to Proposition 5.1."""


def lost_pole() -> float:
    """Return a pole that evenly spaced impulses do not excite, for the paper's own nonlinearity.

    With one free stretch the steady state starts it from a state whose part along the pole p is
    proportional to sum_j F(V_j) x^(j-1), x = p^-n: a pole at a root is never seen.
    """
    roots = np.roots(setting.SEGMENTS(np.array(setting.LEVELS))[::-1])
    real = roots[np.abs(roots.imag) < 1e-12].real
    outside = float(real[real > 1.0][0])
    return float(outside ** (-1.0 / setting.ORDER))


def plant_with_pole(pole: float) -> Floats:
    """Return a_1, a_2 of a plant with this pole and one at 0.5."""
    return np.array([-(pole + 0.5), 0.5 * pole])


def period_rows(a: Floats, segments: Segments, levels: tuple[float, ...], *, even: bool) -> Floats:
    """Return the regressors of a period in the steady state."""
    composite = np.outer(setting.B, interpolation_coefficients(levels, segments))
    u = impulse_levels(levels, setting.ORDER, even=even)
    return stationary_period(a, composite, u, levels)[0]


def counter_example() -> Segments:
    """Return segments with F(V_1) = 0 under which (5.1) loses a pole at `COUNTER_POLE`.

    With F(V_1) = 0 the gap after the first impulse brings nothing, and the other three heights meet
    F(V_2) + F(V_3) x + F(V_4) x^2 = 0 by the choice of the positive preload.
    """
    x = COUNTER_POLE**-setting.ORDER
    negative = Segments(1.0, 1.0, 1.0, -1.0, 0.0, 5.0)
    v1, v2, v3, v4 = setting.LEVELS
    assert negative(v1) == 0.0
    offset = -(float(negative(v2)) + x * v3 + x**2 * v4) / (x + x**2)
    return Segments(1.0, 1.0, 1.0, -1.0, 1.0 + offset, 5.0)


def cases() -> dict[str, tuple[Excitation, float]]:
    """Return excitation and rate of convergence for the paper's plant and the two difficult ones."""
    hidden, counter = plant_with_pole(lost_pole()), plant_with_pole(COUNTER_POLE)
    moved = (-7.0, *setting.LEVELS[1:])
    rows = {
        "example": period_rows(np.array(setting.A), setting.SEGMENTS, setting.LEVELS, even=False),
        "example/even": period_rows(np.array(setting.A), setting.SEGMENTS, setting.LEVELS, even=True),
        "hidden-pole": period_rows(hidden, setting.SEGMENTS, setting.LEVELS, even=False),
        "hidden-pole/even": period_rows(hidden, setting.SEGMENTS, setting.LEVELS, even=True),
        "zero-at-V1": period_rows(counter, counter_example(), setting.LEVELS, even=False),
        "zero-at-V1/V1-moved": period_rows(counter, counter_example(), moved, even=False),
    }
    return {name: (excitation_of(found), convergence_rate(found)) for name, found in rows.items()}


def excitation_numbers() -> dict[str, float]:
    """Return rank, smallest singular value and rate of every case."""
    found: dict[str, float] = {"excitation/lost_pole": lost_pole()}
    for name, (excitation, rate) in cases().items():
        found |= {
            f"excitation/{name}/rank": float(excitation.rank),
            f"excitation/{name}/smallest_singular_value": excitation.smallest,
            f"excitation/{name}/rate": rate,
        }
    return found
