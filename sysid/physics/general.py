"""Runs of any physical model for diagnosis: effects at its input and output, and smooth forces inside."""

from dataclasses import replace
from threading import Lock

import numpy as np

from sysid.errors import ModelError
from sysid.linear.forms import Floats
from sysid.physics.expressions import Symbol
from sysid.physics.forced import LAW_NAMES, NO_LAW
from sysid.physics.model import Model, Output, Parameter, Term
from sysid.physics.own_laws import NO_OWN_LAW, OwnLaw, renamed
from sysid.physics.ports import Port, find_port
from sysid.physics.simulation import MOST_SUBSTEPS, Simulator, fastest_rate

# Forces that are smooth in position x and speed v, by the coefficients of a law that they take.
SMOOTH_FORCES = {
    "drag": "-law_drag*{v}*abs({v})",
    "cubic": "-law_cubic*{x}**3",
    "gravity": "-law_gravity*sin(law_wave_number*{x})",
    "constant": "law_constant",
}


class GeneralPlant:
    """Runs of a model that is not linear, or has many states, as `ForcedPlant` makes them.

    Parameters
    ----------
    model : Model
        With one output.
    period : float
        Sampling period [s]; the input is held between samples.

    Attributes
    ----------
    port : Port
        Where forces enter; nowhere in a linear model with many states or a delay, whose run is exact.

    Examples
    --------
    >>> from sysid.physics import load_model
    >>> hard = load_model("oscillator").with_parameters(start={"cubic": 2.0})
    >>> plant = GeneralPlant(hard, 0.1)
    >>> values = np.array([[1.0, 0.1, 1.0, 2.0]])
    >>> y = plant.run(values, np.empty((1, 0)), np.ones(400), substeps=1)
    >>> round(float(y[0, -100:].mean()), 2)  # it settles where x + 2 x^3 = 1
    0.59
    """

    hold = "zero"
    same = False
    always_steps = True

    def __init__(self, model: Model, period: float) -> None:
        if len(model.outputs) != 1:
            raise ModelError(f"model {model.name!r} has {len(model.outputs)} outputs: diagnosis takes one")
        self.model, self.period = model, period
        self.names = tuple(parameter.name for parameter in model.parameters)
        self.order, self.n_inputs = len(model.states), len(model.inputs)
        self._simulator = Simulator(model, period)
        self._simulators: dict[OwnLaw, Simulator] = {}
        self._one_at_a_time = Lock()
        found = Port() if self._simulator.linear else find_port(model)
        self.port = Port() if found.velocity is None else replace(found, levels=())

    def _with_forces(self, own: OwnLaw) -> Simulator:
        """Return the simulator of the model with smooth forces, and of its states beside the output."""
        if own not in self._simulators:
            self._simulators[own] = self._forced(own)
        return self._simulators[own]

    def _forced(self, own: OwnLaw) -> Simulator:
        velocity, position = self.port.velocity, self.port.position
        model = self.model
        if velocity is not None and position is not None:
            names = {"v": model.states[velocity].name, "x": model.states[position].name}
            for name, expression in SMOOTH_FORCES.items():
                needed = [name, "wave_number"] if name == "gravity" else [name]
                parameters = tuple(Parameter(f"law_{coefficient}", "", 0.0) for coefficient in needed)
                model = model.with_term(names["v"], name, expression.format(**names), parameters)
            for number, (_, expression, given) in enumerate(own.terms):
                called = names | {name: f"law_own{number}_{name}" for name in given}
                parameters = tuple(Parameter(called[name], "", 0.0) for name in given)
                force = f"-({renamed(expression, called)})"
                model = model.with_term(names["v"], f"own{number}", force, parameters)
        inside = tuple(
            Output(f"state_{state.name}", state.unit, (Term(state.name, Symbol(state.name)),))
            for state in model.states
        )
        return Simulator(replace(model, outputs=(*model.outputs, *inside)), self.period, searched=())

    def substeps(self, values: Floats, largest: float) -> tuple[int, float]:
        """Return the steps in a sample that are fine enough, and the plant's fastest rate in a sample.

        Parameters
        ----------
        values : ndarray, shape (n_parameters,)
        largest : float
            Largest product of the step and of the fastest rate of the model linearised at rest.  Where this
            asks for more steps than any simulation takes, the rate is infinite.
        """
        if self._simulator.linear:
            return 1, largest
        named = dict(zip(self.names, values.tolist(), strict=True))
        still = np.zeros((1, self.n_inputs))
        pace = fastest_rate(self.model, named, still, self._simulator.rest()) * self.period
        needed = np.ceil(pace / largest)
        return (max(int(needed), 1), pace) if needed <= MOST_SUBSTEPS else (1, np.inf)

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
        """Simulate several runs; of the laws the smooth forces count, and forces of the user's own."""
        lanes = values.shape[0]
        signal = u[np.newaxis, :, np.newaxis] if u.ndim == 1 else (u[np.newaxis] if u.ndim == 2 else u)
        pushed = exact is False and self.port.velocity is not None
        simulator = self._with_forces(own) if pushed or states is not None else self._simulator
        names = [f"law_own{i}_{name}" for i, (_, _, given) in enumerate(own.terms) for name in given]
        runs = np.empty((lanes, signal.shape[1]))
        with self._one_at_a_time:  # the simulator holds the number of its steps
            simulator.substeps = substeps
            for lane in range(lanes):
                named = dict(zip(self.names, values[lane].tolist(), strict=True))
                if simulator is not self._simulator and self.port.velocity is not None:
                    law = laws[lane] if pushed else NO_LAW
                    named |= {f"law_{name}": float(law[LAW_NAMES.index(name)]) for name in _COEFFICIENTS}
                    named |= dict(zip(names, laws[lane, NO_LAW.size :].tolist(), strict=True))
                start = None if starts is None else starts[lane]
                with np.errstate(all="ignore"):
                    found = simulator.run(named, signal[lane if signal.shape[0] > 1 else 0], start)
                runs[lane] = found[:, 0]
                if states is not None:
                    states[lane] = found[:, 1:]
        return runs

    def respond(self, values: Floats, force: Floats) -> Floats:
        """Return how a constant force as large as this one changes the output: its size is what counts."""
        if self.port.velocity is None:
            return np.zeros(force.size)
        laws = np.tile(NO_LAW, (2, 1))
        laws[1, LAW_NAMES.index("constant")] = float(np.sqrt(np.mean(force**2)))
        still = np.zeros((force.size, self.n_inputs))
        many = np.tile(values, (2, 1))
        runs = self.run(many, laws, still, None, self.substeps(values, 1.0)[0], exact=False)
        return np.asarray(runs[1] - runs[0])


_COEFFICIENTS = (*SMOOTH_FORCES, "wave_number")


def is_general(model: Model) -> bool:
    """Tell whether a model is not one for `sysid.physics.forced`."""
    from sysid.physics.forced import MOST_STATES
    from sysid.physics.linear_form import linear_form

    delayed = any(variable.delay for variable in model.inputs)
    unknown_delay = delayed and any(model.parameter(v.delay).start != 0.0 for v in model.inputs if v.delay)
    return linear_form(model, ()) is None or len(model.states) > MOST_STATES or unknown_delay
