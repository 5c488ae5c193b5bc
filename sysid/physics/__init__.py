"""Continuous-time models made of physical terms, simulated and fitted."""

from sysid.physics.model import Equation, Model, Output, Parameter, Term, Variable
from sysid.physics.reading import load_model, model_names, read_model

__all__ = [
    "Equation",
    "Model",
    "Output",
    "Parameter",
    "Term",
    "Variable",
    "load_model",
    "model_names",
    "read_model",
]
