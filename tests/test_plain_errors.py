"""Standard errors of plain fits under noise with a memory."""

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from sysid.data import make_record
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.physics.structure import PhysicsStructure
from sysid.diagnosis.structures.plain_errors import plain_errors
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort
from sysid.physics.reading import load_model

MEMORY = np.array([1.0, -0.95])
TRUTH = {"m": 2.0, "c": 1.5, "k": 8.0}


def noise_like(rng, n, size):
    """Noise with D(q) = 1 - 0.95 q^-1 whose past is as long as its memory."""
    return size * lfilter([1.0], MEMORY, rng.standard_normal(n + 200))[200:]


def test_the_errors_are_those_of_the_covariance_written_out():
    rng = np.random.default_rng(0)
    J = np.column_stack([np.ones(400), np.linspace(0.0, 1.0, 400), rng.standard_normal(400)])
    residual = noise_like(rng, 400, 0.1)
    driving = residual[1:] - 0.95 * residual[:-1]
    variance = driving @ driving / (driving.size - 3)
    # The memory of noise at rest before the first row: L L' with the columns of 1/D in L.
    L = np.tril(toeplitz(0.95 ** np.arange(400)))
    inverse = np.linalg.inv(J.T @ J)
    expected = np.sqrt(variance * np.diag(inverse @ J.T @ L @ L.T @ J @ inverse))
    # Only rounding differs.
    assert plain_errors(J, residual, [slice(0, 400)], MEMORY) == pytest.approx(expected, rel=1e-10)


def test_runs_do_not_remember_one_another():
    rng = np.random.default_rng(1)
    J, residual = rng.standard_normal((300, 2)) + 1.0, noise_like(rng, 300, 1.0)
    L = np.zeros((300, 300))
    for first, end in ((0, 100), (100, 300)):
        L[first:end, first:end] = np.tril(toeplitz(0.95 ** np.arange(end - first)))
    driving = np.concatenate([r[1:] - 0.95 * r[:-1] for r in (residual[:100], residual[100:])])
    inverse = np.linalg.inv(J.T @ J)
    spread = driving @ driving / (driving.size - 2)
    expected = np.sqrt(spread * np.diag(inverse @ J.T @ L @ L.T @ J @ inverse))
    found = plain_errors(J, residual, [slice(0, 100), slice(100, 300)], MEMORY)
    assert found == pytest.approx(expected, rel=1e-10)


def test_what_the_output_does_not_show_is_not_known():
    J = np.column_stack([np.ones(50), np.zeros(50), np.arange(50.0), np.arange(50.0)])
    errors = plain_errors(J, np.random.default_rng(2).standard_normal(50), [slice(0, 50)], WHITE)
    assert np.isfinite(errors).tolist() == [True, False, False, False]


def structure_of(kind, record):
    if kind == "linear":
        return LinearStructure(record, 2, initial_state="rest")
    return PhysicsStructure(record, load_model("mass-spring-damper").with_parameters(TRUTH), "rest")


@pytest.mark.parametrize("kind", ["physical", "linear"])
def test_a_plain_fit_says_how_far_off_it_is_in_coloured_noise(kind):
    from sysid.physics.simulation import Simulator

    simulator = Simulator(load_model("mass-spring-damper"), 0.1)
    u = np.sign(np.sin(np.arange(800.0) ** 1.3))
    clean = simulator.run(TRUTH, u)[:, 0]

    def fitted(y):
        structure = structure_of(kind, make_record(u, y, period=0.1))
        rows = structure.record.learning
        base = structure.baseline(rows)
        return structure, structure.fit((), rows, WHITE, base, effort=Effort.REFIT)

    truth = [p.value for p in fitted(clean)[1].parameters]
    ratios = []
    for seed in range(24):
        structure, fit = fitted(clean + noise_like(np.random.default_rng(seed), 800, 0.005))
        found = structure.finish(fit, MEMORY, plain=True).parameters
        ratios.append([(p.value - value) / p.std_error for p, value in zip(found, truth, strict=True)])
    # The root mean square of 24 runs of some three independent ratios spreads by 8 %.
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.25)


def test_what_is_known_only_together_leaves_the_other_errors_as_they_are():
    """A constant of the equation and an offset of the sensor do the same."""
    rng = np.random.default_rng(4)
    u, y = rng.uniform(-1.0, 1.0, 600), np.zeros(600)
    for k in range(1, u.size):
        y[k] = 0.7 * y[k - 1] + u[k - 1]
    record = make_record(u, y + 0.05 * rng.standard_normal(u.size), 1.0)
    structure = LinearStructure(record, 1)
    baseline = structure.finish(structure.baseline(record.learning), WHITE)
    (offset,) = find_effects(["out_offset"])
    doubled = structure.fit(
        [Choice(offset, offset.forms[0])], record.learning, WHITE, baseline, effort=Effort.FINE
    )
    errors = {p.name: p.std_error for p in structure.finish(doubled, WHITE).parameters}
    assert np.isnan([errors["constant"], errors["offset"]]).all()
    for p in baseline.parameters[:2]:
        # The same fit but for one unknown less, and so one row more to tell the noise by.
        assert errors[p.name] == pytest.approx(p.std_error, rel=0.01)
