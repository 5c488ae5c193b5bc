"""Simulate a physical model: exactly when it is linear, by small Runge-Kutta steps otherwise."""

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import ModelError, UsageError
from sysid.linear.forms import Floats
from sysid.physics.generator import Sensitivities, Simulate, Writer, compiled_kernels
from sysid.physics.hold import PIECES, in_columns, over_pieces, refined
from sysid.physics.linear_form import Discrete, LinearForm, discretise, linear_form
from sysid.physics.model import Model

# Local errors of a Runge-Kutta step of length h go with (rate h)^5 / 120; 0.1 keeps a run at about 1e-6.
LARGEST_RATE_STEP = 0.1
MOST_SUBSTEPS = 1000
MOST_KEPT = 16


class Simulator:
    """Runs of a model at one sampling period.

    Parameters
    ----------
    model : Model
    period : float
        Sampling period [s]; the input is held between samples.
    searched : sequence of str, optional
        Parameters by which derivatives are taken; all that are not fixed by default.
    substeps : int, optional
        Runge-Kutta steps a sample for a model that is not linear (a piece of it, where the input is smooth);
        chosen by `choose_substeps` if not given.
    hold : {"zero", "smooth"}
        Between samples the input is held, or follows a cubic spline, as one that was sampled does.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.physics import load_model
    >>> simulator = Simulator(load_model("mass-spring-damper"), period=0.1)
    >>> y = simulator.run({"m": 1.0, "c": 2.0, "k": 4.0}, np.ones(200))
    >>> round(float(y[-1, 0]), 6)
    0.25
    """

    def __init__(
        self,
        model: Model,
        period: float,
        substeps: int | None = None,
        searched: Sequence[str] | None = None,
        hold: str = "zero",
    ) -> None:
        if not (np.isfinite(period) and period > 0.0):
            raise UsageError(f"the sampling period is {period}: give a positive number of seconds")
        self.model = model
        self.period = float(period)
        fixed_zero = {p.name for p in model.parameters if p.status == "fixed" and p.start == 0.0}
        free = tuple(p.name for p in model.parameters if p.status != "fixed")
        self.searched = free if searched is None else tuple(searched)
        self._carried = tuple(p.name for p in model.parameters if p.name not in fixed_zero)
        self._positions = [self._carried.index(name) for name in self.searched]
        self.form: LinearForm | None = linear_form(model, self.searched)
        self.substeps = substeps
        self.hold = hold
        # The last inputs in columns: a search runs the same ones over and over.
        self._driving: dict[int, tuple[Floats, Floats]] = {}

    @property
    def linear(self) -> bool:
        """Whether the model is linear in state and input, and so simulated exactly."""
        return self.form is not None

    @cached_property
    def _searches_delay(self) -> bool:
        return any(variable.delay in self.searched for variable in self.model.inputs)

    @cached_property
    def source(self) -> str:
        """Generated source of the Runge-Kutta kernels."""
        model = self.model
        return Writer(
            model.reduced_rates(),
            model.reduced_outputs(),
            [state.name for state in model.states],
            [variable.name for variable in model.inputs],
            self._carried,
        ).source()

    @cached_property
    def _kernels(self) -> tuple[Simulate, Sensitivities]:
        return compiled_kernels(self.source)

    def values(self, changes: Mapping[str, float] | None = None) -> dict[str, float]:
        """Return the start value of every parameter, with changes."""
        for name, value in (changes or {}).items():
            parameter = self.model.parameter(name)
            if parameter.status == "fixed" and parameter.start == 0.0 and value != 0.0:
                raise ModelError(
                    f"parameter {name!r} of model {self.model.name!r} is fixed at 0 and cannot be {value:g}: "
                    "give it a start value or another fixed value first"
                )
        values = {parameter.name: parameter.start for parameter in self.model.parameters}
        return values | {name: float(value) for name, value in (changes or {}).items()}

    def rest(self) -> Floats:
        """Return the state at rest."""
        return np.array([state.rest for state in self.model.states])

    def run(
        self,
        values: Mapping[str, float],
        u: ArrayLike,
        start: ArrayLike | None = None,
        *,
        before: float = 0.0,
    ) -> Floats:
        """Simulate one experiment.

        Parameters
        ----------
        values : mapping of str to float
            Parameters; the model's start values for those left out.
        u : array_like, shape (n_samples,) or (n_samples, n_inputs)
        start : array_like, shape (n_states,), optional
            Initial state; at rest by default.
        before : float
            Share of the first input that a delayed input shows before the first sample: 0 or 1.

        Returns
        -------
        ndarray, shape (n_samples, n_outputs)
            Not finite from where the model diverges on.
        """
        signal, state, known = self._checked(values, u, start)
        y = np.empty((signal.shape[0], len(self.model.outputs)))
        delayed, _ = self._delayed(signal, known, before, slopes=False)
        if self.form is not None:
            from sysid.physics.kernels import affine_run

            d = self._discrete(known, slopes=False)
            affine_run(d.A, d.B, d.C, d.D, self._driven_by(delayed), state, y)
            return y
        pieces = PIECES if self.hold == "smooth" else 1
        if pieces > 1:
            delayed = refined(delayed)
            y = np.empty((pieces * y.shape[0], y.shape[1]))
        substeps = self._substeps(known, delayed, state)
        p = np.array([known[name] for name in self._carried])
        self._kernels[0](delayed, state, p, self.period / pieces / substeps, substeps, y)
        return np.ascontiguousarray(y[::pieces])

    def sensitivities(
        self,
        values: Mapping[str, float],
        u: ArrayLike,
        start: ArrayLike | None = None,
        *,
        before: float = 0.0,
    ) -> tuple[Floats, Floats]:
        """Simulate with derivatives by the searched parameters and by the initial state.

        Returns
        -------
        y : ndarray, shape (n_samples, n_outputs)
        J : ndarray, shape (n_samples, n_outputs, n_searched + n_states)
        """
        signal, state, known = self._checked(values, u, start)
        n_rows, n_outputs = signal.shape[0], len(self.model.outputs)
        y = np.empty((n_rows, n_outputs))
        delayed, slopes = self._delayed(signal, known, before, slopes=True)
        if self.form is not None:
            from sysid.physics.kernels import affine_sensitivities

            d = self._discrete(known, slopes=True)
            delayed = self._driven_by(delayed)
            slopes = slopes[self._positions] if self._searches_delay else slopes[:0]
            if self.hold == "smooth" and slopes.size:
                slopes = in_columns(slopes, axis=1)
            J = np.empty((n_rows, n_outputs, len(self.searched) + self.model.order))
            read_out = any(self.form.output_slopes)
            affine_sensitivities(
                *(d.A, d.B, d.C, d.D, d.A_slopes, d.B_slopes),
                *((d.C_slopes, d.D_slopes) if read_out else (d.C_slopes[:0], d.D_slopes[:0])),
                *(delayed, slopes, state, y, J),
            )
            return y, J
        pieces = PIECES if self.hold == "smooth" else 1
        if not self._searches_delay:
            slopes = slopes[:0]
        if pieces > 1:
            delayed, slopes = refined(delayed), refined(slopes, axis=1) if slopes.size else slopes
            y = np.empty((pieces * n_rows, n_outputs))
        substeps = self._substeps(known, delayed, state)
        p = np.array([known[name] for name in self._carried])
        J = np.empty((y.shape[0], n_outputs, p.size + self.model.order))
        self._kernels[1](delayed, slopes, state, p, self.period / pieces / substeps, substeps, y, J)
        y, J = np.ascontiguousarray(y[::pieces]), np.ascontiguousarray(J[::pieces])
        chosen = [*self._positions, *range(p.size, p.size + self.model.order)]
        return y, J if len(chosen) == J.shape[2] else np.ascontiguousarray(J[:, :, chosen])

    def _discrete(self, values: Mapping[str, float], *, slopes: bool) -> Discrete:
        """Return the exact recursion over a sample."""
        assert self.form is not None
        if self.hold == "zero":
            return discretise(self.form, values, self.period, slopes=slopes)
        return over_pieces(discretise(self.form, values, self.period / PIECES, slopes=slopes))

    def _driven_by(self, delayed: Floats) -> Floats:
        """Return what drives the recursion over a sample."""
        if self.hold == "zero":
            return delayed
        kept = self._driving.get(id(delayed))
        if kept is None or kept[0] is not delayed:
            if len(self._driving) > MOST_KEPT:
                self._driving.clear()
            kept = self._driving[id(delayed)] = (delayed, in_columns(delayed))
        return kept[1]

    def delayed_input(self, u: ArrayLike, values: Mapping[str, float], before: float = 0.0) -> Floats:
        """Return the input as the equations see it, behind its delays; same shape.

        Parameters
        ----------
        u : array_like, shape (n_samples, n_inputs)
        values : mapping of str to float
        before : float
            Share of the first input that a delayed input shows before the first sample: 0 or 1.
        """
        signal, _, known = self._checked(values, u, None)
        return self._delayed(signal, known, before, slopes=False)[0]

    def _checked(
        self, values: Mapping[str, float], u: ArrayLike, start: ArrayLike | None
    ) -> tuple[Floats, Floats, dict[str, float]]:
        signal = np.ascontiguousarray(u, dtype=np.float64)
        if signal.ndim == 1:
            signal = signal[:, np.newaxis]
        if signal.ndim != 2 or signal.shape[1] != len(self.model.inputs):
            raise UsageError(
                f"the input has the shape {signal.shape}, model {self.model.name!r} takes "
                f"{len(self.model.inputs)} inputs: give the shape (n_samples, n_inputs)"
            )
        state = self.rest() if start is None else np.array(start, dtype=np.float64)
        if state.shape != (self.model.order,):
            raise UsageError(
                f"the initial state has the shape {state.shape}: it must be ({self.model.order},)"
            )
        return signal, state, self.values(values)

    def _delayed(
        self, u: Floats, values: Mapping[str, float], before: float, *, slopes: bool
    ) -> tuple[Floats, Floats]:
        """Return the delayed input and its derivative by each carried parameter.

        Between samples a delay interpolates linearly; before the first sample the input is its first
        value times ``before``.
        """
        has_delay = any(variable.delay in self._carried for variable in self.model.inputs)
        du = np.zeros((len(self._carried), *(u.shape if slopes else (1, u.shape[1]))))
        if not has_delay:
            return u, du
        delayed = u.copy()
        n_rows = u.shape[0]
        for j, variable in enumerate(self.model.inputs):
            if variable.delay not in self._carried:
                continue
            samples = min(values[variable.delay] / self.period, n_rows + 1.0)
            whole = int(samples)
            padded = np.concatenate([np.full(whole + 1, before * u[0, j]), u[:, j]])
            near, far = padded[1 : n_rows + 1], padded[:n_rows]
            delayed[:, j] = near + (samples - whole) * (far - near)
            if slopes:
                du[self._carried.index(variable.delay), :, j] = (far - near) / self.period
        return delayed, du

    def _substeps(self, values: Mapping[str, float], u: Floats, state: Floats) -> int:
        if self.substeps is None:
            period = self.period / (PIECES if self.hold == "smooth" else 1)
            self.substeps = choose_substeps(self.model, values, period, u, state)
        return self.substeps


