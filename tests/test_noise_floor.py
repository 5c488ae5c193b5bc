"""Noise floor, periods and nonlinear distortion against systems whose noise is known."""

import numpy as np
import pytest
from scipy import signal

from sysid.data import make_record
from sysid.diagnosis.compare import compare
from sysid.diagnosis.comparison.noise import WIDE, noise_floor, one_step_floor, quiet_floor
from sysid.diagnosis.comparison.periods import distortion, find_period, periodic_part

PERIOD = 0.1


def plant(u):
    return signal.lfilter([0.0, 0.1, 0.05], [1.0, -1.8, 0.85], u)


def multisine(rng, lines, length):
    k = np.arange(length)
    phases = rng.uniform(0.0, 2.0 * np.pi, len(lines))
    return sum(np.cos(2.0 * np.pi * h * k / length + p) for h, p in zip(lines, phases, strict=True))


def rows_of(record):
    return np.ones(record.n_samples, dtype=bool)


# Periods


@pytest.mark.parametrize("rows", [200, 217, 450])
def test_period_is_found_exactly(rows):
    rng = np.random.default_rng(0)
    u = np.resize(rng.standard_normal(97), rows)[:, np.newaxis]
    assert find_period(u) == 97


def test_no_period_where_there_is_none():
    rng = np.random.default_rng(1)
    u = rng.standard_normal((400, 1))
    assert find_period(u) is None
    assert find_period(np.ones((400, 1))) is None
    almost = np.resize(rng.standard_normal(100), 400)[:, np.newaxis]
    almost[250] += 0.05
    assert find_period(almost) is None


def test_period_of_two_inputs_is_that_of_both():
    rng = np.random.default_rng(2)
    u = np.column_stack([np.resize(rng.standard_normal(20), 600), np.resize(rng.standard_normal(30), 600)])
    assert find_period(u) == 60


# Noise floor


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_floor_from_periods_is_the_noise(memory):
    """5 periods of 400 give 1600 degrees of freedom, 2 % for white noise; slow noise has a tenth of them."""
    rng = np.random.default_rng(3)
    u = np.tile(multisine(rng, range(1, 40), 400), 6)
    noise = signal.lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], rng.standard_normal(u.size + 200))[
        200:
    ]
    y = np.tanh(plant(u)) + 0.1 * noise
    record = make_record(u, y, PERIOD)
    floor = noise_floor(record, np.zeros(u.size), rows_of(record))
    assert floor.repeated
    assert floor.method == "scatter between 5 periods of the input"
    assert floor.rms == pytest.approx(0.1, rel=0.06 if memory == 0.0 else 0.2)
    assert floor.nrmse == pytest.approx(floor.rms / y.std())


def test_floor_from_repeated_experiments():
    rng = np.random.default_rng(4)
    one = rng.standard_normal(700)
    u = np.concatenate([one, one, rng.standard_normal(700), one])
    y = np.concatenate([plant(part) ** 3 for part in u.reshape(4, 700)]) + 0.2 * rng.standard_normal(2800)
    record = make_record(u, y, PERIOD, experiment=np.repeat(list("abcd"), 700))
    floor = noise_floor(record, np.zeros(2800), rows_of(record))
    assert "3 experiments with the same input" in floor.method
    assert floor.rms == pytest.approx(0.2, rel=0.06)


