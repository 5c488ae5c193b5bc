"""Chapter 4 of Pepona's thesis: the setting is that of the text, and every gate sees what it guards."""

from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from replications.errata import erratum_gates
from replications.pepona import chapter4, chapter4_theory, prediction, records, setting
from replications.pepona import chapter4_checks as checks
from replications.pepona import paper as pepona
from replications.pepona.chapter4_errata import errata4
from replications.pepona.chapter4_study import (
    SIZES,
    ExampleRun,
    HammersteinRun,
    ReadingRun,
    readings,
    structure,
    true_start,
)
from replications.pepona.chapter4_theory import TheoryRun, theory_numbers
from replications.pepona.paper import judged
from replications.studies import entry
from sysid.claims import Claim, read
from sysid.errors import UsageError
from sysid.lft import fit_lft, initial_estimate, printed_search
from sysid.lft.printed import printed_search as search_as_printed
from sysid.montecarlo import Runner

RUNS = 40


def red(gates):
    return {gate.id for gate in gates if not gate.passed}


def study(task, case, runs=RUNS, seed=5):
    return Runner(jobs=1).run(case, task, runs, seed=seed)


# The setting ----------------------------------------------------------------------------------------


def test_the_signals_obey_the_printed_equations():
    for case, e in setting.EXAMPLES.items():
        s = setting.experiment(e, 400, np.random.default_rng(1))
        left = s.y[1:] - e.a * s.y[:-1] - e.b * s.u[:-1] - s.w[1:] - e.g * s.w[:-1]
        np.testing.assert_allclose(left, s.e[1:], atol=1e-12)
        z = sum(d * s.u[3 - i - 1 : -i - 1] for i, d in enumerate(e.d)) if e.d else s.y[1:-2]
        np.testing.assert_allclose(s.z[3:], z, atol=1e-12, err_msg=case)
    s = setting.experiment(setting.EXAMPLES["4.2"], 400, np.random.default_rng(1))
    np.testing.assert_allclose(s.w, s.z / np.sqrt(0.1 + 0.9 * s.z**2))
    low, high = s.u.min(), s.u.max()
    assert -0.7 <= low < -0.6
    assert 2.4 < high <= 2.5


@pytest.mark.parametrize("case", ["4.3", "4.4"])
def test_the_free_run_of_the_truth_goes_on_from_measured_signals(case):
    e = setting.EXAMPLES[case]
    s = setting.experiment(e, 300, np.random.default_rng(2))
    quiet = setting.respond(e, s.u, np.where(np.arange(300) < 100, s.e, 0.0))
    # Noise until 99, none after: from 100 on the whole run and the run that is begun anew are one.
    np.testing.assert_allclose(setting.respond_after(e, quiet, 100), quiet.y[100:], atol=1e-9)


@pytest.mark.parametrize("case", list(setting.EXAMPLES))
def test_the_slopes_are_derivatives(case):
    e = setting.EXAMPLES[case]
    z = np.array([-2.3, -0.4, 0.3, 1.1, 2.7])
    difference = (e.function(z + 1e-6) - e.function(z - 1e-6)) / 2e-6
    np.testing.assert_allclose(e.slope(z), difference, atol=1e-8)  # second differences of order 1e-12 / 1e-6


@pytest.mark.parametrize("case", list(setting.EXAMPLES))
def test_the_first_estimate_follows_431(case):
    e = setting.EXAMPLES[case]
    s = setting.experiment(e, e.samples, np.random.default_rng(3))
    found = initial_estimate((s.u, s.y), structure(e))
    k = np.arange(structure(e).largest_lag, e.samples)
    columns = [s.y[k - 1]] * ("a1" in e.true) + [s.u[k - 1]] * ("b1" in e.true) + [np.ones(k.size)]
    linear = np.linalg.lstsq(np.column_stack(columns), s.y[k], rcond=None)[0]
    v = s.y[k] - np.column_stack([*columns[:-1], 0 * columns[-1]]) @ linear
    np.testing.assert_allclose(found.v, v, atol=1e-10)
    if e.d:
        d = np.linalg.lstsq(np.column_stack([s.u[k - i] for i in range(1, len(e.d) + 1)]), v, rcond=None)[0]
        np.testing.assert_allclose(found.d, d / np.linalg.norm(d), atol=1e-10)
    if "a1" in e.true:
        assert found.a[1] == pytest.approx(-linear[0])


