"""A physical model with a second, measured input."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import sysid
from sysid.data import make_record
from sysid.errors import UsageError
from sysid.physics import load_model

SHAKEN = """
name = "loaded-mass"
title = "A mass on a spring against a load"

[states]
x = { unit = "m", meaning = "position" }
v = { unit = "m/s", meaning = "velocity" }

[inputs]
u = { unit = "N", meaning = "force" }
d = { unit = "N", meaning = "load" }

[outputs.y]
unit = "m"
terms = { "position" = "x" }

[[equations]]
state = "x"
unit = "m/s"
terms = { "velocity" = "v" }

[[equations]]
state = "v"
factor = "m"
unit = "N"
terms = { "force" = "u", "load" = "-d", "damper" = "-c*v", "spring" = "-k*x" }

[parameters]
m = { unit = "kg", start = 1.1, minimum = 0.0, meaning = "mass" }
c = { unit = "N s/m", start = 0.5, minimum = 0.0, meaning = "damping" }
k = { unit = "N/m", start = 1.8, minimum = 0.0, meaning = "stiffness" }
"""
PERIOD, N = 0.1, 900


def measured():
    rng = np.random.default_rng(2)
    u, load = np.repeat(rng.uniform(-3, 3, N // 10), 10), np.repeat(rng.uniform(-2, 2, N // 25), 25)
    state, y = np.zeros(2), []
    for held, against in zip(u, load, strict=True):
        y.append(state[0])

        def slope(_, s, force=held - against):
            return [s[1], force - 0.6 * s[1] - 2.0 * s[0] - 0.8 * s[1] * abs(s[1])]

        state = solve_ivp(slope, (0.0, PERIOD), state, rtol=1e-8, atol=1e-10).y[:, -1]
    noise = 0.005 * rng.standard_normal(N)
    return make_record(np.column_stack([u, load]), np.array(y) + noise, PERIOD), noise


def test_an_effect_is_found_beside_a_measured_load(tmp_path):
    file = tmp_path / "loaded.toml"
    file.write_text(SHAKEN)
    record, noise = measured()
    found = sysid.diagnose(record, load_model(file), initial_state="rest")
    assert found.accepted == ("quad_drag",)
    (drag,) = found.final.fitted.parameters_of("quad_drag")
    assert abs(drag.value - 0.8) < 4 * drag.std_error
    # With twice the inputs there are twice the questions: what these took for noise was 0.8 of it.
    assert found.noise_floor == pytest.approx(np.std(noise[record.learning]), rel=0.05)


def test_a_linear_model_of_two_inputs_is_refused_with_a_way_out():
    record, _ = measured()
    with pytest.raises(UsageError, match="choose them by --input and --output, or describe the plant"):
        sysid.diagnose(record, "linear")
