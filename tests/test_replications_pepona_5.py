"""Chapter 5 of Pepona's thesis: its numbers, its errata, and that broken things turn gates red."""

from dataclasses import replace

import numpy as np
import pytest

from replications.errata import erratum_gates
from replications.pepona import chapter5_gates as checks
from replications.pepona.chapter5 import CHAPTER_5, plan5
from replications.pepona.chapter5_errata import NOT_NECESSARY, deficiency, errata5
from replications.pepona.chapter5_pwarx import (
    PAIRS,
    direct_errors,
    mode_counts,
    n_parameters,
    pwarx_points,
    submodel,
    table_5_3_lft,
    table_5_3_slack,
    table_5_3_unrounded,
)
from replications.pepona.chapter5_runs import ExampleRun, LongRun, StageRun, ThresholdRun, alternate, jointly
from replications.pepona.chapter5_setting import EXAMPLES, PRINTED, experiment, parameters
from replications.pepona.chapter5_theory import bound_std, theory_numbers
from sysid.lft import PiecewiseLft, rows_of
from sysid.nonlinearities.piecewise_affine import PiecewiseAffineMap


def test_the_last_column_of_table_5_3_follows_from_table_5_2():
    found = table_5_3_lft()
    # By hand for (1, 1), from the printed entries.
    exact = np.array([0.4, 0.5, -0.25, 1.2, 1.0, -0.5, -0.25 + 0.5 * 0.25])
    estimate = np.array(
        [0.3904, 0.494, -0.4914 * 0.494, 1.2041, 1.0195, -0.4914 * 1.0195, -0.2826 + 0.4914 * 0.2826]
    )
    assert np.isclose(
        found["1,1"], 100 * np.linalg.norm(estimate - exact) / np.linalg.norm(exact), rtol=1e-12
    )
    assert table_5_3_unrounded() < 5e-5
    assert all(0.004 < slack < 0.008 for slack in table_5_3_slack().values())


def test_the_equivalent_pwarx_model_predicts_as_the_lft_model_does():
    example = EXAMPLES["5.2"]
    u, y = experiment(example, np.random.default_rng(1))
    points, target = pwarx_points(example, u, y)
    rows = rows_of(example.structure, u, y)
    labels = example.model.map.mode(rows.z)
    # Sorted lags: u(k-1), u(k-2), u(k-3), y(k-1), y(k-2), y(k-3); those of Theta: y first.
    regressors = np.column_stack([points[:, 3:], points[:, :3], np.ones(target.size)])
    predicted = np.empty(target.size)
    for i, j in PAIRS:
        here = (labels[rows.now] == i - 1) & (labels[rows.now - 1] == j - 1)
        predicted[here] = regressors[here] @ submodel(example.true, i, j)
    assert np.allclose(predicted, example.model.predict(rows), atol=1e-12)


def test_direct_errors_vanish_without_noise():
    quiet = replace(EXAMPLES["5.2"], noise=0.0)
    u, y = experiment(quiet, np.random.default_rng(2))
    assert max(direct_errors(u, y).values()) < 1e-9


def test_modes_and_parameters_are_counted():
    assert [n_parameters(EXAMPLES[case]) for case in ("5.2", "5.3")] == [(9, 28), (10, 352)]
    u, y = experiment(EXAMPLES["5.3"], np.random.default_rng(3))
    counts = mode_counts(EXAMPLES["5.3"], u, y)
    assert counts.size == 32
    assert counts.sum() == 1000 - EXAMPLES["5.3"].structure.first


@pytest.mark.parametrize("case", ["5.2", "5.3"])
def test_a_boundary_turned_round_gives_the_same_table(case):
    example = EXAMPLES[case]
    map_ = example.model.map
    turned = PiecewiseAffineMap(map_.theta[::-1], map_.separators[::-1])
    other = PiecewiseLft.of(example.structure, example.linear, turned)
    assert parameters(example, other) == pytest.approx(dict(example.true))


def test_other_numbers_of_modes_leave_the_table_undefined():
    example = EXAMPLES["5.1"]
    three = PiecewiseAffineMap.of_breakpoints([[1, 0], [2, 0], [3, 0]], [-1.0, 1.0])
    found = parameters(example, PiecewiseLft.of(example.structure, example.linear, three))
    assert np.isnan(found["alpha1"])
    assert found["a1"] == -0.8