# Prediction and bounds ------------------------------------------------------------------------------


@pytest.mark.parametrize("case", list(setting.EXAMPLES))
def test_the_true_prediction_leaves_the_noise(case):
    e = setting.EXAMPLES[case]
    p = prediction.Predictor(e, setting.experiment(e, 500, np.random.default_rng(4)))
    np.testing.assert_allclose(p.measured - p.known(prediction.theta(e)), p.signals.e[3:], atol=1e-12)


def test_the_derivatives_by_differences_are_those_by_hand():
    e = setting.EXAMPLES["4.3"]
    p = prediction.Predictor(e, setting.experiment(e, 500, np.random.default_rng(4)))
    found = prediction.derivatives(p.known, prediction.theta(e))  # a1, d1, d2, g1
    s, k = p.signals, np.arange(3, 500)
    by_d1 = e.slope(s.z[k]) * s.u[k - 1] + e.g * e.slope(s.z[k - 1]) * s.u[k - 2]
    by_hand = np.column_stack([s.y[k - 1], by_d1, s.w[k - 1]])
    np.testing.assert_allclose(found[:, [0, 1, 3]], by_hand, atol=1e-9)  # step 1e-4, fourth order


def test_the_prediction_of_a_fit_is_that_of_the_plain_one():
    e = setting.EXAMPLES["4.3"]
    s = setting.experiment(e, e.samples, np.random.default_rng(5))
    fit = fit_lft((s.u, s.y), structure(e), start=true_start(e))
    plain = prediction.Predictor(e, s).spline(
        np.array([-fit.a[1], *fit.d, fit.g[1]]), np.asarray(fit.map.coefficients)
    )
    # The knots are set by the range of z in the rows of the fit, which are those of the plain one, too.
    np.testing.assert_allclose(plain, s.y[3:] - fit.residual, atol=1e-9)


# Gates of the examples ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def example_studies():
    studies = {case: study(ExampleRun(case), case) for case in setting.EXAMPLES}
    return studies | {chapter4.FEWER_CASE: study(ExampleRun("4.2", 150), chapter4.FEWER_CASE)}


@pytest.fixture(scope="module")
def example_numbers(example_studies):
    numbers = chapter4.setting_numbers()
    for case in setting.EXAMPLES:
        numbers |= chapter4.example_numbers(case, example_studies[case])
    return numbers


def gates_of(case, found, numbers):
    one = setting.EXAMPLES[case]
    numbers = numbers | chapter4.example_numbers(case, found)
    return [
        *checks.estimate_gates(case, entry(found, one.true), numbers),
        *checks.search_gates(case, numbers),
    ]


@pytest.mark.parametrize("case", list(setting.EXAMPLES))
def test_gates_of_an_example_are_green(case, example_studies, example_numbers):
    assert red(gates_of(case, example_studies[case], example_numbers)) == set()


def test_gates_of_the_vaf_are_green(example_numbers):
    assert red(checks.vaf_gates(example_numbers)) == set()


@dataclass(frozen=True)
class Idle(ExampleRun):
    """Stops before it has begun."""

    def identify(self, data, form):
        return fit_lft(data, form, start=initial_estimate(data, form), max_evaluations=1)


@dataclass(frozen=True)
class NoConstraint(ExampleRun):
    """Forgets that d has the length 1: returns it as long as Table 4.2 has it."""

    def __call__(self, rng):
        found = super().__call__(rng)
        return found | {f"d{i}": 0.9946 * found[f"d{i}"] for i in (1, 2, 3)}


@dataclass(frozen=True)
class Overconfident(ExampleRun):
    """Covers half as often as it says."""

    def __call__(self, rng):
        found = super().__call__(rng)
        return found | {name: value * (rng.random() < 0.5) for name, value in found.items() if "cov" in name}


