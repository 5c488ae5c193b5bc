"""The work that a search is given: counted, told, and the same for any number of jobs."""

import json
import subprocess
import sys

import numpy as np
import pytest

import sysid
from sysid.cli import main
from sysid.data import make_record
from sysid.diagnosis.decide.allowance import Allowance, GivenUpError, allowance_of
from sysid.diagnosis.decide.decision import Decision
from sysid.diagnosis.decide.growth import Growth
from sysid.diagnosis.decide.noise_colour import Noise
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.decide.search import Search
from sysid.diagnosis.decide.trials import FURTHER, FURTHER_LATE, Trials
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.effects.catalogue import catalogue
from sysid.diagnosis.linear import structure as linear_structure
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.orders import decided_with_order
from sysid.diagnosis.physics import structure as physics_structure
from sysid.diagnosis.physics.evaluation import Evaluation
from sysid.diagnosis.physics.structure import PhysicsStructure
from sysid.diagnosis.ports.physics_plant import PhysicsPlant
from sysid.diagnosis.structures.rows import SEARCH_ROWS, rows_of_search
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort
from sysid.diagnosis.structures.work import Work
from sysid.physics import fit_physics, load_model
from sysid.physics.forced import COARSER, ForcedPlant
from sysid.progress import Progress
from sysid.separable.descent import Status, descend

FEW = ["quad_drag", "in_delay", "out_offset", "out_drift", "cubic_stiffness"]
START = {"m": 1.1, "c": 0.45, "k": 2.2}


