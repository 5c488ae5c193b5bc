"""The experiment that separates two candidates: predicted, then carried out."""

import numpy as np

from sysid.data import make_record
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.experiment import Responding, separating_experiment
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort


def test_a_small_signal_record_gets_a_larger_one():
    """Saturation and cubic stiffness differ little for an input that hardly reaches the knee."""
    rng = np.random.default_rng(2)
    u, y = np.repeat(rng.uniform(-1, 1, 100), 5), np.zeros(500)
    for k in range(1, 500):
        y[k] = 0.8 * y[k - 1] + 0.2 * np.clip(u[k - 1], -0.8, 0.8)
    record = make_record(u, y + 0.02 * rng.standard_normal(500), period=1.0)
    structure = LinearStructure(record, 1, initial_state="rest")
    assert isinstance(structure, Responding)
    rows = record.learning
    base = structure.baseline(rows)
    fits = [
        structure.fit([Choice(effect, effect.forms[0])], rows, WHITE, base, effort=Effort.FINE)
        for effect in find_effects(["in_saturation", "cubic_stiffness"])
    ]
    found = separating_experiment(structure, fits[0], fits[1], record.u[:, 0], 0.02)
    assert found.separation > 3.0
    same = separating_experiment(structure, fits[0], fits[0], record.u[:, 0], 0.02)
    assert same.separation < 1e-9
    # From rest, the response is the free run of the fit.
    response, slopes = structure.respond(fits[0], record.u[:, 0].copy())
    assert np.allclose(response, fits[0].output)
    assert slopes.shape == (500, fits[0].n_parameters)
