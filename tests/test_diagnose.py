"""The diagnosis: verdicts, evidence, the command, files."""

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import sysid
from benchmarks.hidden_effects.plan import assign
from sysid.cli import main
from sysid.data import make_record
from sysid.diagnosis.decide import search
from sysid.diagnosis.decide.evidence import remainder, score_screen
from sysid.diagnosis.decide.residual_evidence import interleaved
from sysid.diagnosis.decide.search import Search
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.export.saved import load, save, saved_model, to_control, to_python
from sysid.diagnosis.export.saved_effects import SavedEffect
from sysid.diagnosis.export.saved_linear import SavedModel
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.structures.projection import orthonormal
from sysid.diagnosis.structures.structure import Effort, Structure
from sysid.errors import DataError, UsageError

FEW = [
    "in_saturation", "in_deadzone", "in_backlash", "in_delay", "out_saturation", "out_offset", "out_drift",
    "out_quadratic", "quad_drag", "cubic_stiffness", "coloured_noise",
]  # fmt: skip
A, B = [-1.5, 0.7], [0.3, -0.1]


def plant(x, force=lambda z, speed: 0.0):
    """A plain loop, written apart from the library."""
    z, v = np.zeros(x.size), np.zeros(x.size)
    for k in range(x.size):
        for i in (1, 2):
            if k >= i:
                z[k] += B[i - 1] * v[k - i] - A[i - 1] * z[k - i]
        v[k] = x[k] - force(z[k], z[k] - z[k - 1] if k else 0.0)
    return z


