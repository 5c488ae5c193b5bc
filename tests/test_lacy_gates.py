"""Every gate of the paper of Lacy, Erwin and Bernstein goes red when what it guards is broken."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from replications.errata import erratum_gates
from replications.lacy import checks, exactness, setting, step_tests
from replications.lacy import paper as lacy
from replications.lacy.errata import errata, fast_form_errors
from replications.lacy.examples import ConsistencyRun, ExampleRun
from replications.lacy.paper import (
    CONSISTENT,
    SIZES,
    bound_std,
    consistency_numbers,
    exactness_numbers,
    example_numbers,
    noise_free_numbers,
    setting_numbers,
    step_test_numbers,
)
from replications.studies import entry, protocol_gates
from sysid.claims import judge, read
from sysid.montecarlo import Runner
from sysid.nonlinearities import DEAD_ZONE, SIGN, PiecewiseAffine, Quantiser, sine
from sysid.wiener import Criterion, identify_wiener, kernels, solvers

RUNS = 20
TRUE = dict(zip(setting.PARAMETERS, setting.TRUE.tolist(), strict=True))


def red(gates):
    return {gate.id for gate in gates if not gate.passed}


def study(task, runs=RUNS, seed=3, case=None):
    return Runner(jobs=1).run(case or task.case, task, runs, seed=seed)


@pytest.mark.parametrize("case", setting.EXAMPLES)
def test_gates_of_an_example_are_green(case):
    assert red(checks.example_gates(case, example_numbers(case, study(ExampleRun(case))))) == set()


@dataclass(frozen=True)
class FirstBranch(ExampleRun):
    """Takes arcsin for the inverse of the sine."""

    def identify(self, data):
        fit = super().identify(data)
        y = np.arcsin(np.clip(data.z, -1, 1))
        theta = identify_wiener(data.u, data.z, sine((-np.pi / 2, np.pi / 2)), 2).theta
        candidate = solvers.Candidate(y, theta, 0.0, 0.0, True)
        return replace(fit, y=y, theta=theta, candidates=(candidate,))


@dataclass(frozen=True)
class WrongMap(ExampleRun):
    """Believes in another width of the dead zone, or another step of the quantiser."""

    def identify(self, data):
        known = PiecewiseAffine.of(DEAD_ZONE, 3.0) if self.case == "dead-zone" else Quantiser(2.0)
        wrong = identify_wiener(data.u, data.z, known, 2)
        right = setting.nonlinearity(self.case).preimage(data.z)
        return replace(wrong, preimage=right)


@dataclass(frozen=True)
class Constant(ExampleRun):
    """Takes the middle of the preimage, here the sign itself, for y."""

    def identify(self, data):
        fit = super().identify(data)
        theta = identify_wiener(data.u, data.z, PiecewiseAffine("line", [-9, 9], [1.0], [0.0]), 2).theta
        return replace(fit, theta=theta)


@dataclass(frozen=True)
class NoisyOutput(ExampleRun):
    """Adds noise behind the nonlinearity."""

    def experiment(self, rng):
        data = super().experiment(rng)
        return replace(data, z=data.z + 0.3 * rng.standard_normal(data.z.size))


@dataclass(frozen=True)
class LazyLikelihood(ExampleRun):
    """A maximum likelihood that returns the naive fit."""

    def estimates(self, data):
        fit, found = super().estimates(data)
        return fit, {**found, "ml": found["naive"]}


@pytest.mark.parametrize(
    ("task", "expected"),
    [
        (FirstBranch("sine"), {"median-of-20/sine/paper/rms_db", "naive-is-worse/sine"}),
        (WrongMap("dead-zone"), {"median-of-20/dead-zone/paper/relative_h2", "inside-preimage/dead-zone"}),
        (WrongMap("quantisation"), {"inside-preimage/quantisation"}),
        (Constant("sign"), {"median-of-20/sign/paper/rms_db", "naive-is-worse/sign"}),
        (NoisyOutput("sine"), {"moved/sine"}),
        (LazyLikelihood("dead-zone"), {"ml-near-bound/dead-zone", "median-of-20/dead-zone/ml/rms_deg"}),
        (LazyLikelihood("quantisation"), {"median-of-20/quantisation/ml/rms_db"}),
    ],
)
def test_a_broken_estimator_turns_its_gate_red(task, expected):
    assert expected <= red(checks.example_gates(task.case, example_numbers(task.case, study(task))))


@pytest.mark.parametrize("case", setting.EXAMPLES)
def test_gates_without_noise(case):
    numbers = noise_free_numbers(case, study(ExampleRun(case, noisy=False), 5))
    assert red(checks.noise_free_gates(case, numbers)) == set()


def test_noise_turns_the_gates_without_noise_red():
    numbers = noise_free_numbers("dead-zone", study(ExampleRun("dead-zone"), 5))
    expected = {"noise-free/dead-zone/criterion", "noise-free/dead-zone/error"}
    assert red(checks.noise_free_gates("dead-zone", numbers)) == expected


@dataclass(frozen=True)
class Biased(ExampleRun):
    """An estimate that is off by a tenth."""

    def estimates(self, data):
        fit, found = super().estimates(data)
        return fit, {**found, "ml": found["ml"] + 0.1}


def test_bias_gates():
    for task, expected in ((ExampleRun("dead-zone"), set()), (Biased("dead-zone"), {"bias/dead-zone/ml/a2"})):
        found = study(task, 40)
        gates = checks.bias_gates(entry(found, TRUE, bound_std(found), "ml/"))
        assert expected <= red(gates)
        assert bool(red(gates)) == bool(expected)


@dataclass(frozen=True)
class Swapped(ConsistencyRun):
    """Shows the inconsistent estimate as maximum likelihood, and the other way round."""

    def estimates(self, data):
        fit, found = super().estimates(data)
        return fit, {"paper": found["ml"], "ml": found["paper"], "naive": found["naive"]}


def test_consistency_gates():
    for kind, expected in (
        (ConsistencyRun, set()),
        (
            Swapped,
            {"inconsistent/dead-zone/paper/a2", "consistent/dead-zone/ml/a2", "efficiency/dead-zone/ml/a2"},
        ),
    ):
        studies = {
            f"{CONSISTENT}/n={n}": study(kind(CONSISTENT, n), 40, case=f"{CONSISTENT}/n={n}") for n in SIZES
        }
        gates = red(checks.consistency_gates(consistency_numbers(studies)))
        assert expected <= gates
        assert bool(gates) == bool(expected)
    numbers = consistency_numbers(studies)
    numbers["slope/ml/b1"] = 0.0
    assert "slope/dead-zone/ml/b1" in red(checks.consistency_gates(numbers))


@pytest.fixture(scope="module")
def exact_numbers():
    return exactness_numbers()


def test_exactness_gates(exact_numbers):
    assert red(checks.exactness_gates(exact_numbers)) == set()


def test_a_search_that_looks_at_one_branch_only_is_red(exact_numbers, monkeypatch):
    search = kernels.branch_and_bound

    def greedy(u, first, points, order, mode, bound, keep, node_limit):
        count = np.diff(first)
        middle = points[first[:-1] + count // 2]  # one candidate a sample
        return search(u, np.arange(u.size + 1), middle, order, mode, np.inf, keep, node_limit)

    monkeypatch.setattr(solvers.kernels, "branch_and_bound", greedy)
    monkeypatch.setattr(exactness, "CASES", 3)
    share = exactness.agreement_with_brute_force()
    broken = {**exact_numbers, "branch_and_bound/agrees_with_brute_force": share}
    assert red(checks.exactness_gates(broken)) == {"branch-and-bound"}


@pytest.mark.parametrize(
    ("number", "value", "gate"),
    [
        ("fast-form/gradient", 1e-6, "fast-form/gradient"),
        ("fast-form/hessian", np.nan, "fast-form/hessian"),
        ("special/square/minimisers", 1.0, "special/square"),
        ("section-4/j_theta_at_minimum", 1e-3, "section-4/j-theta"),
        ("scale/relative_shrunk_over_relative", 1e-6, "scale/relative"),
        ("scale/j_y_shrunk_over_j_y", 1.0, "scale/j-y"),
    ],
)
def test_a_wrong_derivative_or_criterion_is_red(exact_numbers, number, value, gate):
    assert red(checks.exactness_gates({**exact_numbers, number: value})) == {gate}


def test_a_gradient_that_forgets_the_filter_is_red(exact_numbers, monkeypatch):
    def forgetful(self, y):
        residual = self.eliminate(y)[3]
        return np.concatenate([np.zeros(self.order), 2 * residual])

    monkeypatch.setattr(Criterion, "gradient", forgetful)
    gradient, hessian = fast_form_errors()
    broken = {**exact_numbers, "fast-form/gradient": gradient, "fast-form/hessian": hessian}
    assert "fast-form/gradient" in red(checks.exactness_gates(broken))


@dataclass(frozen=True)
class CoarseSteps(step_tests.StepTestRun):
    """Forgets that the measured nonlinearity goes with G(1) = 1 and a dead zone: takes it for a line."""

    def __call__(self, rng):
        data = setting.experiment("dead-zone", step_tests.SAMPLES, rng, self.noisy)
        line = PiecewiseAffine("line", [-9.0, 9.0], [1.0], [0.0])
        theta = identify_wiener(data.u, data.z, line, 2, normalisation="dc-gain").theta
        found = super().__call__(np.random.default_rng(0))
        return {**found, **dict(zip(setting.PARAMETERS, theta, strict=True)), "rms_db": 6.0}


def test_step_test_gates():
    for kind, expected in (
        (step_tests.StepTestRun, set()),
        (CoarseSteps, {"step-tests/noise-free", "step-tests/median"}),
    ):
        studies = {
            "step-tests": study(kind(), 20, case="step-tests"),
            "step-tests/noise-free": study(kind(noisy=False), 5, case="step-tests/noise-free"),
        }
        numbers = {**step_test_numbers(studies), "step-tests/normalisation-error": 1e-15}
        assert red(checks.step_test_gates(numbers)) == expected
    numbers["step-tests/normalisation-error"] = 0.1
    assert "step-tests/normalisation" in red(checks.step_test_gates(numbers))


def test_errata_gates_tell_print_from_correction():
    found = errata()
    assert red(erratum_gates(found)) == set()
    for one in found:
        swapped = replace(one, printed_error=one.corrected_error, corrected_error=one.printed_error)
        assert red(erratum_gates([swapped])) == {f"erratum/{one.id}/printed", f"erratum/{one.id}/corrected"}


def test_claims_and_failed_runs(exact_numbers):
    numbers = {**setting_numbers(), **exact_numbers}
    claims = [judge(claim, numbers[claim.number]) for claim in read(lacy.claims_file)]
    assert [claim.id for claim in claims if not claim.passed] == []
    wrong = [
        judge(replace(claim, printed=0.5), numbers[claim.number])
        for claim in claims
        if claim.id == "system/numerator-1"
    ]
    healthy, ill = SimpleNamespace(failed=0), SimpleNamespace(failed=1)
    assert red(protocol_gates({"sine": healthy}, claims)) == set()
    assert red(protocol_gates({"sine": healthy}, wrong)) == {"claims"}
    assert red(protocol_gates({"sine": healthy, "sign": ill}, claims)) == {"failed-runs"}


def test_the_setting_is_that_of_the_paper():
    rng = np.random.default_rng(0)
    data = setting.experiment("sign", 60, rng)
    assert np.linalg.norm(data.y - data.y.mean()) / np.linalg.norm(data.w) == pytest.approx(10)
    np.testing.assert_array_equal(data.z, SIGN(data.y + data.w))
    shifted = data.y[2:] - 1.03 * data.y[1:-1] + 0.9048 * data.y[:-2]
    np.testing.assert_allclose(shifted, 0.445 * data.u[1:-1] + 0.4299 * data.u[:-2], atol=1e-12)
    assert np.max(np.abs(setting.experiment("sine", 20, rng).y)) < 2 * np.pi * 1.1
