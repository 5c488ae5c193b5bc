"""Linear difference equations with effects, as the decision logic sees them."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Effect, EffectParameter, Floats
from sysid.diagnosis.levenberg import Minimum, minimise
from sysid.diagnosis.linear_chain import MOST_DRIVES, Chain, Data
from sysid.diagnosis.linear_probes import probe_directions
from sysid.diagnosis.linear_search import EffectSearch
from sysid.diagnosis.linear_starts import further_starts
from sysid.diagnosis.structures import Choice, FittedParameter, StructureFit
from sysid.errors import DataError, UsageError
from sysid.linear.output_error import fit_output_error
from sysid.linear.simulation import first_rows

WHITE = np.ones(1)
TOO_MANY = f"a linear model takes at most {MOST_DRIVES} forces"
# A search runs on at most this many rows; its end is polished on all of them.
SEARCH_ROWS = 6000
HIGHEST_ORDER = 6
# A higher order must lower the validation error by at least this share.
WORTHWHILE = 0.02
# Searches agree when their root mean square errors differ by this share.
AGREEMENT = 1e-3
RESTARTS, SPREADS, RESTART_SEED = 12, (0.4, 0.15, 0.05), 3


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
    >>> fit = structure.fit([choice], rows, WHITE, structure.baseline(rows), effort=2)
    >>> round(fit.parameters_of("in_saturation")[0].value, 6)
    0.5
    """

    name = "linear"

    def __init__(self, record: Record, order: int | None = None, *, initial_state: str = "estimate") -> None:
        if record.u.shape[1] != 1 or record.y.shape[1] != 1:
            raise UsageError(
                f"the record has {record.u.shape[1]} inputs and {record.y.shape[1]} outputs: diagnosis of a "
                "linear model takes one of each"
            )
        if initial_state not in ("estimate", "rest"):
            raise UsageError(f"initial_state is {initial_state!r}: choose 'estimate' or 'rest'")
        self.record = record
        self.free_start = initial_state == "estimate"
        self.initial_state = initial_state
        self.order = self._chosen_order() if order is None else order
        self._data = lru_cache(maxsize=16)(self._make_data)
        self._baselines: dict[bytes, Floats] = {}

    def on(self, record: Record) -> "LinearStructure":
        """Return the same structure, of the same order, for another record."""
        return LinearStructure(record, self.order, initial_state=self.initial_state)

    def offered(self, effects: Sequence[Effect]) -> tuple[Effect, ...]:
        """Return the effects that make sense for a linear difference equation, in the given order."""
        same = {"out_delay": "in_delay"}  # a linear model cannot tell them apart
        if self.free_start:
            same["constant_force"] = ""  # the constant is in the model
        names = {effect.name for effect in effects}
        return tuple(
            effect
            for effect in effects
            if "linear" in effect.families and not (effect.name in same and same[effect.name] in names | {""})
        )

    def baseline(self, rows: Mask) -> StructureFit:
        """Fit the model without effects, from several starts."""
        fit = fit_output_error(self.record, self.order, initial_state=self.initial_state, rows=rows)
        data, chain = self.data(rows), self.chain(())
        point = np.zeros(chain.size(data))
        point[: 2 * self.order] = np.concatenate([fit.a[1:], fit.b[0]])
        if chain.constant:
            point[2 * self.order] = fit.constant
        free = np.arange(point.size) >= 2 * self.order
        minimum = minimise(chain, data, point, WHITE, free=free, iterations=3) if free.any() else None
        minimum = minimise(chain, data, point if minimum is None else minimum.point, WHITE)
        if minimum is None:
            raise DataError("the baseline diverges in simulation: give another --order")
        if fit.restarts_agree:
            return self._fitted(chain, data, rows, minimum, True, fit.status)
        minimum, agree = self._restarted(chain, data, minimum)
        end = (
            "restarts from moved parameters agree"
            if agree
            else "restarts from moved parameters end elsewhere"
        )
        return self._fitted(chain, data, rows, minimum, agree, end)

    def _restarted(self, chain: Chain, data: Data, best: Minimum) -> tuple[Minimum, bool]:
        """Search again from moved parameters; tell whether another search ends at the least cost."""
        rng, ends = np.random.default_rng(RESTART_SEED), [best]
        for _ in range(2):
            # Where the best of the first searches stands alone, more set out from there.
            for spread in (SPREADS[number % len(SPREADS)] for number in range(RESTARTS)):
                end = self._from_moved_poles(chain, data, ends[0].point, spread, rng)
                if end is not None:
                    ends.append(end)
            ends.sort(key=lambda end: end.cost)
            if _found_again(ends):
                break
        return ends[0], _found_again(ends)

    def _from_moved_poles(
        self, chain: Chain, data: Data, point: Floats, spread: float, rng: np.random.Generator
    ) -> Minimum | None:
        """Search from poles whose time constants are stretched at random, conjugate ones alike."""
        n = self.order
        poles = np.roots(np.concatenate([[1.0], point[:n]])).astype(complex)
        stretch = np.exp(spread * rng.standard_normal(n))
        stretch = np.where(poles.imag != 0.0, stretch[0], stretch)
        moved = np.exp(np.log(np.where(poles == 0.0, 1e-6, poles)) * stretch)
        start = point.copy()
        start[:n] = np.real(np.poly(moved))[1:]
        linear = np.arange(start.size) >= n
        end = minimise(chain, data, start, WHITE, free=linear, iterations=2)
        return None if end is None else minimise(chain, data, end.point, WHITE)

    def directions(self, fit: StructureFit, effect: Effect) -> list[Floats]:
        """Return how an effect would change the free run of a fit, at a grid of its shapes."""
        rows = self.record.learning
        data, chain = self.data(rows), self.chain(fit.choices)
        point = self._carried(fit, chain, data)
        base = chain.run(data, point)
        if base is None or effect.port == "noise" or _too_many((*fit.choices, *_as_choices(effect))):
            return []
        found = []
        for form in effect.forms:
            extended = self.chain((*fit.choices, Choice(effect, form)))
            search = EffectSearch(extended, data, WHITE, [point])
            strengths = [i for i, p in enumerate(form.parameters) if p.is_strength]
            if len(search.grids) > 1 and not strengths and len(effect.forms) > 1:
                continue  # the symmetric form stands for the two-sided one
            for shapes in search.grid_points():
                start = search.joined(point, shapes)
                run = extended.run(data, start)
                if run is None:
                    continue
                if strengths:
                    columns = extended.jacobian(data, start, run)[-len(form.parameters) :][strengths]
                else:
                    columns = (run.y - base.y)[np.newaxis]
                found.append(self._on_record(columns, rows))
        return found

    def tangent(self, fit: StructureFit) -> Floats:
        """Return the derivative of the free run by all parameters, shape (n_samples, n_parameters)."""
        data, chain = self.data(self.record.learning), self.chain(fit.choices)
        point = self._carried(fit, chain, data)
        run = chain.run(data, point)
        if run is None:
            return np.zeros((self.record.n_samples, point.size))
        return self._on_record(chain.jacobian(data, point, run), self.record.learning)

    def fit(
        self, choices: Sequence[Choice], rows: Mask, noise: Floats, start: StructureFit, *, effort: int
    ) -> StructureFit:
        """Fit the model with these effects, from a fit with fewer, other or the same effects."""
        kept = tuple(c for c in choices if c in start.choices)
        new = [c for c in choices if c not in start.choices]
        if _too_many(choices):
            return replace(start, choices=tuple(choices), cost=np.inf, converged=False, status=TOO_MANY)
        data = self.data(rows)
        chain = self.chain(kept)
        point = self._carried(start, chain, data)
        if not new or kept != start.choices:
            minimum = self._polished(chain, data, point, noise)
            if len(kept) < len(start.choices):
                # Without the effect that was left out its equation may be another, or not be stable.
                again = self._polished(chain, data, self._from_baseline(point, rows), noise)
                if minimum is None or (again is not None and again.cost < minimum.cost):
                    minimum = again
            if minimum is not None:
                point = minimum.point
        agree = start.restarts_agree
        for choice in new:
            chain = self.chain((*chain.choices, choice))
            minimum, agree = self._searched(chain, data, rows, point, noise, effort)
            point = point if minimum is None else minimum.point
            if minimum is None:
                break
        if minimum is None:
            return replace(start, choices=tuple(choices), cost=np.inf, converged=False, status="it diverges")
        end = "the search came to rest" if minimum.converged else "the search was still moving"
        status = f"{end}; " + ("several starts agree" if agree else "other starts ended elsewhere")
        return self._fitted(chain, data, rows, minimum, agree, status)

    def _from_baseline(self, point: Floats, rows: Mask) -> Floats:
        """Return a point with the coefficients of the model without effects."""
        key = rows.tobytes()
        if key not in self._baselines:
            self._baselines[key] = self.baseline(rows).point[: 2 * self.order]
        moved = point.copy()
        moved[: 2 * self.order] = self._baselines[key]
        return moved

    def _searched(
        self, chain: Chain, data: Data, rows: Mask, point: Floats, noise: Floats, effort: int
    ) -> tuple[Minimum | None, bool]:
        """Search the last effect of a chain on part of the rows, polish on all."""
        part = self._part(data)
        starts = [point, *further_starts(chain, part, point)]
        ends = EffectSearch(chain, part, noise, starts).search(effort)
        if not ends:
            return None, False
        agree = len(ends) == 1 or ends[1].cost <= ends[0].cost * (1.0 + AGREEMENT)
        if part is data:
            return ends[0], agree
        return self._polished(chain, data, ends[0].point, noise), agree

    def _polished(self, chain: Chain, data: Data, point: Floats, noise: Floats) -> Minimum | None:
        """Minimise over all that the output follows smoothly."""
        places = chain.places(data)
        held = [
            place.start + i
            for place, choice in zip(places, chain.choices, strict=True)
            if not choice.form.smooth
            for i in choice.form.shapes
        ]
        free = np.ones(point.size, dtype=bool)
        free[held] = False
        return minimise(chain, data, point, noise, free=free, iterations=40)

    def finish(self, fit: StructureFit, noise: Floats) -> StructureFit:
        """Return a fit with standard errors of its parameters filled in."""
        data, chain = self.data(fit.rows), self.chain(fit.choices)
        run = chain.run(data, fit.point)
        if run is None:
            return fit
        J = chain.slopes(data, fit.point, run, noise).T
        scale = np.linalg.norm(J, axis=0)
        used = scale > 0.0  # a relay's threshold moves within its cell without any change
        errors = np.full(fit.point.size, np.nan)
        R = np.linalg.qr(J[:, used] / scale[used], mode="r")
        if np.abs(np.diag(R)).min(initial=1.0) > 1e-10:
            spread = np.linalg.norm(np.linalg.inv(R), axis=1)
            variance = fit.cost / max(J.shape[0] - fit.n_parameters, 1)
            errors[used] = spread * np.sqrt(variance) / scale[used]
        own = [*range(2 * self.order + int(chain.constant)), *range(chain.n_linear(data), fit.point.size)]
        parameters = tuple(
            replace(parameter, std_error=float(error))
            for parameter, error in zip(fit.parameters, errors[own], strict=True)
        )
        return replace(fit, parameters=parameters)

    def probes(self, fit: StructureFit) -> Floats:
        """Return directions in which an effect that is not in any list would show."""
        data, chain = self.data(self.record.learning), self.chain(fit.choices)
        lines = probe_directions(chain, data, self._carried(fit, chain, data))
        return self._on_record(lines, self.record.learning)

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

    def equation(self, fit: StructureFit) -> str:
        """Return the model's equation with its effects, for a reader."""
        n = self.order
        a, b = fit.point[:n], fit.point[n : 2 * n]
        left = "z(k)" + "".join(f" {_signed(value)} z(k-{i})" for i, value in enumerate(a, 1))
        right = "".join(f" {_signed(value)} x(k-{i})" for i, value in enumerate(b, 1)).lstrip("+ ")
        if self.free_start:
            right += f" {_signed(fit.point[2 * n])}"
        lines = [f"{left} = {right}"]
        lines += [f"{choice.name}: {choice.effect.equation}" for choice in fit.choices]
        return "\n".join(lines)

    def chain(self, choices: Sequence[Choice]) -> Chain:
        """Return the model with effects; noise is not part of it."""
        kept = tuple(choice for choice in choices if choice.effect.port != "noise")
        return Chain(self.order, kept, self.free_start, self.free_start)

    def data(self, rows: Mask) -> Data:
        """Return the experiments with chosen rows, each up to its last chosen one."""
        return self._data(rows.tobytes())

    def _make_data(self, key: bytes) -> Data:
        rows = np.frombuffer(key, dtype=bool)
        parts, begin = [], [0]
        for part in self.record.slices:
            inside = np.flatnonzero(rows[part])
            if inside.size:
                parts.append(np.arange(part.start, part.start + inside[-1] + 1))
                begin.append(begin[-1] + parts[-1].size)
        if not parts:
            raise DataError("no row is chosen for the fit: mark rows as train, est or val")
        index = np.concatenate(parts)
        used = rows[index]
        y = np.where(used, self.record.y[index, 0], 0.0)
        return Data(
            np.ascontiguousarray(self.record.u[index, 0]), y, used, np.array(begin), self.record.period
        )

    def _part(self, data: Data) -> Data:
        """Return the first rows, enough for a search; all where each experiment has its own start."""
        if data.u.size <= SEARCH_ROWS or (self.free_start and data.n_experiments > 1):
            return data
        stop = min(max(SEARCH_ROWS, int(np.argmax(data.used)) + SEARCH_ROWS), data.u.size)
        begin = np.array([*data.begin[:-1][data.begin[:-1] < stop], stop])
        return Data(data.u[:stop], data.y[:stop], data.used[:stop], begin, data.period)

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

    def _on_record(self, lines: Floats, rows: Mask) -> Floats:
        """Return lines over the rows of `data` as columns over all rows of the record."""
        columns = np.zeros((self.record.n_samples, lines.shape[0]))
        columns[self._index(rows)] = lines.T
        return columns

    def _index(self, rows: Mask) -> np.ndarray:
        parts = []
        for part in self.record.slices:
            inside = np.flatnonzero(rows[part])
            if inside.size:
                parts.append(np.arange(part.start, part.start + inside[-1] + 1))
        return np.concatenate(parts)

    def _fitted(
        self, chain: Chain, data: Data, rows: Mask, minimum: Minimum, agree: bool, status: str
    ) -> StructureFit:
        return StructureFit(
            choices=chain.choices,
            point=minimum.point,
            parameters=self._parameters(chain, data, minimum.point),
            output=self._free_run(chain, data, rows, minimum.point),
            rows=rows,
            cost=minimum.cost,
            n_parameters=minimum.point.size,
            converged=minimum.converged,
            restarts_agree=agree,
            status=status,
        )

    def _parameters(self, chain: Chain, data: Data, point: Floats) -> tuple[FittedParameter, ...]:
        u_unit, y_unit = (self.record.unit(names[0]) for names in (self.record.inputs, self.record.outputs))
        units = {"u": u_unit, "y": y_unit, "x": y_unit, "v": y_unit, "F": u_unit}
        gain = EffectParameter("b", "[y]/[u]", "").unit_with(units)
        names = [(f"a{i}", "") for i in range(1, self.order + 1)]
        names += [(f"b{i}", gain) for i in range(1, self.order + 1)]
        names += [("constant", y_unit)] * chain.constant
        found = [
            FittedParameter(name, float(value), np.nan, unit)
            for (name, unit), value in zip(names, point, strict=False)
        ]
        for choice, place in zip(chain.choices, chain.places(data), strict=True):
            found += [
                FittedParameter(p.name, float(value), np.nan, p.unit_with(units), choice.name)
                for p, value in zip(choice.form.parameters, point[place], strict=True)
            ]
        return tuple(found)

    def _free_run(self, chain: Chain, data: Data, rows: Mask, point: Floats) -> Floats:
        """Run every row of the record; starts of experiments without rows of the fit are estimated."""
        used, starts, other = np.zeros(self.record.n_samples, dtype=bool), [], []
        shared, number = 2 * self.order + int(chain.constant), 0
        for e, part in enumerate(self.record.slices):
            if rows[part].any():
                starts.append(point[shared + number * self.order : shared + (number + 1) * self.order])
                number += 1
                continue
            y = self.record.y[part, 0]
            skip = self.record.skip.get(str(self.record.split[part][0]), 0)
            used[part] = first_rows(y, skip, self.order)[0]
            starts.append(np.zeros(self.order))
            other += list(range(shared + e * self.order, shared + (e + 1) * self.order))
        begin = np.array([*self.record.starts, self.record.n_samples])
        y = np.where(used, self.record.y[:, 0], 0.0)
        whole = Data(self.record.u[:, 0].copy(), y, used, begin, self.record.period)
        own = np.concatenate(starts) if self.free_start else np.empty(0)
        full = np.concatenate([point[:shared], own, point[chain.n_linear(data) :]])
        if self.free_start and other and used.any():
            free = np.zeros(full.size, dtype=bool)
            free[other] = True
            end = minimise(chain, whole, full, WHITE, free=free, iterations=4)
            full = full if end is None else end.point
        run = chain.run(whole, full)
        return np.full(self.record.n_samples, np.inf) if run is None else run.y

    def _chosen_order(self) -> int:
        """Return the lowest order whose validation error is not worth a higher one."""
        record, best, chosen = self.record, np.inf, 1
        for order in range(1, HIGHEST_ORDER + 1):
            self.order = order
            self._data = lru_cache(maxsize=16)(self._make_data)
            fit = self.baseline(record.estimation)
            error = record.y[:, 0] - fit.output
            cost = float(np.mean(error[record.validation] ** 2))
            if cost < best * (1.0 - WORTHWHILE) ** 2:
                best, chosen = cost, order
        return chosen


def _found_again(ends: Sequence[Minimum]) -> bool:
    """Tell whether a second of the searches ended at the least cost."""
    return len(ends) > 1 and ends[1].cost <= ends[0].cost * (1.0 + AGREEMENT) ** 2


def _too_many(choices: Sequence[Choice]) -> bool:
    """Tell whether more forces act than the compiled run takes."""
    return sum(choice.effect.port in ("force", "gain") for choice in choices) > MOST_DRIVES


def _as_choices(effect: Effect) -> tuple[Choice, ...]:
    return (Choice(effect, effect.forms[0]),)


def _signed(value: float) -> str:
    return f"{'-' if value < 0 else '+'} {abs(value):.4g}"