def test_every_printed_error_is_an_error_and_its_correction_is_right():
    gates = erratum_gates(errata5())
    assert all(gate.passed for gate in gates)
    swapped = [
        replace(e, printed_error=e.corrected_error, corrected_error=e.printed_error) for e in errata5()
    ]
    assert not any(gate.passed for gate in erratum_gates(swapped))


def test_the_counterexample_to_lemma_5_1_has_full_rank():
    assert deficiency(NOT_NECESSARY, (0.5,)) == 0


@pytest.mark.parametrize("case", ["5.2", "5.3"])
def test_the_bound_is_that_of_a_known_partition_by_differences(case):
    example = EXAMPLES[case]
    names = [name for name in example.true if not name.startswith("h")]
    u, y = experiment(example, np.random.default_rng(4), 20_000)
    rows = rows_of(example.structure, u, y)
    point = np.array([example.true[name] for name in names])
    n_linear = example.structure.n_linear

    def predicted(values):
        map_ = PiecewiseAffineMap(values[n_linear:].reshape(2, 3), example.model.map.separators)
        return PiecewiseLft.of(example.structure, values[:n_linear], map_).predict(rows)

    columns = [(predicted(point + s) - predicted(point - s)) / 2e-6 for s in 1e-6 * np.eye(point.size)]
    information = np.array(columns) @ np.array(columns).T / rows.y.size
    per_record = example.samples - example.structure.first
    sizes = np.sqrt(np.diag(np.linalg.inv(information)) / per_record) * example.noise_std
    # Two independent sets of some 20,000 and 40,000 samples: 3 %.
    assert np.allclose(sizes, [bound_std(case)[name] for name in names], rtol=0.05)


def test_the_bound_of_the_kink_is_met_by_the_spread_of_the_joint_fit():
    example, runs = EXAMPLES["5.1"], []
    for i in range(80):
        rng = np.random.default_rng([5, i])
        runs.append(parameters(example, jointly(example, *experiment(example, rng), rng)))
    for name, bound in bound_std("5.1").items():
        spread = np.std([run[name] for run in runs])
        assert 0.7 * bound < spread < 1.5 * bound  # 80 runs of 100 samples: 4 x 8 % and small samples


def test_what_holds_without_a_study():
    numbers = theory_numbers()
    assert all(gate.passed for gate in checks.theory_gates(numbers))
    broken = {name: value + 1.0 for name, value in numbers.items()}
    red = [gate for gate in checks.theory_gates(broken) if not gate.passed]
    assert len(red) == len(checks.theory_gates(numbers)) - 1  # the blown-up recursion stays so


def test_a_wrong_entry_of_table_5_3_turns_its_gate_red():
    numbers = {f"table_5.3_lft/{pair}": value for pair, value in table_5_3_lft().items()}
    numbers |= {f"table_5.3_lft/slack/{pair}": value for pair, value in table_5_3_slack().items()}
    numbers |= {"table_5.3_lft/unrounded": table_5_3_unrounded(), "table_5.3/better_share": 0.9}
    assert all(gate.passed for gate in checks.table_gates(numbers))
    for name, value in (
        ("table_5.3_lft/1,1", 1.3528),
        ("table_5.3_lft/unrounded", 1e-3),
        ("table_5.3/better_share", 0.5),
    ):
        assert sum(not gate.passed for gate in checks.table_gates({**numbers, name: value})) == 1


GOOD = {
    "bias/5.2/alternating/theta1_1/z": 9.0, "bias/5.3/alternating/theta1_1/z": 50.0,
    "bias/5.2/joint/largest_z": 2.0, "bias/5.3/joint/largest_z": 2.0,
}  # fmt: skip


@pytest.mark.parametrize("name", GOOD)
def test_bias_gates_turn_red(name):
    assert all(gate.passed for gate in checks.bias_gates(GOOD))
    broken = {**GOOD, name: 5.0 if "joint" in name else 2.0}
    assert sum(not gate.passed for gate in checks.bias_gates(broken)) == 1