def make_case(effect="", seed=0, n=1200, snr=30.0, coloured=False):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-2, 2, n // 4), 4)
    x = np.clip(u, -1.0, 1.0) if effect == "in_saturation" else u
    y = plant(x, (lambda z, s: 4.0 * s * abs(s)) if effect == "quad_drag" else (lambda z, s: 0.0))
    if effect == "out_drift":
        y = y + np.linspace(0.0, 1.5 * np.std(y), n)
    if effect == "foreign":
        y = y * np.cos(1.2 * y / np.std(y))  # a reading that folds over
    noise = rng.standard_normal(n)
    if coloured:
        for k in range(1, n):
            noise[k] += 0.85 * noise[k - 1]
    y = y + noise / np.std(noise) * np.std(y) * 10 ** (-snr / 20)
    return u, y, np.repeat(["est", "val", "test"], [n // 2, n // 4, n // 4])


def record_of(*arguments, **keywords):
    u, y, split = make_case(*arguments, **keywords)
    return make_record(u, y, period=1.0, split=split)


def diagnosed(*arguments, effects=FEW, **keywords):
    return sysid.diagnose(record_of(*arguments, **keywords), order=2, initial_state="rest", effects=effects)


@pytest.mark.parametrize("effect", ["in_saturation", "quad_drag", "out_drift"])
def test_a_hidden_effect_is_named_and_the_error_falls_to_the_noise(effect):
    found = diagnosed(effect)
    assert (found.verdict, found.accepted) == ("missing-effect", (effect,))
    assert found.decision.trials[0].name == effect
    before, after = (rung.scores["test"]["rmse"] for rung in (found.ladder[0], found.ladder[-1]))
    noise = np.std(found.record.y) * 10**-1.5
    # Noise of 300 rows is known to 4 %; the fitted parameters add less than that.
    assert before > 2.0 * noise
    assert after < 1.15 * noise
    assert found.ladder[1].removed > 0.95
    assert found.noise_floor == pytest.approx(noise, rel=0.1)
    assert any(sentence.endswith("what is left is noise.") for sentence in found.sentences())


class RefitsDiverge(LinearStructure):
    """Fits in which a second one, from the point that was found, diverges under the test rows."""

    def fit(self, choices, rows, noise, start, *, effort):
        found = super().fit(choices, rows, noise, start, effort=effort)
        if effort is Effort.REFIT and choices:
            test = self.record.split == "test"
            found = replace(found, output=np.where(test, np.inf, found.output))
        return found


def test_a_refit_that_diverges_on_other_rows_is_not_taken():
    record = record_of("quad_drag")
    structure = RefitsDiverge(record, 2, initial_state="rest")
    found = sysid.diagnose(record, model=structure, effects=["in_saturation", "quad_drag", "coloured_noise"])
    assert found.accepted == ("quad_drag",)
    assert np.isfinite(found.final.output).all()
    assert 0.0 < found.noise_floor < found.ladder[1].scores["test"]["rmse"] * 1.2


def test_nothing_missing_is_said_so():
    found = diagnosed("")
    assert (found.verdict, found.accepted) == ("nothing-missing", ())
    assert found.advice.startswith("No effect needs to be added. The model is kept with --save FILE")
    assert np.array_equal(found.baseline.output, found.final.output)


def test_noise_with_a_memory_is_no_effect_of_the_plant():
    found = diagnosed("", coloured=True)
    assert (found.verdict, found.accepted) == ("coloured-noise", ("coloured_noise",))


def test_an_effect_outside_the_list_gets_no_name():
    assert diagnosed("foreign").verdict == "unexplained"


def test_the_same_seed_gives_the_same_numbers():
    first, second = (diagnosed("in_saturation").to_json() for _ in range(2))
    for answer in (first, second):
        answer.pop("seconds")
    assert first == second


def test_candidates_fitted_side_by_side_give_the_same_answer():
    few = ["in_saturation", "in_deadzone", "quad_drag", "out_offset"]
    alone, side_by_side = (
        sysid.diagnose(record_of("quad_drag"), "linear", 2, initial_state="rest", effects=few, **keywords)
        for keywords in ({}, {"jobs": 2, "progress": True})
    )
    first, second = alone.to_json() | {"seconds": 0}, side_by_side.to_json() | {"seconds": 0}
    assert json.dumps(first) == json.dumps(second)
    with pytest.raises(UsageError, match="jobs is 0: give 1 or more"):
        sysid.diagnose(record_of("quad_drag"), jobs=0)


def test_a_diagnosis_takes_one_thread_of_the_linear_algebra_and_gives_the_others_back():
    def threads():
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    asked = []
    with threadpool_limits(2):
        sysid.diagnose(
            record_of("quad_drag"), "linear", 2, initial_state="rest", effects=["quad_drag", "out_offset"],
            accept=lambda name: asked.append(threads()) or True,
        )  # fmt: skip
        assert threads() == {2}
    assert asked
    assert all(counted == {1} for counted in asked)


def test_a_change_after_the_rows_of_the_fit_is_said():
    u, y, split = make_case("")
    y[split == "test"] *= np.linspace(1.0, 1.5, 300)
    found = sysid.diagnose(
        make_record(u, y, period=1.0, split=split),
        "linear",
        2,
        initial_state="rest",
        effects=["in_saturation"],
    )
    (said,) = [sentence for sentence in found.sentences() if "grows along test" in sentence]
    assert "first third" in said
    assert not any(
        "grows along" in sentence for sentence in diagnosed("", effects=["out_offset"]).sentences()
    )


def test_a_constant_force_of_the_model_itself_is_said():
    u = np.repeat(np.random.default_rng(3).uniform(-1.0, 1.0, 60), 5)
    speed, position, y = 0.0, 0.0, []
    for value in u:  # exact for a held input: M = 1, F_v = 0.5, a constant force of 0.2
        y.append(position)
        steady = (value - 0.2) / 0.5
        decayed = (speed - steady) * np.exp(-0.05)
        position += 0.1 * steady + (speed - steady - decayed) / 0.5
        speed = steady + decayed
    record = make_record(u, np.array(y) + 1e-3 * np.random.default_rng(4).standard_normal(u.size), period=0.1)
    found = sysid.diagnose(
        record, "positioning-stage", initial_state="rest", effects=["constant_force", "in_saturation"]
    )
    assert any(
        "constant_force: a constant force is part of the model already, offset = 0.2" in s
        for s in found.sentences()
    )
    # Of a model that is known to have none it is missing, and has a name.
    found = sysid.diagnose(
        record, "positioning-stage", initial_state="rest", effects=["constant_force", "in_saturation"],
        fixed={"offset": 0.0},
    )  # fmt: skip
    assert found.accepted == ("constant_force",)


def motor(load=0.0):
    """Return the exact speed of a motor without inductance, R = J = K = 1, b = 0.5, under held voltages."""
    u = np.repeat(np.random.default_rng(5).uniform(-1.0, 1.0, 60), 5)
    speed, y = 0.0, []
    for value in u - load:
        y.append(speed)
        speed = value / 1.5 + (speed - value / 1.5) * np.exp(-0.15)
    return make_record(u, np.array(y) + 1e-3 * np.random.default_rng(6).standard_normal(u.size), period=0.1)


def test_parameters_that_only_count_together_are_named():
    """Without inductance a motor's speed has a gain and a time constant: two numbers for J, b and K."""

    def said(**fixed):
        found = sysid.diagnose(
            motor(), "dc-motor", initial_state="rest", effects=["in_deadzone"], fixed={"L": 1e-4} | fixed
        )
        return [sentence for sentence in found.sentences() if "only together" in sentence]

    (sentence,) = said(R=1.0)
    assert sentence.startswith("The record determines J, b and K only together")
    assert said(R=1.0, K=1.0) == []


def test_forces_in_a_model_too_fast_to_be_simulated_are_said_not_to_be_tried():
    """A larger inductance, which the record hardly shows either, lets them be tried."""

    def found(inductance):
        fixed = {"R": 1.0, "L": inductance, "K": 1.0}
        return sysid.diagnose(
            motor(load=0.15), "dc-motor", initial_state="rest", effects=["constant_force"], fixed=fixed
        )

    said = [sentence for sentence in found(1e-4).sentences() if "could not be tried" in sentence]
    assert len(said) == 1
    assert said[0].startswith("constant_force could not be tried: the model has a motion of 100 µs")
    slower = found(1e-3)
    assert slower.accepted == ("constant_force",)
    assert slower.final.parameters[-1].value == pytest.approx(0.15, rel=0.05)
    assert not any("could not be tried" in sentence for sentence in slower.sentences())


def test_effects_are_added_by_hand_and_offered_only_where_they_make_sense():
    found = diagnosed("in_saturation", effects=["out_offset"])
    model = found.add("in_saturation").fit()
    (level,) = model.fitted.parameters_of("in_saturation")
    assert abs(level.value - 1.0) < 5.0 * level.std_error
    with pytest.raises(UsageError, match="makes no sense for the model 'linear'"):
        found.add("coulomb")


def test_accepting_nothing_leaves_the_baseline():
    record = record_of("in_saturation")
    found = sysid.diagnose(record, order=2, initial_state="rest", effects=FEW, accept="none")
    assert found.verdict == "missing-effect"
    assert found.accepted == ()
    assert len(found.ladder) == 1
    assert any(sentence.endswith("what lies above it is the model's.") for sentence in found.sentences())
    assert found.advice.startswith("in_saturation was found and not added: --add, or --accept auto")
    refused = sysid.diagnose(record, order=2, initial_state="rest", effects=FEW, accept=lambda name: False)
    assert refused.accepted == ()


def test_the_structure_is_one_of_the_protocol():
    structure: Structure = LinearStructure(record_of(), 2, initial_state="rest")
    assert structure.name == "linear"


def test_the_null_distribution_of_the_largest_score_is_right():
    """Of 300 white records, 30 +- 4 x 5.2 have a p-value below 0.1 (four standard errors of a binomial)."""
    rng = np.random.default_rng(5)
    u = rng.standard_normal(200)
    tangent = np.column_stack([u, np.roll(u, 1)])
    directions = {
        "clip": [np.clip(u, -a, a)[:, np.newaxis] for a in (0.3, 0.6, 1.0, 1.5)],
        "cube": [u[:, np.newaxis] ** 3],
        "pair": [np.column_stack([u**2, np.ones(200)])],
    }
    small = 0
    for run in range(300):
        noise = 1.7 * rng.standard_normal(200)
        found = score_screen(noise, tangent, directions, 1.7**2, np.random.default_rng(run))
        small += found.p_value(max(found.statistics.values())) < 0.1
    assert abs(small - 30) < 4 * np.sqrt(300 * 0.1 * 0.9)


def test_the_test_for_a_remainder_is_right_where_nothing_is_left():
    """Of 300 white records, 30 +- 4 x 5.2 have a p-value below 0.1."""
    rng = np.random.default_rng(6)
    tangent, probes = rng.standard_normal((150, 3)), rng.standard_normal((150, 12))
    small = sum(remainder(rng.standard_normal(150), tangent, probes).p_value < 0.1 for _ in range(300))
    assert abs(small - 30) < 4 * np.sqrt(300 * 0.1 * 0.9)
    assert remainder(probes[:, 0] + 0.1 * rng.standard_normal(150), tangent, probes).p_value < 1e-6


def test_a_basis_is_orthonormal_and_leaves_out_what_is_there():
    rng = np.random.default_rng(7)
    columns, without = rng.standard_normal((50, 4)), orthonormal(rng.standard_normal((50, 3)))
    basis = orthonormal(np.column_stack([columns, columns[:, :2], without[:, 0]]), without)
    assert basis.shape == (50, 4)
    assert np.allclose(basis.T @ basis, np.eye(4), atol=1e-12)
    assert np.allclose(without.T @ basis, 0.0, atol=1e-12)


def test_false_alarms_on_records_with_nothing_missing():
    """Twelve small records, half of them with coloured noise: at most one alarm (at 1 % each, p = 0.006)."""
    effects, alarms = find_effects(FEW[:-1]), 0
    for seed in range(12):
        structure = LinearStructure(
            record_of("", seed=seed, n=600, coloured=seed % 2 == 1), 2, initial_state="rest"
        )
        alarms += bool(Search(structure, effects, seed=seed).decide().accepted)
    assert alarms <= 1


def test_every_candidate_is_ranked():
    effects = find_effects(["coulomb", "coloured_noise", "in_deadzone"])
    structure = LinearStructure(record_of("", n=600, coloured=True), 2, initial_state="rest")
    decision = Search(structure, effects, seed=1).decide()
    assert decision.accepted == ("coloured_noise",)
    # Dry friction is not for difference equations: last, and without numbers.
    assert [trial.name for trial in decision.trials] == ["coloured_noise", "in_deadzone", "coulomb"]
    assert decision.trials[0].p_value < 0.01
    assert np.isnan(decision.trials[-1].p_value)


def test_the_best_candidate_stands_where_its_own_likelihood_is_largest():
    # Weighted by the colour of what is left without it, it would be off by several standard errors.
    found = diagnosed("in_saturation", seed=3, snr=38.0)
    best = found.decision.trials[0]
    noise = best.noise.polynomial
    finished = found.structure.finish(best.fit, noise)
    again = found.structure.fit(best.fit.choices, best.fit.rows, noise, best.fit, effort=Effort.REFIT)
    for ours, moved in zip(finished.parameters, again.parameters, strict=True):
        assert abs(ours.value - moved.value) < 0.05 * ours.std_error
    assert abs(finished.parameters_of("in_saturation")[0].value - 1.0) < (
        3.0 * finished.parameters_of("in_saturation")[0].std_error
    )


def test_what_begins_after_the_rows_of_the_search_is_found():
    # The gain falls to two thirds within the validation rows: estimation rows alone say nothing of it.
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-2, 2, 300), 4)
    y = plant(u * np.where(np.arange(1200) < 700, 1.0, 0.67))
    y += 0.03 * np.std(y) * rng.standard_normal(1200)
    record = make_record(u, y, period=1.0, split=np.repeat(["est", "val", "test"], [600, 300, 300]))
    structure = LinearStructure(record, 2, initial_state="rest")
    effects = find_effects(["in_saturation", "out_offset", "time_variation"])
    decision = Search(structure, effects, seed=1).decide()
    assert (decision.verdict, decision.accepted) == ("missing-effect", ("time_variation",))


