"""Parts of a diagnosis: a Jacobian beside a run alone, runs side by side beside runs one by one."""

import numpy as np
import pytest

from sysid.data import make_record
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.physics.problem import COARSE_STEP, Problem
from sysid.diagnosis.physics.structure import PhysicsStructure
from sysid.diagnosis.structures.structure import Choice
from sysid.physics import forced_kernels, load_model
from sysid.physics.forced import ForcedPlant, law
from sysid.physics.forced_lanes import lane_runs
from sysid.physics.own_laws import NO_OWN_LAW, kernel_of

LANES, SUBSTEPS, PERIOD = 8, 3, 0.15
LAWS = {
    "cubic": law(cubic=0.5),
    "dry friction": law(friction_forward=0.3, friction_back=0.3),
    "gain": law(gain=0.3, gain_scale=0.5),
}


def forced_runs(*arguments):
    """Run one after another, without a law of the user's own."""
    forced_kernels.forced_runs(*arguments, kernel_of(NO_OWN_LAW))


@pytest.mark.parametrize("runs", [forced_runs, lane_runs], ids=["one by one", "side by side"])
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.benchmark(group="eight runs of a two-mass plant, 1200 samples")
def test_runs(benchmark, runs, name):
    plant = ForcedPlant(load_model("two-mass"), PERIOD)
    values = np.tile([parameter.start for parameter in plant.model.parameters], (LANES, 1))
    plants, by_input, direct = plant.coefficients(values, np.tile(LAWS[name], (LANES, 1)))
    u = np.repeat(np.random.default_rng(0).standard_normal(240), 5)[np.newaxis, :, np.newaxis]
    y, states = np.empty((LANES, u.shape[1])), np.empty((LANES, 0, 4))
    rest = np.zeros((LANES, 4))
    arguments = (plant.order, plant.same, by_input, direct, u, rest, PERIOD / SUBSTEPS, SUBSTEPS, y, states)
    runs(plants.copy(), *arguments)
    benchmark(lambda: runs(plants.copy(), *arguments))
    assert np.isfinite(y).all()


@pytest.mark.parametrize("part", ["residual", "jacobian", "with_derivative"])
@pytest.mark.parametrize("name", ["in_saturation", "cubic_stiffness", "coulomb", "op_gain"])
@pytest.mark.benchmark(group="one evaluation of a two-mass fit with an effect, 1200 rows")
def test_evaluation(benchmark, part, name):
    generator = np.random.default_rng(0)
    u = np.repeat(generator.standard_normal(240), 5)
    model = load_model("two-mass")
    values = np.array([[parameter.start for parameter in model.parameters]])
    y = ForcedPlant(model, PERIOD).run(values, law()[np.newaxis], u)[0]
    structure = PhysicsStructure(make_record(u, y, period=PERIOD), model, "rest")
    (effect,) = find_effects([name])
    choice = Choice(effect, effect.forms[0])
    rows = structure.record.learning
    problem = Problem(structure.setting, [choice], rows, np.ones(1), COARSE_STEP)
    point = np.concatenate([structure.setting.nominal, 0.2 * problem.sizes[problem.effect_places[0]]])
    function = getattr(problem, part)
    function(point)
    benchmark(function, point)
