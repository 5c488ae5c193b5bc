"""A plant with a pole that dies out before the next sample: few steps in a search, fine ones at its end."""

import numpy as np
import pytest

from sysid.data import make_record
from sysid.diagnosis.diagnose import structure_of
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort
from sysid.physics import load_model
from sysid.physics.forced import ForcedPlant, law

# A motor whose current settles 25 times in a sample, its speed once in four samples.
VALUES = {"J": 0.1, "b": 0.05, "K": 0.25, "L": 0.02, "R": 2.5}
PERIOD = 0.2


@pytest.fixture
def driven():
    rng = np.random.default_rng(3)
    return np.repeat(rng.uniform(-10.0, 10.0, 120), 5)


@pytest.mark.parametrize(
    "force",
    [
        {"friction_forward": 0.1, "friction_back": 0.1},
        {"friction_forward": 0.05, "friction_back": 0.05, "breakaway": 0.1, "stribeck_speed": 0.5},
        {"gain": 0.4, "gain_scale": 2.0},
    ],
)
def test_steps_near_the_limit_of_stability_do_for_a_pole_that_dies_out(driven, force):
    plant = ForcedPlant(load_model("dc-motor"), PERIOD)
    values = np.array([[VALUES[name] for name in plant.names]])
    count, pace = plant.substeps(values[0], 0.35)
    # Steps of 0.35 everywhere would be 71; those of a lasting pole of this rate are.
    assert pace == pytest.approx(24.9, abs=0.3)
    assert 14 <= count <= 16
    coarse, fine = (plant.run(values, law(**force)[np.newaxis], driven, substeps=n)[0] for n in (count, 400))
    assert np.std(coarse - fine) < 1e-3 * np.std(fine)


def test_a_minimum_under_fine_steps_is_a_few_evaluations_from_that_under_coarse_ones(driven):
    plant = ForcedPlant(load_model("dc-motor"), PERIOD)
    values = np.array([[VALUES[name] for name in plant.names]])
    hidden = {"friction_forward": 0.05, "friction_back": 0.05, "breakaway": 0.1, "stribeck_speed": 0.5}
    y = plant.run(values, law(**hidden)[np.newaxis], driven, substeps=400)[0]
    y = y + 0.003 * y.std() * np.random.default_rng(4).standard_normal(y.size)
    record = make_record(driven, y, period=PERIOD)
    fixed = {"L": 0.02, "R": 2.5}
    found = structure_of(record, "dc-motor", None, "rest", {"J": 0.11, "b": 0.045, "K": 0.27}, fixed)
    (effect,) = find_effects(["stribeck"])
    rows = record.learning
    fit = found.fit([Choice(effect, effect.forms[0])], rows, WHITE, found.baseline(rows), effort=Effort.FINE)
    before = found.work.done
    fine = found.with_fine_steps(fit, WHITE)
    spent = found.work.done - before
    assert fine is not fit
    # Sixty steps of a plant with dry friction in each row, eight runs side by side.
    assert spent < 14 * 8 * 6 * 100 * rows.sum()
    assert np.std(fine.output - y) < 1.05 * 0.003 * y.std()
    # Who asks again, as the verdict does after the search, gets the same.
    assert found.with_fine_steps(fit, WHITE) is fine
