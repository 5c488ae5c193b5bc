"""Gaussian priors: the posterior of a linear case, honest errors in coloured noise, how they are given."""

import numpy as np
import pytest

from sysid.data import make_record
from sysid.errors import ModelError
from sysid.physics import Prior, fit_physics, load_model, read_model
from sysid.physics.simulation import Simulator

PERIOD = 0.1
LINEAR = read_model(
    """
name = "scale"
title = "A lag of known speed, seen through a gain and an offset"
[states]
x = { unit = "m" }
[inputs]
u = { unit = "V" }
[outputs.y]
unit = "m"
terms = { "reading" = "g*x", "offset" = "o" }
[[equations]]
state = "x"
unit = "m/s"
terms = { "input" = "u", "decay" = "-2*x" }
[parameters]
g = { unit = "1", start = 1.0, std = 0.2 }
o = { unit = "m", start = 0.0, std = 0.05 }
""",
    "scale",
)
MEAN, SPREAD = np.array([1.0, 0.0]), np.array([0.2, 0.05])


def measured(rng, truth, n=80, colour=0.0, size=0.4):
    u = np.repeat(rng.standard_normal(n // 4), 4)
    y = Simulator(LINEAR, PERIOD).run(dict(zip("go", truth, strict=True)), u)[:, 0]
    noise = size * rng.standard_normal(n)
    for k in range(1, n):
        noise[k] += colour * noise[k - 1]
    return make_record(u, y + noise, PERIOD)


def test_posterior_is_that_of_the_closed_form():
    record = measured(np.random.default_rng(0), [1.25, 0.04], n=400)
    fit = fit_physics(record, LINEAR, initial_state="rest")
    u = record.u
    columns = np.column_stack(
        [Simulator(LINEAR, PERIOD).run({"g": g, "o": o}, u)[:, 0] for g, o in ((1.0, 0.0), (0.0, 1.0))]
    )
    noise = fit.uncertainty.effective_noise
    information = columns.T @ columns + np.diag((noise / SPREAD) ** 2)
    posterior = np.linalg.solve(information, columns.T @ record.y[:, 0] + (noise / SPREAD) ** 2 * MEAN)
    # Both solve the same equations; the noise settles to a millionth.
    np.testing.assert_allclose([fit.values["g"], fit.values["o"]], posterior, rtol=1e-6, atol=1e-8)
    # White noise of 0.4, known to a few percent from 400 rows, gives the textbook covariance.
    np.testing.assert_allclose(noise, 0.4, rtol=0.12)
    textbook = np.linalg.inv(columns.T @ columns / 0.4**2 + np.diag(SPREAD**-2))
    np.testing.assert_allclose(fit.uncertainty.covariance, textbook, rtol=0.25, atol=0.1 * textbook.min())


def test_without_information_the_prior_comes_back():
    rng = np.random.default_rng(1)
    record = measured(rng, [1.0, 0.0], n=40, size=1e3)
    fit = fit_physics(record, LINEAR, initial_state="rest")
    np.testing.assert_allclose([fit.values["g"], fit.values["o"]], MEAN, atol=0.01)
    np.testing.assert_allclose(fit.uncertainty.standard_errors, SPREAD, rtol=0.01)
    assert "(prior 1 ± 0.2)" in repr(fit)


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_errors_are_calibrated_when_the_truth_comes_from_the_prior(colour):
    rng = np.random.default_rng(2)
    scores = []
    for _ in range(40):
        truth = MEAN + SPREAD * rng.standard_normal(2)
        fit = fit_physics(measured(rng, truth, n=120, colour=colour), LINEAR, initial_state="rest")
        estimate = np.array([fit.values["g"], fit.values["o"]])
        scores.append((estimate - truth) / fit.uncertainty.standard_errors)
    # Mean squares of 40 standard normal variables: 1 with a deviation of 0.22.
    assert np.all(np.mean(np.square(scores), axis=0) < 1.0 + 4.0 * 0.23)
    assert np.all(np.mean(np.square(scores), axis=0) > 0.4)


def test_a_prior_determines_what_the_record_does_not():
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-1.0, 1.5, 120), 5)
    truth = {"J": 0.39, "b": 0.26, "K": 1.12, "L": 0.105, "R": 1.2}
    y = Simulator(load_model("dc-motor"), PERIOD).run(truth, u)[:, 0]
    record = make_record(u, y + 0.02 * y.std() * rng.standard_normal(600), PERIOD)
    near = {name: 1.1 * value for name, value in truth.items()}
    assert fit_physics(record, "dc-motor", start=near, initial_state="rest").uncertainty.undetermined
    near |= {"R": (1.2, 0.02), "L": (0.105, 0.005)}
    fit = fit_physics(record, "dc-motor", start=near, initial_state="rest")
    assert not fit.uncertainty.undetermined
    errors = fit.parameters()
    assert all(abs(errors[name][0] - truth[name]) < 4.0 * errors[name][1] for name in truth)
    assert errors["R"][1] <= 0.0201


def test_priors_are_given_in_files_and_as_pairs():
    assert [p.prior for p in LINEAR.parameters] == [Prior(1.0, 0.2), Prior(0.0, 0.05)]
    assert {p.status for p in LINEAR.parameters} == {"uncertain"}
    changed = LINEAR.with_parameters(start={"g": (2.0, 0.1), "o": 0.5})
    assert changed.parameter("g").prior == Prior(2.0, 0.1)
    assert changed.parameter("o").prior == Prior(0.0, 0.05)  # a nearer start is no other knowledge
    assert LINEAR.with_parameters(fixed={"g": 1.0}).parameter("g").prior is None
    for wrong in (0.0, -0.1, float("inf"), float("nan")):
        with pytest.raises(ModelError, match="give a positive standard deviation"):
            LINEAR.with_parameters(start={"g": (1.0, wrong)})
    with pytest.raises(ModelError, match="give a number, or a start as"):
        LINEAR.with_parameters(start={"g": (1.0, 0.1, 2.0)})
