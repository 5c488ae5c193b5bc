import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete, dlsim

from sysid.cli import main
from sysid.commands.demo import FOUND_AS, SCENES
from sysid.demonstration import (
    CANDIDATES,
    MODELS,
    Difficulty,
    Hidden,
    Inside,
    Plant,
    draw_case,
    draw_plant,
    kernels,
    simulate,
)
from sysid.demonstration.effects import LINEAR, NAMES
from sysid.demonstration.kernels import FORCE_SIZE
from sysid.demonstration.sealing import reveal, seal
from sysid.demonstration.share import added_share, baseline_share, nonlinear_share
from sysid.errors import DataError, UsageError

OSCILLATOR = Plant("mass-spring-damper", {"m": 1.0, "c": 0.3, "k": 4.0}, 0.1)


def steps(n, seed=0, hold=15):
    return np.repeat(np.random.default_rng(seed).uniform(-3, 3, n), hold)[:n]


@pytest.mark.parametrize(
    "family", [name for name in MODELS if name not in ("difference-equation", "two-tanks")]
)
def test_linear_plants_follow_the_exact_discretisation(family):
    plant = draw_plant(np.random.default_rng(5), family)
    matrix, column = plant.dynamics
    n, u = len(matrix), steps(400)
    system = (matrix, column[:, None], np.eye(n)[:1], np.zeros((1, 1)))
    exact = dlsim(cont2discrete(system, plant.period), u)[1][:, 0]
    # Runge-Kutta steps of at most 0.08 of the fastest pole: local error 0.08^5 / 120 = 3e-8.
    np.testing.assert_allclose(plant.response(u), exact, atol=1e-6 * np.abs(exact).max())


def test_linear_tanks_follow_the_exact_discretisation():
    plant = draw_plant(np.random.default_rng(5), "two-tanks")
    matrix, column = plant.dynamics
    u = np.abs(steps(400))
    system = (matrix, column[:, None], np.array([[0.0, 1.0]]), np.zeros((1, 1)))
    exact = dlsim(cont2discrete(system, plant.period), u)[1][:, 0]
    np.testing.assert_allclose(plant.response(u), exact, atol=1e-6 * np.abs(exact).max())


def test_the_difference_equation_is_a_filter():
    from scipy.signal import lfilter

    plant = draw_plant(np.random.default_rng(3), "difference-equation", order=3)
    p, u = plant.parameters, steps(300)
    b = [0.0, p["b1"], p["b2"], p["b3"]]
    np.testing.assert_allclose(plant.response(u), lfilter(b, [1.0, p["a1"], p["a2"], p["a3"]], u), atol=1e-10)


def test_dry_friction_agrees_with_a_steep_smooth_law():
    friction = np.zeros(FORCE_SIZE)
    friction[7:9] = 1.0
    u = steps(60)

    def slope(t, x):
        force = u[min(int(t / 0.1), u.size - 1)]
        return [x[1], force - 0.3 * x[1] - 4.0 * x[0] - np.tanh(x[1] / 1e-4)]

    y = [0.0]
    state = np.zeros(2)
    for k in range(u.size - 1):
        ends = (k * 0.1 + 1e-12, (k + 1) * 0.1 - 1e-12)
        state = solve_ivp(slope, ends, state, method="LSODA", rtol=1e-7, atol=1e-9).y[:, -1]
        y.append(state[0])
    # The smooth law creeps by at most 1e-4 m/s while the body ought to rest: 6 s of it are 6e-4 m.
    np.testing.assert_allclose(OSCILLATOR.response(u, Inside(force=friction)), y, atol=1e-3)


def test_a_body_below_its_breakaway_force_does_not_move():
    friction = np.zeros(FORCE_SIZE)
    friction[[7, 8, 9, 10]] = 2.0, 2.0, 0.5, 0.1
    assert not OSCILLATOR.response(np.full(50, 2.99), Inside(force=friction)).any()
    assert OSCILLATOR.response(np.full(50, 3.01), Inside(force=friction)).any()


