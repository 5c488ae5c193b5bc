r"""Block-structured models with one static map inside a linear part (LFT models).

`fit_lft` fits :math:`A(q) y = B(q) u + G(q) f(D(q) x) + e` with a spline f, chapter 4 of Pepona (2011):
Wiener, Hammerstein, Wiener-Hammerstein systems and maps that are fed the output are special cases.

`fit_alternating`, `fit_joint` and `fit_continuous` fit :math:`A(q) y = B(q) u + G(q) f(z) + e` with a
piecewise affine f of lagged inputs and outputs, chapter 5: f may jump.
"""

from sysid.lft.alternating import AlternatingFit, GivenRegions, fit_alternating
from sysid.lft.continuous import ContinuousFit, fit_continuous
from sysid.lft.estimate import fit_lft
from sysid.lft.identifiability import Identifiability, identifiability
from sysid.lft.initial import InitialEstimate, initial_estimate
from sysid.lft.joint import JointFit, fit_given_partition, fit_joint
from sysid.lft.model import LftFit
from sysid.lft.piecewise import PiecewiseLft, PiecewiseStructure, Rows, rows_of
from sysid.lft.printed import PrintedSearch, printed_search
from sysid.lft.smoothing import Inversion, inversion, smooth
from sysid.lft.structure import Lag, LftStructure, lags
from sysid.lft.theorems import ProblemComparison, basis_conditions, compare_problems

__all__ = [
    "AlternatingFit",
    "ContinuousFit",
    "GivenRegions",
    "Identifiability",
    "InitialEstimate",
    "Inversion",
    "JointFit",
    "Lag",
    "LftFit",
    "LftStructure",
    "PiecewiseLft",
    "PiecewiseStructure",
    "PrintedSearch",
    "ProblemComparison",
    "Rows",
    "basis_conditions",
    "compare_problems",
    "fit_alternating",
    "fit_continuous",
    "fit_given_partition",
    "fit_joint",
    "fit_lft",
    "identifiability",
    "initial_estimate",
    "inversion",
    "lags",
    "printed_search",
    "rows_of",
    "smooth",
]
