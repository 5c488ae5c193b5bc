"""Two-state runs with added forces beside the generated kernel of the same equation, in one run."""

import numpy as np
import pytest

from sysid.physics import Simulator, load_model
from sysid.physics.forced import ForcedPlant, law

PERIOD, SUBSTEPS = 0.1, 2
VALUES = np.array([[1.0, 0.2, 1.0]])
LAWS = {
    "cubic": law(cubic=0.5),
    "drag": law(drag=0.5),
    "coulomb": law(friction_forward=0.3, friction_back=0.3),
    "stribeck": law(friction_forward=0.2, friction_back=0.2, breakaway=0.2, stribeck_speed=0.1),
}


def excitation(n):
    return np.repeat(np.random.default_rng(0).standard_normal(n // 5), 5)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.benchmark(group="100,000 samples, two steps each")
def test_forced_plant(benchmark, name):
    plant, u = ForcedPlant(load_model("mass-spring-damper"), PERIOD), excitation(100_000)
    plant.run(VALUES, LAWS[name][np.newaxis], u[:10], substeps=SUBSTEPS)
    y = benchmark(plant.run, VALUES, LAWS[name][np.newaxis], u, None, SUBSTEPS)
    assert np.isfinite(y).all()


@pytest.mark.benchmark(group="100,000 samples, two steps each")
def test_generated_kernel(benchmark):
    model = load_model("oscillator").with_parameters(start={"zeta": 0.1, "cubic": 0.5})
    simulator, u = Simulator(model, PERIOD, SUBSTEPS), excitation(100_000)
    simulator.run({}, u[:10])
    assert np.isfinite(benchmark(simulator.run, {}, u)).all()