SYSTEMS = {
    "linear": plant,
    "input saturation": lambda u: plant(np.clip(u, -0.8, 0.8)),
    "output tanh": lambda u: np.tanh(1.5 * plant(u) / plant(u).std()),
    "output saturation": lambda u: np.clip(plant(u) / plant(u).std(), -1.0, 1.0),
}


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("rows", [800, 3000])
def test_one_step_floor_is_not_far_above_white_noise(system, rows):
    """Noise of 10 % of the signal is found, within 10 % from below and a third from above."""
    rng = np.random.default_rng(5)
    u = np.repeat(rng.standard_normal(rows // 5), 5)
    y = SYSTEMS[system](u)
    true = 0.1 * y.std()
    record = make_record(u, y + true * rng.standard_normal(rows), PERIOD)
    model = np.linalg.lstsq(plant(u)[:, np.newaxis], y, rcond=None)[0][0] * plant(u)
    assert 0.9 * true < one_step_floor(record, model) < (1.1 if system == "linear" else 1.34) * true


STRONG = {
    "tanh of three deviations": lambda x: np.tanh(3.0 * x),
    "clipped at half a deviation": lambda x: np.clip(x, -0.5, 0.5),
    "cube": lambda x: x**3,
    "modulus": np.abs,
}


@pytest.mark.parametrize("shape", STRONG)
@pytest.mark.parametrize("hold", [5, 20])
def test_floor_beneath_strong_nonlinearities_is_bounded(shape, hold):
    """Noise of 2 %: a predictor that lacks the right signals leaves two to seven times as much."""
    rng = np.random.default_rng(11)
    u = np.repeat(rng.standard_normal(3000 // hold), hold)
    x = plant(u)
    y = STRONG[shape](x / x.std())
    true = 0.02 * y.std()
    record = make_record(u, y + true * rng.standard_normal(3000), PERIOD)
    floor = noise_floor(record, np.full(3000, y.mean()), rows_of(record))
    assert 0.9 * true < floor.rms < 2.5 * true
    assert floor.upper > WIDE * floor.rms
    assert floor.wide
    assert floor.to_json()["interval"] == pytest.approx(
        [floor.rms / record.y.std(), floor.upper / record.y.std()]
    )
    assert floor.method.startswith(
        "the quietest frequencies of the error if noise is white, to one-step error"
    )


def test_quiet_floor_of_white_noise_alone_has_no_bias():
    """The quietest of twelve bands is low by chance, and the correction takes that back to 5 %."""
    found = []
    for seed in range(20):
        noise = np.random.default_rng(seed).standard_normal(1500)
        found.append(quiet_floor(make_record(np.arange(1500.0), noise, PERIOD), np.zeros(1500)))
    assert np.mean(found) == pytest.approx(1.0, abs=0.05)


def test_one_step_floor_of_coloured_noise_is_a_lower_bound():
    rng = np.random.default_rng(6)
    u = rng.standard_normal(2000)
    noise = signal.lfilter([1.0], [1.0, -0.9], 0.1 * rng.standard_normal(2200))[200:]
    record = make_record(u, plant(u) + noise, PERIOD)
    # The innovations have the standard deviation 0.1, the noise 0.1 / sqrt(1 - 0.81) = 0.23.
    assert one_step_floor(record, plant(u)) == pytest.approx(0.1, rel=0.06)


def test_comparison_says_what_noise_explains():
    rng = np.random.default_rng(7)
    u = np.tile(multisine(rng, range(1, 60), 500), 4)
    y = np.clip(plant(u), -4.0, 4.0)
    y += 0.02 * y.std() * rng.standard_normal(u.size)
    split = np.repeat(["train", "test"], 1000)
    comparison = compare(make_record(u, y, PERIOD, split=split), order=2, delay=1, constant=False)
    content = comparison.to_json()["noise_floor"]
    assert content["nrmse"] == pytest.approx(0.02, rel=0.1)
    assert content["from_repetitions"]
    sentence = comparison.sentences()[1]
    assert sentence.startswith("The error is ")
    assert "noise explains 2" in sentence or "noise explains 1.9" in sentence
    assert sentence.endswith("% is the model's.")


# Even and odd distortion


def periodic(shape, seed=8, noise=1e-3, lines=None, length=1000, count=5):
    rng = np.random.default_rng(seed)
    chosen = [h for h in range(1, 80, 2) if h % 8 != 3] if lines is None else lines
    u = np.tile(multisine(rng, chosen, length), count)
    x = plant(u) / plant(u).std()
    record = make_record(u, shape(x) + noise * rng.standard_normal(u.size), PERIOD)
    return periodic_part(record, slice(0, u.size), rows_of(record))


@pytest.mark.parametrize(
    ("shape", "even", "odd"),
    [
        (lambda x: x, False, False),
        (lambda x: x + 0.05 * x**2, True, False),
        (lambda x: x - 0.05 * x**3, False, True),
        (lambda x: x + 0.05 * x**2 - 0.05 * x**3, True, True),
    ],
)
def test_even_and_odd_distortion_are_told_apart(shape, even, odd):
    found = distortion(periodic(shape), PERIOD)
    assert found.available
    assert (found.p_even <= 0.005) == even
    assert (found.p_odd <= 0.005) == odd


def test_false_alarms_of_distortion_are_nominal():
    """At 5 %, 120 linear plants and two tests give 12 +- 3.4."""
    alarms = 0
    for seed in range(120):
        found = distortion(periodic(lambda x: x, seed=seed, noise=0.05, count=4), PERIOD)
        alarms += (found.p_even <= 0.05) + (found.p_odd <= 0.05)
    assert 2 <= alarms <= 24


def test_distortion_says_why_it_cannot_be_had():
    full = distortion(periodic(lambda x: x, lines=range(1, 500)), PERIOD)
    assert not full.available
    assert "excites every line" in full.reason
    assert "does not repeat" in distortion(None, PERIOD).reason
    assert distortion(None, PERIOD).to_json()["available"] is False
