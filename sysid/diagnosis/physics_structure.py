"""Physical models as diagnosis sees them: fitted with effects, by their free run."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Effect, Floats
from sysid.diagnosis.effects.catalogue import find_effects
from sysid.diagnosis.physics_laws import SMOOTH_LAWS, SWITCHES, has_law, with_level
from sysid.diagnosis.physics_problem import Problem, Setting
from sysid.diagnosis.physics_search import Tangent, grid_starts, problem_point, refined
from sysid.diagnosis.physics_starts import wide_starts
from sysid.diagnosis.structures import Choice, FittedParameter, StructureFit
from sysid.errors import IdentifiabilityError, ModelError
from sysid.linear.simulation import first_rows
from sysid.physics.forced import NO_LAW, ForcedPlant
from sysid.physics.general import GeneralPlant, is_general
from sysid.physics.model import Model
from sysid.separable.descent import Minimum, Residual

# Fastest rate times the Runge-Kutta step: the run's relative error is about its fourth power / 120.
COARSE_STEP, FINE_STEP = 0.35, 0.2
# A search runs on the first rows, so many; its end is polished on all.
SEARCH_ROWS = 2_500
RESTARTS, MORE_RESTARTS = 4, 16
SPREAD = 0.25
# Two searches agree when their root mean square errors differ by this share, and their outputs by less than
# that share of the error.
AGREEMENT, OUTPUT_AGREEMENT = 1e-3, 0.05
SEED = 7
EVALUATIONS = (100, 14, 60)
TOLERANCES = (1e-7, 1e-4, 1e-7)
DESCENTS = (1, 2, 4)
# So many evaluations are spent on every start before the better ones are followed.
TRIED = 6
# The input counts as smooth between samples when that lowers the error to this share at least.
SMOOTHER = 0.7
GAIN_ROWS, SAME_DIRECTION = 1_000, 1e-4
# A held input has power up to the Nyquist frequency: less than this share above this frequency is none.
UPPER_FREQUENCY, UPPER_POWER = 0.8, 1e-4
DIVERGES = "it diverges"
WHITE = np.ones(1)
Plant = ForcedPlant | GeneralPlant


class PhysicsStructure:
    """A physical model that can be fitted with effects to one record.

    Parameters
    ----------
    record : Record
        With one output.
    model : Model
        Start values, known values.
    initial_state : {"estimate", "rest"}

    Attributes
    ----------
    screened : int
        Candidates worth a fit: all, for a fit takes some hundredths of a second, and an effect that
        changes the run much, as a square root does, is not seen in its first-order direction.
    """

    screened = 100

    def __init__(self, record: Record, model: Model, initial_state: str = "estimate") -> None:
        self.record = record
        self.name = model.name
        self.general = is_general(model)
        plant: Plant = (
            GeneralPlant(model, record.period) if self.general else ForcedPlant(model, record.period)
        )
        self.model, self.free_start = model, initial_state == "estimate"
        self._hold_chosen = False
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
        sensible = [effect for effect in effects if self._makes_sense(effect)]
        if all(effect.name not in SWITCHES for effect in sensible) or self._has_free_gain():
            return tuple(sensible)
        return tuple(with_level(effect) if effect.name in SWITCHES else effect for effect in sensible)

    def _has_free_gain(self) -> bool:
        """Tell whether a change of the model's parameters can scale its output."""
        rows = _first_rows(self.record.learning, GAIN_ROWS)
        problem = Problem(self.setting, (), rows, WHITE, COARSE_STEP, free_start=False)
        point = self.setting.nominal
        output = problem.outputs(point[np.newaxis])
        with np.errstate(all="ignore"):
            left = Tangent(problem, point).outside(output)
        return bool(np.linalg.norm(left) < SAME_DIRECTION * np.linalg.norm(output))

    def _makes_sense(self, effect: Effect) -> bool:
        port = self.plant.port
        if "physics" not in effect.families:
            return False
        if effect.port in ("force", "gain", "flow") and not has_law(effect):
            return False
        if effect.port == "force":
            # With a constant force of the model's own these two would be second names.
            doubled = bool(port.constant) and effect.name in ("asymmetric_friction", "constant_force")
            known = not self.general or effect.name in SMOOTH_LAWS
            return port.velocity is not None and known and not doubled
        if self.general and effect.port == "gain":
            return False
        return effect.port != "flow" or bool(port.levels)

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
        quick = smooth.fit((), rows, WHITE, held, effort=0)
        if self._held_out_error(quick) > SMOOTHER * self._held_out_error(held):
            return held
        rivals = [self._with_path(held, name, rows) for name in ("feedthrough", "in_delay")]
        if self._held_out_error(quick) > SMOOTHER * min(map(self._held_out_error, rivals)):
            return held
        self._use(smooth.plant)
        return self._baseline(rows)

    def _use(self, plant: Plant) -> None:
        self.plant = plant
        self.setting = _setting(self.record, self.model, plant, self.free_start)

    def _with_path(self, held: StructureFit, name: str, rows: Mask) -> StructureFit:
        (effect,) = find_effects([name])
        return self.fit([Choice(effect, effect.forms[0])], rows, WHITE, held, effort=1)

    def _held_out_error(self, fit: StructureFit) -> float:
        """Return the root mean square of the free-run error on validation rows, or on those of the fit."""
        rows = self.record.validation & ~fit.rows
        error = (fit.output - self.record.y[:, 0])[rows if rows.any() else fit.rows]
        return float(np.sqrt(np.mean(error**2)))

    def _baseline(self, rows: Mask) -> StructureFit:
        problem = self._problem((), rows, WHITE, COARSE_STEP)
        if problem.target.size < 2 * problem.size:
            raise IdentifiabilityError(
                f"{problem.target.size} rows cannot determine {problem.size} unknowns: at least "
                f"{2 * problem.size} rows are needed"
            )
        unknown = any(p.status == "free" for p in self.setting.searched)
        starts = self._wide_starts(rows) if unknown else self._near_starts(RESTARTS)
        small = _first_rows(rows, SEARCH_ROWS)
        search = problem if small.sum() == rows.sum() else self._problem((), small, WHITE, COARSE_STEP)
        ends = self._descents(search, starts)
        if not _agree(ends):
            ends = sorted([*ends, *self._descents(search, self._near_starts(MORE_RESTARTS))], key=_cost)
        if not ends:
            raise ModelError(
                f"model {self.name!r} diverges from every start: give start values nearer to the plant's"
            )
        best = ends[0]
        if search is not problem:
            best = problem.descend(self._moved(search, problem, best.x), EVALUATIONS[2], TOLERANCES[2])
        return self._result(problem, best, _agree(ends))

    def _descents(self, problem: Problem, starts: Sequence[Floats]) -> list[Minimum[Residual]]:
        """Return where searches from model parameters end, the best first."""
        points = [self._with_states(problem, start) for start in starts]
        ends = [
            problem.descend(point, EVALUATIONS[2], TOLERANCES[2])
            for point in points
            if np.isfinite(problem.cost(point))
        ]
        return sorted(ends, key=_cost)

    def _wide_starts(self, rows: Mask) -> list[Floats]:
        """Return starts for parameters of which little is known."""
        if not self.general:
            return wide_starts(self.setting, rows)
        from sysid.physics.fit import fit_physics

        state = "estimate" if self.free_start else "rest"
        fit = fit_physics(self.record, self.model, initial_state=state, rows=rows)
        found = self.setting.to_coordinates(np.array([fit.values[p.name] for p in self.setting.searched]))
        return [found, self.setting.nominal]

    def _near_starts(self, count: int) -> list[Floats]:
        """Return the nominal values and draws around them."""
        generator = np.random.default_rng(SEED)
        nominal = self.setting.nominal
        width = np.where(self.setting.positive, SPREAD, SPREAD * np.abs(nominal))
        draws = [nominal + width * generator.uniform(-1.0, 1.0, nominal.size) for _ in range(count)]
        return [nominal, *draws]

    def fit(
        self, choices: Sequence[Choice], rows: Mask, noise: Floats, start: StructureFit, *, effort: int
    ) -> StructureFit:
        """Fit the model with these effects, from a fit with fewer (or other, or the same) effects."""
        largest = FINE_STEP if effort == 2 else COARSE_STEP
        problem = self._problem(choices, rows, noise, largest)
        kept = [choice for choice in choices if choice in start.choices]
        new = [i for i, choice in enumerate(choices) if choice not in start.choices]
        before = self._problem(kept, rows, noise, largest)
        known = self._carried(before, start)
        if effort == 0 or not new:
            point = problem_point(problem, before, known)
            if not np.isfinite(problem.cost(point)):  # an effect that was left out may have held it
                return replace(start, choices=tuple(choices), cost=np.inf, converged=False, status=DIVERGES)
            end = problem.descend(point, EVALUATIONS[effort], TOLERANCES[effort])
            return self._result(problem, refined(problem, end, EVALUATIONS[1], TOLERANCES[effort]), True)
        small = _first_rows(rows, SEARCH_ROWS)
        search, plain = problem, before
        if small.sum() < rows.sum():
            search = self._problem(choices, small, noise, largest)
            plain = self._problem(kept, small, noise, largest)
        ends = self._ends(search, plain, self._carried(plain, start), new, effort)
        if noise.size > 1:
            # The colour of what is missing can hide an effect from the grid: search without it, too.
            white = self._problem(choices, search.rows, WHITE, largest)
            bare = self._problem(kept, search.rows, WHITE, largest)
            near = self._ends(white, bare, self._carried(bare, start), new, 1)[0].x
            if np.isfinite(search.cost(near)):
                ends.append(search.descend(near, EVALUATIONS[effort], TOLERANCES[effort]))
                ends.sort(key=_cost)
        best, agree = ends[0], _agree(ends)
        if search is not problem:
            last = EVALUATIONS[2] if effort == 2 else TRIED
            best = problem.descend(self._moved(search, problem, best.x), last, TOLERANCES[effort])
        return self._result(problem, best, agree or effort == 1)

    def _ends(
        self, problem: Problem, before: Problem, known: Floats, new: Sequence[int], effort: int
    ) -> list[Minimum[Residual]]:
        """Search from the best points of the grid, around the fit so far and around the nominal values."""
        found: list[Floats] = []
        for centre in self._centres(problem, before, known, new):
            found += [point for _, point in grid_starts(problem, before, centre, new)[: DESCENTS[effort]]]
        tried = [problem.descend(x, TRIED, TOLERANCES[effort]) for x in found if np.isfinite(problem.cost(x))]
        if not tried:
            tried = [problem.descend(problem_point(problem, before, known), 2, TOLERANCES[effort])]
        ends = [
            end
            if end.status.converged
            else problem.descend(end.x, EVALUATIONS[effort] - TRIED, TOLERANCES[effort])
            for end in _different(sorted(tried, key=_cost))[: DESCENTS[effort]]
        ]
        ends.sort(key=_cost)
        # For a ranking the shapes of earlier effects stay where they are on the whole.
        scanned = None if effort == 2 else new
        ends[0] = refined(problem, ends[0], EVALUATIONS[1], TOLERANCES[effort], scanned)
        return ends

    def _centres(self, problem: Problem, before: Problem, known: Floats, new: Sequence[int]) -> list[Floats]:
        """Return the points without the new effects around which these are searched."""
        centres = [known]
        nominal = known.copy()
        nominal[: before.n_model] = self.setting.nominal
        if not np.allclose(nominal, known, rtol=1e-3):
            centres.append(nominal)
        return centres

    def _with_states(self, problem: Problem, coordinates: Floats) -> Floats:
        """Return a point whose initial states fit best, the rest as given."""
        point = np.concatenate([coordinates, np.zeros(problem.size - coordinates.size)])
        if problem.n_starts == 0:
            return point
        rest = [state.rest for state in self.model.states]
        point[coordinates.size :] = np.tile(rest, len(problem.parts))
        problem.held[: coordinates.size] = True
        with np.errstate(all="ignore"):
            found = problem.descend(point, 8, 1e-6).x if np.isfinite(problem.cost(point)) else point
        problem.held[:] = False
        return found

    def _problem(self, choices: Sequence[Choice], rows: Mask, noise: Floats, largest: float) -> Problem:
        return Problem(self.setting, choices, rows, noise, largest)

    def _carried(self, problem: Problem, start: StructureFit) -> Floats:
        """Return the point of a problem with effects of ``start`` where that fit left them."""
        old = self._problem(start.choices, start.rows, WHITE, COARSE_STEP)
        return self._moved(old, problem, start.point)

    def _moved(self, old: Problem, problem: Problem, x: Floats) -> Floats:
        """Return a point with what another problem's point says about the same unknowns."""
        point = np.zeros(problem.size)
        point[: problem.n_model] = x[: old.n_model]
        for i, choice in enumerate(problem.choices):
            if choice in old.choices:
                point[problem.effect_places[i]] = x[old.effect_places[old.choices.index(choice)]]
        order = self.plant.order
        rest = np.array([state.rest for state in self.model.states])
        first = {part.start: k for k, part in enumerate(old.parts)}
        for number, part in enumerate(problem.parts if problem.n_starts else []):
            place = problem.n_model + problem.n_effects + number * order
            k = first.get(part.start)
            where = old.n_model + old.n_effects + (k or 0) * order
            point[place : place + order] = rest if k is None or not old.n_starts else x[where : where + order]
        return point

    def _result(self, problem: Problem, minimum: Minimum[Residual], agree: bool) -> StructureFit:
        return StructureFit(
            choices=problem.choices,
            point=minimum.x,
            parameters=self._parameters(problem, minimum.x, np.full(problem.size, np.nan)),
            output=self._everywhere(problem, minimum.x),
            rows=problem.rows,
            cost=minimum.cost,
            n_parameters=problem.size,
            converged=minimum.status.converged,
            restarts_agree=agree,
            status=minimum.status.value,
        )

    def _parameters(self, problem: Problem, x: Floats, errors: Floats) -> tuple[FittedParameter, ...]:
        """Return the parameters for a reader; errors are those of the coordinates."""
        values = self.setting.to_values(x[: problem.n_model])
        slopes = np.where(self.setting.positive, values, 1.0)
        found = [
            FittedParameter(p.name, float(value), float(error * slope), p.unit)
            for p, value, error, slope in zip(self.setting.searched, values, errors, slopes, strict=False)
        ]
        for choice, place in zip(problem.choices, problem.effect_places, strict=True):
            for parameter, value, error in zip(choice.form.parameters, x[place], errors[place], strict=True):
                unit = parameter.unit_with(self.units)
                found.append(FittedParameter(parameter.name, float(value), float(error), unit, choice.name))
        return tuple(found)

    @property
    def units(self) -> dict[str, str]:
        """Units of input, output, force, position and speed."""
        model, port = self.model, self.plant.port
        units = {"u": model.inputs[0].unit, "y": model.outputs[0].unit}
        if port.velocity is not None and port.position is not None:
            units |= {
                "F": model.equations[port.velocity].unit,
                "x": model.states[port.position].unit,
                "v": model.states[port.velocity].unit,
            }
        elif port.levels:
            units["x"] = model.states[port.levels[0]].unit
        return units

    def _everywhere(self, problem: Problem, x: Floats) -> Floats:
        """Return the free run over every row, initial states of experiments without rows estimated."""
        record = self.record
        output = np.empty(record.n_samples)
        fitted = {part.start: number for number, part in enumerate(problem.parts)}
        for part in record.slices:
            number = fitted.get(part.start)
            if number is None and problem.n_starts:
                output[part] = self._new_experiment(problem, x, part)
            else:
                output[part] = problem.run(part, x[np.newaxis], number)[0]
        return output

    def _new_experiment(self, problem: Problem, x: Floats, part: slice) -> Floats:
        """Return the free run of an experiment that has no rows in the fit."""
        y = self.record.y[part, 0]
        used, count = first_rows(
            y, self.record.skip.get(str(self.record.split[part][0]), 0), self.plant.order
        )
        own = problem.n_model + problem.n_effects
        if not count:
            return np.asarray(problem.run(part, x[np.newaxis], None)[0])
        rows = np.zeros(self.record.n_samples, dtype=bool)
        rows[part] = used
        local = Problem(self.setting, problem.choices, rows, WHITE, problem.largest)
        end = self._with_states(local, x[:own])
        return np.asarray(local.run(part, end[np.newaxis], 0)[0])

    def problem_of(self, fit: StructureFit, choices: Sequence[Choice] | None = None) -> Problem:
        """Return the problem of a fit, or of the same rows with other effects."""
        return self._problem(fit.choices if choices is None else choices, fit.rows, WHITE, COARSE_STEP)

    def tangent(self, fit: StructureFit) -> Floats:
        """Return the derivative of the free run by all parameters, shape (n_samples, n_parameters)."""
        problem = self.problem_of(fit)
        points, moved = problem.shifted(fit.point, range(problem.size))
        outputs = self.runs(problem, points)
        return np.asarray(((outputs[1:] - outputs[0]) / moved[:, np.newaxis]).T)

    def runs(self, problem: Problem, points: Floats) -> Floats:
        """Return free runs over every row, experiments without rows of the fit from rest."""
        numbers = {part.start: number for number, part in enumerate(problem.parts)}
        return np.concatenate(
            [problem.run(part, points, numbers.get(part.start)) for part in self.record.slices], axis=1
        )

    def directions(self, fit: StructureFit, effect: Effect) -> list[Floats]:
        """Return how an effect, added to a fit, would change its free run."""
        from sysid.diagnosis.physics_directions import directions

        return directions(self, fit, effect)

    def finish(self, fit: StructureFit, noise: Floats) -> StructureFit:
        """Return a fit with standard errors of its parameters filled in."""
        problem = self._problem(fit.choices, fit.rows, noise, FINE_STEP)
        J = problem.jacobian(fit.point)
        error = problem.residual(fit.point)
        scale = np.linalg.norm(J, axis=0)
        lost = scale == 0.0
        scale[lost] = 1.0
        _, sizes, right = np.linalg.svd(J / scale, full_matrices=False)
        seen = sizes > 1e-9 * sizes.max(initial=0.0)
        spread = np.sqrt(float(error @ error) / max(error.size - problem.size, 1))
        errors = spread * np.linalg.norm(right[seen].T / sizes[seen], axis=1) / scale
        loose = lost | (np.abs(right[~seen]).max(axis=0, initial=0.0) > 1e-2)
        errors[loose] = np.inf
        return replace(fit, parameters=self._parameters(problem, fit.point, errors))

    def probes(self, fit: StructureFit) -> Floats:
        """Return directions in which an effect that is not in any list would show."""
        from sysid.diagnosis.physics_directions import probes

        return probes(self, fit)

    def equation(self, fit: StructureFit) -> str:
        """Return the model's equation with its effects, for a reader."""
        lines = [str(self.model)]
        for choice in fit.choices:
            values = ", ".join(f"{p.name} = {p.value:.4g}" for p in fit.parameters_of(choice.name))
            lines.append(f"{choice.name}: {choice.effect.equation}" + (f"  ({values})" if values else ""))
        return "\n".join(lines)