def test_rows_to_search_on_and_to_hold_out_take_turns():
    learning = np.array([True] * 300 + [False] * 100 + [True] * 150)
    rows, held_out = interleaved(learning)
    assert not (rows & held_out).any()
    assert np.array_equal(rows | held_out, learning)
    assert held_out.sum() == learning.sum() // 3


def test_searches_that_stop_at_a_pole_of_one_count_as_agreeing():
    # A drift that is not in the model draws a pole to the border of stability, where searches come to rest
    # at errors that differ by some hundredths of a per cent.
    case = assign(3500, 4, family="difference-equation", kind="two").case
    assert "out_drift" in case.names
    record = make_record(case.u, case.y, period=1.0, split=case.sets)
    structure = LinearStructure(record, case.plant.order, initial_state="rest")
    assert structure.baseline(record.estimation).restarts_agree


def test_the_chance_of_a_fit_bounds_that_of_a_search_off_the_grid():
    # The largest of many noisy sums, over a line of directions of which the grid holds a few.
    time = np.linspace(0.0, 1.0, 200)

    def direction(place):
        return np.exp(-0.5 * ((time - place) / 0.03) ** 2)[:, np.newaxis]

    rng, grid = np.random.default_rng(3), np.linspace(0.1, 0.9, 9)
    fine = np.hstack([direction(place) for place in np.linspace(0.1, 0.9, 400)])
    fine = fine / np.linalg.norm(fine, axis=0)
    directions = {"bump": [direction(place) for place in grid]}
    screen = score_screen(np.zeros(200), np.ones((200, 1)), directions, 1.0, rng)
    assert screen.n_points == 9
    draws = ((rng.standard_normal((1000, 200)) @ fine) ** 2).max(axis=1)
    chances = np.array([screen.fitted_p_value(draw, 2) for draw in draws])
    # 1000 draws: three standard deviations of a share of 5 % are 2 %.
    assert np.mean(chances < 0.05) < 0.07
    assert np.mean(chances < 0.5) > 0.1