@dataclass(frozen=True)
class FewRows(ExampleRun):
    """Uses a sixth of the rows."""

    def identify(self, data, form):
        n = data[0].size // 6
        return super().identify((data[0][:n], data[1][:n]), form)


@pytest.mark.parametrize(
    ("task", "expected"),
    [
        (Idle("4.3"), {"converged/4.3", "reached/4.3"}),
        (NoConstraint("4.2"), {"bias/4.2/d1"}),
        (Overconfident("4.4"), {"coverage/4.4/a1", "coverage/4.4/g1"}),
        (FewRows("4.2"), {"efficiency/4.2/d1", "efficiency/4.2/d3"}),
    ],
)
def test_a_broken_estimator_turns_its_gate_red(task, expected, example_numbers):
    found = study(task, task.case, 25)
    assert expected <= red(gates_of(task.case, found, example_numbers))


def test_a_vaf_of_the_wrong_kind_is_red(example_studies, example_numbers):
    """Calls the free run a prediction, and the other way round."""
    other = {"vaf_one_step": "vaf_free_run", "vaf_free_run": "vaf_one_step"}
    for case, expected in (
        ("4.3", {"which-vaf/4.3", "vaf-loss/4.3/free_run"}),
        ("4.4", {"which-vaf/4.4"}),
    ):
        found = example_studies[case]
        swapped = SimpleNamespace(column=lambda name, found=found: found.column(other.get(name, name)))
        numbers = example_numbers | chapter4.example_numbers(case, swapped)
        assert expected <= red(checks.vaf_gates(numbers))
    numbers = example_numbers | {"4.4/score/vaf_free_run": 2.4}
    assert red(checks.vaf_gates(numbers)) == {"which-vaf/4.4/free-run"}


def test_claims_hold_and_a_wrong_one_is_seen(example_studies, example_numbers):
    numbers = example_numbers
    claims = [claim for claim in read(pepona.claims_file) if claim.id.startswith("4")]
    assert [claim.id for claim in claims if not judged(claim, example_studies, numbers).passed] == []
    by_id = {claim.id: claim for claim in claims}
    for name, printed in (("4.3/final/g1", 0.5078), ("4.3/vaf", 98.04), ("4.2/final/d2", 0.2483)):
        assert not judged(replace(by_id[name], printed=printed), example_studies, numbers).passed
    nowhere = replace(by_id["4.3/vaf"], number="4.3/nothing")
    with pytest.raises(UsageError, match="is no column of a study"):
        judged(nowhere, example_studies, numbers)


def test_a_number_that_is_missing_passes_no_claim():
    claim = Claim("x", "nowhere", 1.0, "x", "1", "not replicated", {"type": "exact"})
    assert not judged(claim, {}, {"x": None}).passed


# Gates of the signs ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sign_numbers():
    return {
        name: value
        for case in chapter4.READ_ANEW
        for name, value in chapter4.reading_numbers(
            case, study(ReadingRun(case), f"{case}/signs", 20)
        ).items()
    }


def test_gates_of_the_signs(sign_numbers):
    assert red(checks.reading_gates(sign_numbers)) == set()
    turned = {
        name.replace("+a+g", "x").replace("+a-g", "+a+g").replace("x", "+a-g"): value
        for name, value in sign_numbers.items()
    }
    expected = {f"signs/4.4/{name}" for name in ("as-printed", "corrected", "stable/+a+g", "stable/+a-g")}
    assert red(checks.reading_gates(turned)) == expected
    mirrored = {name.replace("-a-g", "x").replace("+a-g", "-a-g").replace("x", "+a-g"): value
                for name, value in sign_numbers.items()}  # fmt: skip
    assert {"signs/4.3/as-printed", "signs/4.4/other-stable"} <= red(checks.reading_gates(mirrored))


def test_readings_turn_signs_only():
    found = readings("4.4")
    assert {(one.a, one.g) for one in found.values()} == {
        (s * 0.4, t * 0.5) for s in (1, -1) for t in (1, -1)
    }
    assert (found["+a-g"].a, found["+a-g"].g) == (0.4, -0.5)


