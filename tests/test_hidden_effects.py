import json

import numpy as np
import pytest

from benchmarks.hidden_effects.__main__ import main
from benchmarks.hidden_effects.intervals import plant_values, true_values
from benchmarks.hidden_effects.outcome import write_case
from benchmarks.hidden_effects.plan import FAMILIES, KINDS, TIERS, assign
from benchmarks.hidden_effects.refit import rms, true_structure
from benchmarks.hidden_effects.summary import calibration, confusion, coverage, summarise
from sysid.errors import UsageError
from sysid.statistics import wilson_interval


def outcome(kind="single", truth=("coulomb",), **answer):
    base = {
        "id": "x",
        "tier": "normal",
        "kind": kind,
        "family": "dc-motor",
        "share": 0.1,
        "snr": 30.0,
        "truth": list(truth),
        "seconds": 1.0,
        "error": None,
        "verdict": "missing-effect" if truth else "nothing-missing",
        "accepted": list(truth),
        "ranked": [*truth, "in_deadzone", "in_preload", "in_relay"],
        "p_value": 0.5,
        "intervals": [],
        "reduction": 1.0,
    }
    return base | answer


def scores(*outcomes):
    return {name: s["share"] for name, s in summarise(outcomes)["normal"]["scores"].items()}


def test_right_answers_score_one_and_no_alarm():
    found = scores(
        outcome(),
        outcome("null", ()),
        outcome("two", ("in_deadzone", "out_offset")),
        outcome("outside", ("preisach",), verdict="unexplained", accepted=[], ranked=["in_relay"]),
    )
    assert found == {
        "first": 1.0,
        "first_three": 1.0,
        "exact": 1.0,
        "false_alarm": 0.0,
        "reduction": 1.0,
        "both": 1.0,
        "unexplained": 1.0,
        "wrongly_unexplained": 0.0,
    }


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("first", outcome(ranked=["in_deadzone", "coulomb"])),
        ("first_three", outcome(ranked=["in_deadzone", "in_relay", "in_preload", "coulomb"])),
        ("exact", outcome(accepted=["coulomb", "in_relay"])),
        ("exact", outcome("null", (), accepted=["coloured_noise"])),
        ("reduction", outcome(reduction=0.89)),
        ("both", outcome("two", ("in_deadzone", "out_offset"), accepted=["out_offset"])),
        ("unexplained", outcome("outside", ("preisach",), verdict="missing-effect", accepted=["in_relay"])),
    ],
)
def test_a_wrong_answer_is_held_against(name, wrong):
    assert scores(wrong)[name] == 0.0


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("false_alarm", outcome("null", (), accepted=["in_relay"])),
        ("wrongly_unexplained", outcome(verdict="unexplained")),
    ],
)
def test_an_alarm_is_counted(name, wrong):
    assert scores(wrong)[name] == 1.0


def test_a_failed_diagnosis_is_wrong_and_listed():
    failed = outcome() | {"error": "exit code 2"}
    for key in ("ranked", "accepted", "verdict", "reduction", "intervals", "p_value"):
        del failed[key]
    found = summarise([failed])["normal"]
    assert found["failed"] == [{"id": "x", "error": "exit code 2"}]
    assert found["scores"]["first"]["share"] == 0.0
    assert found["confusion"] == {"coulomb": {"failed": 1}}


def test_noise_that_is_coloured_by_nature_may_be_named_or_not():
    hard = {
        "tier": "hard",
        "ranked": ["coloured_noise", "coulomb"],
        "accepted": ["coulomb", "coloured_noise"],
    }
    found = summarise([outcome(**hard), outcome(tier="hard")])["hard"]["scores"]
    assert (found["first"]["share"], found["exact"]["share"]) == (1.0, 1.0)
    assert scores(outcome(**(hard | {"tier": "normal"})))["first"] == 0.0


def test_no_reduction_is_asked_where_nothing_can_be_gained():
    noise = outcome(truth=("coloured_noise",), reduction=None)
    found = summarise([noise, outcome()])["normal"]["scores"]["reduction"]
    assert (found["hits"], found["n"]) == (1, 1)


def test_shares_carry_wilson_intervals_and_targets():
    found = summarise([outcome()] * 19 + [outcome(ranked=["in_relay"])])["normal"]["scores"]["first"]
    assert (found["hits"], found["n"], found["met"]) == (19, 20, True)
    assert (found["low"], found["high"]) == wilson_interval(19, 20)


def test_confusion_takes_the_first_accepted_else_the_verdict():
    table = confusion(
        [outcome(), outcome(accepted=[], verdict="unexplained"), outcome(accepted=["in_relay"])]
    )
    assert table == {"coulomb": {"coulomb": 1, "unexplained": 1, "in_relay": 1}}


