"""A linear difference equation between maps of its input and output, with forces fed back."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats, Map
from sysid.diagnosis.effects.laws import drive_of, no_drive, pointer_of
from sysid.diagnosis.linear.differences import STEP, quotient
from sysid.diagnosis.linear.kernels import (
    chosen_filtered,
    driven,
    is_stable,
    simulate,
    simulate_driven,
    tangent,
)
from sysid.diagnosis.structures.structure import Choice
from sysid.diagnosis.structures.whitening import opening
from sysid.errors import UsageError

# Least value of a shape whose bound is zero, as a share of the largest one on its grid.
LEAST_SHAPE = 1e-6
# Ports of effects that act within the equation; the compiled run takes so many.
DRIVING, MOST_DRIVES = ("force", "gain"), 2
# Derivatives of the driven input by input, position and speed.
Slopes = tuple[Floats | float, Floats, Floats]


@dataclass(frozen=True, eq=False)
class Data:
    """Rows of all experiments one after the other.

    Attributes
    ----------
    u, y : ndarray, shape (n_rows,)
    used : ndarray of bool, shape (n_rows,)
    begin : ndarray of int, shape (n_experiments + 1,)
    period : float
    """

    u: Floats
    y: Floats
    used: Mask
    begin: np.ndarray
    period: float

    @cached_property
    def all_used(self) -> bool:
        """Whether every row is one of the fit."""
        return bool(self.used.all())

    @property
    def n_experiments(self) -> int:
        """Number of experiments."""
        return self.begin.size - 1

    def by_experiment(self, apply: Map, sequence: Floats, p: Floats) -> Floats:
        """Apply a map to the rows of each experiment."""
        if self.begin.size == 2:
            return apply(sequence, p, self.period)
        parts = zip(self.begin[:-1], self.begin[1:], strict=True)
        return np.concatenate([apply(sequence[i:j], p, self.period) for i, j in parts])

    def lagged(self, signal: Floats, lag: int) -> Floats:
        """Delay a signal by whole samples within each experiment."""
        out = np.zeros_like(signal)
        for i, j in zip(self.begin[:-1], self.begin[1:], strict=True):
            out[i + lag : j] = signal[i : max(j - lag, i)]
        return out


@dataclass(frozen=True, eq=False)
class Run:
    """One free run: the input x after its maps, v after forces, z, and the output after each map.

    Forces see z: with a direct path inside the equation it holds what that adds.
    """

    x: Floats
    v: Floats
    z: Floats
    outputs: tuple[Floats, ...]

    @property
    def y(self) -> Floats:
        """The model's output."""
        return self.outputs[-1]


