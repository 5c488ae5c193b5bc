"""Simulate a model of up to four linear states with added forces, several runs at a time."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import ModelError
from sysid.linear.forms import Floats
from sysid.physics.expressions import code
from sysid.physics.hold import PIECES, refined
from sysid.physics.linear_form import Entry, linear_form
from sysid.physics.model import Model
from sysid.physics.own_laws import NO_OWN_LAW, OwnLaw, kernel_of
from sysid.physics.ports import Port, find_port

MOST_STATES = 4
MOST_SUBSTEPS = 200
# So many times a step may be coarser for what decays within a sample: a Runge-Kutta step is stable up to 2.78
# over its rate, and what a mode that dies out does wrong no other mode sees.
COARSER = 5.0
# The law without effects: nineteen coefficients, in the order of `sysid.physics.forced_kernels`.
LAW_NAMES = (
    "friction_forward",
    "friction_back",
    "breakaway",
    "stribeck_speed",
    "drag",
    "cubic",
    "gravity",
    "wave_number",
    "constant",
    "elastic",
    "yield",
    "gain",
    "gain_scale",
    "first_power",
    "second_power",
    "first_cap",
    "second_cap",
    "caught",
    "loop_bend",
)
_NO_LAW = dict.fromkeys(LAW_NAMES, 0.0) | {
    "stribeck_speed": 1.0,
    "wave_number": 1.0,
    "gain_scale": 1.0,
    "first_power": 1.0,
    "second_power": 1.0,
    "first_cap": np.inf,
    "second_cap": np.inf,
}
NO_LAW = np.array([_NO_LAW[name] for name in LAW_NAMES])
NO_LAW.setflags(write=False)
POWERS = [LAW_NAMES.index("first_power"), LAW_NAMES.index("second_power")]


def law(**coefficients: float) -> Floats:
    """Return the coefficients of a law by name; the rest are those of no effect.

    Examples
    --------
    >>> law(cubic=3.0)[LAW_NAMES.index("cubic")]
    np.float64(3.0)
    """
    values = NO_LAW.copy()
    for name, value in coefficients.items():
        values[LAW_NAMES.index(name)] = value
    return values


class ForcedPlant:
    """Runs of one model with laws of force, flow and gain added at its port.

    Parameters
    ----------
    model : Model
        Linear in state and input, with at most four states and one output.
    period : float
        Sampling period [s].
    hold : {"zero", "smooth"}
        Between samples the input is held, or follows a cubic spline, as one that was sampled does.

    Raises
    ------
    ModelError
        If the model is not linear or has more states.

    Examples
    --------
    A body that the force cannot move, as friction holds it:

    >>> import numpy as np
    >>> from sysid.physics import load_model
    >>> plant = ForcedPlant(load_model("mass-spring-damper"), 0.1)
    >>> values = np.array([[1.0, 0.5, 2.0]])
    >>> y = plant.run(values, law(friction_forward=1.0, friction_back=1.0)[np.newaxis], np.full(50, 0.9))
    >>> float(np.abs(y).max())
    0.0
    """

    always_steps = False  # without added forces a run is exact

    def __init__(self, model: Model, period: float, hold: str = "zero") -> None:
        form = linear_form(model, ())
        if form is None or len(model.states) > MOST_STATES or len(model.outputs) != 1:
            raise ModelError(
                f"model {model.name!r} cannot take added forces by the fast simulation: it must be linear, "
                f"with one output and at most {MOST_STATES} states"
            )
        self.model, self.period, self._form, self.hold = model, period, form, hold
        self.names = tuple(parameter.name for parameter in model.parameters)
        self.port: Port = find_port(model)
        self.order, self.n_inputs = len(model.states), len(model.inputs)
        self.states_first = _order(self.port, self.order)
        position = self.port.position
        self.same = position is not None and position == self.port.velocity
        self.delayed = tuple(variable.delay for variable in model.inputs)

    @cached_property
    def _matrices(self) -> Callable[[Sequence[float]], Sequence[float]]:
        """Compiled entries of the generator and of the output, and the rate of a force on the velocity."""
        from sysid.physics.expressions import Number, operation

        push = Number(0.0)
        entries: tuple[Entry, ...] = (*self._form.rates, *self._form.outputs)
        expressions = [code(entry[2], self._inside) for entry in entries]
        if self.port.velocity is not None:
            expressions.append(
                code(
                    operation("/", Number(1.0), self.model.equations[self.port.velocity].factor), self._inside
                )
            )
        else:
            expressions.append(code(push, self._inside))
        source = f"def entries(p):\n    return ({', '.join(expressions)},)\n"
        namespace: dict[str, Any] = {"np": np}
        exec(compile(source, f"<matrices of {self.model.name}>", "exec"), namespace)
        function: Callable[[Sequence[float]], Sequence[float]] = namespace["entries"]
        return function

    @cached_property
    def _inside(self) -> dict[str, str]:
        return {name: f"p[{i}]" for i, name in enumerate(self.names)}

    @cached_property
    def _rest(self) -> Floats:
        """Where the states are at rest, in the order of the kernels."""
        return np.array([self.model.states[k].rest for k in self.states_first])

    @cached_property
    def _targets(self) -> tuple[Any, Any, Any]:
        """Where entries stand, and which: in plants, in by_input, in direct."""
        from sysid.physics import forced_kernels as fk

        place = {state: k for k, state in enumerate(self.states_first)}
        n = self.order
        plant, by_input, direct = [], [], []
        count = len(self._form.rates)
        for number, (row, column, _) in enumerate((*self._form.rates, *self._form.outputs)):
            rate = number < count
            if column < n:
                k = place[column]
                plant.append((fk.A + 4 * place[row] + k if rate else fk.READ + k, number))
            elif column == n + self.n_inputs:
                plant.append((fk.STEADY + place[row] if rate else fk.READ + 4, number))
            elif rate:
                by_input.append((place[row], column - n, number))
            else:
                direct.append((column - n, number))
        if self.port.velocity is not None:
            plant.append((fk.PUSH, -1))
        return _columns(plant, 2), _columns(by_input, 3), _columns(direct, 2)

    def coefficients(
        self, values: Floats, laws: Floats, own: OwnLaw = NO_OWN_LAW
    ) -> tuple[Floats, Floats, Floats]:
        """Return what the kernels need of each lane: coefficients, rates by input, output by input."""
        from sysid.physics import forced_kernels as fk

        lanes = values.shape[0]
        laws = np.atleast_2d(laws)
        plants = np.zeros((lanes, fk.SIZE + laws.shape[1] - NO_LAW.size))
        by_input = np.zeros((lanes, MOST_STATES, self.n_inputs))
        direct = np.zeros((lanes, self.n_inputs))
        distinct: dict[tuple[float, ...], int] = {}
        # Lanes often differ in what is not a parameter of the model.
        which = [distinct.setdefault(tuple(p), len(distinct)) for p in values.tolist()]
        with np.errstate(all="ignore"):
            entries = np.array([self._entries(p) for p in distinct])[which]
        (places, first), (rows, columns, second), (inputs, third) = self._targets
        plants[:, places] = entries[:, first]
        by_input[:, rows, columns] = entries[:, second]
        direct[:, inputs] = entries[:, third]
        plants[:, fk.LAW : fk.OWN] = laws[:, : NO_LAW.size]
        plants[:, fk.OWN] = float(bool(own.terms))
        plants[:, fk.SIZE :] = laws[:, NO_LAW.size :]
        return plants, by_input, direct

    def _entries(self, values: Sequence[float]) -> Sequence[float]:
        """Return the entries of the matrices; not numbers where they have none."""
        try:
            return self._matrices(values)
        except (ZeroDivisionError, OverflowError):
            return [np.nan] * (len(self._form.rates) + len(self._form.outputs) + 1)

    def poles(self, values: Floats) -> NDArray[np.complex128]:
        """Return the poles of the plant without laws times the sampling period; none where it has none.

        Parameters
        ----------
        values : ndarray, shape (n_parameters,)
        """
        from sysid.physics import forced_kernels as fk

        n = self.order
        plants, _, _ = self.coefficients(values[np.newaxis], NO_LAW[np.newaxis])
        matrix = plants[0, fk.A : fk.A + 16].reshape(4, 4)[:n, :n]
        if not np.isfinite(matrix).all():
            return np.zeros(0, dtype=np.complex128)
        return np.asarray(np.linalg.eigvals(matrix) * self.period, dtype=np.complex128)

    def substeps(self, values: Floats, largest: float) -> tuple[int, float]:
        """Return the steps in a sample that are fine enough, and the plant's fastest rate in a sample.

        Parameters
        ----------
        values : ndarray, shape (n_parameters,)
        largest : float
            Largest product of the step and of the rate of a pole that lasts.  One that decays by exp(-d)
            within a sample leaves so much less of its error, which goes with the fourth power, so that its
            product may be larger by exp(d / 4), up to `COARSER` times.
        """
        poles = self.poles(values)
        rates = np.abs(poles)
        factors = np.minimum(np.exp(np.clip(-0.25 * poles.real, 0.0, 1.0 + np.log(COARSER))), COARSER)
        needed = int(np.ceil((rates / factors).max(initial=0.0) / largest))
        return min(max(needed, 1), MOST_SUBSTEPS), float(rates.max(initial=0.0))

    def run(
        self,
        values: Floats,
        laws: Floats,
        u: Floats,
        starts: Floats | None = None,
        substeps: int = 1,
        states: Floats | None = None,
        exact: bool | None = None,
        own: OwnLaw = NO_OWN_LAW,
    ) -> Floats:
        """Simulate several runs.

        Parameters
        ----------
        values : ndarray, shape (lanes, n_parameters)
            Every parameter of the model, in its order.
        laws : ndarray, shape (lanes, 19 or more)
            See `law`; behind them the parameters of ``own``.
        u : ndarray, shape (n_samples,), (n_samples, n_inputs) or (lanes, n_samples, n_inputs)
        starts : ndarray, shape (lanes, n_states), optional
            Initial states; at rest by default.
        substeps : int
            Runge-Kutta steps in a sample; a run without added forces is exact.
        states : ndarray, shape (lanes, n_samples, n_states), optional
            Filled with the states.
        exact : bool, optional
            Whether there are no added forces; found from the laws by default.
        own : OwnLaw
            Forces and gains of the user's own.

        Returns
        -------
        ndarray, shape (lanes, n_samples)
            Not a number from where a run diverges on.
        """
        from sysid.physics.forced_kernels import forced_runs
        from sysid.physics.forced_lanes import lane_runs
        from sysid.physics.linear_kernels import linear_runs

        lanes = values.shape[0]
        signal = u[np.newaxis, :, np.newaxis] if u.ndim == 1 else (u[np.newaxis] if u.ndim == 2 else u)
        signal = np.require(signal, requirements=["C", "W"])  # a kernel is compiled for one kind of array
        pieces = 1 if self.hold == "zero" else PIECES
        period = self.period / pieces
        if pieces > 1:
            signal, substeps = refined(signal, axis=1), -(-substeps // pieces)
        y = np.empty((lanes, signal.shape[1]))
        at_start = np.zeros((lanes, MOST_STATES))
        if starts is None:
            at_start[:, : self.order] = self._rest
        else:
            at_start[:, : self.order] = starts[:, self.states_first]
        inner = np.empty((lanes, signal.shape[1] if states is not None else 0, MOST_STATES))
        arguments = self.coefficients(values, laws, own)
        plants, by_input, direct = arguments
        if exact is None:
            exact = not own.terms and np.array_equal(laws, np.broadcast_to(NO_LAW, laws.shape))
        if exact:
            linear_runs(plants, self.order, by_input, direct, signal, at_start, period, y, inner)
        else:
            step = period / substeps
            powers = laws[:, POWERS]
            side_by_side = not own.terms and bool(((powers == 0.5) | (powers == 1.0)).all())
            known = (
                plants,
                self.order,
                self.same,
                by_input,
                direct,
                signal,
                at_start,
                step,
                substeps,
                y,
                inner,
            )
            if side_by_side:
                lane_runs(*known)
            else:
                forced_runs(*known, kernel_of(own))
        if states is not None:
            for k, state in enumerate(self.states_first):
                states[:, :, state] = inner[:, ::pieces, k]
        return y if pieces == 1 else np.ascontiguousarray(y[:, ::pieces])

    def respond(self, values: Floats, force: Floats) -> Floats:
        """Return the output, from rest, to a force alone, held between samples.

        Parameters
        ----------
        values : ndarray, shape (n_parameters,)
        force : ndarray, shape (n_samples,)

        Returns
        -------
        ndarray, shape (n_samples,)
            Zero for a model without a moving body.
        """
        from sysid.physics import forced_kernels as fk
        from sysid.physics.linear_kernels import linear_runs

        plants, _, direct = self.coefficients(values[np.newaxis], NO_LAW[np.newaxis])
        pushed = np.zeros((1, MOST_STATES, 1))
        pushed[0, 0, 0] = plants[0, fk.PUSH]
        plants[:, fk.STEADY : fk.STEADY + 4] = plants[:, fk.READ + 4] = 0.0
        y = np.empty((1, force.size))
        signal = np.ascontiguousarray(force)[np.newaxis, :, np.newaxis]
        at_start, inner = np.zeros((1, MOST_STATES)), np.empty((1, 0, MOST_STATES))
        linear_runs(plants, self.order, pushed, direct[:, :1] * 0.0, signal, at_start, self.period, y, inner)
        found: Floats = y[0]
        return found


def _columns(rows: Sequence[tuple[int, ...]], count: int) -> list[NDArray[np.intp]]:
    """Return the columns of a table of indices."""
    return list(np.array(rows, dtype=np.intp).reshape(-1, count).T)


def _order(port: Port, n: int) -> list[int]:
    """Return the states in the order of the kernels: velocity and position, or the levels, first."""
    first = [*port.levels]
    if port.velocity is not None and port.position is not None:
        first = [port.velocity, *([port.position] if port.position != port.velocity else [])]
    return [*first, *(i for i in range(n) if i not in first)]
