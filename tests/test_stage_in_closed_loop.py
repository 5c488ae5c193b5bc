"""A positioning stage under control at 1 kHz whose friction no candidate has exactly, as a real one."""

import numpy as np
import pytest

from sysid.data import make_record
from sysid.diagnosis.diagnose import diagnose

MASS, DRY, LOAD = 40.0, 9.0, 1.5
FORWARD, BACKWARD = 75.0, 105.0  # viscous friction [N s/m]: no candidate knows a direction
PERIOD, PARTS = 1e-3, 20
EFFECTS = [
    "coulomb", "stribeck", "quad_drag", "gravity_sine", "op_gain", "extra_mode", "out_quadratic",
    "coloured_noise",
]  # fmt: skip


def held(reference, dry, seed=0):
    """Return force and encoder position; a plain loop whose friction may hold the body in each small step."""
    rng, step = np.random.default_rng(seed), PERIOD / PARTS
    u, y = np.zeros(reference.size), np.zeros(reference.size)
    x = v = 0.0
    for k in range(reference.size):
        y[k] = x + 2e-7 * rng.standard_normal()
        u[k] = 8000.0 * (reference[k] - y[k]) - 900.0 * v + 0.05 * rng.standard_normal()
        for _ in range(PARTS):
            friction = FORWARD if v > 0.0 else BACKWARD
            free = v + step / MASS * (u[k] - LOAD - friction * v)
            v = np.sign(free) * max(abs(free) - step / MASS * dry, 0.0)
            x += step * v
    return u, y


def reference(n, phase):
    t = PERIOD * np.arange(n)
    path = 0.1 * np.cos(2.0 * t + phase) + 0.03 * np.sin(7.0 * t)
    return (path - path[0]) * np.minimum(t / 0.5, 1.0)


def record_of(dry, estimation=11_000, test=4_000):
    parts = [held(reference(estimation, 0.0), dry), held(reference(test, 1.0), dry, 1)]
    # The record begins while the stage is moving already, so that its initial state has to be estimated.
    u, y = (np.concatenate([part[i][300:] for part in parts]) for i in (0, 1))
    sets = np.repeat(["train", "test"], [estimation - 300, test - 300])
    return make_record(u, y, period=PERIOD, split=sets, experiment=sets.copy(), skip={"test": 20})


def test_dry_friction_is_named_and_nothing_else_beside_what_no_candidate_explains():
    found = diagnose(
        record_of(DRY),
        "positioning-stage",
        start={"M": 45.0, "F_v": 80.0},
        effects=[*EFFECTS, "constant_force"],
    )
    assert found.verdict == "missing-effect"
    assert found.accepted[0] in ("coulomb", "stribeck")
    assert set(found.accepted[1:]) <= {"coloured_noise"}
    errors = [rung.scores["test"]["rmse"] for rung in found.ladder]
    assert errors[-1] < 0.5 * errors[0]
    values = {p.name: p.value for p in found.final.parameters}
    # What differs between the directions is seen as a constant force, on the average over the motion.
    speed = float(np.mean(np.abs(np.diff(found.record.y[:, 0])))) / PERIOD
    seen = LOAD + 0.5 * (FORWARD - BACKWARD) * speed
    # Tolerances a few times the errors of a search that ends within 1 % of its minimum.
    assert values["offset"] == pytest.approx(seen, abs=0.4)
    assert values["M"] == pytest.approx(MASS, rel=0.05)
    if found.accepted[0] == "coulomb":
        assert values["Fc"] == pytest.approx(DRY, rel=0.1)
    assert any("a constant force is part of the model" in sentence for sentence in found.sentences())
    assert "of the explainable error is left" in found.advice