def test_friction_stops_a_sliding_mass_after_the_time_of_the_closed_form():
    mass = Plant("positioning-stage", {"M": 2.0, "F_v": 1e-9, "gain": 1.0, "offset": 0.0}, 0.1)
    friction = np.zeros(FORCE_SIZE)
    friction[7:9] = 1.0
    u = np.r_[np.full(10, 3.0), np.zeros(40)]
    y = mass.response(u, Inside(force=friction))
    # 1 s at (3 - 1) / 2 = 1 m/s^2, then -0.5 m/s^2 from 1 m/s: 0.5 m and 1 m.
    assert y[-1] == pytest.approx(1.5, abs=1e-6)
    assert y[30] == pytest.approx(1.5, abs=1e-6)


def test_cubic_stiffness_and_drag_agree_with_an_adaptive_solver():
    force = np.zeros(FORCE_SIZE)
    force[:3] = 0.7, 2.0, 1.5
    u = steps(60, seed=2)
    state, y = np.zeros(2), [0.0]
    for k in range(u.size - 1):

        def slope(_, x, k=k):
            extra = 0.7 * x[1] * abs(x[1]) + 2.0 * x[0] ** 3 + 1.5 * np.sin(x[0])
            return [x[1], u[k] - 0.3 * x[1] - 4.0 * x[0] - extra]

        state = solve_ivp(slope, (0, 0.1), state, rtol=1e-10, atol=1e-12).y[:, -1]
        y.append(state[0])
    np.testing.assert_allclose(OSCILLATOR.response(u, Inside(force=force)), y, atol=1e-5)


def test_tanks_settle_where_the_square_root_law_says_and_stop_at_the_rim():
    tanks = Plant("two-tanks", {"a1": 0.05, "a2": 0.04, "b": 0.05}, 5.0)
    u = np.full(600, 0.9)
    assert tanks.response(u, Inside(root=True))[-1] == pytest.approx((0.05 * 0.9 / 0.04) ** 2, rel=1e-6)
    assert tanks.response(u, Inside(root=True, rim=0.7))[-1] == 0.7


def test_what_comes_in_above_the_rim_does_not_flow_on():
    tanks = Plant("two-tanks", {"a1": 0.05, "a2": 0.04, "b": 0.05}, 5.0)
    u = np.abs(steps(60, seed=4, hold=5))
    rim, count = 1.6, 2000
    upper, lower, y = 0.0, 0.0, []
    for value in u:
        y.append(lower)
        for _ in range(count):  # first-order steps, 1/200 of ours
            between = 0.05 * upper
            upper = min(upper + 5.0 / count * (0.05 * value - between), rim)
            lower = min(lower + 5.0 / count * (between - 0.04 * lower), rim)
    found = tanks.response(u, Inside(rim=rim))
    assert np.mean(np.isclose(y, rim)) < 0.5 < np.max(y)
    # Both are of first order where a tank begins to run over: 5e-5 here; 1e-2 where what is above flows on.
    np.testing.assert_allclose(found, y, atol=2e-4)


def test_a_linear_plant_has_no_share_beyond_linear_models():
    plant = draw_plant(np.random.default_rng(7), "difference-equation", order=2)
    u = steps(1500)
    y = plant.response(u)
    assert nonlinear_share(u, y, plant.poles) < 1e-8
    assert baseline_share(u, y, plant.poles) < 1e-8


def test_the_share_of_an_added_signal_is_its_power():
    plant = draw_plant(np.random.default_rng(7), "difference-equation", order=2)
    rng = np.random.default_rng(0)
    u = rng.standard_normal(20_000)
    y = plant.response(u)
    added = rng.standard_normal(u.size) * np.std(y) * 0.5
    # Not of u: a quarter of y's power is a fifth of the sum's; the chance error is 1 / sqrt(20000).
    assert nonlinear_share(u, y + added, plant.poles) == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize(
    ("name", "parameters", "u", "expected"),
    [
        ("in_saturation", {"upper": 1.0, "lower": 2.0}, [3, -3, 0.5], [1, -2, 0.5]),
        ("in_deadzone", {"upper": 1.0, "lower": 2.0}, [3, -3, 0.5], [2, -1, 0]),
        ("in_preload", {"upper": 1.0, "lower": 2.0}, [3, -3, 0], [4, -5, 0]),
        ("in_relay", {"level": 2.0, "threshold": 1.0}, [3, -3, 0.5], [2, -2, 0]),
        ("in_backlash", {"upper": 1.0, "lower": 1.0}, [3, 1.5, -1, 0, 5], [2, 2, 0, 0, 4]),
        ("in_delay", {"delay": 1.25}, [4, 8, 0, 0], [0, 3, 7, 2]),
        ("in_rate_limit", {"rate": 1.0}, [3, 3, -1], [1, 2, 1]),
        ("in_hysteresis", {"level": 2.0, "threshold": 1.0}, [0, 2, 0, -2, 0], [0, 2, 2, -2, -2]),
    ],
)
def test_effects_at_the_input_are_what_their_names_say(name, parameters, u, expected):
    delay = Plant("difference-equation", {"a1": 0.0, "b1": 1.0}, 1.0)
    y = simulate(delay, [Hidden(name, parameters)], np.array([*u, 0], float))
    np.testing.assert_allclose(y[1:], expected)