# Gates of theorems and statements -------------------------------------------------------------------


def theory_of(case, runs=4):
    return chapter4.theory_medians(case, study(TheoryRun(case), f"{case}/theory", runs))


@pytest.fixture(scope="module")
def theory():
    return {case: theory_of(case) for case in setting.EXAMPLES}


@pytest.mark.parametrize("case", list(setting.EXAMPLES))
def test_gates_of_the_theorems_are_green(case, theory):
    assert red(checks.theory_gates(case, theory[case])) == set()


def test_a_search_that_stops_early_breaks_theorem_1(monkeypatch):
    early = partial(chapter4_theory.compare_problems, max_evaluations=1)
    monkeypatch.setattr(chapter4_theory, "compare_problems", early)
    assert "theorem-4.1/4.3/gradient" in red(checks.theory_gates("4.3", theory_of("4.3", 2)))


def test_a_basis_of_another_space_is_red(monkeypatch):
    def quintic(z, knots, *, degree=3):
        powers = np.abs(np.asarray(z)[:, np.newaxis] - knots) ** 5
        return np.column_stack([powers, z, np.ones_like(z)])

    monkeypatch.setattr(chapter4_theory, "absolute_power_basis", quintic)
    assert {"basis/4.2/same-fit", "basis/4.2/rounding"} <= red(
        checks.theory_gates("4.2", theory_of("4.2", 2))
    )


def test_a_repaired_iteration_is_told_from_the_printed_one(monkeypatch):
    monkeypatch.setattr(chapter4_theory, "printed_search", partial(search_as_printed, until="reversed"))
    assert "table-4.1/4.3/never-ends" in red(checks.theory_gates("4.3", theory_of("4.3", 2)))


def test_the_wrong_order_of_conditions_and_another_minimum_are_red(theory):
    numbers = dict(theory["4.4"])
    prefix = "4.4/theory/"
    numbers[f"{prefix}joint_cost_off_worst"] = 1e-6
    numbers[f"{prefix}condition/ratio_worst"] = 1 / numbers[f"{prefix}condition/ratio_worst"]
    numbers[f"{prefix}basis/thesis"], numbers[f"{prefix}basis/bspline"] = (
        numbers[f"{prefix}basis/bspline"], numbers[f"{prefix}basis/thesis"],
    )  # fmt: skip
    assert red(checks.theory_gates("4.4", numbers)) == {
        "theorem-4.1/4.4/cost", "theorem-4.2/4.4", "basis/4.4/condition",
    }  # fmt: skip


@pytest.fixture(scope="module")
def statement_numbers():
    return {
        **theory_numbers(),
        "4.3/theory/printed/excess_worst": 0.05,
        "4.4/theory/printed/worst-rise_worst": 2.0,
    }


def test_gates_of_statements_are_green(statement_numbers):
    assert red(checks.statement_gates(statement_numbers)) == set()


def test_a_constant_that_stands_once_changes_the_rank(statement_numbers, monkeypatch):
    once = partial(chapter4_theory.lemma_columns, once=True)
    monkeypatch.setattr(chapter4_theory, "lemma_columns", once)
    broken = statement_numbers | chapter4_theory.lemma_numbers()
    assert red(checks.statement_gates(broken)) == {"lemma-4.1/deficit/n_g=1", "lemma-4.1/deficit/n_g=2"}


def test_a_map_without_its_line_hides_nothing(statement_numbers, monkeypatch):
    def without_line(z, knots, **keywords):
        return np.cos(np.outer(z, np.arange(1, 16)))

    monkeypatch.setattr(chapter4_theory, "spline_basis", without_line)
    broken = statement_numbers | chapter4_theory.overlap_numbers()
    assert red(checks.statement_gates(broken)) == {"overlap/n_b=1", "overlap/n_b=2"}


