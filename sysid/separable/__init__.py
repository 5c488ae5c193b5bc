r"""Separable least squares: the estimator core that every method of the library shares.

All estimators here minimise :math:`\|y - \Phi(\eta)\theta\|^2`.  The linear parameters
:math:`\theta` are eliminated by an orthogonal factorisation, which leaves
:math:`J(\eta) = \|(I - P(\eta)) y\|^2` (Bai 2002, eq. (2.9); Golub and Pereyra 1973):

* `fit` descends from a start, for any number of nonlinear parameters with smooth regressors, by
  `descend`, the one Levenberg-Marquardt iteration of the library;
* `search` looks for the global minimum over bounds for one or two parameters of any regressors;
* `search_pieces` and `search_two_pieces` find the global minimum exactly when the regressors are
  lagged samples of a signal that is affine in the parameter between knots (all hard maps).
"""

from sysid.separable.descent import Minimum, Point, Residual, Status, descend, levenberg_marquardt
from sysid.separable.estimate import SeparableFit
from sysid.separable.factor import BlockedQR, Projection, project
from sysid.separable.lagged import (
    LaggedRegression,
    experiment_starts,
    search_pieces,
    search_two_pieces,
)
from sysid.separable.search import search
from sysid.separable.variable_projection import (
    Derivative,
    Regression,
    fit,
    golub_pereyra_jacobian,
    kaufman_jacobian,
)

__all__ = [
    "BlockedQR",
    "Derivative",
    "LaggedRegression",
    "Minimum",
    "Point",
    "Projection",
    "Regression",
    "Residual",
    "SeparableFit",
    "Status",
    "descend",
    "experiment_starts",
    "fit",
    "golub_pereyra_jacobian",
    "kaufman_jacobian",
    "levenberg_marquardt",
    "project",
    "search",
    "search_pieces",
    "search_two_pieces",
]