@pytest.mark.parametrize(
    ("name", "parameters", "expected"),
    [
        ("out_saturation", {"upper": 1.0, "lower": 1.5}, [0, 1, -1.5, 0.4]),
        ("out_offset", {"offset": 1.0}, [1, 3, -1, 1.4]),
        ("out_drift", {"rate": 0.5}, [0, 2.5, -1, 1.9]),
        ("out_quantisation", {"step": 0.5}, [0, 2, -2, 0.5]),
        ("out_rectify", {"bias": 0.0, "half": 0.0}, [0, 2, 2, 0.4]),
        ("out_rectify", {"bias": 0.0, "half": 1.0}, [0, 2, 0, 0.4]),
        ("out_quadratic", {"c": 0.5}, [0, 4, 0, 0.48]),
        ("feedthrough", {"d": 1.0}, [2, 0, -1.6, 0.4]),
    ],
)
def test_effects_at_the_output_are_what_their_names_say(name, parameters, expected):
    delay = Plant("difference-equation", {"a1": 0.0, "b1": 1.0}, 1.0)
    y = simulate(delay, [Hidden(name, parameters)], np.array([2.0, -2.0, 0.4, 0.0]))
    np.testing.assert_allclose(y, expected)


def test_an_extra_mode_rings_at_its_frequency_with_its_damping():
    still = Plant("difference-equation", {"a1": 0.0, "b1": 0.0}, 1.0)
    mode = Hidden("extra_mode", {"gain": 2.0, "frequency": 0.3, "damping": 0.02})
    y = simulate(still, [mode], np.ones(4000))
    system = ([[0.0, 1.0], [-0.09, -2 * 0.02 * 0.3]], [[0.0], [0.09]], [[2.0, 0.0]], [[0.0]])
    exact = dlsim(cont2discrete(tuple(map(np.array, system)), 1.0), np.ones(4000))[1][:, 0]
    np.testing.assert_allclose(y, exact, atol=1e-9)


@pytest.mark.parametrize(
    "name", ["in_backlash", "out_quadratic", "cubic_stiffness", "in_delay", "extra_mode"]
)
def test_a_case_has_the_size_and_the_noise_that_were_asked_for(name):
    difficulty = Difficulty(share=(0.05, 0.2), snr=(25.0, 30.0))
    case = draw_case(np.random.default_rng(11), "difference-equation", [name], difficulty)
    assert 0.05 <= case.share <= 0.2
    measure = baseline_share if name in LINEAR else nonlinear_share
    assert measure(case.u, case.noise_free, case.plant.poles) == pytest.approx(case.share)
    noise = case.y - case.noise_free
    assert 10 * np.log10(np.var(case.noise_free) / np.var(noise)) == pytest.approx(case.snr, abs=0.3)
    assert [int(np.sum(case.sets == part)) for part in ("est", "val", "test")] == [1200, 600, 600]


def test_the_same_seed_gives_the_same_case():
    one, two = (draw_case(np.random.default_rng(3), "dc-motor", ["coulomb"]) for _ in range(2))
    np.testing.assert_array_equal(one.y, two.y)
    assert one.truth() == two.truth()
    for name, value in one.start.items():
        assert 0.0999 <= abs(value / one.plant.parameters[name] - 1) <= 0.2001


def test_candidates_are_effects_that_can_be_hidden():
    for family in MODELS:
        assert set(CANDIDATES[family]) <= set(NAMES)


def test_what_cannot_be_hidden_is_an_error():
    with pytest.raises(UsageError, match="the family 'clock' is unknown"):
        draw_plant(np.random.default_rng(0), "clock")
    with pytest.raises(UsageError, match="no body that rubs"):
        draw_plant(np.random.default_rng(0), "two-tanks").motion(np.ones(3))


