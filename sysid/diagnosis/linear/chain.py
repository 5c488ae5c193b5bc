"""A linear difference equation between maps of its input and output, with forces fed back."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats, Map
from sysid.diagnosis.effects.laws import drive_of, no_drive, pointer_of, rows_of
from sysid.diagnosis.linear.differences import STEP, quotient
from sysid.diagnosis.linear.kernels import (
    chosen_filtered,
    free_run,
    simulate_driven,
    speed_of,
    spread,
)
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.linear.tangents import tangent, tangent_driven, tangent_through
from sysid.diagnosis.structures.structure import Choice
from sysid.diagnosis.structures.whitening import opening
from sysid.diagnosis.structures.work import Steps
from sysid.errors import UsageError

# Ports of effects that act within the equation; the compiled run takes so many.
DRIVING, MOST_DRIVES = ("force", "gain"), 2
# Derivatives of the driven input by input, position and speed.
Slopes = tuple[Floats | float, Floats, Floats]


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the parameters of a chain stand in a point for given rows.

    Attributes
    ----------
    n_linear : int
        Number of parameters of the difference equation, starts included; they stand first.
    places : list of slice
        Of the parameters of each effect.
    inputs : ndarray of int
        Places of those of the maps of the input.
    size : int
        Number of all.
    """

    n_linear: int
    places: list[slice]
    inputs: np.ndarray
    size: int


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
    steps : Steps, optional
        Where rows of runs and of lines of Jacobians are counted.
    """

    def __init__(
        self,
        order: int,
        choices: Sequence[Choice],
        constant: bool,
        free_start: bool,
        steps: Steps | None = None,
    ) -> None:
        self.order, self.choices = order, tuple(choices)
        self.constant, self.free_start = constant, free_start
        self.at = {port: [i for i, c in enumerate(choices) if c.effect.port == port] for port in _PORTS}
        drives = [i for i, c in enumerate(choices) if c.effect.port in DRIVING]
        if too_many_drives(choices):
            raise UsageError(
                f"{len(drives)} forces are asked for in a linear model: take at most {MOST_DRIVES}"
            )
        self.drives = drives
        self.steps = Steps() if steps is None else steps
        self._layouts: dict[Data, Layout] = {}
        self._bounds: dict[Data, tuple[Floats, Floats]] = {}
        self._mapped: tuple[Data, bytes, Floats] | None = None
        compiled = [drive_of(choices[i].effect, choices[i].form) for i in drives]
        laws = [*compiled, *[no_drive()] * (MOST_DRIVES - len(drives))] if drives else []
        self.laws = [pointer_of(law) for law in laws]
        self.rows_of_laws = [rows_of(choices[i].effect, choices[i].form) for i in drives]
        # A direct path that forces pass, too: where there are some.
        inside = [i for i in self.at["parallel"] if drives and self.choices[i].form.inside]
        self.inside = inside[0] if inside else None
        self.at["parallel"] = [i for i in self.at["parallel"] if i not in inside]

    def layout(self, data: Data) -> Layout:
        """Return where the parameters stand in a point."""
        found = self._layouts.get(data)
        if found is None:
            found = self._layouts[data] = self._laid_out(data)
        return found

    def _laid_out(self, data: Data) -> Layout:
        starts = self.order * data.n_experiments if self.free_start else 0
        n_linear = 2 * self.order + int(self.constant) + starts
        places, place = [], n_linear
        for choice in self.choices:
            places.append(slice(place, place + len(choice.form.parameters)))
            place = places[-1].stop
        inputs = [row for i in self.at["input"] for row in range(places[i].start, places[i].stop)]
        return Layout(n_linear, places, np.array(inputs, dtype=np.intp), place)

    def n_linear(self, data: Data) -> int:
        """Return the number of parameters of the difference equation, starts included."""
        return self.layout(data).n_linear

    def places(self, data: Data) -> list[slice]:
        """Return where the parameters of each effect stand in a point."""
        return self.layout(data).places

    def size(self, data: Data) -> int:
        """Length of a point."""
        return self.layout(data).size

    def bounds(self, data: Data) -> tuple[Floats, Floats]:
        """Return lower and upper bounds of a point."""
        if data not in self._bounds:
            free = np.full(self.n_linear(data), np.inf)
            parameters = [p for c in self.choices for p in c.form.parameters]
            lower = np.concatenate([-free, [data.least(p) for p in parameters]])
            self._bounds[data] = lower, np.concatenate([free, [p.maximum for p in parameters]])
        return self._bounds[data]

    def smooth(self, data: Data) -> Mask:
        """Tell which unknowns the output follows smoothly: all but the shapes of what jumps."""
        found = np.ones(self.size(data), dtype=bool)
        for place, choice in zip(self.places(data), self.choices, strict=True):
            if not choice.form.smooth:
                found[[place.start + i for i in choice.form.shapes]] = False
        return found

    def run(self, data: Data, point: Floats) -> Run | None:
        """Simulate; None if it diverges."""
        self.steps.taken += data.u.size
        x = self._recalled(data, point)
        z = np.empty(x.size)
        v = np.empty(x.size) if self.drives else x
        if not self._simulated(data, point, x, z, v):
            return None
        places, y = self.places(data), z
        for i in self.at["parallel"]:
            y = y + data.by_experiment(_map(self.choices[i]), data.u, point[places[i]])
        outputs = [y]
        for i in self.at["output"]:
            outputs.append(data.by_experiment(_map(self.choices[i]), outputs[-1], point[places[i]]))
        return Run(x, v, z, tuple(outputs))

    def mapped(self, data: Data, point: Floats) -> Floats:
        """Return the input after its maps."""
        x, places = data.u, self.places(data)
        for i in self.at["input"]:
            x = data.by_experiment(_map(self.choices[i]), x, point[places[i]])
        return x

    def _recalled(self, data: Data, point: Floats) -> Floats:
        """Return the input after its maps, the last one if their parameters have not moved since."""
        if not self.at["input"]:
            return data.u
        key, last = point[self.layout(data).inputs].tobytes(), self._mapped
        if last is None or last[0] is not data or last[1] != key:
            last = self._mapped = data, key, self.mapped(data, point)
        return last[2]

    def _simulated(self, data: Data, point: Floats, x: Floats, z: Floats, v: Floats) -> bool:
        n = self.order
        if not self.drives:
            # An unstable one would diverge on later rows; a force may hold such a plant.
            return bool(free_run(x, point, n, self.constant, self.free_start, data.begin, z))
        starts, constant = self._starts(data, point), point[2 * n] if self.constant else 0.0
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
        """Return the derivative of the output by the ``free`` parameters, shape (n_free, n_rows).

        By all of them where nothing is said.
        """
        places, n_linear = self.places(data), self.n_linear(data)
        wanted = np.ones(point.size, dtype=bool) if free is None else free
        self.steps.taken += int(np.count_nonzero(wanted)) * data.u.size
        slopes = self.drive_slopes(data, point, run)
        moved = [(row, change * slopes[0]) for row, change in self._input_changes(data, point, wanted)]
        moved += self._law_changes(data, point, run, wanted)
        inputs = np.array([change for _, change in moved]) if moved else np.empty((0, data.u.size))
        columns = self.followed(data, point, run, slopes, inputs, wanted[:n_linear])
        rows = [*np.flatnonzero(wanted[:n_linear]).tolist(), *(row for row, _ in moved)]
        if self.inside is not None:
            rows.append(places[self.inside].start)
        if rows == np.flatnonzero(wanted).tolist():
            J = columns
        else:
            line = np.cumsum(wanted) - 1
            J = np.zeros((int(wanted.sum()), data.u.size))
            asked = [number for number, row in enumerate(rows) if wanted[row]]
            J[line[[rows[number] for number in asked]]] = columns[asked]
        for i in self.at["parallel"]:
            self._fill_differences(data, i, data.u, point, wanted, J)
        for i, before in zip(self.at["output"], run.outputs, strict=False):
            J = self._through(data, i, before, point[places[i]], J)
            self._fill_differences(data, i, before, point, wanted, J)
        return J

    def followed(
        self, data: Data, point: Floats, run: Run, slopes: Slopes, inputs: Floats, own: Mask
    ) -> Floats:
        """Return how z follows its own parameters, small changes of v, and the direct path inside if any.

        ``slopes`` are those of `drive_slopes`, ``inputs`` has shape (n_changes, n_rows), ``own`` says which
        of its own parameters are asked for.
        """
        n, (_, by_position, by_speed) = self.order, slopes
        a, b = point[:n], point[n : 2 * n]
        if not self.drives:
            found = tangent(run.z, run.v, a, b, data.begin, self.constant, own, inputs)
        elif self.inside is None:
            found = tangent_driven(
                run.z, run.v, a, b, data.begin, self.constant, own, by_position, by_speed, inputs
            )
        else:
            none = np.zeros_like(run.v)
            outputs = np.array([none] * inputs.shape[0] + [run.v])
            found = tangent_through(
                run.z, run.v, a, b, self._direct(data, point), data.begin, self.constant, own,
                by_position, by_speed, np.vstack([inputs, none]), outputs,
            )  # fmt: skip
        return np.asarray(found)

    def through_sensor(self, data: Data, point: Floats, run: Run, lines: Floats) -> Floats:
        """Return what the maps of the output make of small changes before them."""
        for i, before in zip(self.at["output"], run.outputs, strict=False):
            lines = self._through(data, i, before, point[self.places(data)[i]], lines)
        return lines

    def _input_changes(self, data: Data, point: Floats, wanted: Mask) -> list[tuple[int, Floats]]:
        """Return the change of x with each parameter of the input maps."""
        found = []
        for i in self.at["input"]:
            place = self.places(data)[i]
            for row in range(place.start, place.stop):
                if not wanted[row]:
                    continue

                def mapped(value: float, row: int = row) -> Floats:
                    shifted = point.copy()
                    shifted[row] = value
                    return self.mapped(data, shifted)

                found.append((row, quotient(mapped, point[row], self._is_strength(i, row - place.start))))
        return found

    def _law_changes(self, data: Data, point: Floats, run: Run, wanted: Mask) -> list[tuple[int, Floats]]:
        found = []
        speed = speed_of(run.z, data.begin) if self.drives else _NONE
        for i in self.drives:
            place = self.places(data)[i]
            for row in range(place.start, place.stop):
                if not wanted[row]:
                    continue

                def acting(value: float, row: int = row) -> Floats:
                    shifted = point.copy()
                    shifted[row] = value
                    return self._driven(data, shifted, run.x, run.z, speed)

                found.append((row, quotient(acting, point[row], self._is_strength(i, row - place.start))))
        return found

    def drive_slopes(self, data: Data, point: Floats, run: Run) -> Slopes:
        """Return the derivative of the driven input by input, position and speed; empty without forces."""
        if not self.drives:
            return 1.0, _NONE, _NONE
        seen = (run.x, run.z, speed_of(run.z, data.begin))

        def slope(number: int) -> Floats:
            step = STEP * spread(seen[number])
            move = [step if i == number else 0.0 for i in range(3)]
            ahead = self._driven(data, point, *(signal + by for signal, by in zip(seen, move, strict=True)))
            behind = self._driven(data, point, *(signal - by for signal, by in zip(seen, move, strict=True)))
            return np.asarray((ahead - behind) / (2.0 * step))

        # Forces are taken from the input: they leave its slope as it is.
        return slope(0) if self.at["gain"] else 1.0, slope(1), slope(2)

    def _driven(self, data: Data, point: Floats, x: Floats, position: Floats, speed: Floats) -> Floats:
        """Return the input after the drives."""
        for law, i in zip(self.rows_of_laws, self.drives, strict=True):
            x = law(x, position, speed, point[self.places(data)[i]])
        return x

    def felt(self, data: Data, point: Floats, x: Floats, z: Floats) -> Floats:
        """Return the input that acts if the output were ``z``."""
        return self._driven(data, point, x, z, speed_of(z, data.begin))

    def _fill_differences(
        self, data: Data, i: int, sequence: Floats, point: Floats, wanted: Mask, J: Floats
    ) -> None:
        """Fill the lines of the wanted parameters of a map: how its result changes with them."""
        place = self.places(data)[i]
        p = point[place]
        line = int(np.count_nonzero(wanted[: place.start]))
        for j in np.flatnonzero(wanted[place]).tolist():

            def mapped(value: float, j: int = j) -> Floats:
                shifted = p.copy()
                shifted[j] = value
                return data.by_experiment(_map(self.choices[i]), sequence, shifted)

            J[line] = quotient(mapped, p[j], self._is_strength(i, j))
            line += 1

    def _is_strength(self, i: int, j: int) -> bool:
        return self.choices[i].form.parameters[j].is_strength

    def _through(self, data: Data, i: int, before: Floats, p: Floats, J: Floats) -> Floats:
        """Return what an output map makes of small changes of its sequence."""
        form, apply = self.choices[i].form, _map(self.choices[i])
        if form.slope == "identity":
            return J
        if form.slope == "linear":
            return np.array([data.by_experiment(apply, line, p) for line in J])
        step = STEP * spread(before)
        with np.errstate(all="ignore"):  # a run that is about to diverge: what is not finite is turned away
            ahead = data.by_experiment(apply, before + step, p)
            return np.asarray(J * ((ahead - data.by_experiment(apply, before - step, p)) / (2.0 * step)))

    def error(self, data: Data, run: Run, noise: Floats) -> Floats:
        """Return the filtered error of a run on the used rows."""
        missed = data.y - run.y
        if noise.size == 1 and data.all_used:
            return missed
        return np.asarray(self._filtered(data, missed[np.newaxis], noise)[0])

    def slopes(self, data: Data, point: Floats, run: Run, noise: Floats, free: Mask | None = None) -> Floats:
        """Return the filtered derivative by the free parameters, shape (n_free, n_used)."""
        return self._filtered(data, self.jacobian(data, point, run, free), noise)

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
