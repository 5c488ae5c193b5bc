"""Runs of any physical model for diagnosis: effects at its input and output, none inside."""

from collections.abc import Sequence
from threading import Lock

import numpy as np

from sysid.errors import ModelError
from sysid.linear.forms import Floats
from sysid.physics.model import Model
from sysid.physics.ports import Port
from sysid.physics.simulation import Simulator, choose_substeps


class GeneralPlant:
    """Runs of a model that is not linear, or has many states, as `ForcedPlant` makes them.

    Parameters
    ----------
    model : Model
        With one output.
    period : float
        Sampling period [s]; the input is held between samples.

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
    port = Port()

    def __init__(self, model: Model, period: float) -> None:
        if len(model.outputs) != 1:
            raise ModelError(f"model {model.name!r} has {len(model.outputs)} outputs: diagnosis takes one")
        self.model, self.period = model, period
        self.names = tuple(parameter.name for parameter in model.parameters)
        self.order, self.n_inputs = len(model.states), len(model.inputs)
        self._simulator = Simulator(model, period)
        self._one_at_a_time = Lock()

    def substeps(self, values: Floats, largest: float) -> int:
        """Return the Runge-Kutta steps in a sample, as the model chooses them itself."""
        if self._simulator.linear:
            return 1
        named = dict(zip(self.names, values[0].tolist(), strict=True))
        rest = self._simulator.rest()
        return choose_substeps(self.model, named, self.period, np.zeros((1, self.n_inputs)), rest)

    def run(
        self,
        values: Floats,
        laws: Floats,
        u: Floats,
        starts: Floats | None = None,
        substeps: int = 1,
        states: Floats | None = None,
        exact: bool | None = None,
    ) -> Floats:
        """Simulate several runs; laws are left out, and of the states only their size is told."""
        lanes = values.shape[0]
        signal = u[np.newaxis, :, np.newaxis] if u.ndim == 1 else (u[np.newaxis] if u.ndim == 2 else u)
        with self._one_at_a_time:  # the simulator holds the number of its steps
            self._simulator.substeps = substeps
            runs = [
                self._run(values[lane], signal[lane if signal.shape[0] > 1 else 0], starts, lane)
                for lane in range(lanes)
            ]
        if states is not None:
            states[:] = np.array(runs)[:, :, np.newaxis]
        return np.array(runs)

    def _run(self, values: Floats, u: Floats, starts: Floats | None, lane: int) -> Floats:
        named: Sequence[tuple[str, float]] = list(zip(self.names, values.tolist(), strict=True))
        start = None if starts is None else starts[lane]
        with np.errstate(all="ignore"):
            return np.asarray(self._simulator.run(dict(named), u, start)[:, 0])

    def respond(self, values: Floats, force: Floats) -> Floats:
        """Return zeros: the model has no port for a force."""
        return np.zeros(force.size)


def is_general(model: Model) -> bool:
    """Tell whether a model is not one for `sysid.physics.forced`."""
    from sysid.physics.forced import MOST_STATES
    from sysid.physics.linear_form import linear_form

    delayed = any(variable.delay for variable in model.inputs)
    unknown_delay = delayed and any(model.parameter(v.delay).start != 0.0 for v in model.inputs if v.delay)
    return linear_form(model, ()) is None or len(model.states) > MOST_STATES or unknown_delay
