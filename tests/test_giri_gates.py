"""Every gate of Giri's paper goes red when what it guards is broken, and is green when it is not."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from replications.giri import (
    checks,
    convergence,
    disturbance,
    errata,
    excitation,
    identifiability,
    precision,
    setting,
    theory,
)
from replications.giri.paper import errata_numbers, monte_carlo_entries, theta_numbers
from replications.giri.paper import paper as giri
from replications.studies import slope_std_error
from sysid import excitation as signals
from sysid.claims import judge, read
from sysid.montecarlo import Runner
from sysid.nonlinearities import Segments
from sysid.recursive import ProjectionGradient, RecursiveLeastSquares, averaged_rate, recover

RUNS = 24


def red(gates):
    return {gate.id for gate in gates if not gate.passed}


@pytest.fixture
def broken(monkeypatch):
    """Replace a name in a module of the replication."""

    def replaced(module, **names):
        for name, value in names.items():
            monkeypatch.setattr(module, name, value)
        identifiability.converged.cache_clear()

    yield replaced
    identifiability.converged.cache_clear()


# Convergence ------------------------------------------------------------------------------------------


def convergence_gates():
    return red(checks.convergence_gates(convergence.convergence_numbers()))


def test_convergence_gates_are_green():
    assert convergence_gates() == set()


def test_a_gradient_of_half_the_step_is_seen(broken):
    def half(*arguments, **keywords):
        return ProjectionGradient(*arguments, step=0.5, **keywords)

    broken(convergence, ProjectionGradient=half)
    assert {"rate-by-simulation", "periods/1e-3-to-1e-6", "periods/1e-2-to-1e-3"} <= convergence_gates()


def test_the_averaged_matrix_in_place_of_the_periods_map_is_seen(broken):
    broken(convergence, convergence_rate=averaged_rate)
    assert {"rate-by-simulation", "averaged-matrix-is-off"} <= convergence_gates()


def test_an_input_that_does_not_excite_is_seen(broken):
    a = excitation.plant_with_pole(excitation.lost_pole())
    rows = excitation.period_rows(a, setting.SEGMENTS, setting.LEVELS, even=True)
    broken(convergence, stationary_rows=lambda: rows)
    assert {"rate-below-one", "rate-by-simulation"} <= convergence_gates()


def test_a_wrong_plant_is_seen(broken):
    broken(setting, B=(1.0, -2.001))
    assert "theta-star-norm" in convergence_gates()


def test_slow_least_squares_is_seen(broken):
    def timid(*arguments, initial_covariance):
        return RecursiveLeastSquares(*arguments, initial_covariance=1e-4)

    broken(convergence, RecursiveLeastSquares=timid)
    assert convergence_gates() == {"rls-samples"}


# Proposition 4.1 --------------------------------------------------------------------------------------


def proposition_gates():
    return red(checks.proposition_gates(convergence.proposition_4_1()))


def overshooting(*arguments, **keywords):
    estimator = ProjectionGradient(*arguments, **keywords)
    estimator.step = 2.2  # set past the check
    return estimator


def test_proposition_4_1_is_green():
    assert proposition_gates() == set()


def test_a_step_that_overshoots_is_seen(broken):
    broken(convergence, ProjectionGradient=overshooting)
    expected = {f"proposition-4.1/excited/{name}" for name in ("growth", "increments", "last_increment")}
    expected |= {"proposition-4.1/excited/posterior_errors", "proposition-4.1/not-excited/growth"}
    assert expected <= proposition_gates()


def test_an_estimate_that_is_right_without_excitation_is_suspicious(broken):
    def knowing(*arguments, **keywords):
        return ProjectionGradient(*arguments, start=setting.theta_star(), **keywords)

    broken(convergence, ProjectionGradient=knowing)
    assert "proposition-4.1/not-excited/error" in proposition_gates()


# Recovery and identifiability -------------------------------------------------------------------------


def recovery_gates():
    return red(checks.recovery_gates(identifiability.identifiability_numbers()))


def test_recovery_gates_are_green(broken):
    assert recovery_gates() == set()


def test_the_printed_normalisation_is_seen(broken):
    broken(identifiability, recover=lambda *a, **k: recover(*a, **{**k, "normalisation": "unit-norm"}))
    assert {"recovered/K1", "recovered/K2", "recovered/H2", "recovered/b2"} <= recovery_gates()


def test_an_unfinished_run_is_seen(broken):
    broken(identifiability, PERIODS=100)
    assert {f"recovered/{name}" for name in setting.PARAMETERS} <= recovery_gates()


@pytest.mark.parametrize(
    ("other", "gate"),
    [(Segments(1.0, 2.0, 1.0, -2.0, 1.1, -2.0), "identifiability/levels"),
     (setting.SEGMENTS, "identifiability/inside")],
)  # fmt: skip
def test_maps_that_are_no_proof_are_seen(broken, other, gate):
    broken(identifiability, OTHER=other)
    assert recovery_gates() == {gate}


# Excitation -------------------------------------------------------------------------------------------


def excitation_gates():
    numbers = excitation.excitation_numbers()
    numbers["confirmed/Proposition 5.1, random plants"] = errata.excited_share()
    return red(checks.excitation_gates(numbers))


def test_excitation_gates_are_green():
    assert excitation_gates() == set()


def test_even_impulses_in_place_of_uneven_ones_are_seen(broken):
    def even(levels, order, periods=1, *, even=False):
        return signals.impulse_levels(levels, order, periods, even=True)

    broken(excitation, impulse_levels=even)
    assert "excitation/hidden-pole/rank" in excitation_gates()


def test_uneven_impulses_in_place_of_even_ones_are_seen(broken):
    def uneven(levels, order, periods=1, *, even=False):
        return signals.impulse_levels(levels, order, periods)

    broken(excitation, impulse_levels=uneven)
    expected = {"excitation/hidden-pole/even/rank", "excitation/hidden-pole/even/rate"}
    assert excitation_gates() == expected


def test_an_input_without_a_level_is_seen(broken):
    def poor(levels, order):
        u = signals.impulse_levels(levels, order)
        return np.where(u == levels[1], 0.0, u)

    broken(errata, impulse_levels=poor)
    assert "excitation/random-plants" in excitation_gates()


def test_a_counter_example_that_is_none_is_seen(broken):
    broken(excitation, counter_example=lambda: setting.SEGMENTS)
    assert {"excitation/zero-at-V1/rank", "excitation/zero-at-V1/rate"} <= excitation_gates()


# Disturbances -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class HalfStep(disturbance.DisturbedRun):
    def estimator(self):
        estimator = super().estimator()
        estimator.step = 0.5
        return estimator


@dataclass(frozen=True)
class WrongStart(disturbance.DisturbedRun):
    """An algorithm that has not settled: its error does not fall with the disturbance."""

    def estimator(self):
        start = setting.theta_star() + 1.0
        return ProjectionGradient(setting.ORDER, setting.LEVELS, start=start)


def disturbance_gates(task, runs=RUNS):
    study = Runner(jobs=1).run(f"disturbance/{task.kind}", task, runs, seed=4)
    numbers = disturbance.ratio_numbers(task.kind, study) | THEORY
    return red(checks.disturbance_gates(task.kind, numbers))


THEORY = theory.theory_numbers()


@pytest.mark.parametrize("kind", disturbance.KINDS)
def test_disturbance_gates_are_green(kind):
    runs = RUNS if kind in disturbance.RANDOM_KINDS else 10
    assert disturbance_gates(disturbance.DisturbedRun(kind), runs) == set()


@pytest.mark.parametrize("kind", ["gaussian", "uniform", "constant", "alternating"])
def test_half_the_step_is_seen_in_the_ratio(kind):
    assert f"noise-ratio/{kind}" in disturbance_gates(HalfStep(kind, periods=600), 12)


@pytest.mark.parametrize("kind", ["gaussian", "sinusoidal"])
def test_an_error_that_does_not_scale_is_seen(kind):
    expected = {f"noise-slope/{kind}", f"proposition-4.1/increment_ratio/{kind}"}
    expected |= {f"proposition-4.1/posterior_ratio/{kind}"}
    assert expected <= disturbance_gates(WrongStart(kind, periods=100), 3)


# Precision --------------------------------------------------------------------------------------------


class Swapped(precision.NoisyRun):
    def __call__(self, rng):
        values = dict(super().__call__(rng))
        for method in ("structured", "least-squares"):
            first, second = f"{method}/K1", f"{method}/K2"
            values[first], values[second] = values[second], values[first]
        return values


class Wasteful(precision.NoisyRun):
    """An estimator that throws four fifths of the data away."""

    def identify(self, u, y):
        n = u.size // 5
        return super().identify(u[:n], y[:n])


class Stuck(precision.NoisyRun):
    """Estimates that more data do not improve."""

    def __call__(self, rng):
        return {name: value + 0.02 * rng.standard_normal() for name, value in super().__call__(rng).items()}


class Flattered(precision.NoisyRun):
    """The printed algorithm credited with the best estimate; noise that leaves least squares unbiased."""

    def experiment(self, rng):
        return precision.NoisyRun("equation", self.periods).experiment(rng)

    def identify(self, u, y):
        found = super().identify(u, y)
        return found | {"gradient": found["structured"]}


def precision_gates(kind, runs):
    studies = {}
    for noise in precision.NOISES:
        for n in precision.SIZES:
            name = precision.case_name(noise, n)
            studies[name] = Runner(jobs=1).run(name, kind(noise, n), runs, seed=8)
    monte_carlo = monte_carlo_entries(studies)
    numbers = precision.slope_numbers(monte_carlo)
    numbers["slope_std_error"] = slope_std_error(precision.SIZES, [runs] * len(precision.SIZES))
    return red(checks.precision_gates(monte_carlo, numbers))


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        (precision.NoisyRun, set()),
        (Swapped, {"bias/equation/structured/K1", "bias/equation/least-squares/K2"}),
        (Wasteful, {"efficiency/equation/structured/a1", "efficiency/equation/structured/H1"}),
        (Stuck, {f"slope/equation/structured/{name}" for name in ("a1", "a2", "b2")}),
        (Flattered, {"inefficient/equation/gradient/a1", "biased/output/least-squares/a1"}),
    ],
)
def test_precision_gates(kind, expected):
    # What is broken shows in few runs.
    found = precision_gates(kind, 18 if expected else RUNS)
    assert expected <= found
    if not expected:
        assert found == set()


# Errata, claims, protocol -----------------------------------------------------------------------------


def test_errata_gates_tell_print_from_correction():
    found = errata.errata()
    assert red(checks.errata_gates(errata_numbers(found), found)) == set()
    for erratum in found:
        swapped = replace(
            erratum, printed_error=erratum.corrected_error, corrected_error=erratum.printed_error
        )
        expected = {f"erratum/{erratum.id}/printed", f"erratum/{erratum.id}/corrected"}
        assert red(checks.errata_gates({}, [swapped])) == expected
    assert red(checks.errata_gates({"confirmed/(3.18a)": 1e-3}, [])) == {"confirmed/(3.18a)"}


def test_a_wrong_rule_is_no_longer_confirmed(broken):
    def wrong(snapshot, structure="general", normalisation="first"):
        return recover(replace(snapshot, theta=snapshot.theta * 1.001), structure, normalisation)

    broken(errata, recover=wrong)
    gates = checks.errata_gates({f"confirmed/{k}": v for k, v in errata.confirmed().items()}, [])
    assert {"confirmed/(3.18b)", "confirmed/(3.18c)", "confirmed/(3.16), (3.17)"} <= red(gates)


def numbers_of_claims():
    return {
        **setting.numbers(),
        **theta_numbers(),
        **identifiability.identifiability_numbers(),
        **excitation.excitation_numbers(),
    }


def test_claims_have_their_verdicts_and_a_wrong_one_is_red():
    numbers = numbers_of_claims()
    claims = [judge(claim, numbers[claim.number]) for claim in read(giri.claims_file)]
    assert [claim.id for claim in claims if not claim.passed] == []
    printed = {claim.id: claim for claim in claims}
    assert printed["figure-3b/D1"].verdict == printed["theta-star/mu11"].verdict == "not replicated"
    wrong = replace(printed["theta-star/mu21"], printed=-3.35)
    judged = [judge(wrong, numbers[wrong.number])]
    healthy, ill = {"a": SimpleNamespace(failed=0)}, {"a": SimpleNamespace(failed=2)}
    assert red(checks.protocol_gates(healthy, claims)) == set()
    assert red(checks.protocol_gates(healthy, judged)) == {"claims"}
    assert red(checks.protocol_gates(ill, claims)) == {"failed-runs"}