def write_csv(path, u, y, split):
    lines = ["k,u,y,set"]
    for k, row in enumerate(zip(u, y, split, strict=True)):
        lines.append(f"{k},{row[0]!r},{'' if row[2] == 'test' else repr(float(row[1]))},{row[2]}")
    path.write_text("\n".join(lines).replace("np.float64(", "").replace(")", "") + "\n")


def test_the_command_writes_what_others_read(tmp_path, capsys):
    data = tmp_path / "case.csv"
    write_csv(data, *make_case("in_saturation"))
    files = {name: tmp_path / f"out.{name}" for name in ("json", "csv", "html", "pdf", "toml")}
    code = main(
        ["diagnose", str(data), "--model", "linear", "--order", "2", "--input", "u", "--output", "y",
         "--period", "1.0", "--split-column", "set", "--effects", ",".join(FEW), "--accept", "auto",
         "--initial-state", "rest", "--seed", "1", "--jobs", "1", "--json", str(files["json"]),
         "--predictions", str(files["csv"]), "--html", str(files["html"]), "--pdf", str(files["pdf"]),
         "--save", str(files["toml"])]
    )  # fmt: skip
    assert code == 0
    said = capsys.readouterr().out
    assert "Missing in the model: in_saturation." in said
    for word, kind in (("Page", "html"), ("PDF", "pdf"), ("JSON", "json"), ("Predictions", "csv")):
        assert f"{word}: {files[kind]}\n" in said
    answer = json.loads(files["json"].read_text())
    assert answer["schema"] == 1
    assert answer["verdict"] == "missing-effect"
    assert answer["accepted"] == ["in_saturation"]
    assert sorted(entry["effect"] for entry in answer["ranked"]) == sorted(FEW)
    level = answer["ranked"][0]["parameters"]["level"]
    assert abs(level["value"] - 1.0) < 5.0 * level["std_error"]
    assert [rung["effect"] for rung in answer["ladder"]] == [None, "in_saturation"]
    assert (
        answer["ladder"][1]["scores"]["validation"]["rmse"]
        < answer["ladder"][0]["scores"]["validation"]["rmse"]
    )
    with files["csv"].open() as file:
        rows = list(csv.DictReader(file))
    assert [row["k"] for row in rows] == [str(k) for k in range(1200)]
    assert rows[-1]["measured"] == ""
    assert all(np.isfinite(float(row["final"])) for row in rows)
    page = files["html"].read_text()
    assert "What in_saturation does" in page
    assert "≤ 0.0005" in page
    assert "in_<wbr>saturation: level" in page  # a name goes on in the next line of a narrow cell
    assert "±\N{NO-BREAK SPACE}" in page
    assert files["pdf"].read_bytes().startswith(b"%PDF")
    saved = load(files["toml"])
    u = make_case("in_saturation")[0]
    assert np.allclose(saved.simulate(u), [float(row["final"]) for row in rows], rtol=1e-9, atol=1e-12)


