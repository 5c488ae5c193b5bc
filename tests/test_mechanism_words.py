"""Laws of a position in a linear model: named by what was measured."""

from types import SimpleNamespace

import numpy as np
import pytest

from sysid import diagnose
from sysid.data import make_record
from sysid.data.record import Record
from sysid.diagnosis.decide.modes import swings


def bent_record(output: str, unit: str) -> Record:
    """Return a record of a first-order lag whose loss grows with the cube of its output."""
    rng = np.random.default_rng(5)
    u = np.repeat(rng.uniform(-1, 1, 80), 10)
    y = np.zeros(u.size)
    for k in range(1, u.size):
        y[k] = 0.9 * y[k - 1] + 0.2 * (u[k - 1] - 0.4 * y[k - 1] ** 3)
    split = np.repeat(["est", "val", "test"], [500, 150, 150])
    y += 0.01 * rng.standard_normal(u.size)
    units = {output: unit} if unit else None
    return make_record(u, y, period=1.0, split=split, outputs=[output], units=units)


@pytest.mark.parametrize(
    ("output", "unit", "said", "unsaid"),
    [
        ("T1", "degC", "A loss that grows", "spring"),
        ("phi", "deg", "A spring that stiffens", "radiation"),
        ("y", "", "if the output is a position or an angle; otherwise a loss", "Gravity"),
    ],
)
def test_a_cube_of_the_output_is_a_spring_only_of_a_position(
    output: str, unit: str, said: str, unsaid: str
) -> None:
    found = diagnose(bent_record(output, unit), order=1, effects=["cubic_stiffness"])
    (sentence,) = (s for s in found.sentences() if s.startswith("cubic_stiffness: ") and " = " not in s[:25])
    assert found.accepted == ("cubic_stiffness",)
    assert said in sentence
    assert unsaid not in sentence


@pytest.mark.parametrize(("frequency", "vibrates"), [(0.0, False), (0.5, False), (0.7, True)])
def test_a_mode_that_does_not_swing_once_is_no_vibration(frequency: float, vibrates: bool) -> None:
    # One swing in ten seconds is 0.63 rad/s.
    mode = [SimpleNamespace(name="frequency", value=frequency), SimpleNamespace(name="damping", value=0.1)]
    fit = SimpleNamespace(parameters_of=lambda name: mode if name == "extra_mode" else [])
    assert swings(fit, 10.0) is vibrates  # type: ignore[arg-type]
    assert swings(SimpleNamespace(parameters_of=lambda name: []), 10.0)  # type: ignore[arg-type]


def test_a_part_of_a_sample_beside_a_force_is_no_transport() -> None:
    # A pendulum in steps of a millisecond, its torque held for twenty of them.
    rng = np.random.default_rng(11)
    u, angle, speed, y = np.repeat(rng.uniform(-3.4, 3.4, 40), 25), 0.0, 0.0, np.empty(1000)
    for k, torque in enumerate(u):
        y[k] = angle
        for _ in range(20):
            speed += 0.001 * (torque - 0.35 * speed - 3.9 * np.sin(angle)) / 0.12
            angle += 0.001 * speed
    record = make_record(u, y + 0.002 * rng.standard_normal(1000), period=0.02)
    found = diagnose(record, order=2, effects=["gravity_sine", "in_delay"])
    assert found.accepted == ("gravity_sine", "in_delay")
    assert any("is no transport" in sentence for sentence in found.sentences())
