"""Composite local linear models on records: fit, prediction, scores, figures, errors a user can act on."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from sysid import fit_local_linear
from sysid.data import make_record, read_record
from sysid.errors import DataError, IdentifiabilityError, ModelError, UsageError
from sysid.local_linear import LocalLinearModel, choose_local_linear, plot_weights
from sysid.local_linear import choice as choice_module


def tank(n_samples=600, seed=0, scale=1.0, offset=0.0):
    """A level whose outflow grows with its root, filled at random, in a unit of choice."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.2, 1.0, n_samples // 10 + 1), 10)[:n_samples]
    level = np.zeros(n_samples)
    for k in range(n_samples - 1):
        level[k + 1] = max(level[k] + 0.3 * (u[k] - np.sqrt(level[k])), 0.0)
    # Without noise a search ends where rounding decides.
    return scale * u + offset, level + 0.01 * rng.standard_normal(n_samples)


@pytest.fixture(scope="module")
def fitted():
    u, y = tank()
    record = make_record(u, y, period=1.0, inputs=["pump"], outputs=["level"])
    return record, fit_local_linear(record, order=2, models=3, rows=record.estimation, restarts=2)


def test_fit_beats_the_linear_model_on_held_out_rows(fitted):
    record, fit = fitted
    assert fit.rms[0] < 0.5 * fit.linear_rms[0]
    assert fit.nrmse(record, record.validation)[0] < 0.1
    prediction = fit.predict(record)
    assert prediction.free_run.shape == (record.n_samples,)
    assert prediction.starts == ("estimated on the rows of the fit",)
    off = record.y[record.validation, 0] - prediction.free_run[record.validation]
    size = np.linalg.norm(record.y[record.validation, 0] - record.y[record.validation, 0].mean())
    assert np.isclose(fit.nrmse(record, record.validation)[0], np.linalg.norm(off) / size)
    assert "scheduled by pump" in repr(fit)


def test_result_does_not_depend_on_units(fitted):
    _, fit = fitted
    u, y = tank(scale=50.0, offset=3.0)
    other = make_record(u, 1e-3 * y, period=1.0)
    again = fit_local_linear(other, order=2, models=3, rows=other.estimation, restarts=2)
    assert np.isclose(again.rms[0], 1e-3 * fit.rms[0], rtol=0.02)  # searches end within a relative 1e-3


def test_weights_are_drawn_over_one_and_two_signals(fitted):
    record, fit = fitted
    axes = plot_weights(fit.model, fit.schedule(record))
    assert len(axes.get_legend().get_texts()) == 3
    plane = LocalLinearModel(
        np.zeros((2, 1, 1)), np.ones((2, 1, 1)), np.zeros((2, 1)), [[1.0]], [[-1, 0], [1, 0]], np.ones((2, 2))
    )
    axes = plot_weights(plane, np.random.default_rng(0).uniform(-2, 2, (50, 2)))
    assert axes.get_ylabel() == "scheduling signal 2"
    plt.close("all")


def test_a_signal_of_its_own_schedules_and_is_needed_again(fitted):
    record, _ = fitted
    slow = np.convolve(record.u[:, 0], np.ones(5) / 5)[: record.n_samples]
    fit = fit_local_linear(record, 1, 2, scheduling=slow, restarts=0, initial_state="rest")
    assert fit.predict(record, scheduling=slow).free_run.shape == (record.n_samples,)
    with pytest.raises(UsageError, match="give it for this record"):
        fit.predict(record)


def test_two_experiments_with_two_outputs():
    u, y = tank(400)
    both = np.column_stack([y, y**2])
    record = make_record(u, both, period=1.0, experiment=np.repeat(["a", "b"], 200))
    fit = fit_local_linear(record, order=1, models=2, restarts=0)
    assert fit.predict(record).free_run.shape == (400, 2)
    assert (fit.rms < 0.6 * fit.output_std).all()


