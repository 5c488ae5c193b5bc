"""Linear difference equations with effects, as the decision logic sees them."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Effect, Floats
from sysid.diagnosis.linear.cells import within_cells
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.directions import directions_of
from sysid.diagnosis.linear.drives import MOST_DRIVES, too_many_drives
from sysid.diagnosis.linear.free_run import free_run
from sysid.diagnosis.linear.levenberg import Minimum, minimise
from sysid.diagnosis.linear.order import chosen_order
from sysid.diagnosis.linear.parameters import (
    equation_text,
    named_parameters,
    standard_errors,
    widened_by_memory,
)
from sysid.diagnosis.linear.probes import probe_directions
from sysid.diagnosis.linear.profile import MOST_ROWS
from sysid.diagnosis.linear.restarts import (
    exchanged_poles,
    from_poles,
    from_within_the_circle,
    restarted,
    with_best,
)
from sysid.diagnosis.linear.rows import Data, data_of, for_search, on_record
from sysid.diagnosis.linear.search import EffectSearch, Grid, agree, with_map_before
from sysid.diagnosis.linear.starts import further_starts
from sysid.diagnosis.linear.thresholds import cells_around, with_errors_of_thresholds
from sysid.diagnosis.structures.exercised import shows
from sysid.diagnosis.structures.memory import Fits, Memory, key_of
from sysid.diagnosis.structures.sides import with_forms_of
from sysid.diagnosis.structures.structure import WHITE, Choice, Complexes, Effort, StructureFit, kept_and_new
from sysid.diagnosis.structures.work import Steps, Work
from sysid.errors import DataError, UsageError
from sysid.linear.output_error import fit_output_error

TOO_MANY = f"a linear model takes at most {MOST_DRIVES} forces"
# Laws about a position of zero: seen from afar they are a bend of any shape, whatever bends.
CENTRED = ("gravity_sine", "cubic_stiffness")
# Up to this order poles are tried in other places.
MOST_EXCHANGED = 4
# Work of a whole search, in rows of runs and of lines of Jacobians, whatever the length of the record.  And
# what part of it each further order is given: there the first effects explain the record, or none.
WORK, FURTHER_ORDER = 320e6, 0.1


class LinearStructure:
    """A(q) z = B(q) x + constant with effects at its input, output and within.

    Parameters
    ----------
    record : Record
        With one input and one output.
    order : int, optional
        Degree of A and number of terms of B; chosen by the validation error if not given.
    initial_state : {"estimate", "rest"}
        With ``"estimate"`` each experiment has a start of its own and the equation a constant.

    Examples
    --------
    >>> from sysid.data import make_record
    >>> from sysid.diagnosis.effects import find_effects
    >>> u = np.random.default_rng(0).uniform(-1, 1, 300)
    >>> y = np.zeros(300)
    >>> for k in range(1, 300):
    ...     y[k] = 0.7 * y[k - 1] + np.clip(u[k - 1], -0.5, 0.5)
    >>> structure = LinearStructure(make_record(u, y, period=1.0), order=1, initial_state="rest")
    >>> rows = structure.record.estimation
    >>> (saturation,) = structure.offered(find_effects(["in_saturation"]))
    >>> choice = Choice(saturation, saturation.forms[0])
    >>> fit = structure.fit([choice], rows, WHITE, structure.baseline(rows), effort=Effort.FINE)
    >>> round(fit.parameters_of("in_saturation")[0].value, 6)
    0.5
    """

    name = "linear"

    def __init__(self, record: Record, order: int | None = None, *, initial_state: str = "estimate") -> None:
        if record.u.shape[1] != 1 or record.y.shape[1] != 1:
            channels = f"inputs {', '.join(record.inputs)} and outputs {', '.join(record.outputs)}"
            raise UsageError(
                f"the record has {channels}, diagnosis of a linear model takes one of each: choose them by "
                "--input and --output, or describe the plant as a physical model, which takes all inputs"
            )
        if initial_state not in ("estimate", "rest"):
            raise UsageError(f"initial_state is {initial_state!r}: choose 'estimate' or 'rest'")
        self.record = record
        self.free_start = initial_state == "estimate"
        self.initial_state = initial_state
        self._data = lru_cache(maxsize=16)(lambda rows: data_of(record, np.frombuffer(rows, dtype=bool)))
        self.order = chosen_order(record, self._of_order) if order is None else order
        self._baselines: dict[bytes, Floats] = {}
        self._fits, self._grids = Fits(), Memory[Grid]()
        self.work = Work(WORK)

    def on(self, record: Record) -> "LinearStructure":
        """Return the same structure, of the same order, for another record."""
        return LinearStructure(record, self.order, initial_state=self.initial_state)

    def of_order(self, order: int) -> "LinearStructure":
        """Return the structure of another order, whose search is given less work, or is given up."""
        other = LinearStructure(self.record, order, initial_state=self.initial_state)
        other.work = Work(FURTHER_ORDER * self.work.given, whole=True)
        return other

    def offered(self, effects: Sequence[Effect]) -> tuple[Effect, ...]:
        """Return the effects that make sense for a linear difference equation, in the given order."""
        same = {"out_delay": "in_delay"}  # a linear model cannot tell them apart
        if self.free_start:
            same["constant_force"] = ""  # the constant is in the model
        names = {effect.name for effect in effects}
        return tuple(
            effect.within("linear", self.free_start)
            for effect in effects
            if "linear" in effect.families
            and not (effect.name in same and same[effect.name] in names | {""})
            and not (effect.name in CENTRED and self._far_from_zero())
            and shows(self.record, effect)
        )

    def _far_from_zero(self) -> bool:
        """Tell whether zero is farther from the measured output than all that it moves."""
        y = self.record.y[self.record.learning, 0]
        low, high = float(np.nanmin(y)), float(np.nanmax(y))
        return max(low, -high) > high - low

    def baseline(self, rows: Mask) -> StructureFit:
        """Fit the model without effects, from several starts."""
        fit = fit_output_error(self.record, self.order, initial_state=self.initial_state, rows=rows)
        data, chain = self.data(rows), self.chain(())
        point = np.zeros(chain.size(data))
        point[: 2 * self.order] = np.concatenate([fit.a[1:], fit.b[0]])
        if chain.constant:
            point[2 * self.order] = fit.constant
        point = with_best(chain, data, point, np.arange(point.size) >= 2 * self.order)
        minimum = minimise(chain, data, point, WHITE)
        if minimum is None:
            minimum = from_within_the_circle(chain, data, point)
        if minimum is None:
            raise DataError("the baseline diverges in simulation: give another --order")
        if fit.restarts_agree:
            return self._fitted(chain, data, rows, minimum, True, fit.status)
        minimum, agree = restarted(chain, data, minimum)
        end = (
            "restarts from moved parameters agree"
            if agree
            else "restarts from moved parameters end elsewhere"
        )
        return self._fitted(chain, data, rows, minimum, agree, end)

    def directions(self, fit: StructureFit, effect: Effect) -> list[Floats]:
        """Return how an effect would change the free run of a fit, at a grid of its shapes."""
        chain, data, point = self._learning(fit)
        return [self._on_record(lines) for lines in directions_of(chain, data, point, effect)]

    def tangent(self, fit: StructureFit) -> Floats:
        """Return the derivative of the free run by all parameters, shape (n_samples, n_parameters)."""
        chain, data, point = self._learning(fit)
        run = chain.run(data, point)
        if run is None:
            return np.zeros((self.record.n_samples, point.size))
        return self._on_record(chain.jacobian(data, point, run))

    def probes(self, fit: StructureFit) -> Floats:
        """Return directions in which an effect that is not in any list would show."""
        return self._on_record(probe_directions(*self._learning(fit)))

    def earlier_probes(self, fit: StructureFit) -> Floats:
        """Return directions that hold the input of earlier rows only, as an effect of the plant does."""
        return self._on_record(probe_directions(*self._learning(fit), since=1))

    def _learning(self, fit: StructureFit) -> tuple[Chain, Data, Floats]:
        """Return chain and point of a fit on all rows that may be learnt from."""
        chain, data = self.chain(fit.choices), self.data(self.record.learning)
        return chain, data, self._carried(fit, chain, data)

    def _on_record(self, lines: Floats) -> Floats:
        return on_record(self.record, lines, self.record.learning)

    def fit(
        self, choices: Sequence[Choice], rows: Mask, noise: Floats, start: StructureFit, *, effort: Effort
    ) -> StructureFit:
        """Fit the model with these effects, from a fit with fewer, other or the same effects."""
        return self._fits.fitted(self._counted, choices, rows, noise, start, effort)

    def _counted(
        self, choices: Sequence[Choice], rows: Mask, noise: Floats, start: StructureFit, effort: Effort
    ) -> StructureFit:
        steps = Steps()
        fit = self._fit(choices, rows, noise, start, effort, steps)
        self.work.note(key_of(choices, rows, noise, start, effort), steps.taken)
        return fit

    def _fit(
        self,
        choices: Sequence[Choice],
        rows: Mask,
        noise: Floats,
        start: StructureFit,
        effort: Effort,
        steps: Steps,
    ) -> StructureFit:
        if effort is Effort.REFIT:
            places = self.chain(start.choices).places(self.data(start.rows))
            start = with_forms_of(choices, start, places)
        kept, new = kept_and_new(choices, start, effort)
        gone = any(c not in choices for c in start.choices)
        if too_many_drives(choices):
            return replace(start, choices=tuple(choices), cost=np.inf, converged=False, status=TOO_MANY)
        data = self.data(rows)
        chain = self.chain(kept, steps)
        point = self._carried(start, chain, data)
        if not new or gone:
            minimum = self._polished(chain, data, point, noise)
            if gone:
                # Without the effect that was left out its equation may be another, or not be stable.
                again = self._polished(chain, data, self._from_baseline(point, rows), noise)
                if minimum is None or (again is not None and again.cost < minimum.cost):
                    minimum = again
            if not choices and minimum is not None:
                minimum = self._with_other_poles(chain, data, minimum, noise)
            if minimum is not None:
                point = minimum.point
        agree = start.restarts_agree
        for choice in new:
            there = (*chain.choices, choice)
            chain = self.chain([each for each in choices if each in there], steps)
            minimum, agree = self._searched(chain, choice, data, rows, point, noise, effort)
            point = point if minimum is None else minimum.point
            if minimum is None:
                break
        if minimum is None:
            return replace(start, choices=tuple(choices), cost=np.inf, converged=False, status="it diverges")
        if not new and not np.array_equal(rows, start.rows):
            minimum = cells_around(chain, data, minimum, noise)
        if effort != 1:  # a ranking can do without
            minimum = within_cells(chain, data, minimum, noise)
        end = "the search came to rest" if minimum.converged else "the search was still moving"
        status = f"{end}; " + ("several starts agree" if agree else "other starts ended elsewhere")
        return self._fitted(chain, data, rows, minimum, agree, status)

    def _with_other_poles(self, chain: Chain, data: Data, minimum: Minimum, noise: Floats) -> Minimum:
        """Return the model without effects that is likeliest under coloured noise.

        A plain fit takes slow noise for a slow pole, and from there no search under the noise's colour comes
        back.  Effects would be credited with what other poles do.
        """
        if noise.size == 1 or self.order > MOST_EXCHANGED or data.u.size > MOST_ROWS:
            return minimum
        ends = (from_poles(chain, data, minimum.point, poles, noise)
                for poles in exchanged_poles(minimum.point, self.order))  # fmt: skip
        return min([minimum, *(end for end in ends if end is not None)], key=lambda end: end.cost)

    def _from_baseline(self, point: Floats, rows: Mask) -> Floats:
        """Return a point with the coefficients of the model without effects."""
        key = rows.tobytes()
        if key not in self._baselines:
            self._baselines[key] = self.baseline(rows).point[: 2 * self.order]
        moved = point.copy()
        moved[: 2 * self.order] = self._baselines[key]
        return moved

    def _searched(
        self, chain: Chain, new: Choice, data: Data, rows: Mask, point: Floats, noise: Floats, effort: Effort
    ) -> tuple[Minimum | None, bool]:
        """Search an effect of a chain, from a point without it, on part of the rows; polish on all."""
        part, which = for_search(data, self.free_start), chain.choices.index(new)
        names = tuple((choice.name, choice.form.name) for choice in chain.choices)
        key = which, names, rows.tobytes(), noise.tobytes(), point.tobytes()

        def searched() -> Grid:
            fitted = chain.steps.taken
            starts = [point, *further_starts(chain, part, point, which)]
            grid = EffectSearch(chain, part, noise, starts, which=which).searched()
            self.work.note(key, chain.steps.taken - fitted)
            chain.steps.taken = fitted
            return grid

        grid = self._grids.recalled(key, searched)
        ends = EffectSearch(chain, part, noise, grid.starts, grid.found, which).search(effort)
        if not ends:
            return None, False
        ends = with_map_before(chain, part, noise, which, ends, effort)
        if part is data:
            return ends[0], agree(ends)
        return self._polished(chain, data, ends[0].point, noise), agree(ends)

    def _polished(self, chain: Chain, data: Data, point: Floats, noise: Floats) -> Minimum | None:
        """Minimise over all that the output follows smoothly."""
        return minimise(chain, data, point, noise, free=chain.smooth(data), iterations=40)

    def finish(
        self, fit: StructureFit, noise: Floats, *, plain: bool = False, closely: bool = False
    ) -> StructureFit:
        """Return a fit with standard errors of its parameters filled in.

        A close look may meet a model that is far more likely, which then takes its place, unless its free run
        is farther from the rows: what is likely by the colour of a residual alone follows what it leaves out.
        """
        data, chain, weight = self.data(fit.rows), self.chain(fit.choices), WHITE if plain else noise
        closely &= not plain  # a rise of plain errors is no likelihood
        errors, lower = standard_errors(chain, data, fit.point, weight, fit.cost, closely=closely)
        if lower is not None:
            minimum = self._polished(chain, data, lower, weight)
            if minimum is not None and minimum.cost < fit.cost:
                moved = self._fitted(chain, data, fit.rows, minimum, False, fit.status)
                if moved.usable and self._error(moved) <= self._error(fit):
                    fit = moved
                    errors, _ = standard_errors(chain, data, fit.point, weight, fit.cost, closely=True)
        if plain and noise.size > 1:
            errors *= widened_by_memory(chain, data, fit.point, noise)
        errors = with_errors_of_thresholds(chain, data, fit.point, noise, errors)
        return replace(fit, parameters=named_parameters(self.record, chain, data, fit.point, errors))

    def _error(self, fit: StructureFit) -> float:
        """Return the mean square of the free-run error on the rows of a fit."""
        return float(np.mean((self.record.y[:, 0] - fit.output)[fit.rows] ** 2))

    def respond(self, fit: StructureFit, u: Floats) -> tuple[Floats, Floats]:
        """Return the free run from rest for an input, and its derivative by all parameters.

        Shapes (n_samples,) and (n_samples, n_parameters); infinite where the run diverges.
        """
        choices = self.chain(fit.choices).choices
        chain, data = Chain(self.order, choices, self.free_start, False), self.data(fit.rows)
        shared, own = 2 * self.order + int(chain.constant), self.chain(fit.choices).n_linear(data)
        point = np.concatenate([fit.point[:shared], fit.point[own:]])
        begin = np.array([0, u.size])
        chosen = Data(u, np.zeros(u.size), np.ones(u.size, dtype=bool), begin, self.record.period)
        run = chain.run(chosen, point)
        if run is None:
            return np.full(u.size, np.inf), np.zeros((u.size, point.size))
        return run.y, chain.jacobian(chosen, point, run).T

    def poles(self, fit: StructureFit) -> Complexes:
        """Return the poles [1/s] of the model without effects."""
        roots = np.roots([1.0, *fit.point[: self.order]]).astype(complex)
        return np.asarray(np.log(roots[roots != 0.0]) / self.record.period)

    def equation(self, fit: StructureFit) -> str:
        """Return the model's equation with its effects, for a reader."""
        return equation_text(self.order, self.free_start, fit.point, fit.laws)

    def chain(self, choices: Sequence[Choice], steps: Steps | None = None) -> Chain:
        """Return the model with effects; noise is not part of it."""
        kept = tuple(choice for choice in choices if choice.effect.port != "noise")
        return Chain(self.order, kept, self.free_start, self.free_start, steps)

    def data(self, rows: Mask) -> Data:
        """Return the experiments with chosen rows, each up to its last chosen one."""
        return self._data(rows.tobytes())

    def _carried(self, fit: StructureFit, chain: Chain, data: Data) -> Floats:
        """Return the point of a fit for a chain with some of its effects and for other rows."""
        old, old_data = self.chain(fit.choices), self.data(fit.rows)
        point = np.zeros(chain.size(data))
        shared = 2 * self.order + int(chain.constant)
        point[:shared] = fit.point[:shared]
        if self.free_start:
            starts = min(chain.n_linear(data), old.n_linear(old_data))
            point[shared:starts] = fit.point[shared:starts]
        places = dict(zip(old.choices, old.places(old_data), strict=True))
        for choice, place in zip(chain.choices, chain.places(data), strict=True):
            if choice in places:
                point[place] = fit.point[places[choice]]
        return point

    def _fitted(
        self, chain: Chain, data: Data, rows: Mask, minimum: Minimum, agree: bool, status: str
    ) -> StructureFit:
        return StructureFit(
            choices=chain.choices,
            point=minimum.point,
            parameters=named_parameters(
                self.record, chain, data, minimum.point, np.full(minimum.point.size, np.nan)
            ),
            output=free_run(self.record, chain, data, rows, minimum.point),
            rows=rows,
            cost=minimum.cost,
            n_parameters=minimum.point.size,
            converged=minimum.converged,
            restarts_agree=agree,
            status=status,
        )

    def _of_order(self, order: int) -> StructureFit:
        """Return the model without effects of an order, which becomes the structure's."""
        self.order = order
        return self.baseline(self.record.estimation)