def test_what_was_found_is_told_before_it_is_asked_for(tmp_path, capsys, monkeypatch):
    data = tmp_path / "case.csv"
    write_csv(data, *make_case("in_saturation"))
    known = ["diagnose", str(data), "--order", "2", "--period", "1", "--split-column", "set"]
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    assert main([*known, "--effects", "in_saturation", "--initial-state", "rest", "--accept", "ask"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("in_saturation is missing in the model. The actuator reaches its limit")
    assert "Add in_saturation? [y/N] " in said
    assert "in_saturation was added." in said


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--effects", "in_saturatoin"], "effect 'in_saturatoin' is not known"),
        (["--effects", ","], "--effects names no effect"),
        (["--alpha", "2"], "--alpha is 2"),
        (["--max-effects", "-1"], "--max-effects is -1"),
        (["--jobs", "0"], "--jobs is 0"),
        (["--model", "nosuch"], "nosuch"),
        (["--add", "coloured"], "effect 'coloured' is not known: did you mean coloured_noise"),
        (["--add", "coloured_noise"], "a memory of the noise changes no free run"),
        (["--add", "coulomb"], "'coulomb' makes no sense for the model 'linear': it is for physics models"),
        (["--save", "model.xyz"], "the ending '.xyz' is not known"),
    ],
)
def test_bad_use_is_one_sentence(tmp_path, capsys, monkeypatch, extra, message):
    monkeypatch.chdir(tmp_path)
    data = tmp_path / "case.csv"
    write_csv(data, *make_case("", n=200))
    arguments = ["diagnose", str(data), "--period", "1", "--split-column", "set", "--order", "1"]
    assert main([*arguments, *extra]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    "effects",
    [
        ["in_saturation", "out_quadratic"],
        ["in_backlash", "out_offset"],
        ["quad_drag", "out_drift"],
        ["op_gain", "feedthrough"],
        ["extra_mode", "in_delay"],
        ["time_variation", "out_lowpass"],
    ],
)
def test_a_saved_model_simulates_alike_everywhere(tmp_path, effects):
    found = diagnosed("", n=400, effects=["out_offset"])
    model = found.add(*effects).fit()
    file = tmp_path / "model.json"
    save(model, file)
    saved = load(file)
    assert saved == saved_model(model)
    u = found.record.u[:, 0]
    expected = saved.simulate(u)
    assert np.allclose(expected, model.output, rtol=1e-9, atol=1e-12)
    names: dict[str, object] = {}
    exec(to_python(saved), names)
    # The same sums in another order: rounding grows with the steps, not beyond 1e-9.
    assert np.allclose(names["simulate"](u), expected, rtol=1e-8, atol=1e-9)