def choose_substeps(
    model: Model, values: Mapping[str, float], period: float, u: Floats, state: Floats
) -> int:
    """Return the number of Runge-Kutta steps in a sample from the fastest rate of the linearised model.

    The rate is that at the initial state, for inputs over their range; a run that goes on to faster
    states is checked by halving the step (see `step_error`).
    """
    fastest = fastest_rate(model, values, u, state)
    needed = np.ceil(fastest * period / LARGEST_RATE_STEP)
    if needed > MOST_SUBSTEPS:
        raise ModelError(
            f"model {model.name!r} has a rate of {fastest:.3g} 1/s, too fast for the sampling period "
            f"{period:.3g} s ({needed:.0f} steps in a sample): check the parameters and their units"
        )
    return max(int(needed), 1)


def fastest_rate(model: Model, values: Mapping[str, float], u: Floats, state: Floats) -> float:
    """Return the fastest rate [1/s] of a model linearised at a state, for inputs over their range."""
    levels = {tuple(u.min(axis=0)), tuple(u.max(axis=0))}
    rates = [np.abs(linearised_poles(model, values, state, np.array(level))) for level in levels]
    return float(max(found.max(initial=0.0) for found in rates))


def linearised_poles(
    model: Model, values: Mapping[str, float], state: Floats, level: Floats
) -> NDArray[np.complex128]:
    """Return the poles [1/s] of a model linearised at a state and an input; none where it has no slope."""
    names = [variable.name for variable in model.states]
    point = dict(values) | dict(zip(names, state.tolist(), strict=True))
    point |= dict(zip((variable.name for variable in model.inputs), level.tolist(), strict=True))
    matrix = np.reshape(model.rate_slopes(point), (len(names), len(names)))
    return np.linalg.eigvals(matrix) if np.isfinite(matrix).all() else np.empty(0, dtype=np.complex128)


def step_error(simulator: Simulator, values: Mapping[str, float], u: ArrayLike, start: ArrayLike) -> float:
    """Return how much half the step changes the output, relative to the output's size; 0 if exact."""
    if simulator.linear:
        return 0.0
    coarse = simulator.run(values, u, start)
    twice = Simulator(simulator.model, simulator.period, 2 * (simulator.substeps or 1), hold=simulator.hold)
    fine = twice.run(values, u, start)
    size = float(np.std(fine)) or 1.0
    return float(np.sqrt(np.mean((coarse - fine) ** 2))) / size
