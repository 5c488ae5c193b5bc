"""The study of the positioning system: its simulation, its fits, and what its record says."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from benchmarks.real_records.estimators import (
    COULOMB,
    TWO_SIDED,
    by_forces,
    by_free_run,
    by_pieces,
    by_weighed_free_run,
    random_starts,
)
from benchmarks.real_records.evidence import plateaus, repeated
from benchmarks.real_records.stage import Experiment, Stage, free_run, score
from benchmarks.real_records.stops import RECURSIONS, stepped, stops

PERIOD = 0.001
TRUE = Stage(95.0, 170.0, 240.0, 20.0, -3.0)


def reference():
    """A force that moves the stage back and forth, four seconds long."""
    t = np.arange(4000) * PERIOD
    return 110.0 * np.sin(2.0 * np.pi * 0.6 * t) + 25.0 * np.sign(np.sin(2.0 * np.pi * 1.1 * t)) - 3.0


# Dry friction alone is exact; its rise near rest is held for half a sample each.
@pytest.mark.parametrize(("rise", "allowed"), [(0.0, 1e-8), (8.0, 2e-5)])
def test_a_moving_stage_is_simulated_as_by_an_integrator(rise, allowed):
    stage = TRUE._replace(rise=rise, speed=0.05)
    force = np.repeat([60.0, 90.0, 75.0], 100)

    def slope(t, state, held):
        dry = stage.dry + stage.rise * np.exp(-((state[1] / stage.speed) ** 2))
        return [state[1], (held - stage.constant - stage.viscous_forward * state[1] - dry) / stage.mass]

    state, expected = np.array([0.0, 0.02]), []
    for held in (60.0, 90.0, 75.0):
        t = np.arange(101) * PERIOD
        end = solve_ivp(slope, (0.0, t[-1]), state, t_eval=t, rtol=1e-11, atol=1e-13, args=(held,))
        expected.extend(end.y[0][:-1])
        state = end.y[:, -1]
    # In m; the stage has gone 50 mm.
    assert np.abs(free_run(stage, force, np.array([0.0, 0.02]), PERIOD) - expected).max() < allowed


def test_a_stage_stops_and_stays_where_friction_holds_it():
    stage = Stage(2.0, 10.0, 10.0, 5.0, 1.0)
    x = free_run(stage, np.full(3000, 4.0), np.array([0.0, 0.3]), PERIOD)
    # v' = -(2 + 10 v) / 2 until v = 0 at 0.2 ln 2.5; 3 N are then less than friction.
    stop = 0.2 * np.log(2.5)
    assert x[-1] == pytest.approx(-0.2 * stop + 0.2 * 0.5 * (1.0 - np.exp(-stop / 0.2)), rel=1e-9)
    assert np.ptp(x[1000:]) == 0.0


@pytest.mark.parametrize("way", ["free run", "pieces", "forces"])
def test_each_way_of_fitting_finds_the_truth(way):
    force = reference()
    experiment = Experiment(force, free_run(TRUE, force, np.array([1e-5, 0.006]), PERIOD), PERIOD)
    points = random_starts(TWO_SIDED, 2)
    if way == "free run":
        found = by_free_run(TWO_SIDED, experiment, "free", points)[0][1]
    elif way == "pieces":
        found = by_pieces(TWO_SIDED, experiment, 1.0, points)
    else:
        found = by_forces(TWO_SIDED, experiment).stage
    # Filters pass 20 Hz of forces that jump; pieces begin at a smoothed motion.
    allowed = {"free run": 1e-4, "pieces": 0.02, "forces": 0.1}[way]
    assert found[:4] == pytest.approx(TRUE[:4], rel=allowed)


def test_a_stage_that_is_made_to_repeat_an_experiment_does():
    force = reference()
    experiment = Experiment(force, free_run(TRUE, force, np.array([0.0, 0.006]), PERIOD), PERIOD)
    wrong = COULOMB.stage(np.array([90.0, 215.0, 22.0, -1.0]))
    assert score(wrong, experiment) > 1.0
    errors = repeated(wrong, experiment, experiment)
    # 0.1 mm in 100: jumps of the force are followed within 1 / 60 s.
    assert errors[0] == errors[1] < 0.1


def test_the_second_experiment_of_the_positioning_system_needs_more_force(records):
    from benchmarks.real_records.__main__ import read

    first, second = read(records)
    for plateau in plateaus(first, second, 95.0, 6.25):
        more = (plateau.second - plateau.first) * np.sign(plateau.speed)
        assert 0.5 < more < 1.7
    for structure in (COULOMB, TWO_SIDED):
        errors = repeated(by_forces(structure, first).stage, first, second)
        assert errors[0] < 0.02
        assert 5.5 < errors[1] < 8.5


def test_weighing_by_the_colour_is_right_where_noise_disturbs_the_force():
    force, rng = reference(), np.random.default_rng(0)
    true = COULOMB.stage(np.array([95.0, 200.0, 20.0, -3.0]))
    points = [np.array([94.0, 205.0, 19.5, -2.8])]
    errors = {"plain": [], "weighed": []}
    for _ in range(6):
        memory = np.exp(-PERIOD / 0.3)
        noise = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], rng.standard_normal(force.size))
        experiment = Experiment(force, free_run(true, force + noise, np.array([0.0, 0.006]), PERIOD), PERIOD)
        errors["plain"].append(by_free_run(COULOMB, experiment, "read", points)[0][1].mass - true.mass)
        errors["weighed"].append(by_weighed_free_run(COULOMB, experiment, points).mass - true.mass)
    plain, weighed = (np.sqrt(np.mean(np.square(found))) for found in errors.values())
    assert weighed < 0.3 * plain


@pytest.mark.parametrize("recursion", RECURSIONS.values())
def test_a_stage_in_steps_comes_near_the_exact_one(recursion):
    force, numbers = reference(), np.array([95.0, 200.0, 20.0, -3.0])
    exact = free_run(COULOMB.stage(numbers), force, np.zeros(2), PERIOD)
    x = stepped(recursion, numbers, force, 0.0, PERIOD)
    # First-order steps: right within what the stage goes in two samples at its largest speed.
    assert np.ptp(exact) > 0.1
    assert np.abs(x - exact).max() < 2.0 * np.abs(np.diff(exact)).max()


def test_quick_searches_of_the_positioning_system_are_lucky_where_they_stop_early(records):
    from benchmarks.real_records.__main__ import read

    found = stops(RECURSIONS["friction that stops within a step"], *read(records))
    lowest, luckiest = min(found, key=lambda s: s.fitted), min(found, key=lambda s: s.tested)
    assert lowest.tested > luckiest.tested + 1.0
    assert luckiest.fitted > 1.03 * lowest.fitted
    assert luckiest.tested > 4.1