def test_a_saved_model_with_a_direct_path_inside_simulates_alike_everywhere(tmp_path):
    effects = (
        SavedEffect("feedthrough", "inside", {"d": 0.4}),
        SavedEffect("cubic_stiffness", "cubic", {"k3": 0.5}),
        SavedEffect("quad_drag", "drag", {"c": 0.3}),
    )
    saved = SavedModel((-1.4, 0.6), (0.3, -0.1), 0.02, 0.1, effects)
    u = np.random.default_rng(0).uniform(-1.0, 1.0, 400)
    expected = saved.simulate(u)
    names: dict[str, object] = {}
    exec(to_python(saved), names)
    # Both search each root to rounding; the equations amplify that some ten times.
    assert np.allclose(names["simulate"](u), expected, rtol=1e-11, atol=1e-12)


def test_a_saved_model_whose_paths_begin_behind_the_actuator_simulates_alike_everywhere(tmp_path):
    effects = (
        SavedEffect("feedthrough", "behind", {"d": 0.4}),
        SavedEffect("in_backlash", "symmetric", {"width": 0.2}),
        SavedEffect(
            "extra_mode",
            "second order behind",
            {"frequency": 4.0, "damping": 0.1, "gain_1": 0.2, "gain_2": -0.1},
        ),
        SavedEffect("quad_drag", "drag", {"c": 0.3}),
    )
    saved = SavedModel((-1.4, 0.6), (0.3, -0.1), 0.02, 0.1, effects)
    u = np.random.default_rng(0).uniform(-1.0, 1.0, 400)
    names: dict[str, object] = {}
    exec(to_python(saved), names)
    # The same sums in another order.
    assert np.allclose(names["simulate"](u), saved.simulate(u), rtol=1e-11, atol=1e-12)
    assert "feedthrough: y = w + d x, where x drives the model (d = 0.4)" in saved.equation()
    assert "driven by x, as the model is (frequency = 4" in saved.equation()


