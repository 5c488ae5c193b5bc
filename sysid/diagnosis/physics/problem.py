"""The least-squares problem of a physical model with effects: free-run error over all unknowns."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.budget import Budget
from sysid.diagnosis.physics.evaluation import Evaluation
from sysid.diagnosis.physics.laws import INNER, coefficients, own_law
from sysid.diagnosis.physics.setting import Setting
from sysid.diagnosis.physics.unknowns import bounds_of, sizes_of
from sysid.diagnosis.structures.noise_filter import filtered_lines
from sysid.diagnosis.structures.structure import WHITE, Choice, StructureFit, filtered
from sysid.diagnosis.structures.whitening import opening
from sysid.errors import UsageError
from sysid.separable.descent import Minimum, Residual, descend

Met = Callable[[Residual], bool]
# Fastest rate times the Runge-Kutta step in a search: a run's relative error is its fourth power / 120 or so.
COARSE_STEP = 0.35
# What a step with laws costs, one with dry friction, one of a plant that is simulated run by run, a run, and
# a row of it, in steps of a run without laws.
LAW_STEP, DRY_STEP, GENERAL_STEP, RUN, ROW = 2, 6, 5, 20_000, 25
# States of the plants whose steps count as one; those of more cost as much more.
USUAL_ORDER = 2
# Step of the difference quotients, relative to the size of the unknown: truncation and rounding both
# stay below 1e-5 of the derivative.
DIFFERENCE = 1e-6
# An unknown near zero is moved as one of this share of its typical size.
SMALLEST_SHARE = 1e-2


class Problem:
    """Residual and Jacobian over a point [model parameters, effect parameters, initial states].

    Parameters
    ----------
    setting : Setting
    choices : sequence of Choice
        Effects in the model.
    rows : ndarray of bool, shape (n_samples,)
        Rows that count.
    noise : ndarray
        D(q) by which the residual is filtered.
    largest : float
        Largest product of the model's fastest rate and the Runge-Kutta step.
    free_start : bool, optional
        As the setting has it by default.
    budget : Budget, optional
        Of all problems of one fit.
    """

    def __init__(
        self,
        setting: Setting,
        choices: Sequence[Choice],
        rows: Mask,
        noise: Floats,
        largest: float,
        free_start: bool | None = None,
        budget: Budget | None = None,
    ) -> None:
        self.setting, self.choices, self.rows, self.noise = setting, tuple(choices), rows, noise
        self.largest = largest
        self.budget = Budget() if budget is None else budget
        self.free_start = setting.free_start if free_start is None else free_start
        record = setting.record
        self.parts = [part for part in record.slices if rows[part].any()]
        # Nothing after the last row that counts is simulated.
        self.parts = [
            slice(part.start, part.start + int(np.flatnonzero(rows[part])[-1]) + 1) for part in self.parts
        ]
        self.target = filtered(np.where(rows, record.y[:, 0], 0.0), rows, noise)
        counts = [len(choice.form.parameters) for choice in self.choices]
        n = len(setting.searched)
        self.effect_places = [
            slice(n + sum(counts[:i]), n + sum(counts[: i + 1])) for i in range(len(counts))
        ]
        self.n_model, self.n_effects = n, sum(counts)
        self.n_starts = setting.plant.order * len(self.parts) if self.free_start else 0
        # Effects of strength zero are simulated as the others are, or their difference would be the steps'.
        self.own = own_law(self.choices)
        self.exact = not any(choice.effect.port in INNER for choice in self.choices)
        self.held = np.zeros(self.size, dtype=bool)
        dry = any(choice.effect.dry for choice in self.choices)
        self._weight = 1 if self.exact else (DRY_STEP if dry else LAW_STEP)
        if setting.plant.always_steps:
            self._weight = GENERAL_STEP

    @cached_property
    def run_edges(self) -> NDArray[np.int64]:
        """First place, among the rows that count, of each run of rows that follow one another; the end."""
        places = np.flatnonzero(self.rows)
        first = np.flatnonzero(np.diff(places, prepend=-2) != 1)
        return np.append(first, places.size).astype(np.int64)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.n_model + self.n_effects + self.n_starts

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """Bounds of a point."""
        return bounds_of(self.setting, self.choices, self.n_starts)

    @cached_property
    def sizes(self) -> Floats:
        """Typical size of each unknown: 1 for logarithms."""
        return sizes_of(self.setting, self.choices, len(self.parts) if self.free_start else 0)

    def outputs(self, points: Floats, *, rounded: bool = True) -> Floats:
        """Return the free run on the rows that count, unfiltered, shape (lanes, n_rows)."""
        runs = [
            self.run(part, points, number, rounded=rounded)[:, chosen]
            for number, (part, chosen) in enumerate(zip(self.parts, self._chosen, strict=True))
        ]
        return runs[0] if len(runs) == 1 else np.concatenate(runs, axis=1)

    @cached_property
    def _chosen(self) -> list[Any]:
        """Rows that count in each part: a slice, which copies nothing, where they follow one another."""
        found: list[Any] = []
        for part in self.parts:
            rows = np.flatnonzero(self.rows[part])
            unbroken = rows.size == rows[-1] + 1 - rows[0]
            found.append(slice(int(rows[0]), int(rows[-1]) + 1) if unbroken else self.rows[part])
        return found

    def run(
        self,
        part: slice,
        points: Floats,
        number: int | None,
        states: Floats | None = None,
        *,
        rounded: bool = True,
    ) -> Floats:
        """Simulate one experiment for several points, shape (lanes, n_rows).

        ``number`` says whose initial state in the point counts; None for rest.  Unless ``rounded``,
        sensors that jump and follow their input on the whole are left out, as derivatives want it.
        """
        setting = self.setting
        plant = setting.plant
        u = setting.record.u[part]
        # What only the sensor sees leaves the plant's run as it is.
        which, own = self._distinct(points) if states is None else (None, points)
        lanes = own.shape[0]
        effects = self._effects(points)
        inside = effects if which is None else self._effects(own)
        values = np.empty((lanes, setting.known.size))
        values[:] = setting.known
        values[:, setting.places] = setting.to_values(own[:, : self.n_model])
        laws, starts = self._laws(inside), self._starts(own, number)
        driven = self._inputs(u, inside)
        steps, pace = self._steps(values[0])
        if pace > self.budget.fastest or not np.isfinite(pace):
            return np.full((points.shape[0], u.shape[0]), np.nan)
        self.budget.left -= lanes * u.shape[0] * steps
        stepped = lanes * u.shape[0] * steps * self._weight * max(plant.order / USUAL_ORDER, 1.0)
        self.budget.work += int(stepped) + RUN + ROW * u.shape[0]
        y = plant.run(values, laws, driven, starts, steps, states, self.exact, self.own)
        if which is not None:
            y, driven = y[which], driven if driven.ndim == 2 else driven[which]
        return self._outputs(y, u, driven, effects, rounded)

    def _distinct(self, points: Floats) -> tuple[list[int] | None, Floats]:
        """Return which run is each point's, None where all differ, and the points that run differently."""
        if self._inner.all():
            return None, points
        found: dict[bytes, int] = {}
        which = [found.setdefault(key.tobytes(), len(found)) for key in points[:, self._inner]]
        if len(found) == len(which):
            return None, points
        first = dict(zip(reversed(which), reversed(range(len(which))), strict=True))
        return which, points[[first[number] for number in range(len(found))]]

    def _effects(self, points: Floats) -> list[list[Floats]]:
        """Return the parameters of each effect in each point."""
        return [[point[place] for place in self.effect_places] for point in points]

    @cached_property
    def _inner(self) -> NDArray[np.bool_]:
        """Unknowns that change the plant's run, not only what is added to it or the sensor."""
        inner = np.ones(self.size, dtype=bool)
        for choice, place in zip(self.choices, self.effect_places, strict=True):
            inner[place] = choice.effect.port not in ("output", "parallel")
        return inner

    def _starts(self, points: Floats, number: int | None) -> Floats | None:
        """Return the initial states of an experiment in some points; None for rest."""
        if not self.free_start or number is None:
            return None
        first = self.n_model + self.n_effects + number * self.setting.plant.order
        return points[:, first : first + self.setting.plant.order]

    def moved_by_input(self, part: slice, number: int | None, point: Floats, signals: Floats) -> Floats:
        """Return how an experiment's free run changes with small signals added to the plant's input.

        Shape (n_signals, n_rows); sensors that jump are left out.  ``number`` as for `run`.
        """
        setting, plant = self.setting, self.setting.plant
        lanes = signals.shape[0] + 1
        values = np.tile(setting.known, (lanes, 1))
        values[:, setting.places] = setting.to_values(point[: self.n_model])
        effects = [[point[place] for place in self.effect_places]] * lanes
        laws = self._laws(effects)
        u = setting.record.u[part]
        driven = self._inputs(u, effects)
        driven = np.tile(driven, (lanes, 1, 1)) if driven.ndim == 2 else driven
        driven[1:, :, 0] += signals
        steps, _ = self._steps(values[0])
        starts = self._starts(np.tile(point, (lanes, 1)), number)
        runs = plant.run(values, laws, driven, starts, steps, None, self.exact, self.own)
        y = self._outputs(runs, u, driven, effects, False)
        return np.asarray(y[1:] - y[0])

    def _laws(self, effects: Sequence[Sequence[Floats]]) -> Floats:
        """Return the law of each lane; most lanes of a Jacobian share theirs."""
        found: dict[bytes, Floats] = {}
        lanes = []
        for parameters in effects:
            key = b"".join(own.tobytes() for own in parameters)
            if key not in found:
                found[key] = coefficients(self.choices, parameters)
            lanes.append(found[key])
        return np.array(lanes)

    def _inputs(self, u: Floats, effects: Sequence[Sequence[Floats]]) -> Floats:
        """Send the first input through the effects at the input, if there are any."""
        own = [i for i, choice in enumerate(self.choices) if choice.effect.port == "input"]
        if not own:
            return u
        found: dict[bytes, Floats] = {}
        lanes = []
        for parameters in effects:
            key = b"".join(parameters[i].tobytes() for i in own)
            if key not in found:  # most lanes of a Jacobian share their input
                signal = np.ascontiguousarray(u[:, 0])
                for i in own:
                    signal = self._applied(i, signal, parameters[i])
                found[key] = signal
            lanes.append(found[key])
        if len(found) == 1 and u.shape[1] == 1:
            return lanes[0][:, np.newaxis]
        driven = np.tile(u, (len(effects), 1, 1))
        driven[:, :, 0] = lanes
        return driven

    def _outputs(
        self, y: Floats, u: Floats, driven: Floats, effects: Sequence[Sequence[Floats]], rounded: bool
    ) -> Floats:
        """Send the output through the sensor's effects, after what runs beside the model is added."""
        beside = [i for i, choice in enumerate(self.choices) if choice.effect.port == "parallel"]
        sensor = [
            i
            for i, choice in enumerate(self.choices)
            if choice.effect.port == "output" and (rounded or not choice.form.jumps)
        ]
        for lane, parameters in enumerate(effects if beside or sensor else ()):
            signal = y[lane]
            for i in beside:
                given = u if not self.choices[i].form.behind else driven[lane] if driven.ndim == 3 else driven
                signal = signal + self._applied(i, np.ascontiguousarray(given[:, 0]), parameters[i])
            for i in sensor:
                signal = self._applied(i, signal, parameters[i])
            y[lane] = signal
        return y

    def _applied(self, effect: int, signal: Floats, parameters: Floats) -> Floats:
        apply = self.choices[effect].form.apply
        assert apply is not None
        flags = signal.flags
        if not (flags.c_contiguous and flags.writeable):  # a kernel is compiled for one kind of array
            signal = signal.copy()
        return apply(signal, parameters, self.setting.record.period)

    def errors(self, points: Floats, *, rounded: bool = True) -> Floats:
        """Return the filtered residual of several points, shape (lanes, n_rows)."""
        outputs = self.outputs(points, rounded=rounded)
        out = outputs
        if self.noise.size > 1:
            out = filtered_lines(
                np.ascontiguousarray(outputs), self.run_edges, self.noise, opening(self.noise)
            )
        out -= self.target
        return out

    def residual(self, point: Floats) -> Floats:
        """Return the filtered residual, model less measurement."""
        return np.asarray(self.errors(point[np.newaxis])[0])

    def cost(self, point: Floats) -> float:
        """Return the sum of its squares; infinite where the model diverges."""
        error = self.residual(point)
        with np.errstate(all="ignore"):
            cost = float(error @ error)
        return cost if np.isfinite(cost) else np.inf

    def shifted(self, point: Floats, columns: Sequence[int]) -> tuple[Floats, Floats]:
        """Return the point and copies with one unknown moved in each, and how far."""
        _, upper = self.bounds
        step = DIFFERENCE * np.maximum(np.abs(point), self._smallest)
        step[: self.n_model] = np.where(self.setting.positive, DIFFERENCE, step[: self.n_model])
        step = np.where(point + step > upper, -step, step)
        own = np.asarray(columns, dtype=np.intp)
        points = np.empty((1 + own.size, point.size))
        points[:] = point
        lanes = np.arange(own.size)
        points[1 + lanes, own] += step[own]
        return points, points[1 + lanes, own] - point[own]

    @cached_property
    def _smallest(self) -> Floats:
        """Sizes below which an unknown is moved as one of this size."""
        return SMALLEST_SHARE * self.sizes

    def jacobian(self, point: Floats) -> Floats:
        """Return the derivative of the residual by difference quotients; zero for what is held."""
        columns = np.flatnonzero(~self.held)
        points, moved = self.shifted(point, columns.tolist())
        return self._quotients(self.errors(points, rounded=False), moved)

    def _quotients(self, errors: Floats, moved: Floats) -> Floats:
        slopes: Floats = errors[1:] - errors[0]
        slopes /= moved[:, np.newaxis]
        if not self.held.any():
            return np.asarray(slopes.T)
        lines = np.zeros((self.size, errors.shape[1]))
        lines[~self.held] = slopes
        return lines.T

    def with_derivative(self, point: Floats) -> tuple[Floats, Floats]:
        """Return residual and Jacobian from runs side by side, which take little longer than one alone."""
        points, moved = self.shifted(point, np.flatnonzero(~self.held).tolist())
        errors = self.errors(points)
        return errors[0], self._quotients(errors, moved)

    @cached_property
    def jumps(self) -> bool:
        """Whether a sensor jumps, so that derivatives are taken without it."""
        return any(choice.effect.port == "output" and choice.form.jumps for choice in self.choices)

    @cached_property
    def steps_of_an_evaluation(self) -> float:
        """Steps that a residual with its Jacobian takes at the start values."""
        return self.steps_at(self.setting.nominal)

    def steps_at(self, point: Floats) -> float:
        """Return the steps that a residual with its Jacobian takes at a point, or one of another problem."""
        rows = sum(part.stop - part.start for part in self.parts)
        return float((1 + self.size) * rows * self._steps(self.setting.values_of(point))[0])

    def pace_at(self, point: Floats) -> float:
        """Return the plant's fastest rate in a sample at a point, or one of another problem."""
        return self._steps(self.setting.values_of(point))[1]

    def _steps(self, values: Floats) -> tuple[int, float]:
        """Return the steps between two rows, and the plant's fastest rate in a sample where they tell."""
        plant = self.setting.plant
        return plant.substeps(values, self.largest) if plant.always_steps or not self.exact else (1, 0.0)

    def descend_if_finite(
        self, point: Floats, evaluations: int, tolerance: float, met: Met | None = None
    ) -> Minimum[Residual] | None:
        """Search on from a point; None if the model diverges there."""
        try:
            return self.descend(point, evaluations, tolerance, met)
        except UsageError:
            return None

    def descend(
        self, point: Floats, evaluations: int, tolerance: float, met: Met | None = None
    ) -> Minimum[Residual]:
        """Search on by Levenberg and Marquardt's method until the cost falls by a negligible share.

        ``met`` as for `sysid.separable.descent.descend`.
        """
        lower, upper = self.bounds
        most = self.budget.evaluations(evaluations, self.steps_of_an_evaluation)
        with np.errstate(all="ignore"):
            return descend(
                Evaluation(self, most),
                np.clip(point, lower, upper),
                bounds=(lower, upper),
                negligible=tolerance,
                max_evaluations=most,
                met=met,
            )


def problem_of(setting: Setting, fit: StructureFit, choices: Sequence[Choice] | None = None) -> Problem:
    """Return the problem of a fit, or of the same rows with other effects."""
    return Problem(setting, fit.choices if choices is None else choices, fit.rows, WHITE, COARSE_STEP)