def test_gates_of_stages_thresholds_and_direct_fits_turn_red():
    numbers = {
        f"stage/{case}/{stage}/success": 1.0
        for case in EXAMPLES
        for stage in ("global", "k-plane", "bounded-error")
    }
    numbers |= {name.replace("success", "runs"): 100.0 for name in numbers}
    assert all(gate.passed for gate in checks.stage_gates(numbers))
    half = {name: 0.5 if name.endswith("success") else value for name, value in numbers.items()}
    assert not any(gate.passed for gate in checks.stage_gates(half))
    numbers = {
        "5.1/as_printed/iterations": 47.0,
        "threshold/5.1/constant/0.001/iterations": 3.0,
        "threshold/5.2/as_printed/0.001/distance": 0.004,
    }
    assert all(gate.passed for gate in checks.threshold_gates(numbers))
    swapped = {
        "5.1/as_printed/iterations": 5.0,
        "threshold/5.1/constant/0.001/iterations": 30.0,
        "threshold/5.2/as_printed/0.001/distance": 1e-5,
    }
    assert not any(gate.passed for gate in checks.threshold_gates(swapped))
    numbers = {"5.2/pwarx-0.4/two_modes_share": 1.0, "5.2/pwarx-0.25/least_misplaced": 0.3}
    assert all(gate.passed for gate in checks.pwarx_gates(numbers))
    assert not any(gate.passed for gate in checks.pwarx_gates(dict.fromkeys(numbers, 0.0)))


class FakeStudy:
    n_runs = 200


def test_gates_of_the_joint_fit_turn_red():
    numbers = {"ratio_to_bound/5.2/joint/largest": 1.1, "ratio_to_bound/5.3/joint/largest": 1.1}
    quality = {"bias": 0.0, "bias_std_error": 0.001, "std": 0.01}
    entries = {
        f"{case}/joint": {"parameters": {"g1": quality, "h1": quality}, "success_share": 1.0}
        for case in EXAMPLES
    }
    studies = dict.fromkeys(EXAMPLES, FakeStudy())
    assert all(gate.passed for gate in checks.precision_gates(studies, entries, numbers))
    biased = {"parameters": {"g1": {**quality, "bias": 0.01}}, "success_share": 0.5}
    broken = checks.precision_gates(studies, dict.fromkeys(entries, biased), dict.fromkeys(numbers, 1.5))
    assert not any(gate.passed for gate in broken)


def test_runs_have_the_columns_that_are_printed():
    for case, task in (("5.2", ExampleRun("5.2")), ("5.3", ExampleRun("5.3")), ("5.1", ExampleRun("5.1"))):
        found = task(np.random.default_rng(7))
        wanted = [column for name, column, _ in PRINTED.values() if name == case]
        assert set(wanted) <= set(found)
        assert case == "5.1" or found["success"] == found["joint/success"] == 1.0


def test_the_same_generator_gives_the_same_run():
    first, second = (StageRun("5.2", "bounded-error")(np.random.default_rng(8)) for _ in range(2))
    assert first == second or str(first) == str(second)


def test_long_runs_show_the_bias():
    found = LongRun("5.3", 20_000)(np.random.default_rng(9))
    bound = bound_std("5.3")["theta1_1"] * np.sqrt(1000 / 20_000)
    assert found["alternating/theta1_1"] - 0.2 > 8 * bound
    assert abs(found["joint/theta1_1"] - 0.2) < 4.5 * bound


def test_a_smaller_threshold_stops_nearer_to_the_fixed_point():
    found = ThresholdRun("5.2")(np.random.default_rng(10))
    distances = [found[f"as_printed/{gamma:g}/distance"] for gamma in (1e-2, 1e-3, 1e-4)]
    assert distances == sorted(distances, reverse=True)


def test_example_5_1_settles_quickly_with_a_constant():
    example = EXAMPLES["5.1"]
    rng = np.random.default_rng(11)
    found = alternate(example, *experiment(example, rng), "global", rng)
    assert found.converged
    assert found.iterations <= 8


def test_the_plan_names_the_pinned_cases():
    cases = plan5(200)
    assert {"5.1", "5.2", "5.3"} <= set(cases)
    assert all(cases[case][1] == 100 for case in EXAMPLES)
    assert CHAPTER_5.plan is plan5