def test_a_direct_path_that_forces_pass_is_found_where_one_beside_leaves_something():
    """A resonance with a stiffening spring, sampled so that its force acts at once, too."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-1.0, 1.0, 400), 2)
    truth = SavedModel(
        (-1.4, 0.8), (0.2, 0.1), 0.0, 0.1,
        (
            SavedEffect("feedthrough", "inside", {"d": 0.3}),
            SavedEffect("cubic_stiffness", "cubic", {"k3": 0.4}),
        ),
    )  # fmt: skip
    y = truth.simulate(u) + 1e-3 * rng.standard_normal(u.size)
    found = sysid.diagnose(
        make_record(u, y, period=0.1), "linear", 2, initial_state="rest",
        effects=["cubic_stiffness", "feedthrough", "in_saturation", "out_quadratic"],
    )  # fmt: skip
    assert found.verdict == "missing-effect"
    assert set(found.accepted) == {"cubic_stiffness", "feedthrough"}
    for name, value in (("feedthrough", 0.3), ("cubic_stiffness", 0.4)):
        (parameter,) = found.final.fitted.parameters_of(name)
        assert abs(parameter.value - value) < 4.0 * parameter.std_error < 0.02 * value


def test_a_saved_model_runs_in_python_control():
    import control

    found = diagnosed("", n=400, effects=["out_offset"])
    saved = saved_model(found.add("in_saturation", "cubic_stiffness", "out_quadratic").fit())
    u = found.record.u[:60, 0]
    system = to_control(saved)
    start = np.zeros(4)
    start[:] = 0.0
    response = control.input_output_response(system, np.arange(60.0), u, start)
    assert np.allclose(response.outputs, saved.simulate(u), rtol=1e-9, atol=1e-9)


def test_a_file_that_is_no_model_is_refused(tmp_path):
    file = tmp_path / "model.json"
    file.write_text('{"kind": "other"}')
    with pytest.raises(DataError, match=r"model\.json is no"):
        load(file)


def test_a_damped_path_beside_an_effect_that_only_together_fit_is_called_unexplained():
    """u + g |u| is a saturation of one side at zero, beside a path without any: not what is there."""
    rng = np.random.default_rng(2)
    n = 700
    u = rng.uniform(-1.0, 1.0, n) + 0.25
    x = u + 0.6 * np.abs(u)
    y = np.zeros(n)
    for k in range(2, n):
        y[k] = 1.1 * y[k - 1] - 0.3 * y[k - 2] + 0.2 * x[k - 1] + 0.05 * x[k - 2]
    y += 0.02 * np.std(y) * rng.standard_normal(n)
    record = make_record(u, y, period=1.0)
    found = sysid.diagnose(record, order=2, initial_state="rest", effects=["in_saturation", "extra_mode"])
    assert found.verdict == "unexplained"


def test_a_relay_that_few_inputs_switch_is_no_dead_zone():
    rng = np.random.default_rng(4)
    u = np.repeat(rng.standard_normal(300), 4)
    threshold = np.quantile(np.abs(u[:900]), 0.85)
    y = plant(np.sign(u) * (np.abs(u) > threshold))
    y = y + 0.03 * np.std(y) * rng.standard_normal(u.size)
    record = make_record(u, y, period=1.0, split=np.repeat(["est", "val", "test"], [600, 300, 300]))
    candidates = ["in_relay", "in_deadzone", "in_saturation", "in_preload", "coloured_noise"]
    found = sysid.diagnose(record, order=2, initial_state="rest", effects=candidates)
    assert found.accepted == ("in_relay",)
    (threshold_found,) = found.final.fitted.parameters_of("in_relay")
    assert threshold_found.value == pytest.approx(threshold, rel=0.05)  # between the next two inputs


def test_a_second_look_at_rows_that_fix_no_model_changes_nothing(monkeypatch):
    # The rows of the first search gave a model that all starts agree on: it is not taken back.
    rng = np.random.default_rng(3)
    u = rng.uniform(-2, 2, 400)
    y = plant(u) + 0.02 * rng.standard_normal(400)
    structure = LinearStructure(make_record(u, y, period=1.0), 2, initial_state="rest")
    found = LinearStructure.baseline

    def disagreeing(self, rows):
        return replace(found(self, rows), restarts_agree=np.array_equal(rows, self.record.estimation))

    monkeypatch.setattr(LinearStructure, "baseline", disagreeing)
    monkeypatch.setattr(search, "_held_out_rows_show_more", lambda *_: True)
    assert Search(structure, find_effects(["in_saturation"])).decide().verdict == "nothing-missing"
