"""A force that only resembles the missing one, the rest of which passes for noise."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

import sysid
from sysid.data import make_record

PERIOD, N = 0.1, 1500


def stage(force, memory):
    """Return x'' = u - 0.1 x' - force(x') under a sweep, 32 dB above noise with a memory."""
    t, state, y = PERIOD * np.arange(N), np.zeros(2), []
    u = 2.0 * np.sin(0.1 * t + 0.006 * t**2)
    for held in u:
        y.append(state[0])
        slope = lambda _, s, held=held: [s[1], held - 0.1 * s[1] - force(s[1])]  # noqa: E731
        state = solve_ivp(slope, (0.0, PERIOD), state, rtol=1e-7, atol=1e-9).y[:, -1]
    noise = lfilter([1.0], [1.0, -memory], np.random.default_rng(1).standard_normal(N))
    return make_record(u, y + np.std(y) * 10 ** (-32 / 20) * noise * np.sqrt(1.0 - memory**2), PERIOD)


@pytest.mark.parametrize(
    ("force", "memory", "verdict", "accepted"),
    [
        (lambda v: v**3, 0.0, "unexplained", ()),
        (lambda v: v * abs(v), 0.6, "missing-effect", ("quad_drag", "coloured_noise")),
    ],
    ids=["a damper of the third degree is no drag", "a drag is one beside coloured noise, too"],
)
def test_a_law_is_named_only_if_no_curve_follows_the_force_better(force, memory, verdict, accepted):
    found = sysid.diagnose(
        stage(force, memory),
        "positioning-stage",
        initial_state="rest",
        start={"M": 1.05, "F_v": 0.11},
        fixed={"gain": 1.0},
        effects=["quad_drag", "cubic_stiffness", "in_saturation", "coloured_noise"],
    )
    assert (found.verdict, found.accepted) == (verdict, accepted)
    if not accepted:
        assert found.ports[0].port == "velocity"
        assert found.ports[0].explains_at_most > 0.8
