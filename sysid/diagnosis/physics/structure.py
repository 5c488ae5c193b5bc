"""Physical models as diagnosis sees them: fitted with effects, by their free run."""

from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Effect, Floats
from sysid.diagnosis.effects.catalogue import find_effects
from sysid.diagnosis.physics.budget import Budget, fastest_followed
from sysid.diagnosis.physics.cells import with_thresholds_between, within_cells
from sysid.diagnosis.physics.descents import (
    EVALUATIONS,
    TOLERANCES,
    TRIED,
    agree,
    cost_of,
    descents,
    ends_beside,
    ends_without_colour,
    likelier_from_start_values,
    likeliest,
    nearly_agree,
)
from sysid.diagnosis.physics.directions import directions, probes
from sysid.diagnosis.physics.equation import equation_text
from sysid.diagnosis.physics.free_run import free_run, runs
from sysid.diagnosis.physics.hold import SMOOTHER, band_limited
from sysid.diagnosis.physics.lengthening import lengthened
from sysid.diagnosis.physics.offered import idle_levels, makes_sense, with_levels
from sysid.diagnosis.physics.parameters import named_parameters, standard_errors
from sysid.diagnosis.physics.points import moved
from sysid.diagnosis.physics.problem import COARSE_STEP, Problem, problem_of
from sysid.diagnosis.physics.response import response
from sysid.diagnosis.physics.scatter import is_rugged, scattered
from sysid.diagnosis.physics.search import problem_point, refined
from sysid.diagnosis.physics.setting import Plant, setting_of
from sysid.diagnosis.physics.starts import near_starts, wide_starts
from sysid.diagnosis.physics.steps import enough_steps
from sysid.diagnosis.structures.memory import Fits, key_of
from sysid.diagnosis.structures.rows import rows_of_search
from sysid.diagnosis.structures.sides import with_forms_of
from sysid.diagnosis.structures.structure import WHITE, Choice, Complexes, Effort, StructureFit, kept_and_new
from sysid.diagnosis.structures.work import Work
from sysid.errors import IdentifiabilityError, ModelError
from sysid.physics.forced import ForcedPlant
from sysid.physics.general import GeneralPlant, is_general
from sysid.physics.model import Model
from sysid.physics.simulation import linearised_poles
from sysid.separable.descent import Minimum, Residual

# Draws around the nominal values; more where no two searches agree.
RESTARTS, MORE_RESTARTS = 4, 16
# Most steps that the simulations of a fit of each effort may take, for so many rows; more for more rows.
BUDGETS, BUDGET_ROWS = (60e6, 25e6, 80e6), 1_200
# Work of a whole search, in steps of a run without laws, whatever the length of the record.
WORK = 280e6
FINEST = EVALUATIONS[Effort.FINE], TOLERANCES[Effort.FINE]
DIVERGES = "it diverges"
SPENT = "stopped: the simulations took as many steps as a fit is given; the minimum may be lower"


