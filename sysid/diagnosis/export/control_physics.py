"""A physical model with effects as a system of python-control."""

from typing import Any

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.export.saved_physics import SavedPhysicalModel
from sysid.diagnosis.structures.pointwise import check_pointwise
from sysid.errors import ModelError
from sysid.physics import forced_kernels as fk
from sysid.physics.forced import MOST_STATES, ForcedPlant
from sysid.physics.own_laws import kernel_of


def control_system(saved: SavedPhysicalModel) -> Any:
    """Return a `control.NonlinearIOSystem` in continuous time.

    Its states are those of the model, a velocity on which friction acts first, and the deflection of an
    elastic contact last if there is one.  Dry friction holds a body that rests and jumps with the
    direction of one that moves, as the simulation of `SavedPhysicalModel.simulate` has it.
    """
    import control

    plant = saved.plant
    if not isinstance(plant, ForcedPlant):
        raise ModelError(
            f"model {saved.model.name!r} is not linear in its states: use SavedPhysicalModel.simulate instead"
        )
    check_pointwise(saved.choices)
    values, laws = saved.values[np.newaxis], saved.law[np.newaxis]
    plants, by_input, direct = plant.coefficients(values, laws, saved.own_law)
    w, n, port, own = plants[0], plant.order, plant.port, kernel_of(saved.own_law)
    dry = bool((w[[fk.FRICTION_FORWARD, fk.FRICTION_BACK]] > 0.0).any() or w[fk.BREAKAWAY] != 0.0)
    contact = bool(w[fk.YIELD] > 0.0)

    def state(x: Floats) -> fk.State:
        z = np.zeros(MOST_STATES + 1)
        z[:n] = x[:n]
        z[:2] = np.minimum(z[:2], w[[fk.FIRST_CAP, fk.SECOND_CAP]])
        if contact:
            z[MOST_STATES] = x[n]
        return (z[0], z[1], z[2], z[3], z[4])

    def update(t: float, x: Floats, u: Floats, params: Any) -> Floats:
        first = saved.applied("input", np.array([u[0]], dtype=float))
        w[fk.DRIVE : fk.DRIVE + MOST_STATES] = by_input[0] @ np.concatenate([first, u[1:]])
        z = state(x)
        rates = np.array(fk.rates_at(w, n, plant.same, z, dry, own))
        if port.levels and z[0] >= w[fk.FIRST_CAP]:
            rates[1] += w[fk.CAUGHT] * max(rates[0], 0.0)
        for place, cap in enumerate((fk.FIRST_CAP, fk.SECOND_CAP)):
            if port.levels and z[place] >= w[cap]:
                rates[place] = min(rates[place], 0.0)
        return np.concatenate([rates[:n], rates[MOST_STATES:] if contact else rates[:0]])

    def measured(t: float, x: Floats, u: Floats, params: Any) -> Floats:
        z = np.array(state(x))[:MOST_STATES]
        first = saved.applied("input", np.array([u[0]], dtype=float))
        value = w[fk.READ : fk.READ + MOST_STATES] @ z + w[fk.READ + MOST_STATES]
        value += float(direct[0] @ np.concatenate([first, u[1:]]))
        return saved.applied("output", np.array([value]))

    return control.NonlinearIOSystem(
        update,
        measured,
        states=n + int(contact),
        inputs=[variable.name for variable in saved.model.inputs],
        outputs=[saved.model.outputs[0].name],
        name="diagnosed",
    )
