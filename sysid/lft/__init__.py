r"""Block-structured models with one static map inside a linear part (LFT models).

`fit_lft` fits :math:`A(q) y = B(q) u + G(q) f(D(q) x) + e` with a spline f, chapter 4 of Pepona (2009):
Wiener, Hammerstein, Wiener-Hammerstein systems and maps that are fed the output are special cases.
`fit_wiener_hammerstein` fits :math:`y = G_2 f(G_1 u)` by its simulation error, with poles on both
sides of the map.
"""

from sysid.lft.estimate import fit_lft
from sysid.lft.files import load, save
from sysid.lft.free_run import refine_free_run
from sysid.lft.initial import InitialEstimate, initial_estimate
from sysid.lft.linear_block import LinearBlock
from sysid.lft.model import LftFit, LftModel
from sysid.lft.printed import PrintedSearch, printed_search
from sysid.lft.structure import Lag, LftStructure, lags
from sysid.lft.theorems import ProblemComparison, basis_conditions, compare_problems
from sysid.lft.wiener_hammerstein import fit_wiener_hammerstein
from sysid.lft.wiener_hammerstein_choice import WienerHammersteinChoice, choose_wiener_hammerstein
from sysid.lft.wiener_hammerstein_fit import WienerHammersteinFit
from sysid.lft.wiener_hammerstein_model import WienerHammerstein

__all__ = [
    "InitialEstimate",
    "Lag",
    "LftFit",
    "LftModel",
    "LftStructure",
    "LinearBlock",
    "PrintedSearch",
    "ProblemComparison",
    "WienerHammerstein",
    "WienerHammersteinChoice",
    "WienerHammersteinFit",
    "basis_conditions",
    "choose_wiener_hammerstein",
    "compare_problems",
    "fit_lft",
    "fit_wiener_hammerstein",
    "initial_estimate",
    "lags",
    "load",
    "printed_search",
    "refine_free_run",
    "save",
]
