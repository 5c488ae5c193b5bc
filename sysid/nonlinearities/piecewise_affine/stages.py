"""The three stages as settings that can be handed on: each is called with (z, w, rng)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sysid.nonlinearities.piecewise_affine.bounded_error import bounded_error
from sysid.nonlinearities.piecewise_affine.fit import PiecewiseAffineFit
from sysid.nonlinearities.piecewise_affine.global_search import global_search
from sysid.nonlinearities.piecewise_affine.k_plane import k_plane
from sysid.nonlinearities.piecewise_affine.separation import Separation
from sysid.nonlinearities.piecewise_affine.subsystems import USUAL, PartitionSearch


@dataclass(frozen=True)
class BoundedError:
    """`bounded_error` with its settings; ``delta`` is in the unit of w.

    Examples
    --------
    >>> import numpy as np
    >>> z = np.linspace(-1, 1, 50)
    >>> BoundedError(delta=0.01)(z, np.abs(z), np.random.default_rng(0)).map.theta[:, 0].round(9)
    array([-1.,  1.])
    """

    delta: float
    search: PartitionSearch = USUAL
    separation: Separation = "linear-programming"
    polish: bool = False
    convex: bool = False

    def __call__(self, z: ArrayLike, w: ArrayLike, rng: np.random.Generator) -> PiecewiseAffineFit:
        """Fit a map to the points."""
        return bounded_error(
            z,
            w,
            self.delta,
            rng=rng,
            search=self.search,
            separation=self.separation,
            polish=self.polish,
            convex=self.convex,
        )


@dataclass(frozen=True)
class KPlane:
    """`k_plane` with its settings.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> z = rng.uniform(-1, 1, 50)
    >>> KPlane(modes=2)(z, np.abs(z), rng).map.theta[:, 0].round(9)
    array([-1.,  1.])
    """

    modes: int
    restarts: int = 20
    min_points: int | None = None

    def __call__(self, z: ArrayLike, w: ArrayLike, rng: np.random.Generator) -> PiecewiseAffineFit:
        """Fit a map to the points."""
        return k_plane(z, w, self.modes, rng=rng, restarts=self.restarts, min_points=self.min_points)


@dataclass(frozen=True)
class GlobalSearch:
    """`global_search` with its settings.

    Examples
    --------
    >>> import numpy as np
    >>> z = np.linspace(-1, 1, 50)
    >>> GlobalSearch(modes=2)(z, np.sign(z - 0.2), np.random.default_rng(0)).map.tau.round(1)
    array([0.2])
    """

    modes: int
    exact_up_to: int = 1_000_000
    pivots: int = 64
    restarts: int = 20
    min_points: int | None = None

    def __call__(self, z: ArrayLike, w: ArrayLike, rng: np.random.Generator) -> PiecewiseAffineFit:
        """Fit a map to the points."""
        return global_search(
            z,
            w,
            self.modes,
            rng=rng,
            exact_up_to=self.exact_up_to,
            pivots=self.pivots,
            restarts=self.restarts,
            min_points=self.min_points,
        )
