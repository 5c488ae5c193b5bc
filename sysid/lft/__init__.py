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
r"""Block-structured models with one static map inside a linear part (LFT models).

`fit_lft` fits :math:`A(q) y = B(q) u + G(q) f(D(q) x) + e` with a spline f, chapter 4 of Pepona (2011):
Wiener, Hammerstein, Wiener-Hammerstein systems and maps that are fed the output are special cases.
"""

from sysid.lft.estimate import fit_lft
from sysid.lft.initial import InitialEstimate, initial_estimate
from sysid.lft.model import LftFit
from sysid.lft.printed import PrintedSearch, printed_search
from sysid.lft.structure import Lag, LftStructure, lags
from sysid.lft.theorems import ProblemComparison, basis_conditions, compare_problems

__all__ = [
    "InitialEstimate",
    "Lag",
    "LftFit",
    "LftStructure",
    "PrintedSearch",
    "ProblemComparison",
    "basis_conditions",
    "compare_problems",
    "fit_lft",
    "initial_estimate",
    "lags",
    "printed_search",
]
