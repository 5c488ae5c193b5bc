"""The plant whose ports are opened, from a fitted model."""

from sysid.diagnosis.ports.linear_plant import LinearPlant
from sysid.diagnosis.ports.physics_plant import PhysicsPlant
from sysid.diagnosis.ports.plants import Plant
from sysid.errors import UsageError
from sysid.linear.output_error import OutputErrorFit
from sysid.physics.fitted import PhysicsFit


def plant_of(model: OutputErrorFit | PhysicsFit) -> Plant:
    """Return the plant of a fitted model.

    Raises
    ------
    ModelError
        If a physical model is not linear in state and input.
    UsageError
        If the model is of another kind.
    """
    if isinstance(model, OutputErrorFit):
        return LinearPlant(model)
    if isinstance(model, PhysicsFit):
        return PhysicsPlant(model)
    raise UsageError(
        f"the model is of type {type(model).__name__}: give the result of fit_output_error or fit_physics"
    )