@pytest.mark.parametrize(
    ("number", "value", "gate"),
    [
        ("example-4.1/shifted", 0.9, "example-4.1"),
        ("undetermined/sign-of-d", 1e-3, "undetermined/sign-of-d"),
        ("undetermined/offset-deficit", 0.0, "undetermined/offset"),
        ("initialisation/shared-lags", 0.7, "initialisation/shared-lags"),
        ("4.3/theory/printed/excess_worst", 1e-6, "table-4.1/excess"),
        ("4.4/theory/printed/worst-rise_worst", 1.0, "table-4.1/uphill"),
    ],
)
def test_a_statement_that_fails_is_red(statement_numbers, number, value, gate):
    assert red(checks.statement_gates(statement_numbers | {number: value})) == {gate}


# Consistency ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ignorant(HammersteinRun):
    """Takes n_g = 0 for granted: its map and a1 stay off however many samples there are."""

    def __call__(self, rng):
        other = HammersteinRun(0, self.samples)
        return {**other.__class__.__call__(_Same(0, self.samples), rng), "g1": 0.0}


@dataclass(frozen=True)
class _Same(HammersteinRun):
    def experiment(self, rng):
        return HammersteinRun(1, self.samples).experiment(rng)


def consistency_of(kinds, runs=12):
    studies = {
        chapter4.hammerstein_case(n_g, n): study(kinds[n_g](n_g, n), chapter4.hammerstein_case(n_g, n), runs)
        for n_g in (0, 1)
        for n in SIZES
    }
    return chapter4.consistency_numbers(studies)


def test_consistency_gates():
    numbers = consistency_of((HammersteinRun, HammersteinRun))
    assert red(checks.consistency_gates(numbers, [12] * len(SIZES))) == set()
    numbers = consistency_of((HammersteinRun, Ignorant), 10)
    expected = {f"hammerstein/n_g=1/{name}" for name in ("a1", "g1", "map")}
    assert red(checks.consistency_gates(numbers, [10] * len(SIZES))) == expected


# Errata, and the printed iteration ------------------------------------------------------------------


def test_errata_gates_tell_print_from_correction():
    found = errata4()
    assert red(erratum_gates(found)) == set()
    for one in found:
        swapped = replace(one, printed_error=one.corrected_error, corrected_error=one.printed_error)
        assert red(erratum_gates([swapped])) == {f"erratum/{one.id}/printed", f"erratum/{one.id}/corrected"}


def test_the_printed_iteration_step_by_step():
    """One step of Table 4.1 in Example 4.4, where only g1 is searched, by plain algebra."""
    e = setting.EXAMPLES["4.4"]
    s = setting.experiment(e, e.samples, np.random.default_rng(6))
    form = structure(e)
    course = printed_search((s.u, s.y), form, start=([1.0], [1.0, 0.0]))
    p = prediction.Predictor(e, s)
    phi = p.basis(np.empty(0))
    late = np.vstack([phi[:1], phi[:-1]])
    linear = np.column_stack([s.y, s.u])
    rows = np.column_stack([np.vstack([linear[:1], linear[:-1]]), phi])[3:]
    theta = np.linalg.lstsq(rows, p.measured, rcond=None)[0]
    residual = p.measured - rows @ theta
    moved = late[3:] @ theta[2:]
    js = moved - rows @ np.linalg.lstsq(rows, moved, rcond=None)[0]  # (4.31)
    step = js @ residual / (js @ js + 1.0)  # delta = 1
    # The length of d is free in the table but does nothing here: the knots move with it.
    assert course.steps[0][-1] == pytest.approx(step, rel=1e-6)
    assert course.costs[0] == pytest.approx(residual @ residual / (2 * residual.size), rel=1e-9)


# Real records ---------------------------------------------------------------------------------------


def test_a_number_of_a_record_is_null_with_a_note(monkeypatch, tmp_path):
    quick = records.record_result(SimpleNamespace(with_records=False))
    assert quick.numbers == {records.NUMBER: None}
    assert "--with-records" in quick.notes[records.NUMBER]
    monkeypatch.setenv("SYSID_DATA", str(tmp_path))
    monkeypatch.setattr("sysid.data.registry.cache_folder", lambda: tmp_path)
    missing = records.record_result(SimpleNamespace(with_records=True))
    assert missing.numbers == {records.NUMBER: None}
    assert "not at hand" in missing.notes[records.NUMBER]
