"""A linear difference equation between maps of its input and output, with forces fed back."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats, Map
from sysid.diagnosis.linear.differences import STEP, fill_quotient
from sysid.diagnosis.linear.drives import DRIVING, Drives
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
from sysid.diagnosis.structures.thresholds import followed_smoothly, is_switched_by_input
from sysid.diagnosis.structures.whitening import opening
from sysid.diagnosis.structures.work import Steps

# What a run, and a Jacobian with the step that it leads to, cost besides their rows, in rows.
RUN, JACOBIAN = 1_000, 4_000


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the parameters of a chain stand in a point for given rows.

    Attributes
    ----------
    n_linear : int
        Number of parameters of the difference equation, starts included; they stand first.
    places : list of slice
        Of the parameters of each effect.
    inputs, driving : ndarray of int
        Places of those of the maps of the input, and of the drives.
    followed : ndarray of int
        Places of those by which `Chain.followed` differentiates, in its order.
    size : int
        Number of all.
    """

    n_linear: int
    places: list[slice]
    inputs: np.ndarray
    driving: np.ndarray
    followed: np.ndarray
    size: int


@dataclass(frozen=True, eq=False)
class Run:
    """One free run: the input x after its maps, v after forces, z, and the output after each of its maps.

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
        self.drives = drives
        self.steps = Steps() if steps is None else steps
        self._layouts: dict[Data, Layout] = {}
        self._bounds: dict[Data, tuple[Floats, Floats]] = {}
        self._mapped: tuple[Data, bytes, Floats] | None = None
        self.driven = Drives([self.choices[i] for i in drives])
        self.strengths = [np.array([p.is_strength for p in c.form.parameters], dtype=bool) for c in choices]
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
        inputs, driving = (
            np.array([row for i in which for row in range(places[i].start, places[i].stop)], dtype=np.intp)
            for which in (self.at["input"], self.drives)
        )
        inside = [] if self.inside is None else [places[self.inside].start]
        followed = np.concatenate([np.arange(n_linear), inputs, driving, np.array(inside, dtype=np.intp)])
        return Layout(n_linear, places, inputs, driving, followed, place)

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
        """Return lower and upper bounds of a point.

        No difference is taken by what a switch of the input does, whose threshold may be zero: an input that
        a sine left at 1e-16 is one side of it.
        """
        if data not in self._bounds:
            free = np.full(self.n_linear(data), np.inf)
            parameters = [p for c in self.choices for p in c.form.parameters]
            least = [
                p.minimum if is_switched_by_input(self.choices, i) else data.least(p)
                for i, c in enumerate(self.choices)
                for p in c.form.parameters
            ]
            lower = np.concatenate([-free, least])
            self._bounds[data] = lower, np.concatenate([free, [p.maximum for p in parameters]])
        return self._bounds[data]

    def smooth(self, data: Data) -> Mask:
        """Tell which unknowns the output follows smoothly: all but the shapes of what jumps."""
        return followed_smoothly(self.choices, self.places(data), self.size(data))

    def run(self, data: Data, point: Floats) -> Run | None:
        """Simulate; None if it diverges."""
        self.steps.taken += data.u.size + RUN
        x = self._recalled(data, point)
        z = np.empty(x.size)
        v = np.empty(x.size) if self.drives else x
        if not self._simulated(data, point, x, z, v):
            return None
        places, y = self.places(data), z
        for i in self.at["parallel"]:
            y = y + data.by_experiment(_map(self.choices[i]), self._given(i, data, x), point[places[i]])
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
        a, b, drives = point[:n], point[n : 2 * n], self.driven.given(self._of_drives(data, point))
        if self.inside is not None:
            from sysid.diagnosis.linear.direct_path import simulate_through

            direct = self._direct(data, point)
            return bool(simulate_through(x, a, b, direct, constant, starts, data.begin, *drives, z, v))
        return bool(simulate_driven(x, a, b, constant, starts, data.begin, *drives, z, v))

    def _direct(self, data: Data, point: Floats) -> float:
        """Return the gain of the direct path inside the equation."""
        assert self.inside is not None
        return float(point[self.places(data)[self.inside].start])

    def _of_drives(self, data: Data, point: Floats) -> list[Floats]:
        """Return the parameters of each drive."""
        places = self.places(data)
        return [point[places[i]] for i in self.drives]

    def _starts(self, data: Data, point: Floats) -> Floats:
        if not self.free_start:
            return np.zeros((data.n_experiments, self.order))
        first = 2 * self.order + int(self.constant)
        return np.ascontiguousarray(point[first : self.n_linear(data)]).reshape(-1, self.order)

    def jacobian(self, data: Data, point: Floats, run: Run, free: Mask | None = None) -> Floats:
        """Return the derivative of the output by the ``free`` parameters, shape (n_free, n_rows).

        By all of them where nothing is said.
        """
        layout = self.layout(data)
        wanted = np.ones(point.size, dtype=bool) if free is None else free
        self.steps.taken += int(np.count_nonzero(wanted)) * data.u.size + JACOBIAN
        slopes = self.drive_slopes(data, point, run, wanted[layout.driving])
        inputs = self._input_changes(data, point, wanted, len(slopes) - 3)
        n_maps = inputs.shape[0] - len(slopes) + 3
        beside = self.past_the_plant(data, point, inputs[:n_maps])
        inputs[:n_maps] *= slopes[0]
        inputs[n_maps:] = slopes[3:]
        columns = self.followed(data, point, run, slopes, inputs, wanted[: layout.n_linear])
        J = self._in_order(layout, columns, wanted)
        if beside is not None:
            J[(np.cumsum(wanted) - 1)[layout.inputs[wanted[layout.inputs]]]] += beside
        for i in self.at["parallel"]:
            given = self._given(i, data, run.x)
            self._fill_differences(data, i, given, point, wanted, J[self._lines(i, data, wanted)])
        for i, before in zip(self.at["output"], run.outputs, strict=False):
            J = self._through(data, i, before, point[layout.places[i]], J)
            self._fill_differences(data, i, before, point, wanted, J[self._lines(i, data, wanted)])
        return J

    def _lines(self, i: int, data: Data, wanted: Mask) -> slice:
        """Return where the wanted parameters of an effect stand among all that are wanted."""
        place = self.places(data)[i]
        first = int(np.count_nonzero(wanted[: place.start]))
        return slice(first, first + int(np.count_nonzero(wanted[place])))

    def _in_order(self, layout: Layout, columns: Floats, wanted: Mask) -> Floats:
        """Return what `followed` found in the order of a point; lines of other parameters are zero."""
        rows = layout.followed[wanted[layout.followed]]
        if rows.size == columns.shape[0] == np.count_nonzero(wanted) and (rows[1:] > rows[:-1]).all():
            return columns
        lines = np.cumsum(wanted) - 1
        J = np.zeros((lines[-1] + 1, columns.shape[1]))
        J[lines[rows]] = columns[: rows.size]  # that of the path inside is made in any case
        return J

    def followed(
        self, data: Data, point: Floats, run: Run, slopes: Floats, inputs: Floats, own: Mask
    ) -> Floats:
        """Return how z follows its own parameters, small changes of v, and the direct path inside if any.

        ``slopes`` are those of `drive_slopes`, ``inputs`` has shape (n_changes, n_rows), ``own`` says which
        of its own parameters are asked for.
        """
        n, (by_position, by_speed) = self.order, slopes[1:3]
        a, b = point[:n], point[n : 2 * n]
        if not self.drives:
            found = tangent(run.z, run.v, a, b, data.begin, self.constant, own, inputs)
        elif self.inside is None:
            found = tangent_driven(
                run.z, run.v, a, b, data.begin, self.constant, own, by_position, by_speed, inputs
            )
        else:
            found = tangent_through(
                run.z, run.v, a, b, self._direct(data, point), data.begin, self.constant, own,
                by_position, by_speed, inputs,
            )  # fmt: skip
        return np.asarray(found)

    def _given(self, i: int, data: Data, x: Floats) -> Floats:
        """Return what a path beside the plant is given: the input, or what its maps make of it."""
        return x if self.choices[i].form.behind else data.u

    def past_the_plant(self, data: Data, point: Floats, lines: Floats) -> Floats | None:
        """Return what small changes of x add to the output beside the plant; None where no path takes x."""
        places, found = self.places(data), None
        for i in self.at["parallel"]:
            if self.choices[i].form.behind:
                apply, p = _map(self.choices[i]), point[places[i]]
                added = np.array([data.by_experiment(apply, line, p) for line in lines]).reshape(lines.shape)
                found = added if found is None else found + added
        return found

    def through_sensor(self, data: Data, point: Floats, run: Run, lines: Floats) -> Floats:
        """Return what the maps of the output make of small changes before them."""
        for i, before in zip(self.at["output"], run.outputs, strict=False):
            lines = self._through(data, i, before, point[self.places(data)[i]], lines)
        return lines

    def _input_changes(self, data: Data, point: Floats, wanted: Mask, n_further: int) -> Floats:
        """Return the change of x with each wanted parameter of its maps, and room for further lines."""
        if not self.at["input"]:
            return np.empty((n_further, data.u.size))
        count = int(np.count_nonzero(wanted[self.layout(data).inputs]))
        changes, x, line = np.empty((count + n_further, data.u.size)), data.u, 0
        for i in self.at["input"]:
            apply, place = _map(self.choices[i]), self.places(data)[i]
            # Maps before it are linear in their strengths, but what it makes of them is not.
            for slope in changes[:line]:
                step = STEP * spread(x) / (float(np.abs(slope).max()) or 1.0)
                ahead, behind = (
                    data.by_experiment(apply, x + moved * slope, point[place]) for moved in (step, -step)
                )
                slope[:] = (ahead - behind) / (2.0 * step)
            own = int(np.count_nonzero(wanted[place]))
            self._fill_differences(data, i, x, point, wanted, changes[line : line + own])
            x, line = data.by_experiment(apply, x, point[place]), line + own
        return changes

    def drive_slopes(self, data: Data, point: Floats, run: Run, wanted: Mask) -> Floats:
        """Return the derivative of v by input, position, speed and the ``wanted`` parameters of the drives.

        Shape (3 + n_wanted, n_rows); without drives v is the input itself.
        """
        speed = speed_of(run.z, data.begin) if self.drives else _NONE
        return self.driven.slopes(run.x, run.z, speed, self._of_drives(data, point), wanted)

    def felt(self, data: Data, point: Floats, x: Floats, z: Floats) -> Floats:
        """Return the input that acts if the output were ``z``."""
        return self.driven.acting(x, z, speed_of(z, data.begin), self._of_drives(data, point))

    def _fill_differences(
        self, data: Data, i: int, sequence: Floats, point: Floats, wanted: Mask, lines: Floats
    ) -> None:
        """Fill the lines of the wanted parameters of a map: how its result changes with them."""
        place = self.places(data)[i]
        p = point[place]
        for j, line in zip(np.flatnonzero(wanted[place]).tolist(), lines, strict=True):

            def mapped(value: float, j: int = j) -> Floats:
                shifted = p.copy()
                shifted[j] = value
                return data.by_experiment(_map(self.choices[i]), sequence, shifted)

            fill_quotient(mapped, p[j], bool(self.strengths[i][j]), line)

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
        return np.asarray(chosen_filtered(lines, data.runs, noise, opening(noise)))


_PORTS = ("input", "output", "force", "gain", "parallel", "noise")
_NONE = np.empty(0)


def _map(choice: Choice) -> Map:
    assert choice.form.apply is not None
    return choice.form.apply