class Chain:
    """The model as a function of its point: [a, b, constant, starts, parameters of each effect].

    Parameters
    ----------
    order : int
    choices : sequence of Choice
    constant, free_start : bool
    """

    def __init__(self, order: int, choices: Sequence[Choice], constant: bool, free_start: bool) -> None:
        self.order, self.choices = order, tuple(choices)
        self.constant, self.free_start = constant, free_start
        self.at = {port: [i for i, c in enumerate(choices) if c.effect.port == port] for port in _PORTS}
        drives = [i for i, c in enumerate(choices) if c.effect.port in DRIVING]
        if too_many_drives(choices):
            raise UsageError(
                f"{len(drives)} forces are asked for in a linear model: take at most {MOST_DRIVES}"
            )
        self.drives = drives
        self._bounds: dict[Data, tuple[Floats, Floats]] = {}
        self._places: dict[int, list[slice]] = {}
        compiled = [drive_of(choices[i].effect, choices[i].form) for i in drives]
        laws = [*compiled, *[no_drive()] * (MOST_DRIVES - len(drives))] if drives else []
        self.laws = [pointer_of(law) for law in laws]
        # A direct path that forces pass, too: where there are some.
        inside = [i for i in self.at["parallel"] if drives and self.choices[i].form.inside]
        self.inside = inside[0] if inside else None
        self.at["parallel"] = [i for i in self.at["parallel"] if i not in inside]

    def n_linear(self, data: Data) -> int:
        """Return the number of parameters of the difference equation, starts included."""
        starts = self.order * data.n_experiments if self.free_start else 0
        return 2 * self.order + int(self.constant) + starts

    def places(self, data: Data) -> list[slice]:
        """Return where the parameters of each effect stand in a point."""
        if data.n_experiments in self._places:
            return self._places[data.n_experiments]
        place, found = self.n_linear(data), []
        for choice in self.choices:
            found.append(slice(place, place + len(choice.form.parameters)))
            place = found[-1].stop
        self._places[data.n_experiments] = found
        return found

    def size(self, data: Data) -> int:
        """Length of a point."""
        return self.n_linear(data) + sum(len(c.form.parameters) for c in self.choices)

    def bounds(self, data: Data) -> tuple[Floats, Floats]:
        """Return lower and upper bounds of a point."""
        if data in self._bounds:
            return self._bounds[data]
        free = np.full(self.n_linear(data), np.inf)
        parameters = [p for c in self.choices for p in c.form.parameters]
        # A shape stays a little away from zero, where a relative step of its difference would vanish.
        lower = [
            max(p.minimum, LEAST_SHAPE * float(p.grid.values(data.u, data.y[data.used], data.period).max()))
            if p.grid is not None and p.minimum == 0.0
            else p.minimum
            for p in parameters
        ]
        upper = [p.maximum for p in parameters]
        self._bounds[data] = np.concatenate([-free, lower]), np.concatenate([free, upper])
        return self._bounds[data]

    def run(self, data: Data, point: Floats) -> Run | None:
        """Simulate; None if it diverges."""
        places, x = self.places(data), self.mapped(data, point)
        z, v = np.empty_like(x), np.empty_like(x)
        if not self._simulated(data, point, x, z, v):
            return None
        y = z
        for i in self.at["parallel"]:
            y = y + data.by_experiment(_map(self.choices[i]), data.u, point[places[i]])
        outputs = [y]
        for i in self.at["output"]:
            outputs.append(data.by_experiment(_map(self.choices[i]), outputs[-1], point[places[i]]))
        return Run(x, v, z, tuple(outputs))

    def mapped(self, data: Data, point: Floats) -> Floats:
        """Return the input after its maps."""
        x = data.u
        for i in self.at["input"]:
            x = data.by_experiment(_map(self.choices[i]), x, point[self.places(data)[i]])
        return x

    def _simulated(self, data: Data, point: Floats, x: Floats, z: Floats, v: Floats) -> bool:
        n, starts = self.order, self._starts(data, point)
        constant = point[2 * n] if self.constant else 0.0
        if not self.drives:
            if not is_stable(point[:n]):  # it would diverge on later rows; a force may hold such a plant
                return False
            v[:] = x
            return bool(simulate(x, point[:n], point[n : 2 * n], constant, starts, data.begin, z))
        p, q = self._law_parameters(data, point)
        if self.inside is not None:
            from sysid.diagnosis.linear.direct_path import simulate_through

            return bool(
                simulate_through(
                    x, point[:n], point[n : 2 * n], self._direct(data, point), constant, starts, data.begin,
                    len(self.drives), self.laws[0], p, self.laws[1], q, z, v,
                )
            )  # fmt: skip
        return bool(
            simulate_driven(
                x, point[:n], point[n : 2 * n], constant, starts, data.begin, len(self.drives),
                self.laws[0], p, self.laws[1], q, z, v,
            )
        )  # fmt: skip

    def _direct(self, data: Data, point: Floats) -> float:
        """Return the gain of the direct path inside the equation."""
        assert self.inside is not None
        return float(point[self.places(data)[self.inside].start])

    def _law_parameters(self, data: Data, point: Floats) -> tuple[Floats, Floats]:
        places = self.places(data)
        p = [np.ascontiguousarray(point[places[i]]) for i in self.drives]
        return p[0], p[1] if len(p) > 1 else np.empty(0)

    def _starts(self, data: Data, point: Floats) -> Floats:
        if not self.free_start:
            return np.zeros((data.n_experiments, self.order))
        first = 2 * self.order + int(self.constant)
        return np.ascontiguousarray(point[first : self.n_linear(data)]).reshape(-1, self.order)

    def jacobian(self, data: Data, point: Floats, run: Run, free: Mask | None = None) -> Floats:
        """Return the derivative of the output by the point, shape (n_parameters, n_rows).

        Lines of parameters that are not ``free`` may be left at zero.
        """
        self._wanted = np.ones(point.size, dtype=bool) if free is None else free
        places, n_linear = self.places(data), self.n_linear(data)
        J = np.zeros((self.size(data), data.u.size))
        slopes = self.drive_slopes(data, point, run)
        moved = [(row, change * slopes[0]) for row, change in self._input_changes(data, point)]
        moved += self._law_changes(data, point, run)
        inputs = np.array([change for _, change in moved]) if moved else np.empty((0, data.u.size))
        columns = self.followed(data, point, run, slopes, inputs)
        J[:n_linear] = columns[:n_linear]
        if self.inside is not None:
            J[places[self.inside]] = columns[-1:]
            columns = columns[:-1]
        for (row, _), column in zip(moved, columns[n_linear:], strict=True):
            J[row] = column
        for i in self.at["parallel"]:
            J[places[i]] = self._differences(data, i, data.u, point)
        for i, before in zip(self.at["output"], run.outputs, strict=False):
            J = self._through(data, i, before, point[places[i]], J)
            J[places[i]] = self._differences(data, i, before, point)
        return J

    def followed(self, data: Data, point: Floats, run: Run, slopes: Slopes, inputs: Floats) -> Floats:
        """Return how z follows its own parameters, small changes of v, and the direct path inside if any.

        ``slopes`` are those of `drive_slopes`, ``inputs`` has shape (n_changes, n_rows).
        """
        n, (_, by_position, by_speed) = self.order, slopes
        if self.inside is None:
            return np.asarray(
                tangent(
                    run.z, run.v, point[:n], point[n : 2 * n], data.begin, self.constant, self.free_start,
                    bool(self.drives), by_position, by_speed, inputs,
                )
            )  # fmt: skip
        from sysid.diagnosis.linear.direct_path import tangent_through

        none = np.zeros_like(run.v)
        outputs = np.array([none] * inputs.shape[0] + [run.v])
        return np.asarray(
            tangent_through(
                run.z, run.v, point[:n], point[n : 2 * n], self._direct(data, point), data.begin,
                self.constant, self.free_start, by_position, by_speed, np.vstack([inputs, none]), outputs,
            )
        )  # fmt: skip

    def through_sensor(self, data: Data, point: Floats, run: Run, lines: Floats) -> Floats:
        """Return what the maps of the output make of small changes before them."""
        for i, before in zip(self.at["output"], run.outputs, strict=False):
            lines = self._through(data, i, before, point[self.places(data)[i]], lines)
        return lines

    def _input_changes(self, data: Data, point: Floats) -> list[tuple[int, Floats]]:
        """Return the change of x with each parameter of the input maps."""
        found = []
        for i in self.at["input"]:
            place = self.places(data)[i]
            for row in range(place.start, place.stop):
                if not self._wanted[row]:
                    continue

                def mapped(value: float, row: int = row) -> Floats:
                    shifted = point.copy()
                    shifted[row] = value
                    return self.mapped(data, shifted)

                found.append((row, quotient(mapped, point[row], self._is_strength(i, row - place.start))))
        return found

    def _law_changes(self, data: Data, point: Floats, run: Run) -> list[tuple[int, Floats]]:
        found = []
        for i in self.drives:
            place = self.places(data)[i]
            for row in range(place.start, place.stop):
                if not self._wanted[row]:
                    continue

                def acting(value: float, row: int = row) -> Floats:
                    shifted = point.copy()
                    shifted[row] = value
                    return self._driven(data, shifted, run, 0.0, 0.0, 0.0)

                found.append((row, quotient(acting, point[row], self._is_strength(i, row - place.start))))
        return found

    def drive_slopes(self, data: Data, point: Floats, run: Run) -> Slopes:
        """Return the derivative of the driven input by input, position and speed; empty without forces."""
        if not self.drives:
            return 1.0, _NONE, _NONE
        steps = [STEP * (float(np.std(signal)) or 1.0) for signal in (run.x, run.z, np.diff(run.z))]
        slopes = []
        for number, step in enumerate(steps):
            shift = [step if j == number else 0.0 for j in range(3)]
            ahead = self._driven(data, point, run, *shift)
            behind = self._driven(data, point, run, *(-value for value in shift))
            slopes.append((ahead - behind) / (2.0 * step))
        return slopes[0], slopes[1], slopes[2]

    def _driven(self, data: Data, point: Floats, run: Run, du: float, dz: float, dv: float) -> Floats:
        p, q = self._law_parameters(data, point)
        first, second = self.laws
        return np.asarray(driven(run.x, run.z, data.begin, len(self.drives), first, p, second, q, du, dz, dv))

    def felt(self, data: Data, point: Floats, x: Floats, z: Floats) -> Floats:
        """Return the input that acts if the output were ``z``."""
        return self._driven(data, point, Run(x, x, z, (z,)), 0.0, 0.0, 0.0)

    def _differences(self, data: Data, i: int, sequence: Floats, point: Floats) -> Floats:
        """Return the change of a map's result with each of its parameters."""
        place = self.places(data)[i]
        p = point[place]
        lines = np.zeros((p.size, sequence.size))
        for j in np.flatnonzero(self._wanted[place]).tolist():

            def mapped(value: float, j: int = j) -> Floats:
                shifted = p.copy()
                shifted[j] = value
                return data.by_experiment(_map(self.choices[i]), sequence, shifted)

            lines[j] = quotient(mapped, p[j], self._is_strength(i, j))
        return lines

    def _is_strength(self, i: int, j: int) -> bool:
        return self.choices[i].form.parameters[j].is_strength

    def _through(self, data: Data, i: int, before: Floats, p: Floats, J: Floats) -> Floats:
        """Return what an output map makes of small changes of its sequence."""
        form, apply = self.choices[i].form, _map(self.choices[i])
        if form.slope == "identity":
            return J
        if form.slope == "linear":
            return np.array([data.by_experiment(apply, line, p) for line in J])
        step = STEP * (float(np.std(before)) or 1.0)
        with np.errstate(all="ignore"):  # a run that is about to diverge: what is not finite is turned away
            ahead = data.by_experiment(apply, before + step, p)
            return np.asarray(J * ((ahead - data.by_experiment(apply, before - step, p)) / (2.0 * step)))

    def error(self, data: Data, run: Run, noise: Floats) -> Floats:
        """Return the filtered error of a run on the used rows."""
        return np.asarray(self._filtered(data, (data.y - run.y)[np.newaxis], noise)[0])

    def slopes(self, data: Data, point: Floats, run: Run, noise: Floats, free: Mask | None = None) -> Floats:
        """Return the filtered derivative by the free parameters, shape (n_free, n_used)."""
        J = self.jacobian(data, point, run, free)
        return self._filtered(data, J if free is None else J[free], noise)

    def _filtered(self, data: Data, lines: Floats, noise: Floats) -> Floats:
        if noise.size == 1 and data.all_used:
            return lines
        return np.asarray(chosen_filtered(lines, data.used, data.begin, noise, opening(noise)))


def too_many_drives(choices: Sequence[Choice]) -> bool:
    """Tell whether more effects act within the equation than the compiled run takes."""
    return sum(choice.effect.port in DRIVING for choice in choices) > MOST_DRIVES


_PORTS = ("input", "output", "force", "gain", "parallel", "noise")
_NONE = np.empty(0)


def _map(choice: Choice) -> Map:
    assert choice.form.apply is not None
    return choice.form.apply