class PhysicsStructure:
    """A physical model that can be fitted with effects to one record.

    Parameters
    ----------
    record : Record
        With one output.
    model : Model
        Start values, known values.
    initial_state : {"estimate", "rest"}
    units : str
        What is to be said of columns in other units than the model's.

    Attributes
    ----------
    screened : int
        Candidates worth a fit: all, for a fit takes some hundredths of a second, and an effect that
        changes the run much, as a square root does, is not seen in its first-order direction.
    """

    screened = 100

    def __init__(
        self, record: Record, model: Model, initial_state: str = "estimate", units: str = ""
    ) -> None:
        self.record, self.units = record, units
        self.name = model.name
        self.general = is_general(model)
        plant: Plant = (
            GeneralPlant(model, record.period) if self.general else ForcedPlant(model, record.period)
        )
        self.model, self.free_start = model, initial_state == "estimate"
        self._hold_chosen = False
        self.work = Work(WORK)
        self._use(plant)

    def on(self, record: Record) -> "PhysicsStructure":
        """Return the same structure for another record: its plant, held between samples as was chosen."""
        other = PhysicsStructure.__new__(PhysicsStructure)
        other.__dict__.update(self.__dict__)
        other.record = record
        if isinstance(self.plant, ForcedPlant):
            other._use(ForcedPlant(self.model, record.period, self.plant.hold))
        else:
            other._use(GeneralPlant(self.model, record.period))
        return other

    def offered(self, effects: Sequence[Effect]) -> tuple[Effect, ...]:
        """Return the effects that make sense for this model, in the given order.

        A relay gets a level of its own unless the model has a free gain.
        """
        sensible = [
            effect.within("physics", self.free_start)
            for effect in effects
            if makes_sense(self.setting, effect, general=self.general)
        ]
        return with_levels(self.setting, sensible)

    def baseline(self, rows: Mask) -> StructureFit:
        """Fit the model without effects, from several starts.

        The input is held between samples.  Only where it is one without the upper frequencies of a held
        input, and a smooth course between samples lowers the held-out error so much that neither a direct
        path nor a delay could, it counts as smooth from then on.
        """
        held = self._baseline(rows)
        if self._hold_chosen or self.general or not band_limited(self.record, rows):
            return held
        self._hold_chosen = True
        smooth = PhysicsStructure.__new__(PhysicsStructure)
        smooth.__dict__.update(self.__dict__)
        smooth._use(ForcedPlant(self.model, self.record.period, "smooth"))
        quick = smooth.fit((), rows, WHITE, held, effort=Effort.REFIT)
        if self._held_out_error(quick) > SMOOTHER * self._held_out_error(held):
            return held
        rivals = [self._with_path(held, name, rows) for name in ("feedthrough", "in_delay")]
        if self._held_out_error(quick) > SMOOTHER * min(map(self._held_out_error, rivals)):
            return held
        self._use(smooth.plant)
        return self._baseline(rows)

    def held_or_smooth(self) -> bool:
        """Take the input's other course between samples; tell whether it may have another.

        What is missing can change the free run more than the course between samples does, so that the
        baseline does not show which one it is.
        """
        if not isinstance(self.plant, ForcedPlant) or not band_limited(self.record, self.record.learning):
            return False
        other = "zero" if self.plant.hold == "smooth" else "smooth"
        self._hold_chosen = True
        self._use(ForcedPlant(self.model, self.record.period, other))
        return True

    def _use(self, plant: Plant) -> None:
        self.plant, self._fits, self._course = plant, Fits(), getattr(self, "_course", 0) + 1
        self.setting = setting_of(self.record, self.model, plant, self.free_start)

    def _with_path(self, held: StructureFit, name: str, rows: Mask) -> StructureFit:
        (effect,) = find_effects([name])
        return self.fit([Choice(effect, effect.forms[0])], rows, WHITE, held, effort=Effort.COARSE)

    def _held_out_error(self, fit: StructureFit) -> float:
        """Return the root mean square of the free-run error on validation rows, or on those of the fit."""
        rows = self.record.validation & ~fit.rows
        error = (fit.output - self.record.y[:, 0])[rows if rows.any() else fit.rows]
        return float(np.sqrt(np.mean(error**2)))

    def _baseline(self, rows: Mask) -> StructureFit:
        budget = Budget()
        problem = self._problem((), rows, WHITE, budget)
        pace = problem.pace_at(self.setting.nominal)
        if not np.isfinite(pace):
            raise ModelError(
                f"model {self.name!r} at its start values is too fast for the sampling period "
                f"{self.record.period:.3g} s: check the parameters and their units"
            )
        budget.fastest = fastest_followed(pace)
        if problem.target.size < 2 * problem.size:
            raise IdentifiabilityError(
                f"{problem.target.size} rows cannot determine {problem.size} unknowns: at least "
                f"{2 * problem.size} rows are needed"
            )
        unknown = any(p.status == "free" for p in self.setting.searched)
        starts = wide_starts(self.setting, rows) if unknown else near_starts(self.setting, RESTARTS)
        small = self._rows_of_search(rows)
        search = problem if small.sum() == rows.sum() else self._problem((), small, WHITE, budget)
        ends = descents(search, starts)
        found_again = agree(ends, search.target)
        if not found_again:
            ends = sorted([*ends, *descents(search, near_starts(self.setting, MORE_RESTARTS))], key=cost_of)
            found_again = agree(ends, search.target) or nearly_agree(ends)
        if not ends:
            raise ModelError(
                f"model {self.name!r} diverges from every start: give start values nearer to the plant's"
            )
        best = likeliest(search, ends)
        if search is not problem:
            best = problem.descend(moved(search, problem, best.x), *FINEST)
        self.work.note((self._course, rows.tobytes()), budget.work)
        return self._result(problem, best, found_again)

    def fit(
        self, choices: Sequence[Choice], rows: Mask, noise: Floats, start: StructureFit, *, effort: Effort
    ) -> StructureFit:
        """Fit the model with these effects, from a fit with fewer (or other, or the same) effects."""
        return self._fits.fitted(self._counted, choices, rows, noise, start, effort)

    def _counted(
        self, choices: Sequence[Choice], rows: Mask, noise: Floats, start: StructureFit, effort: Effort
    ) -> StructureFit:
        budget = Budget(BUDGETS[effort] * max(float(rows.sum()) / BUDGET_ROWS, 1.0))
        fit = self._fit(choices, rows, noise, start, effort, budget)
        self.work.note((self._course, key_of(choices, rows, noise, start, effort)), budget.work)
        return fit

    def _fit(
        self,
        choices: Sequence[Choice],
        rows: Mask,
        noise: Floats,
        start: StructureFit,
        effort: Effort,
        budget: Budget,
    ) -> StructureFit:
        if effort is Effort.REFIT:
            places = self._problem(start.choices, start.rows, WHITE).effect_places
            start = with_forms_of(choices, start, places)
        kept, searched = kept_and_new(choices, start, effort)
        new = [i for i, choice in enumerate(choices) if choice in searched]
        problem = self._problem(choices, rows, noise, budget)
        budget.fastest = fastest_followed(*map(problem.pace_at, (self.setting.nominal, start.point)))
        before = self._problem(kept, rows, noise, budget)
        known = self._carried(before, start)
        if effort is Effort.REFIT or not new:
            point = problem_point(problem, before, known)
            if not np.isfinite(problem.cost(point)):  # an effect that was left out may have held it
                return _diverged(choices, start)
            end = problem.descend(point, EVALUATIONS[effort], TOLERANCES[effort])
            if is_rugged(problem) and not np.array_equal(rows, start.rows):
                end = scattered(problem, end, *FINEST)
            end = refined(problem, end, EVALUATIONS[Effort.COARSE], TOLERANCES[effort])
            return self._result(problem, with_thresholds_between(problem, within_cells(problem, end)), True)
        small = self._rows_of_search(rows)
        search, plain = problem, before
        if small.sum() < rows.sum():
            search = self._problem(choices, small, noise, budget)
            plain = self._problem(kept, small, noise, budget)
        found: list[Minimum[Residual]] = []
        if effort is Effort.FINE:
            # A finer search goes on from the coarse one; others of its searches may end where that one did.
            coarse = self.fit(choices, rows, noise, start, effort=Effort.COARSE)
            if not coarse.usable:
                return coarse
            on = search.descend_if_finite(moved(problem, search, coarse.point), *FINEST)
            found += [] if on is None else [on]
        ends = ends_beside(search, plain, self._carried(plain, start), new, effort, found)
        if noise.size > 1 and not found:
            # The colour of what is missing can hide an effect from the grid: search without it, too.
            white = self._problem(choices, search.rows, WHITE, budget)
            bare = self._problem(kept, search.rows, WHITE, budget)
            ends += ends_without_colour(white, bare, search, self._carried(bare, start), new, effort)
            ends.sort(key=cost_of)
        if not ends:
            return _diverged(choices, start)
        if effort is Effort.FINE and is_rugged(search):
            ends.insert(0, scattered(search, ends[0], *FINEST))
        if effort is Effort.FINE and noise.size > 1 and any(choice.effect.dry for choice in searched):
            # Where a body sticks and slips there are many minima, and a colour that what is missing has a
            # part in hides the deepest of them: it is also looked for, on openings too, by the plain error.
            plainly = self.fit(choices, rows, WHITE, start, effort=effort)
            on = search.descend_if_finite(moved(problem, search, plainly.point), *FINEST)
            ends = sorted([*ends, *([] if on is None else [on])], key=cost_of)
        elif effort is Effort.FINE and not search.exact and not agree(ends, search.target):
            ends.insert(0, lengthened(search, ends[0], *FINEST))
        best, found_twice = ends[0], agree(ends, search.target)
        if search is not problem:
            last = EVALUATIONS[Effort.FINE] if effort is Effort.FINE else TRIED
            carried = problem.descend_if_finite(moved(search, problem, best.x), last, TOLERANCES[effort])
            if carried is None:  # it stays finite on the rows of the search only
                return _diverged(choices, start)
            best = carried
        if effort is Effort.FINE:  # a ranking can do without
            best = within_cells(problem, best)
        return self._result(problem, best, found_twice or effort is Effort.COARSE)

    def _rows_of_search(self, rows: Mask) -> Mask:
        return rows_of_search([*self.record.u.T, self.record.y[:, 0]], rows)

    def _problem(
        self,
        choices: Sequence[Choice],
        rows: Mask,
        noise: Floats,
        budget: Budget | None = None,
        largest: float = COARSE_STEP,
    ) -> Problem:
        return Problem(self.setting, choices, rows, noise, largest, budget=budget)

    def _carried(self, problem: Problem, start: StructureFit) -> Floats:
        """Return the point of a problem with effects of ``start`` where that fit left them."""
        old = self._problem(start.choices, start.rows, WHITE)
        return moved(old, problem, start.point)

    def _result(self, problem: Problem, minimum: Minimum[Residual], agree: bool) -> StructureFit:
        return StructureFit(
            choices=problem.choices,
            point=minimum.x,
            parameters=named_parameters(problem, minimum.x, np.full(problem.size, np.nan)),
            output=free_run(problem, minimum.x),
            rows=problem.rows,
            cost=minimum.cost,
            n_parameters=problem.size - idle_levels(self.setting, problem.choices),
            converged=minimum.status.converged,
            restarts_agree=agree,
            status=SPENT if problem.budget.spent else minimum.status.value,
        )

    def with_fine_steps(self, fit: StructureFit, noise: Floats) -> StructureFit:
        """Return a fit moved to where it is best with steps as fine as the noise asks.

        A search can do with coarser ones, but what they do wrong ends in the parameters: of many rows with
        little noise these are known better than one row is: it lies next to where a search with coarse ones
        ended, a few evaluations away.  Of minima that are as good the one near the start values is taken.
        """
        key = (self._course, "fine", key_of(fit.choices, fit.rows, noise, fit, Effort.REFIT))
        return self._fits.recalled(key, lambda: self._with_fine_steps(key, fit, noise))

    def _with_fine_steps(self, key: Hashable, fit: StructureFit, noise: Floats) -> StructureFit:
        problem = self._problem(fit.choices, fit.rows, noise)
        point = likelier_from_start_values(problem, fit.point)
        largest = enough_steps(problem, point)
        if largest == COARSE_STEP and point is fit.point:
            return fit
        budget = Budget()
        problem = self._problem(fit.choices, fit.rows, noise, budget, largest)
        end = problem.descend_if_finite(point, EVALUATIONS[Effort.COARSE], TOLERANCES[Effort.REFIT])
        self.work.note(key, budget.work)
        if end is None:
            return fit
        end = with_thresholds_between(problem, within_cells(problem, end))
        return self._result(problem, end, fit.restarts_agree)

    def tangent(self, fit: StructureFit) -> Floats:
        """Return the derivative of the free run by all parameters, shape (n_samples, n_parameters)."""
        problem = problem_of(self.setting, fit)
        points, steps = problem.shifted(fit.point, range(problem.size))
        outputs = runs(problem, points)
        return np.asarray(((outputs[1:] - outputs[0]) / steps[:, np.newaxis]).T)

    def directions(self, fit: StructureFit, effect: Effect) -> list[Floats]:
        """Return how an effect, added to a fit, would change its free run."""
        return directions(self.setting, fit, effect)

    def finish(
        self, fit: StructureFit, noise: Floats, *, plain: bool = False, closely: bool = False
    ) -> StructureFit:
        """Return a fit with standard errors of its parameters filled in."""
        problem = self._problem(fit.choices, fit.rows, WHITE if plain else noise)
        errors = standard_errors(problem, fit.point, noise if plain else WHITE, closely=closely)
        return replace(fit, parameters=named_parameters(problem, fit.point, errors))

    def probes(self, fit: StructureFit) -> Floats:
        """Return directions in which an effect that is not in any list would show."""
        return probes(self.setting, fit)

    def earlier_probes(self, fit: StructureFit) -> Floats:
        """Return directions that hold the input of earlier rows only, as an effect of the plant does."""
        return probes(self.setting, fit, since=1)

    def respond(self, fit: StructureFit, u: Floats) -> tuple[Floats, Floats]:
        """Return the free run from rest for an input, and its derivative by all parameters."""
        return response(self.setting, fit, u)

    def values(self, fit: StructureFit) -> dict[str, float]:
        """Return all parameters of the model, by their names."""
        return dict(zip(self.setting.plant.names, self.setting.values_of(fit.point).tolist(), strict=True))

    def poles(self, fit: StructureFit) -> Complexes:
        """Return the poles [1/s] of the model without effects, linearised at rest."""
        return linearised_poles(
            self.model, self.values(fit), self.setting.rest, np.zeros(len(self.model.inputs))
        )

    def equation(self, fit: StructureFit) -> str:
        """Return the model's equation with its effects, for a reader."""
        return equation_text(self.model, fit.laws)


def _diverged(choices: Sequence[Choice], start: StructureFit) -> StructureFit:
    """Return a fit that cannot be used: with these effects the model diverges wherever it was tried."""
    return replace(start, choices=tuple(choices), cost=np.inf, converged=False, status=DIVERGES)
