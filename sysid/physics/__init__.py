"""Continuous-time models made of physical terms, simulated and fitted."""

from sysid.physics.fit import PhysicsFit, fit_physics
from sysid.physics.model import Equation, Model, Output, Parameter, Term, Variable
from sysid.physics.reading import load_model, model_names, read_model

__all__ = [
    "Equation",
    "Model",
    "Output",
    "Parameter",
    "PhysicsFit",
    "Term",
    "Variable",
    "fit_physics",
    "load_model",
    "model_names",
    "read_model",
]
