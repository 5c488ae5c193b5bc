r"""Block-structured models with one static map inside a linear part (LFT models).

`fit_lft` fits :math:`A(q) y = B(q) u + G(q) f(D(q) x) + e` with a spline f, chapter 4 of Pepona (2009):
Wiener, Hammerstein, Wiener-Hammerstein systems and maps that are fed the output are special cases.

`fit_alternating`, `fit_joint` and `fit_continuous` fit :math:`A(q) y = B(q) u + G(q) f(z) + e` with a
piecewise affine f of lagged inputs and outputs, chapter 5: f may jump.

`fit_wiener_hammerstein` fits :math:`y = G_2 f(G_1 u)` by its simulation error, with poles on both
sides of the map.
"""

from sysid.lft.alternating import AlternatingFit, GivenRegions, fit_alternating
from sysid.lft.continuous import ContinuousFit, fit_continuous
from sysid.lft.estimate import fit_lft
from sysid.lft.files import load, save
from sysid.lft.free_run import refine_free_run
from sysid.lft.identifiability import Identifiability, identifiability
from sysid.lft.initial import InitialEstimate, initial_estimate
from sysid.lft.joint import JointFit, fit_given_partition, fit_joint
from sysid.lft.linear_block import LinearBlock
from sysid.lft.model import LftFit, LftModel
from sysid.lft.piecewise import PiecewiseLft, PiecewiseStructure, Rows, rows_of
from sysid.lft.printed import PrintedSearch, printed_search
from sysid.lft.smoothing import Inversion, inversion, smooth
from sysid.lft.structure import Lag, LftStructure, lags
from sysid.lft.theorems import ProblemComparison, basis_conditions, compare_problems
from sysid.lft.wiener_hammerstein.choice import WienerHammersteinChoice, choose_wiener_hammerstein
from sysid.lft.wiener_hammerstein.estimate import fit_wiener_hammerstein
from sysid.lft.wiener_hammerstein.model import WienerHammerstein
from sysid.lft.wiener_hammerstein.result import WienerHammersteinFit

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
    "LftModel",
    "LftStructure",
    "LinearBlock",
    "PiecewiseLft",
    "PiecewiseStructure",
    "PrintedSearch",
    "ProblemComparison",
    "Rows",
    "WienerHammerstein",
    "WienerHammersteinChoice",
    "WienerHammersteinFit",
    "basis_conditions",
    "choose_wiener_hammerstein",
    "compare_problems",
    "fit_alternating",
    "fit_continuous",
    "fit_given_partition",
    "fit_joint",
    "fit_lft",
    "fit_wiener_hammerstein",
    "identifiability",
    "initial_estimate",
    "inversion",
    "lags",
    "load",
    "printed_search",
    "refine_free_run",
    "rows_of",
    "save",
    "smooth",
]