def band_limited(record: Record, rows: Mask) -> bool:
    """Tell whether the input has no power near the Nyquist frequency, as one that never was held has not."""
    u = record.u[rows, 0]
    spectrum = np.abs(np.fft.rfft((u - u.mean()) * np.hanning(u.size))) ** 2
    upper = spectrum[int(UPPER_FREQUENCY * spectrum.size) :]
    return bool(upper.sum() < UPPER_POWER * spectrum.sum())


def _cost(end: Minimum[Residual]) -> float:
    return end.cost


def _agree(ends: Sequence[Minimum[Residual]]) -> bool:
    """Tell whether the best end, first in the list, was found more than once."""
    return sum(_same(ends[0], end) for end in ends) > 1


def _different(ends: Sequence[Minimum[Residual]]) -> list[Minimum[Residual]]:
    """Leave out searches that have come to where a better one is already, or nearly so."""
    kept: list[Minimum[Residual]] = []
    for end in ends:
        if all(not _same(other, end) for other in kept):
            kept.append(end)
    return kept


def _same(best: Minimum[Residual], end: Minimum[Residual]) -> bool:
    """Tell whether two searches ended at the same error with the same output."""
    apart = float(np.linalg.norm(end.point.residual - best.point.residual))
    error = np.sqrt(best.cost)
    return bool(np.sqrt(end.cost) <= error * (1.0 + AGREEMENT) and apart <= OUTPUT_AGREEMENT * error)


