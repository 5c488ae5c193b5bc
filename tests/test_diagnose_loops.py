"""Records from under a controller, which hands the noise of a sample on to the input of the same sample."""

import numpy as np
import pytest

from sysid.data import make_record
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.diagnose import diagnose
from sysid.diagnosis.linear.structure import LinearStructure

PERIOD, MASS, FRICTION = 0.1, 2.0, 4.0
GIVEN = {"M": 2.2, "F_v": 3.7}
FEW = ["feedthrough", "extra_mode", "out_quantisation", "in_preload", "coloured_noise"]


def positioned(seed, noise, step=0.0, n=900):
    """A stage under a controller of position and speed, exact between samples; its reading in steps."""
    rng = np.random.default_rng(seed)
    target = 0.4 * np.repeat(rng.uniform(-1, 1, n // 15), 15)
    noise = noise * rng.standard_normal(n)
    decay = np.exp(-FRICTION / MASS * PERIOD)
    way = (1.0 - decay) * MASS / FRICTION
    x = v = before = 0.0
    u, y = np.empty(n), np.empty(n)
    for k in range(n):
        position = x + noise[k]
        y[k] = (step * np.round(x / step) if step else x) + noise[k]
        u[k] = 12.0 * (target[k] - position) - 20.0 * (position - before)
        before = position
        x += way * v + (PERIOD - way) * u[k] / FRICTION
        v = decay * v + (1.0 - decay) * u[k] / FRICTION
    return make_record(u, y, period=PERIOD)


def found_in(record):
    return diagnose(
        record, "positioning-stage", start=GIVEN, fixed={"offset": 0.0}, initial_state="rest", effects=FEW
    )


def test_noise_in_the_input_of_a_physical_model_is_not_an_effect():
    found = found_in(positioned(1, 0.03))
    assert found.decision.fed_back
    assert found.verdict == "nothing-missing"
    assert "as under a controller" in found.advice


def test_an_effect_is_named_beside_noise_in_the_input():
    found = found_in(positioned(1, 0.06, step=0.3))
    assert found.accepted == ("out_quantisation",)
    (value,) = (p.value for p in found.final.fitted.parameters_of("out_quantisation"))
    assert value == pytest.approx(0.3, rel=0.03)


def test_noise_shows_in_what_a_smooth_input_does_anew():
    """The input is all but foreseen from earlier rows, so that its plain correlation tells little."""
    rng = np.random.default_rng(0)
    n, x = 900, 0.0
    u, y = np.empty(n), np.empty(n)
    phases = rng.uniform(0.0, 2.0 * np.pi, 12)
    target = np.sum([np.sin(0.08 * (i + 1) * np.arange(n) + p) for i, p in enumerate(phases)], axis=0)
    noise = 0.02 * rng.standard_normal(n)
    for k in range(n):
        y[k] = x + noise[k]
        u[k] = target[k] - 2.0 * y[k]
        x = 0.7 * x + 0.3 * u[k]
    structure = LinearStructure(make_record(u, y, period=PERIOD), 1, initial_state="rest")
    record = structure.record
    evidence = Evidence(structure, record.estimation, record.validation, 0.01)
    assert evidence.only_at_once(structure.baseline(record.estimation))
