"""Piecewise affine maps and three interchangeable ways to fit them to points (z, w).

* `BoundedError`: as few submodels as a bound on the error allows;
* `KPlane`: clustering by residuals with restarts, then polyhedral regions;
* `GlobalSearch`: exact for scalar z and for two modes in the plane, otherwise many descents.

`Joined` puts any of them under a search for kinks: borders at which the map does not jump.

Each is a `Stage`, called with (z, w, rng), and returns a `PiecewiseAffineFit`.
"""

from sysid.nonlinearities.piecewise_affine.bounded_error import bounded_error
from sysid.nonlinearities.piecewise_affine.choice import (
    ModesAgainstDelta,
    knee,
    modes_against_delta,
    plot_modes_against_delta,
)
from sysid.nonlinearities.piecewise_affine.fit import PiecewiseAffineFit, Stage, label_error
from sysid.nonlinearities.piecewise_affine.global_search import global_search
from sysid.nonlinearities.piecewise_affine.joined import Joined, joined
from sysid.nonlinearities.piecewise_affine.k_plane import k_plane
from sysid.nonlinearities.piecewise_affine.map import PiecewiseAffineMap
from sysid.nonlinearities.piecewise_affine.stages import BoundedError, GlobalSearch, KPlane
from sysid.nonlinearities.piecewise_affine.subsystems import PartitionSearch

__all__ = [
    "BoundedError",
    "GlobalSearch",
    "Joined",
    "KPlane",
    "ModesAgainstDelta",
    "PartitionSearch",
    "PiecewiseAffineFit",
    "PiecewiseAffineMap",
    "Stage",
    "bounded_error",
    "global_search",
    "joined",
    "k_plane",
    "knee",
    "label_error",
    "modes_against_delta",
    "plot_modes_against_delta",
]
