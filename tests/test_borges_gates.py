"""Every gate of Borges's paper goes red when what it guards is broken, and is green when it is not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from replications.borges import checks, derivatives, errata, flops, peer, report, setting, study
from replications.borges.paper import paper as borges
from replications.borges.paper import study_numbers
from replications.errata import erratum_gates
from sysid.claims import judge, read
from sysid.local_linear import gradients
from sysid.montecarlo import Runner


def red(gates):
    return {gate.id for gate in gates if not gate.passed}


@pytest.fixture(scope="module")
def numbers():
    return {
        **setting.numbers(),
        **derivatives.derivative_numbers(),
        **flops.flop_numbers(),
        **errata.condition_numbers(),
    }


# Derivatives and redundancy ---------------------------------------------------------------------------


def test_derivative_gates_are_green(numbers):
    assert red(checks.derivative_gates(numbers)) == set()
    assert red(checks.redundancy_gates(numbers)) == set()


def test_the_printed_jacobian_in_place_of_the_exact_one_is_seen(monkeypatch):
    def wrong(course, elimination, **options):
        found = elimination.theta.reshape(course.sizes.n_states, -1)
        return elimination.rotate(gradients.approach_2b(course, found))

    monkeypatch.setattr(derivatives.g, "exact", wrong)
    found = derivatives.derivative_numbers()
    assert red(checks.derivative_gates(found)) == {"jacobian/exact"}
    assert {"projection/exact", "null-space/q1"} <= red(checks.redundancy_gates(found))


def test_a_gradient_without_its_factor_is_seen(monkeypatch):
    def halved(course, elimination):
        r = elimination.residual.reshape(-1, course.sizes.n_outputs)
        G = elimination.theta.reshape(course.sizes.n_states, -1)
        return -gradients.pull_back(course, gradients.fly(course, G), r).by_eta

    monkeypatch.setattr(derivatives.g, "cost_gradient", halved)
    assert red(checks.derivative_gates(derivatives.derivative_numbers())) == {"gradient/adjoint"}


def test_a_point_where_differences_mean_nothing_is_seen(monkeypatch):
    def overlapping(q=1):
        problem, eta = real(q)
        A, C, widths, centres = problem.sizes.unpack(eta)
        return problem, problem.sizes.pack(A, C, 0.3 * widths, centres)

    real = derivatives.point
    monkeypatch.setattr(derivatives, "point", overlapping)
    assert "condition-of-phi" in red(checks.derivative_gates(derivatives.derivative_numbers()))


def test_numbers_out_of_place_are_red(numbers):
    for key, gate in {
        "jacobian_error/2b": "jacobian/2b",
        "jacobian_error/kaufman": "jacobian/kaufman",
        "projection/step_difference/2b": "projection/2b",
        "redundancy/q2/null-space": "null-space/q2",
    }.items():
        wrong = {**numbers, key: 0.0}
        assert gate in red([*checks.derivative_gates(wrong), *checks.redundancy_gates(wrong)])


# Algebra ----------------------------------------------------------------------------------------------


def test_algebra_gates_are_green(numbers):
    assert red(checks.algebra_gates(numbers)) == set()


def test_a_count_with_m_in_place_of_m_plus_one_is_seen(monkeypatch):
    def wrong(sizes, n_samples):
        return {**right(sizes, n_samples), "phi": 24 * n_samples * 30.0}

    right = flops.ours
    monkeypatch.setattr(flops, "ours", wrong)
    found = {**flops.flop_numbers(), **errata.condition_numbers(), **setting.numbers()}
    assert red(checks.algebra_gates(found)) == {"operations/phi"}


def test_normal_equations_that_lose_nothing_are_suspicious(numbers, monkeypatch):
    monkeypatch.setattr(errata, "cho_solve", lambda factor, right: factor[1])
    monkeypatch.setattr(errata, "cho_factor", lambda matrix: (None, EXACT))
    found = {**numbers, **errata.condition_numbers()}
    assert red(checks.algebra_gates(found)) == {"normal-equations"}


EXACT = np.random.default_rng(2).standard_normal(36)


def test_tame_inputs_are_no_proof_of_divergence(numbers, monkeypatch):
    monkeypatch.setattr(setting, "narendra", lambda u: np.zeros_like(u))
    found = {**numbers, "setting/diverging_share": setting.diverging_share()}
    assert red(checks.algebra_gates(found)) == {"diverging-inputs"}


# Studies ----------------------------------------------------------------------------------------------


class Blind:
    """A study in which a score or a count of iterations is the same in all runs."""

    def __init__(self, real):
        self.real, self.columns = real, real.columns

    def column(self, name):
        if "/vaf/" in name:
            return np.array([95.0])
        return np.array([12.0 if name.startswith("kaufman/") else 10.0])


def test_study_gates():
    studies = {}
    for case, (task, _) in borges.plan(6).items():
        # Without noise the order of the searches counts; elsewhere the scores of one of them.
        methods, runs = ("searches", 4) if case == "q2/noise-free" else ("sls", 2)
        studies[case] = Runner(jobs=1).run(case, replace(task, methods=methods), runs, seed=1)
    assert red(checks.study_gates(study_numbers(studies))) == set()
    blind = {case: Blind(real) for case, real in studies.items()}
    assert red(checks.study_gates(study_numbers(blind))) == {
        "q2/vaf/output-1", "q2/vaf/output-2", "q1/vaf/output-2", "linear/vaf",
        "iterations/2b-over-exact", "iterations/kaufman-over-2b",
    }  # fmt: skip


# Errata, claims, protocol -----------------------------------------------------------------------------


def test_errata_gates_tell_print_from_correction():
    found = errata.errata()
    assert red(erratum_gates(found)) == set()
    for erratum in found:
        swapped = replace(
            erratum, printed_error=erratum.corrected_error, corrected_error=erratum.printed_error
        )
        expected = {f"erratum/{erratum.id}/printed", f"erratum/{erratum.id}/corrected"}
        assert red(erratum_gates([swapped])) == expected


def test_claims_have_their_verdicts_and_a_wrong_one_is_red(numbers):
    claims = [judge(claim, numbers[claim.number]) for claim in read(borges.claims_file)]
    assert [claim.id for claim in claims if not claim.passed] == []
    printed = {claim.id: claim for claim in claims}
    assert printed["setting/eta/q2"].verdict == "not replicated"
    wrong = replace(printed["setting/theta"], printed=24)
    judged = [judge(wrong, numbers[wrong.number])]
    healthy, ill = {"a": SimpleNamespace(failed=0)}, {"a": SimpleNamespace(failed=1)}
    assert red(checks.protocol_gates(healthy, claims)) == set()
    assert red(checks.protocol_gates(healthy, judged)) == {"claims"}
    assert red(checks.protocol_gates(ill, claims)) == {"failed-runs"}


def test_system_and_start_are_the_printed_ones():
    u = np.random.default_rng(0).uniform(-1, 1, (6, 2))
    y = setting.narendra(u)
    bottom = 2 + y[3, 1] ** 2
    assert np.isclose(y[4, 0], (0.8 * y[3, 0] ** 3 + u[3, 0] ** 2 * u[3, 1]) / bottom)
    second = y[3, 0] + y[3, 0] * y[3, 1] + (u[2, 0] - 0.5) * (u[3, 1] + 0.8)
    assert np.isclose(y[4, 1], second / bottom)
    rng = np.random.default_rng(1)
    data, output, clean = setting.experiment(rng, "20-dB")
    assert np.allclose((output - clean).std(axis=0) / clean.std(axis=0), 0.1, atol=0.01)
    problem = setting.problem_of(data, output, 2)
    A, _, widths, centres = problem.sizes.unpack(setting.start(problem, rng))
    assert np.abs(A - A[0]).max() == 0.0
    assert max(np.abs(widths).max(), np.abs(centres).max()) <= 1.0


def test_joint_problem_has_the_derivative_of_its_residual():
    rng = np.random.default_rng(4)
    u, y, _ = setting.experiment(rng, "20-dB", 120)
    problem = setting.problem_of(u, y, 1)
    _, eta = derivatives.point()
    point = study.Joint(problem, np.concatenate([eta, rng.standard_normal(36)]))
    jacobian, residual = point.linearise()
    assert np.isclose(residual @ residual, point.cost)
    direction = rng.standard_normal(point.values.size)
    ahead, behind = (
        study.Joint(problem, point.values + sign * 1e-6 * direction).residual() for sign in (1, -1)
    )
    slope = (ahead - behind) / 2e-6
    # The factor keeps products: with the residual, and of the slope with itself.
    assert np.isclose(np.linalg.norm(jacobian @ direction), np.linalg.norm(slope), rtol=1e-6)
    expected = slope @ point.residual()
    assert np.isclose(direction @ jacobian.T @ residual, expected, rtol=1e-5)


def test_the_peer_is_a_ratio_or_a_reason(monkeypatch):
    monkeypatch.setattr(peer, "find_spec", lambda name: None)
    assert peer.times() == {peer.NAME: None}
    for ratio, sentence in ((None, f"{peer.MISSING}."), (20.0, "takes 20 times as long as ours")):
        results = {"papers": {"borges": {"timings": {peer.NAME: ratio}}}}
        assert sentence in report.peer_sentence(results).replace("20.0", "20")
