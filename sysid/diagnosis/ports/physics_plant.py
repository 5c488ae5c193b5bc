"""A physical model as the plant around a port."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sysid.data import Record
from sysid.diagnosis.ports.kernels import BEHIND, KNOWN, STATE
from sysid.diagnosis.ports.plants import Matrices, Port
from sysid.errors import ModelError
from sysid.linear.forms import Floats
from sysid.physics.expressions import symbols
from sysid.physics.fitted import PhysicsFit
from sysid.physics.hold import PIECES, in_columns, over_pieces
from sysid.physics.linear_form import Discrete, discretise, linear_form
from sysid.physics.model import Model, Variable
from sysid.physics.simulation import Simulator

# A positive parameter ran off where the logarithm of how often its start value fits in it is beyond this.
RAN_OFF = 3.0


class PhysicsPlant:
    """A physical model that is linear in state and input, with one more input for the missing force.

    The force acts where the model's mechanics act: in the equation of the output's rate of change
    if that is a state of its own (a position with its velocity), otherwise in the output's equation.
    """

    black_box = False

    def __init__(self, fit: PhysicsFit):
        self.fit = fit
        self.order = fit.order
        self.lag = 0
        self.free_start = fit.initial_state == "estimate"
        self.period = fit.period
        model = fit.model
        delays = {variable.delay for variable in model.inputs}
        self.names = tuple(name for name in fit.names if name not in delays)
        self.position, self.velocity = mechanical_states(model)
        forced = with_force(model, self.velocity)
        form = linear_form(forced, self.names)
        if form is None:
            raise ModelError(
                f"model {model.name!r} is not linear in state and input, and curves at ports are fitted "
                "around linear parts only: fix its nonlinear terms at zero, or take the model 'linear'"
            )
        self.form = form
        self.simulator = Simulator(model, fit.period, searched=self.names)
        self.smooth = fit.hold == "smooth"
        self.positive = np.array([model.parameter(name).positive for name in self.names], dtype=bool)
        self.start = self._parameters(fit.values)
        # Without its map a model may fit best with a parameter that ran off, where no slope leads back.
        nominal = self._parameters({**fit.values, **fit.nominal})
        away = np.abs(self.start - nominal)[self.positive].max(initial=0.0)
        self.origins: tuple[Floats, ...] = (self.start, nominal) if away > RAN_OFF else (self.start,)

    def _parameters(self, values: Mapping[str, float]) -> Floats:
        """Return what is searched: the logarithms of positive parameters, and the others."""
        plain = np.array([values[name] for name in self.names])
        return np.where(self.positive, np.log(np.where(self.positive, plain, 1.0)), plain)

    def values(self, parameters: Floats) -> dict[str, float]:
        """Return every parameter of the model."""
        with np.errstate(over="ignore"):
            plain = np.where(self.positive, np.exp(np.where(self.positive, parameters, 0.0)), parameters)
        return {**self.fit.values, **dict(zip(self.names, plain.tolist(), strict=True))}

    def ports(self, record: Record, kinds: Sequence[str]) -> tuple[Port, ...]:
        """Return one port for each input, one behind, and the forces the model has a place for."""
        model = self.fit.model
        y, y_unit = record.outputs[0], record.unit(record.outputs[0]) or model.outputs[0].unit
        found = []
        for i, (name, variable) in enumerate(zip(record.inputs, model.inputs, strict=True)):
            unit = record.unit(name) or variable.unit.split(" ")[0]
            found.append(Port("input", i, KNOWN, 1.0, 0, False, name, unit, f"added to {name}", unit))
        found.append(
            Port("output", 0, BEHIND, 1.0, 0, True, f"{y} of the model", y_unit, f"added to {y}", y_unit)
        )
        force_unit = model.equations[self.velocity].unit
        own = {"position": self.position, "velocity": self.velocity}
        if self.position == self.velocity:
            moves = model.states[self.position].unit.endswith("/s")
            own = {"velocity" if moves else "position": self.position}
        for kind, number in own.items():
            state = model.states[number]
            name = state.meaning or state.name
            value = f"taken from {model.equations[self.velocity].state}'s balance"
            found.append(
                Port(
                    kind, 0, STATE, -1.0, number, number == self.position, name, state.unit, value, force_unit
                )
            )
        return tuple(port for port in found if port.kind in kinds)

    def channels(self, u: Floats) -> Floats:
        """Return the inputs as the equations see them, and a constant."""
        held = self._delayed(u)
        if self.smooth:
            held = in_columns(held)
        return np.ascontiguousarray(np.hstack([held, np.ones((u.shape[0], 1))]))

    def map_input(self, u: Floats, channel: int) -> Floats:
        """Return the input behind its delay, where the map then acts."""
        return np.ascontiguousarray(self._delayed(u)[:, channel])

    def _delayed(self, u: Floats) -> Floats:
        return self.simulator.delayed_input(u, self.fit.values, float(self.free_start))

    def matrices(self, parameters: Floats, port: Port) -> Matrices | None:
        """Return the exact recursion for inputs as in the fit and a force held between samples.

        The force is that of the state half a sample ahead, as the plant without it would be: held
        from the state at the sample it would lag by half a sample and take damping away.
        """
        with np.errstate(over="ignore"):
            chain = np.where(self.positive, np.exp(np.where(self.positive, parameters, 0.0)), 1.0)
        if not np.isfinite(chain).all():  # a parameter that ran off beyond all numbers
            return None
        d = self._discrete(parameters, 1.0)
        if not (np.isfinite(d.A).all() and np.isfinite(d.A_slopes).all()):
            return None
        n_inputs = len(self.fit.model.inputs)
        P = len(self.names)
        # The missing force is one more input behind those of the model, with pieces of its own if they have.
        kept = [*range(n_inputs), n_inputs + 1]
        force = port.channel if port.kind == "input" else n_inputs
        held, read = [force], force
        if self.smooth:
            first = (n_inputs + 1) * PIECES
            kept = [*range(n_inputs * PIECES), *range(first, first + n_inputs), first + n_inputs + 1]
            held, read = [*range(force * PIECES, (force + 1) * PIECES)], first + force
        half = self._discrete(parameters, 0.5)
        H, dH = half.A[port.state].copy(), half.A_slopes[:, port.state] * chain[:, np.newaxis]
        K, dK = half.B[port.state, kept], half.B_slopes[:, port.state][:, kept] * chain[:, np.newaxis]
        behind = port.mode == BEHIND
        scale = chain[:, np.newaxis]
        E, G = d.B[:, held].sum(axis=-1), 1.0 if behind else float(d.D[0, read])
        dG = np.zeros(P) if behind else d.D_slopes[:, 0, read] * chain
        dB, dC = d.B_slopes * chain[:, np.newaxis, np.newaxis], d.C_slopes[:, 0] * scale
        dA, dD = d.A_slopes * chain[:, np.newaxis, np.newaxis], d.D_slopes[:, 0, kept] * scale
        dE = dB[:, :, held].sum(axis=-1)
        if self.smooth and port.kind == "input":
            # The map's output goes straight from s(k) to s(k+1): x(k+1) = A x + E0 s(k) + E1 s(k+1) is
            # E = E0 + A E1, G = G + C E1 for the state x(k) - E1 s(k).
            late = (np.arange(PIECES) + 0.5) / PIECES
            E1, dE1 = d.B[:, held] @ late, dB[:, :, held] @ late
            E, dE = E - E1 + d.A @ E1, dE - dE1 + dA @ E1 + dE1 @ d.A.T
            G, dG = G + float(d.C[0] @ E1), dG + dC @ E1 + dE1 @ d.C[0]
        return Matrices(
            (d.A, np.ascontiguousarray(d.B[:, kept]), d.C[0].copy(), d.D[0, kept], E, G, H, K),
            (dA, np.ascontiguousarray(dB[:, :, kept]), dC, dD, dE, dG, dH, dK),
        )

    def _discrete(self, parameters: Floats, share: float) -> Discrete:
        """Return the recursion over a share of a sample: half or all of it."""
        values = self.values(parameters)
        if not self.smooth:
            return discretise(self.form, values, share * self.period, slopes=True)
        piece = discretise(self.form, values, self.period / PIECES, slopes=True)
        return over_pieces(piece, round(share * PIECES))


def mechanical_states(model: Model) -> tuple[int, int]:
    """Return the numbers of the position and of the velocity; equal where the output is its own speed."""
    names = [state.name for state in model.states]
    seen = symbols(model.outputs[0].expression)
    position = next((i for i, name in enumerate(names) if name in seen), 0)
    rate = model.equations[position].rate
    for number, name in enumerate(names):
        if number != position and symbols(rate) == {name}:
            return position, number
    return position, position


def with_force(model: Model, number: int) -> Model:
    """Return the model with one more input, which acts in the equation of a state."""
    name = "missing"
    while name in model.names:
        name += "_"
    equation = model.equations[number]
    extended = replace(model, inputs=(*model.inputs, Variable(name, equation.unit)))
    return extended.with_term(equation.state, "missing force", name)
