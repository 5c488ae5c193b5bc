"""Recursive identification of Hammerstein systems, sample by sample: Giri's scheme and its kin."""

from sysid.recursive.algorithms import Kaczmarz, ProjectionGradient, RecursiveLeastSquares
from sysid.recursive.base import Recursive, Snapshot, regressors
from sysid.recursive.convergence import (
    averaged_rate,
    convergence_rate,
    stationary_period,
    transition_matrix,
)
from sysid.recursive.identify import identify_levels
from sysid.recursive.interpolation import interpolation_coefficients, interpolation_polynomial
from sysid.recursive.persistence import Excitation, excitation_of
from sysid.recursive.recovery import HammersteinParameters, RankOne, rank_one, recover
from sysid.recursive.structured import structured

__all__ = [
    "Excitation",
    "HammersteinParameters",
    "Kaczmarz",
    "ProjectionGradient",
    "RankOne",
    "Recursive",
    "RecursiveLeastSquares",
    "Snapshot",
    "averaged_rate",
    "convergence_rate",
    "excitation_of",
    "identify_levels",
    "interpolation_coefficients",
    "interpolation_polynomial",
    "rank_one",
    "recover",
    "regressors",
    "stationary_period",
    "structured",
    "transition_matrix",
]