def test_errors_say_what_to_do():
    u, y = tank(200)
    record = make_record(u, y, period=1.0)
    with pytest.raises(IdentifiabilityError, match="take fewer local models or a lower order"):
        fit_local_linear(make_record(u[:60], y[:60], period=1.0), order=4, models=4)
    with pytest.raises(DataError, match="is constant"):
        fit_local_linear(record, 1, 2, scheduling=np.ones(200))
    switched = (np.arange(200) // 20 % 2).astype(float)
    with pytest.raises(IdentifiabilityError, match="takes 2 different values"):
        fit_local_linear(record, 1, 3, scheduling=switched)
    with pytest.raises(DataError, match="not finite at row 8"):
        fit_local_linear(record, 1, 2, scheduling=np.where(np.arange(200) == 7, np.nan, u))
    with pytest.raises(UsageError, match="is no input"):
        fit_local_linear(record, 1, 2, scheduling="flow")
    with pytest.raises(UsageError, match="order is 0"):
        fit_local_linear(record, 0, 2)
    with pytest.raises(UsageError, match="choose estimate or rest"):
        fit_local_linear(record, 1, 2, initial_state="zero")
    wild = LocalLinearModel(
        np.full((2, 1, 1), 30.0), np.ones((2, 1, 1)), np.ones((2, 1)), [[1.0]], [[0.2], [0.8]], [[1.0], [1.0]]
    )
    long = make_record(np.tile(u, 3), np.tile(y, 3), period=1.0)
    with pytest.raises(ModelError, match="largest eigenvalue of A_1 has the size 30"):
        fit_local_linear(long, 1, 2, start=wild)
    with pytest.raises(ModelError, match="give a matching one"):
        fit_local_linear(record, 2, 2, start=wild)
    with pytest.raises(ModelError, match="centres has shape"):
        LocalLinearModel(wild.A, wild.B, wild.O, wild.C, [[0.2]], wild.widths)
    with pytest.raises(DataError, match="nan at row 3"):
        wild.simulate(np.where(np.arange(9) == 3, np.nan, 1.0))


def test_a_start_is_gone_on_from(fitted):
    record, fit = fitted
    again = fit_local_linear(record, 2, 3, rows=record.estimation, start=fit.model)
    assert again.rms[0] <= 1.001 * fit.rms[0]


def test_structure_and_restart_are_chosen_on_validation_rows():
    u, y = tank(500)
    record = make_record(u, y, period=1.0)
    done = []
    choice = choose_local_linear(
        record, 1, restarts=1, progress=lambda step, total: done.append((step, total))
    )
    assert done[-1] == (len(choice.validation), 6)
    best = min(choice.validation.values())
    chosen = choice.fit.model.sizes.n_models
    assert chosen > 1
    assert choice.validation[1, chosen] <= 1.05 * best
    assert all(error > 1.05 * best for (_, s), error in choice.validation.items() if s < chosen)
    # The error of the accepted model is that of its own prediction, apart from how the mean is taken off.
    accepted = choice.accepted.predict(record, rows=record.estimation).free_run
    missed = (record.y[:, 0] - accepted)[record.validation]
    size = record.y[record.validation, 0].std()
    assert np.isclose(np.sqrt(np.mean(missed**2)) / size, choice.validation[1, chosen], rtol=1e-3)
    assert fit_local_linear(record, 1, restarts=1).rms[0] == choice.fit.rms[0]
    with pytest.raises(UsageError, match="give both, or leave out the rows"):
        fit_local_linear(record, 1, rows=record.estimation)


def test_a_refit_that_would_grow_without_bound_keeps_the_dynamics(monkeypatch):
    u, y = tank(400)
    record = make_record(u, y, period=1.0)
    grown = iter([0.9, 1.2])
    monkeypatch.setattr(choice_module, "growth", lambda model, phi: next(grown))
    found = choose_local_linear(record, 1, 2, restarts=0)
    assert found.fit.status.startswith("A, C and the weights are those of the estimation rows")
    assert found.fit.converged
    assert np.allclose(found.fit.model.A, found.accepted.model.A, rtol=1e-12)
    assert not np.allclose(found.fit.model.B, found.accepted.model.B, rtol=1e-6)


def test_growth_is_the_largest_eigenvalue_where_the_schedule_goes():
    model = LocalLinearModel(
        [[[0.5]], [[3.0]]], np.ones((2, 1, 1)), np.zeros((2, 1)), [[1.0]], [[0.0], [10.0]], [[1.0], [1.0]]
    )
    assert np.isclose(choice_module.growth(model, np.zeros((5, 1))), 0.5)
    assert np.isclose(choice_module.growth(model, np.array([[0.0], [10.0]])), 3.0)


@pytest.mark.parametrize("models", [2, 3, 4])
def test_cascaded_tanks_stay_bounded_on_rows_not_seen(records, models):
    """Three and four models of the lowest cost on the learning rows diverge on the test rows."""
    record = read_record(
        records / "cascaded_tanks" / "cascaded_tanks.csv", split="split", experiment="experiment"
    )
    fit = fit_local_linear(record, order=2, models=models)
    assert fit.nrmse(record, record.scored_rows(record.test_sets[0]))[0] < 0.35


def test_cascaded_tanks(records):
    record = read_record(
        records / "cascaded_tanks" / "cascaded_tanks.csv", split="split", experiment="experiment"
    )
    fit = fit_local_linear(record, order=2, models=2, restarts=2)
    rows = record.scored_rows(record.test_sets[0])
    assert fit.nrmse(record, rows)[0] < 0.35
