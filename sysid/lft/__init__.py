"""Systems of a linear part and a static map in any interconnection (linear fractional transformation)."""

from sysid.lft.alternating import AlternatingFit, GivenRegions, fit_alternating
from sysid.lft.continuous import ContinuousFit, fit_continuous
from sysid.lft.identifiability import Identifiability, identifiability
from sysid.lft.joint import JointFit, fit_given_partition, fit_joint
from sysid.lft.piecewise import PiecewiseLft, PiecewiseStructure, Rows, rows_of
from sysid.lft.smoothing import Inversion, inversion, smooth

__all__ = [
    "AlternatingFit",
    "ContinuousFit",
    "GivenRegions",
    "Identifiability",
    "Inversion",
    "JointFit",
    "PiecewiseLft",
    "PiecewiseStructure",
    "Rows",
    "fit_alternating",
    "fit_continuous",
    "fit_given_partition",
    "fit_joint",
    "identifiability",
    "inversion",
    "rows_of",
    "smooth",
]
