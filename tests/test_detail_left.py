"""What is left beside a true effect: a detail of its own, or the sign of a look-alike."""

from dataclasses import replace

import numpy as np
import pytest

from sysid.data import make_record
from sysid.diagnosis.decide.verdict import with_a_detail_left
from sysid.diagnosis.diagnose import diagnose

CANDIDATES = ["in_saturation", "in_deadzone", "out_saturation"]


def levels(rng, n=1200):
    return np.repeat(rng.uniform(-3.0, 3.0, n // 8 + 1), 8)[:n]


def record_through(actuator, seed=1):
    """A first-order plant behind an actuator, with quiet white noise."""
    rng = np.random.default_rng(seed)
    u = levels(rng)
    y, driven = np.zeros(u.size), actuator(u)
    for k in range(1, u.size):
        y[k] = 0.9 * y[k - 1] + 0.1 * driven[k - 1]
    return make_record(u, y + 0.004 * rng.standard_normal(u.size), period=0.1)


def tiring(command):
    """An actuator that gets weaker the more it has done: a memory that no candidate has."""
    weariness, driven = 0.0, np.empty(command.size)
    for k, v in enumerate(command):
        weariness += 0.2 * (abs(v) - weariness)
        driven[k] = v * (1.0 - 0.13 * weariness)
    return driven


def test_a_true_effect_beside_something_small_is_named_and_the_rest_is_told():
    found = diagnose(record_through(lambda u: tiring(np.clip(u, -1.5, 1.8))), order=1, effects=CANDIDATES)
    assert (found.verdict, found.accepted) == ("missing-effect", ("in_saturation",))
    assert 0.005 < found.decision.left_share < 0.03
    assert found.decision.left_p_value < 1e-10
    assert "of the explainable error is left, which nothing in the list explains" in found.advice
    assert not found.ports


@pytest.mark.parametrize(
    "actuator",
    [
        pytest.param(lambda u: u + 0.08 * np.clip(u, -1.5, 1.8) ** 3, id="bent"),
        pytest.param(tiring, id="memory"),
    ],
)
def test_effects_that_only_resemble_what_is_missing_are_not_believed(actuator):
    """A bent limit is followed to some per cent by two of the list, but one curve follows it to the noise."""
    found = diagnose(record_through(actuator), order=1, effects=CANDIDATES)
    assert found.verdict == "unexplained"
    assert found.accepted == ()
    assert found.ports[0].port == "input"


def test_what_is_left_beside_many_effects_is_no_detail():
    decision = diagnose(
        record_through(lambda u: tiring(np.clip(u, -1.5, 1.8))), order=1, effects=CANDIDATES
    ).decision
    left = replace(decision, verdict="unexplained")
    assert with_a_detail_left(left).verdict == "missing-effect"
    assert with_a_detail_left(replace(left, fits=3 * left.fits)).verdict == "unexplained"
