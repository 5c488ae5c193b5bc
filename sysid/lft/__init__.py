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
