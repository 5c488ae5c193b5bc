"""Records without any noise: computed outputs, and an output that is the input once more."""

import warnings

import numpy as np
from scipy.linalg import expm

import sysid
from sysid.data import make_record
from sysid.data.record import Record


def copied() -> Record:
    u = np.repeat(np.random.default_rng(10820).uniform(-2, 2, 100), 6)
    return make_record(u, u, period=0.01, split=np.repeat(["est", "val", "test"], [300, 150, 150]))


def test_an_output_that_is_the_input_is_diagnosed_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = sysid.diagnose(copied(), order=1, effects=["in_saturation", "quad_drag", "feedthrough"])
    assert found.decision.accepted == ("feedthrough",)
    assert not any("grows" in sentence for sentence in found.sentences())


def test_a_comparison_finds_no_place_where_rounding_fails():
    found = sysid.compare(copied(), "linear")
    assert found.where == ()
    assert (
        found.sentences()[1]
        == "Nothing but rounding is left: 'y' was computed, not measured, or is the input once more."
    )


def test_nothing_is_missing_where_rounding_is_left():
    rng = np.random.default_rng(10821)
    mass, damping, stiffness, period = 1.0, 1.2, 7.0, 0.05
    dynamics = np.array([[0.0, 1.0], [-stiffness / mass, -damping / mass]])
    step = expm(dynamics * period)
    drive = np.linalg.solve(dynamics, step - np.eye(2)) @ [0.0, 1.0 / mass]
    u, x, y = np.repeat(rng.uniform(-2, 2, 40), 10), np.zeros(2), []
    for force in u:
        y.append(x[0])
        x = step @ x + drive * force
    split = np.repeat(["est", "val", "test"], [200, 100, 100])
    record = make_record(u, y, period=period, split=split)
    assert sysid.diagnose(record, "linear", 2).verdict == "nothing-missing"
    found = sysid.diagnose(record, "mass-spring-damper")
    assert found.verdict == "nothing-missing"
    assert [round(p.value, 6) for p in found.final.parameters] == [1.0, 1.2, 7.0]