def limited(n=600):
    """A body on a spring, stepped apart from the library, behind a limit that is no candidate."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(-2.0, 2.0, n // 4), 4)
    x = v = 0.0
    y = np.zeros(n)
    for k in range(n):
        y[k] = x
        for _ in range(40):
            v += 0.005 * (np.clip(u[k], -0.9, 0.6) - 0.5 * v - 2.0 * x)
            x += 0.005 * v
    y += 0.01 * np.std(y) * rng.standard_normal(n)
    return u, y, np.repeat(["est", "val", "test"], [n // 2, n // 4, n // 4])


def record():
    u, y, split = limited()
    return make_record(u, y, period=0.2, split=split)


def found(**keywords):
    return sysid.diagnose(record(), "mass-spring-damper", start=START, effects=FEW, **keywords)


def without_times(diagnosis):
    """What must not depend on the number of jobs."""
    content = diagnosis.to_json()
    return json.dumps({key: value for key, value in content.items() if key != "seconds"}, sort_keys=True)


def test_a_spent_search_decides_says_so_and_is_the_same_for_any_number_of_jobs(monkeypatch):
    monkeypatch.setattr(physics_structure, "WORK", 1.0)
    short = found()
    assert short.verdict == "unexplained"
    assert short.decision.cut_short
    assert short.to_json()["search"] == {"complete": False}
    assert "--thorough" in short.advice
    assert short.advice in short.sentences()
    assert all(trial.fit is not None or trial.name == "coloured_noise" for trial in short.decision.trials)
    both = found(jobs=2)
    assert without_times(both) == without_times(short)
    assert both.structure.work.done == short.structure.work.done > 0
    whole = found(thorough=True)
    assert whole.to_json()["search"] == {"complete": True}
    assert "--thorough" not in whole.advice
    assert whole.structure.work.done > short.structure.work.done


def test_the_command_goes_on_to_the_end_where_it_is_asked(monkeypatch, tmp_path):
    monkeypatch.setattr(physics_structure, "WORK", 1.0)
    u, y, split = limited()
    data, out = tmp_path / "record.csv", tmp_path / "found.json"
    rows = (f"{a},{b},{c}" for a, b, c in zip(u.tolist(), y.tolist(), split.tolist(), strict=True))
    data.write_text("\n".join(["u,y,set", *rows]) + "\n")
    options = [f"--param={name}={value}" for name, value in START.items()]
    command = [
        "diagnose", str(data), "--input", "u", "--output", "y", "--period", "0.2", "--split-column", "set",
        "--model", "mass-spring-damper", "--effects", "quad_drag,out_offset", "--json", str(out), *options,
    ]  # fmt: skip
    for extra, complete in (([], False), (["--thorough"], True)):
        assert main(command + extra) == 0
        assert json.loads(out.read_text())["search"]["complete"] is complete


def test_a_short_search_is_complete():
    structure = PhysicsStructure(record(), load_model("mass-spring-damper").with_parameters(START, {}))
    assert structure.work.given == physics_structure.WORK
    allowance = allowance_of(structure, thorough=False)
    assert allowance.permits()
    assert not allowance.ended


def test_an_allowance_ends_remembers_and_begins_anew():
    work = Work(10.0)
    allowance = Allowance(work)
    work.note("first", 9)
    assert allowance.permits()
    work.note("second", 1)
    assert allowance.permits(1.5)
    assert not allowance.ended
    assert not allowance.permits()
    assert allowance.ended
    allowance.renew()
    assert allowance.permits()
    assert not allowance.ended
    assert Allowance().permits()


def test_a_fit_that_was_forgotten_counts_once():
    structure = PhysicsStructure(record(), load_model("mass-spring-damper").with_parameters(START, {}))
    rows = structure.record.estimation
    base = structure.baseline(rows)
    before = structure.work.done
    structure.fit((), rows, WHITE, base, effort=Effort.REFIT)
    after = structure.work.done
    structure._fits._made.clear()
    structure.fit((), rows, WHITE, base, effort=Effort.REFIT)
    assert before < after == structure.work.done


def test_linear_fits_count_once_whoever_asks_first():
    (drag,) = find_effects(["quad_drag"])
    (width,) = find_effects(["in_deadzone"])
    done = []
    for efforts in [(Effort.COARSE, Effort.FINE), (Effort.FINE, Effort.COARSE)]:
        structure = LinearStructure(record(), 2, initial_state="rest")
        rows = structure.record.estimation
        base = structure.baseline(rows)
        for effort in (*efforts, *efforts):
            for effect in (drag, width):
                structure.fit([Choice(effect, effect.forms[0])], rows, WHITE, base, effort=effort)
            structure._fits._made.clear()
        done.append(structure.work.done)
    assert done[0] == done[1] > 0


def decided(structure, *, named):
    """A decision with the true law, or that none explains."""
    (limit,) = find_effects(["in_saturation"])
    rows = structure.record.estimation
    base = structure.baseline(rows)
    choice = Choice(limit, limit.form("two-sided"))
    fit = structure.fit([choice], rows, WHITE, base, effort=Effort.FINE)
    verdict, fits, names = ("missing-effect", (fit,), (limit.name,)) if named else ("unexplained", (), ())
    noise = Noise(WHITE, 1.0, 0.0)
    return Decision(verdict, base, fits, names, (), (), noise, 1.0, 0.0, 0.0)


@pytest.mark.parametrize("ends", [True, False])
def test_another_order_explains_with_its_first_effects_or_not_at_all(ends):
    first = LinearStructure(record(), 3, initial_state="rest")
    tried = []

    def decide(structure):
        tried.append(structure)
        if structure is not first and not ends:
            raise GivenUpError
        return decided(structure, named=structure is not first), None

    taken = decided_with_order(first, decide, 0.01)
    assert (taken[0] is not first) == ends
    assert [structure.order for structure in tried] == ([3, 2] if ends else [3, 2, 1, 4])
    assert not first.work.whole
    assert all(structure.work.whole for structure in tried[1:])
    assert all(structure.work.given < 0.5 * first.work.given for structure in tried[1:])


def test_a_search_that_counts_only_as_a_whole_is_given_up_where_it_would_stop():
    work = Work(10.0, whole=True)
    spared, usual = Allowance(work), Allowance(Work(10.0))
    assert spared.spares
    assert not usual.spares
    assert not Allowance().spares
    work.note("first", 10)
    usual.work.note("first", 10)
    assert usual.permits_beside(1)
    assert usual.permits(1.5)
    assert not usual.permits_beside(2)
    for asked in (lambda: spared.permits(1.5), lambda: spared.permits_beside(1)):
        with pytest.raises(GivenUpError):
            asked()
    assert Allowance().permits_beside(2)


@pytest.mark.parametrize(("taken", "most"), [(0, FURTHER), (10, FURTHER_LATE)])
def test_fewer_are_tried_beside_others_once_the_work_is_done(taken, most):
    structure = LinearStructure(record(), 2, initial_state="rest")
    data = structure.record
    evidence = Evidence(structure, data.estimation, data.validation, 0.01)
    work = Work(1.0)
    work.note("before", taken)
    allowance = Allowance(work)
    effects = structure.offered(catalogue())
    trials = Trials(evidence, effects, seed=0, jobs=1, bars=Progress(), allowance=allowance)
    tried = trials.beside(structure.baseline(data.estimation), further=True)
    # A map without parameters, such as a rectifier, is tried whatever its slope says.
    named = [trial for trial in tried if trial.fit is not None and trial.fit.choices[-1].form.parameters]
    assert len(tried) == len(effects) > FURTHER
    assert FURTHER_LATE - 1 <= len(named) <= most
    assert allowance.ended == (taken > 0)


def test_a_long_record_is_searched_on_some_of_its_rows_and_given_no_more_work():
    rng = np.random.default_rng(8)
    u = np.repeat(rng.uniform(-1.0, 1.0, 1000), 6)
    y = np.zeros(6000)
    for k in range(1, 6000):
        y[k] = 0.8 * y[k - 1] + 0.2 * np.clip(u[k - 1], -0.6, 0.7)
    y += 0.01 * rng.standard_normal(6000)
    (limit,) = find_effects(["in_saturation"])
    done = []
    for n in (1500, 6000):
        structure = LinearStructure(make_record(u[:n], y[:n], period=1.0, split=["est"] * n), 1)
        rows = structure.record.estimation
        assert structure.work.given == linear_structure.WORK
        base = structure.baseline(rows)
        fit = structure.fit([Choice(limit, limit.forms[0])], rows, WHITE, base, effort=Effort.COARSE)
        assert fit.parameters_of("in_saturation")[0].value == pytest.approx(0.65, abs=0.06)
        done.append(structure.work.done)
    assert done[1] < 2.0 * done[0]


def test_a_search_sees_what_happens_only_at_the_ends_of_a_range():
    rows = np.ones(4000, dtype=bool)
    quiet = np.tile([-1.0, 1.0], 2000)
    loud = quiet.copy()
    loud[3000] = 5.0
    assert rows_of_search([quiet, quiet], rows).sum() == SEARCH_ROWS
    assert rows_of_search([quiet, loud], rows).sum() == 3001


@pytest.mark.parametrize("damping", [0.2, 3.0, 40.0])
def test_coarser_steps_for_what_decays_within_a_sample_keep_the_error(damping):
    # A run without laws is exact: what Runge-Kutta steps do wrong is seen beside it.  With products of rate
    # and step up to 0.35 the error of a mode is 0.35^4 / 120 = 1.3e-4 of it a radian, and it lasts for as
    # many radians as its quality tells.
    plant = ForcedPlant(load_model("mass-spring-damper"), 0.2)
    values = np.array([1.0, damping, 25.0])
    steps, fastest = plant.substeps(values, 0.35)
    poles = np.roots([1.0, damping, 25.0]) * 0.2
    assert fastest == pytest.approx(np.abs(poles).max(), rel=1e-9)
    assert steps == max(
        np.ceil(np.max(np.abs(p) / min(np.exp(max(-p.real, 0.0) / 4), COARSER)) / 0.35) for p in poles
    )
    u = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, 100), 5)
    nothing = physics_law(drag=0.0)
    exact = plant.run(values[np.newaxis], nothing, u)[0]
    stepped = plant.run(values[np.newaxis], nothing, u, substeps=steps, exact=False)[0]
    assert np.linalg.norm(stepped - exact) < 1.3e-4 * max(5.0 / damping, 1.0) * np.linalg.norm(exact)


def physics_law(**coefficients):
    from sysid.physics.forced import law

    return law(**coefficients)[np.newaxis]


def test_a_parameter_beyond_all_numbers_leaves_a_port_without_matrices():
    # Warnings are errors: a search that runs off must not show any.
    fit = fit_physics(record(), load_model("mass-spring-damper").with_parameters(START, {}))
    plant = PhysicsPlant(fit)
    port = plant.ports(record(), ("input",))[0]
    beyond = plant.start.copy()
    beyond[0] = 800.0
    assert plant.matrices(plant.start, port) is not None
    assert plant.matrices(beyond, port) is None


@pytest.mark.parametrize(("work", "rounds"), [(None, 2), (0.0, 1)])
def test_a_second_effect_beside_one_that_does_not_hold_is_searched_while_there_is_work(
    monkeypatch, work, rounds
):
    asked = []
    monkeypatch.setattr(Growth, "_first_accepted", lambda *_: None)
    monkeypatch.setattr(Trials, "beside", counted(Trials.beside, asked))
    search = searched(work)
    search.decide()
    assert [names for names in asked if len(names) < 2][:rounds] == [(), ("out_offset",)][:rounds]
    assert len(asked) == rounds or work is None
    assert search.allowance.ended == (work == 0.0)


@pytest.mark.parametrize(("work", "rounds"), [(None, 2), (0.0, 1)])
def test_what_was_found_beside_a_poor_fit_is_asked_again_while_there_is_work(monkeypatch, work, rounds):
    asked, poor = [], []

    def better(growth, current, *_):
        poor.append(current)
        return current if len(poor) == 1 else None

    monkeypatch.setattr(Growth, "_better_with_fewer", better)
    monkeypatch.setattr(Trials, "beside", counted(Trials.beside, asked))
    searched(work).decide()
    assert asked.count(("out_offset",)) == rounds


def counted(beside, asked):
    """Note beside which effects candidates are tried."""

    def noted(trials, current, *further):
        asked.append(current.names)
        return beside(trials, current, *further)

    return noted


def searched(work):
    """Return a search for an offset and a square in the reading of a first-order plant."""
    rng = np.random.default_rng(2)
    u, y = rng.uniform(-1.0, 1.0, 600), np.zeros(600)
    for k in range(1, 600):
        y[k] = 0.8 * y[k - 1] + u[k - 1]
    y += 1.5 + 0.1 * y**2 + 0.02 * rng.standard_normal(600)
    structure = LinearStructure(make_record(u, y, period=1.0), 1, initial_state="rest")
    if work is not None:
        structure.work = Work(work)
    return Search(structure, find_effects(["out_offset", "out_quadratic", "out_drift"]))


def test_a_physical_model_is_diagnosed_without_kernels_of_linear_ones():
    script = """