def test_calibration_sees_uniform_p_values_and_rejects_squared_ones():
    p = np.random.default_rng(0).uniform(size=500)
    assert calibration(p.tolist())["p"] > 0.01
    assert calibration((p**2).tolist())["p"] < 1e-6
    assert calibration([None, 0.3])["p"] is None


def test_coverage_of_normal_errors_is_95_percent_and_of_wide_ones_is_not():
    z = np.random.default_rng(1).standard_normal(2000)
    right, wide = coverage(z.tolist()), coverage((1.5 * z).tolist())
    assert right["low"] <= 0.95 <= right["high"]
    assert wide["high"] < 0.95


def test_true_values_bear_the_names_and_units_of_the_answer():
    sides = {"upper": 1.0, "lower": 2.0}
    assert true_values("in_deadzone", sides, 0.1, ["width_negative", "width_positive"]) == {
        "width_negative": 2.0,
        "width_positive": 1.0,
    }
    assert true_values("in_deadzone", sides, 0.1, ["width"]) == {}
    assert true_values("out_drift", {"rate": 0.2}, 0.1, ["rate"]) == {"rate": 2.0}
    ramp = {"change": 0.5, "n": 100.0, "step": 0.0, "start": 0.0}
    assert true_values("time_variation", ramp, 0.1, ["rate"]) == {"rate": 0.05}


def test_true_values_of_a_plant_leave_out_what_only_its_product_with_a_level_shows():
    kinds = {
        name: assign(5, 1, family="difference-equation", effect=name).case
        for name in ("in_saturation", "in_relay", "out_rectify")
    }
    known = {name: set(plant_values(case)) for name, case in kinds.items()}
    order = kinds["in_saturation"].plant.order
    assert len(known["in_saturation"]) == 2 * order
    assert all(not any(key.startswith("b") for key in known[name]) for name in ("in_relay", "out_rectify"))


def test_the_same_seed_and_number_give_the_same_case_and_its_command(tmp_path):
    for part in ("a", "b"):
        write_case(assign(4, 2), tmp_path / part)
    for name in ("record.csv", "case.json", "truth.json"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    command = json.loads((tmp_path / "a" / "case.json").read_text())["command"]
    assert command[:3] == ["sysid", "diagnose", "record.csv"]
    rows = (tmp_path / "a" / "record.csv").read_text().splitlines()
    assert rows[0] == "k,u,y,set"
    assert len(rows) == 2401
    assert rows[-1].endswith(",,test")


def test_options_before_an_action_count_for_it(tmp_path, monkeypatch):
    chosen = ["--seed", "4", "--kind", "null", "--cases", "1"]
    for folder, words in (("a", [*chosen, "draw"]), ("b", ["draw", *chosen])):
        monkeypatch.setattr("sys.argv", ["hidden_effects", "--out", str(tmp_path / folder), *words])
        assert main() == 0
        truth = tmp_path / folder / "cases" / "normal-00004-0000" / "truth.json"
        assert json.loads(truth.read_text())["kind"] == "null"


def test_kinds_hide_what_they_say():
    for number in range(4):
        assert assign(9, number, kind="null").case.effects == ()
        two = assign(9, number, kind="two")
        assert len(two.case.effects) == 2
        outside = assign(9, number, kind="outside", family="difference-equation")
        assert outside.case.names[0] not in outside.candidates
        assert assign(9, number, kind="single").case.names[0] in assign(9, number, kind="single").candidates


def test_unknown_names_are_one_sentence():
    with pytest.raises(UsageError, match="the tier 'easy' is unknown; choose from normal, hard"):
        assign(0, 0, "easy")


def test_weights_add_up():
    assert sum(KINDS.values()) == pytest.approx(1.0)
    assert sum(FAMILIES.values()) == pytest.approx(1.0)


def test_the_true_structure_refitted_is_nearly_free_of_error():
    case = assign(9, 1, family="difference-equation", effect="in_deadzone").case
    test = case.sets == "test"
    clean = case.noise_free[test]
    error = rms(true_structure(case)[test] - clean) / np.std(clean)
    noise = 10 ** (-case.snr / 20)
    # Six to eight parameters from 1800 rows: sqrt(8 / 1800) = 0.07 of the noise, and twice that at most.
    assert error < 0.15 * noise


def test_hard_cases_are_smaller_and_louder():
    assert TIERS["hard"].share[1] < TIERS["normal"].share[1]
    case = assign(9, 0, "hard", "difference-equation", "single").case
    assert 10.0 <= case.snr <= 20.0
