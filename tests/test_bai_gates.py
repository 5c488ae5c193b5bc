"""Every gate of Bai's paper goes red when what it guards is broken, and is green when it is not."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from replications.bai import checks, example_2, setting
from replications.bai import paper as bai
from replications.bai.errata import errata
from replications.bai.example_1 import Example1, asymptotic_std, one_parameter_map
from replications.bai.paper import (
    SIZES,
    consistency_numbers,
    cost_numbers,
    entry,
    errata_numbers,
    example_2_numbers,
    size_case,
    slope_std_error,
)
from replications.bai.worked import WORKED, WorkedRun, true_parameters
from sysid.claims import judge, read
from sysid.hammerstein import correlation_method, equation_error_response, search_method
from sysid.montecarlo import Runner

RUNS = 150
CASE = "saturation"


def red(gates):
    return {gate.id for gate in gates if not gate.passed}


def case_gates(task, runs=RUNS):
    study = Runner(jobs=1).run(task.case, task, runs, seed=11)
    bound = asymptotic_std(task.case, setting.EXAMPLE_1_SAMPLES)
    return checks.case_gates(task.case, entry(study, setting.TRUE, bound), cost_numbers(study))


@dataclass(frozen=True)
class WrongMap(Example1):
    def identify(self, u, y):
        return search_method(u, y, one_parameter_map("dead-zone"), setting.ORDER, upper=setting.SEARCH_UPPER)


@dataclass(frozen=True)
class BiasedNoise(Example1):
    def experiment(self, rng):
        u, y = super().experiment(rng)
        return u, y + 0.15


@dataclass(frozen=True)
class Delayed(Example1):
    def experiment(self, rng):
        u, y = super().experiment(rng)
        return u[:-1], y[1:]


@dataclass(frozen=True)
class Transposed(Example1):
    def __call__(self, rng):
        values = dict(super().__call__(rng))
        values["alpha1"], values["alpha2"] = values["alpha2"], values["alpha1"]
        return values


@dataclass(frozen=True)
class LocalMinimum(Example1):
    """A search that stops at the wrong minimum now and then."""

    def __call__(self, rng):
        u, y = self.experiment(rng)
        fitted = search_method(u, y, one_parameter_map(self.case), 2, lower=1.5, upper=setting.SEARCH_UPPER)
        return {**super().__call__(rng), "j": fitted.mean_square}


@dataclass(frozen=True)
class Inefficient(Example1):
    """An estimator that throws half of the data away."""

    def identify(self, u, y):
        return super().identify(u[: u.size // 2], y[: u.size // 2])


@pytest.mark.parametrize("case", setting.CASES)
def test_gates_of_example_1_are_green(case):
    assert red(case_gates(Example1(case))) == set()


@pytest.mark.parametrize(
    ("broken", "expected"),
    [
        (WrongMap, "bias/saturation/a"),
        (BiasedNoise, "mean-cost/saturation"),
        (Delayed, "efficiency/saturation/beta1"),
        (Transposed, "bias/saturation/alpha1"),
        (LocalMinimum, "mean-cost/saturation"),
        (Inefficient, "efficiency/saturation/a"),
    ],
)
def test_a_broken_estimator_turns_its_gate_red(broken, expected):
    assert expected in red(case_gates(broken(CASE)))


class Stuck(Example1):
    """An inconsistent estimator: its threshold has an error that does not fall with N."""

    def __call__(self, rng):
        return {**super().__call__(rng), "a": 1.05 + 0.02 * rng.standard_normal()}


@pytest.mark.parametrize("case", ["preload", "relay"])
def test_consistency_gates(case):
    runner = Runner(jobs=1)
    for task, expected in ((Example1(case), set()), (Stuck(case), {f"slope/{case}/a"})):
        studies = {}
        for n in SIZES:
            name = size_case(case, n)
            studies[name] = runner.run(name, replace(task, n_samples=n), 60, seed=3)
        numbers = {"slope_std_error": slope_std_error(SIZES, [60] * len(SIZES))}
        numbers |= consistency_numbers(case, studies)
        assert red(checks.consistency_gates(case, numbers)) == expected


class LagShifted(example_2.Example2):
    """Correlations that are one lag off."""

    def experiments(self, rng):
        shift = {}
        for inputs, records in super().experiments(rng).items():
            shift[inputs] = [(np.roll(u, 1), y) for u, y in records]
        return shift


class WrongThreshold(example_2.Example2):
    """An actuator that saturates at 1.3 where 1 is expected."""

    def experiments(self, rng):
        def response(u):
            x = one_parameter_map(CASE)(u, 1.3)
            noise = rng.uniform(-0.1, 0.1, u.size)
            return u, equation_error_response(x, setting.ALPHA, setting.BETA, noise)

        found = super().experiments(rng)
        return {inputs: [response(u) for u, _ in records] for inputs, records in found.items()}


def example_2_gates(task):
    study = Runner(jobs=1).run("example-2", task, 60, seed=5)
    monte_carlo = {
        f"example-2/{name}": entry(study, setting.TRUE, prefix=f"{name}/")
        for name in (*example_2.variants(), "separable")
    }
    monte_carlo[CASE] = {"parameters": {"a": {"q025": 0.93, "q975": 1.07}}}
    return checks.example_2_gates(study, monte_carlo, example_2_numbers(study, monte_carlo))


def test_gates_of_example_2():
    assert red(example_2_gates(example_2.Example2())) == set()
    assert "bias/example-2/separable/beta2" in red(example_2_gates(LagShifted()))
    found = red(example_2_gates(WrongThreshold()))
    assert {"bias/example-2/separable/a", "median/example-2/m4-single-shared/a"} <= found


@pytest.mark.parametrize("name", WORKED)
def test_worked_nonlinearities(name):
    study = Runner(jobs=1).run(f"worked/{name}", WorkedRun(name), 40, seed=2)
    assert red(checks.worked_gates(name, entry(study, true_parameters(name)))) == set()


def test_a_worked_nonlinearity_solved_as_printed_is_red():
    study = Runner(jobs=1).run("worked/as-printed", WorkedRun("two-sided-preload-as-printed"), 40, seed=2)
    found = checks.worked_gates("two-sided-preload", entry(study, true_parameters("two-sided-preload")))
    assert red(found) == {"bias/worked/two-sided-preload/a1", "bias/worked/two-sided-preload/a2"}


def test_errata_gates_tell_print_from_correction():
    found = errata()
    assert red(checks.errata_gates(errata_numbers(found), found)) == set()
    for erratum in found:
        swapped = replace(
            erratum, printed_error=erratum.corrected_error, corrected_error=erratum.printed_error
        )
        expected = {f"erratum/{erratum.id}/printed", f"erratum/{erratum.id}/corrected"}
        assert red(checks.errata_gates({}, [swapped])) == expected
    assert red(checks.errata_gates({"confirmed/(3.13)": 1e-3}, [])) == {"confirmed/(3.13)"}
    roots = "confirmed/(3.16) root intervals"
    assert red(checks.errata_gates({roots: 0.99}, [])) == {roots}


def test_a_wrong_printed_value_turns_the_claims_gate_red():
    claims = {claim.id: claim for claim in read(bai.claims_file)}
    study = Runner(jobs=1).run("hysteresis-relay", Example1("hysteresis-relay"), RUNS, seed=1)
    low, middle, high = study.quantile("a", [0.025, 0.5, 0.975])
    claim = claims["table-1/hysteresis-relay/a"]
    right = judge(claim, middle, (low, high))
    wrong = judge(replace(claim, printed=1.3), middle, (low, high))
    assert right.passed
    assert not wrong.passed
    healthy = SimpleNamespace(failed=0)
    ill = SimpleNamespace(failed=1)
    no_example_2 = {"example-2": healthy}
    for studies, judged, expected in (
        (no_example_2, [right], set()),
        (no_example_2, [wrong], {"claims"}),
        ({"example-2": healthy, "preload": ill}, [right], {"failed-runs"}),
    ):
        assert red(checks.protocol_gates(studies, judged)) == expected


def test_a_correlation_with_too_few_lags_is_refused():
    with pytest.raises(ValueError, match="3 lags cannot determine order 2: use at least 4"):
        correlation_method(np.ones(50), np.ones(50), 2, 3)