import sys, numpy as np, sysid
from sysid.data import make_record
u, noise = np.random.default_rng(0).standard_normal((2, 400))
y = np.zeros(400)
for k in range(2, 400):
    y[k] = 1.5 * y[k - 1] - 0.7 * y[k - 2] + 0.2 * u[k - 1]
sysid.diagnose(make_record(u, y + 0.02 * noise, period=1.0), "mass-spring-damper", effects=["quad_drag"])
print([name for name in ("sysid.diagnosis.linear.kernels", "scipy.signal") if name in sys.modules])
"""
    said = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"


def test_values_that_a_shape_is_tried_at_are_looked_for_once():
    setting = PhysicsStructure(record(), load_model("mass-spring-damper")).setting
    (quantiser,) = find_effects(["out_quantisation"])
    grid, rows = quantiser.forms[0].parameters[0].grid, setting.record.estimation
    assert setting.tried(grid, rows) is setting.tried(grid, rows.copy())
    assert not np.array_equal(setting.tried(grid, rows), setting.tried(grid, setting.record.learning))


def test_no_jacobian_is_made_for_a_step_that_is_not_taken():
    class Root:
        """Newton's steps to the root of two: each of them is taken."""

        jumps, jacobians = False, 0

        def residual(self, x):
            return x**2 - 2.0

        def jacobian(self, x):
            self.jacobians += 1
            return 2.0 * x[:, np.newaxis]

        def with_derivative(self, x):
            return self.residual(x), self.jacobian(x)

    root = Root()
    end = descend(Evaluation(root, 3), np.array([3.0]), max_evaluations=3)
    assert end.status is Status.MAX_EVALUATIONS
    assert len(end.costs) == 3
    assert root.jacobians == 2