def _setting(record: Record, model: Model, plant: Plant, free_start: bool) -> Setting:
    known = np.array([parameter.start for parameter in model.parameters])
    searched = tuple(parameter for parameter in model.parameters if parameter.status != "fixed")
    rows = record.learning
    y, u = record.y[rows, 0], record.u[rows, 0]
    part = record.slices[int(np.argmax([rows[part].sum() for part in record.slices]))]
    driven = record.u[part]
    states = np.empty((1, driven.shape[0], plant.order))
    with np.errstate(all="ignore"):
        run = plant.run(known[np.newaxis], NO_LAW[np.newaxis], driven, states=states)[0]
        pushed = plant.respond(known, driven[:, 0] - driven[:, 0].mean())
        factor = _size(y) / _size(run)
        state_sizes = np.array([_size(states[0, :, i]) for i in range(plant.order)]) * factor
        force = _size(u) * _size(y) / _size(pushed)
    port = plant.port
    sizes = {"u": _size(u), "y": _size(y), "F": force, "s": record.period * rows.sum(), "rad": 1.0}
    sizes["x"] = state_sizes[port.position] if port.position is not None else sizes["y"]
    sizes["v"] = state_sizes[port.velocity] if port.velocity is not None else sizes["y"]
    return Setting(record, plant, searched, known, free_start, sizes, state_sizes)


def _size(signal: Floats) -> float:
    """Return the standard deviation, or 1 where that says nothing."""
    size = float(np.std(signal))
    return size if np.isfinite(size) and size > 0.0 else 1.0


def _first_rows(rows: Mask, count: int) -> Mask:
    chosen = rows.copy()
    chosen[np.flatnonzero(rows)[count:]] = False
    return chosen