def test_a_changed_seal_is_noticed(tmp_path):
    path = tmp_path / "truth.sealed"
    seal({"effects": []}, path)
    assert reveal(path)[0] == {"effects": []}
    assert "effects" not in path.read_text()
    path.write_text(path.read_text()[:-4] + "AA=\n")
    with pytest.raises(DataError, match=r"changed after it was sealed|not a sealed truth"):
        reveal(path)
    with pytest.raises(DataError, match="is not there"):
        reveal(tmp_path / "none")


def test_demo_makes_a_record_and_reveals_its_truth(tmp_path, capsys):
    folder = tmp_path / "a demo"
    assert main(["demo", "--out", str(folder), "--seed", "3"]) == 0
    said = capsys.readouterr().out
    names = {effect for _, effect in SCENES}
    assert not any(name in said for name in names)
    assert (folder / "record.csv").read_text().splitlines()[0] == "k,u,y,set"
    assert main(["demo", "--reveal", str(folder)]) == 0
    told = capsys.readouterr().out
    hidden = [name for name in names if f"{name} (" in told]
    assert len(hidden) == 1
    assert "agree" not in told
    for accepted, sentence in (
        (hidden, "It agrees."),
        ([], "The diagnosis added nothing. It does not agree."),
    ):
        (folder / "diagnosis.json").write_text(json.dumps({"accepted": accepted}))
        assert main(["demo", "--reveal", str(folder)]) == 0
        assert sentence in capsys.readouterr().out
    truth = reveal(folder / "truth.sealed")[0]["effects"][0]["parameters"]
    ladder = [{"parameters": {"width_positive": {"value": 0.5, "std_error": 0.01, "unit": "V"}}}]
    (folder / "diagnosis.json").write_text(json.dumps({"accepted": hidden, "ladder": ladder}))
    assert main(["demo", "--reveal", str(folder)]) == 0
    told = capsys.readouterr().out
    assert f"width_negative = {truth['lower']:.4g}\n" in told
    assert f"width_positive = {truth['upper']:.4g}   (found: 0.500 ± 0.020 V)\n" in told
    (folder / "diagnosis.json").write_text("[]")
    assert main(["demo", "--reveal", str(folder)]) == 2
    assert "not an answer of `sysid diagnose --json`" in capsys.readouterr().err


def test_tanks_read_no_memory_before_they_write_it(monkeypatch):
    """With every fresh array full of NaN the response is the same as with zeros."""
    plain = kernels.tanks_response.py_func
    arguments = (np.array([0.3, 0.2]), 0.4, True, 1.5, np.ones(20), 0.5, 4, np.array([0.0, 1.0]))
    expected = kernels.tanks_response(*arguments)

    def poisoned(shape):
        return np.full(shape, np.nan)

    monkeypatch.setattr(kernels.np, "empty", poisoned)
    np.testing.assert_allclose(plain(*arguments), expected, rtol=1e-12)  # rounding of the compiled arithmetic


@pytest.mark.parametrize("seed", range(1, len(SCENES) + 1))
def test_every_scene_can_be_played(tmp_path, seed):
    assert main(["demo", "--out", str(tmp_path), "--seed", str(seed)]) == 0
    truth = reveal(tmp_path / "truth.sealed")[0]
    assert (truth["family"], truth["effects"][0]["name"]) == SCENES[seed - 1]
    assert set(FOUND_AS[SCENES[seed - 1][1]]) <= set(truth["effects"][0]["parameters"])


def test_demo_with_a_negative_seed_is_refused(tmp_path, capsys):
    assert main(["demo", "--out", str(tmp_path), "--seed", "-1"]) == 2
    assert "--seed is -1" in capsys.readouterr().err


def test_demo_asks_for_a_folder_where_a_file_is_named(tmp_path, capsys):
    (tmp_path / "taken").write_text("")
    assert main(["demo", "--out", str(tmp_path / "taken")]) == 2
    assert "is a file: name a folder" in capsys.readouterr().err


def test_an_output_that_stands_still_hides_everything():
    u, still, poles = np.random.default_rng(0).standard_normal(200), np.zeros(200), np.array([0.5])
    shares = [nonlinear_share(u, still, poles), baseline_share(u, still, poles)]
    shares.append(added_share(still, u, u, constant=True))
    assert shares == [np.inf] * 3
