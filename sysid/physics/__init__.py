"""Continuous-time models made of physical terms, simulated and fitted.

The fit is loaded when first used: models can be read and listed without it.
"""

from typing import TYPE_CHECKING, Any

from sysid.physics.classes import PhysicsModel, is_model_class
from sysid.physics.model import Equation, Model, Output, Parameter, Prior, Starts, Term, Variable
from sysid.physics.reading import all_model_names, is_known, load_model, model_names, read_model

if TYPE_CHECKING:
    from sysid.physics.fit import fit_physics, refit_physics
    from sysid.physics.fitted import PhysicsFit
    from sysid.physics.simulation import Simulator

__all__ = [
    "Equation",
    "Model",
    "Output",
    "Parameter",
    "PhysicsFit",
    "PhysicsModel",
    "Prior",
    "Simulator",
    "Starts",
    "Term",
    "Variable",
    "all_model_names",
    "fit_physics",
    "is_known",
    "is_model_class",
    "load_model",
    "model_names",
    "read_model",
    "refit_physics",
]

_LATE = {
    "PhysicsFit": "sysid.physics.fitted",
    "Simulator": "sysid.physics.simulation",
    "fit_physics": "sysid.physics.fit",
    "refit_physics": "sysid.physics.fit",
}


def __getattr__(name: str) -> Any:
    if name in _LATE:
        from importlib import import_module

        return getattr(import_module(_LATE[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
