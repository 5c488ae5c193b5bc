"""Linear blocks: simulation, and fits judged by the free run."""

from sysid.linear.hammerstein import HammersteinFit, fit_hammerstein
from sysid.linear.output_error import OutputErrorFit, fit_output_error
from sysid.linear.selection import Choice, choose_output_error
from sysid.linear.simulation import Prediction, predict, simulate_polynomial, simulate_state_space
from sysid.linear.state_space import StateSpaceFit
from sysid.linear.state_space_fit import fit_state_space

__all__ = [
    "Choice",
    "HammersteinFit",
    "OutputErrorFit",
    "Prediction",
    "StateSpaceFit",
    "choose_output_error",
    "fit_hammerstein",
    "fit_output_error",
    "fit_state_space",
    "predict",
    "simulate_polynomial",
    "simulate_state_space",
]
