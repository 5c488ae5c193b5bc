"""The least number of submodels that explain points within a bound, and the points of each."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.errors import IdentifiabilityError, UsageError
from sysid.nonlinearities.piecewise_affine.points import Points, neighbourhoods
from sysid.nonlinearities.piecewise_affine.refinement import INFEASIBLE, refined
from sysid.nonlinearities.piecewise_affine.relaxation import largest_subsystem

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]

WHO = "bounded error"
MOST_MODES = 40


@dataclass(frozen=True)
class PartitionSearch:
    """How a partition into feasible subsystems is searched and refined.

    Attributes
    ----------
    starts, cycles : int
        Starts of each relaxation, and how often each visits all points.
    neighbours : int
        A point that several submodels explain follows the majority of so many neighbours.
    merge : float
        Two submodels are joined where one explains their points but for this share.
    discard : float
        A mode with less than this share of all points is dropped.
    rounds : int
        Of the refinement, at most.
    """

    starts: int = 6
    cycles: int = 15
    neighbours: int = 10
    merge: float = 0.02
    discard: float = 0.02
    rounds: int = 20

    def check(self) -> None:
        """Raise UsageError if a count is below 1."""
        for name in ("starts", "cycles", "neighbours", "rounds"):
            if getattr(self, name) < 1:
                raise UsageError(f"{WHO}: {name} is {getattr(self, name)}; give 1 at least")


USUAL = PartitionSearch()


@dataclass(frozen=True, eq=False)
class Subsystems:
    """Submodels and the points that belong to each, before hyperplanes are put between them.

    Attributes
    ----------
    theta : ndarray, shape (modes, n_z + 1, n_w)
        Scaled.
    labels : ndarray of int, shape (n_points,)
        Negative where a point belongs to none or is undecided.
    partition : int
        Number of subsystems of the greedy partition, before any were joined or dropped.
    """

    theta: Floats
    labels: Labels
    partition: int

    @property
    def unexplained(self) -> float:
        """Share of the points that no submodel explains."""
        return float(np.mean(self.labels == INFEASIBLE))


def subsystems(
    points: Points,
    delta: float,
    rng: np.random.Generator,
    search: PartitionSearch,
) -> Subsystems:
    """Return the first two steps of `bounded_error`."""
    if not (np.isfinite(delta) and delta > 0.0):
        raise UsageError(f"{WHO}: delta is {delta}; give the bound on the error, a number > 0")
    search.check()
    bound = delta / points.unit
    smallest = max(points.n_z + 2, int(np.ceil(search.discard * points.n)))
    theta = partition(points, bound, rng, starts=search.starts, cycles=search.cycles, smallest=smallest)
    count = theta.shape[0]
    theta, labels = refined(
        points,
        theta,
        bound,
        neighbours=search.neighbours,
        merge=search.merge,
        smallest=smallest,
        rounds=search.rounds,
    )
    if np.bincount(labels[labels >= 0], minlength=1).max() < points.n_z + 2:
        raise IdentifiabilityError(
            f"{WHO}: no {points.n_z + 2} points agree with one affine submodel within delta = {delta:g}; "
            "give a larger delta"
        )
    return Subsystems(theta, labels, count)


def partition(
    points: Points, bound: float, rng: np.random.Generator, *, starts: int, cycles: int, smallest: int
) -> Floats:
    """Return submodels (subsystems, n_z + 1, n_w), scaled, that explain the points within a bound.

    Greedy: each explains as many of the points that are left as relaxation can find.  It ends where fewer
    than ``smallest`` points agree with one.
    """
    z, w = points.z, points.w
    found: list[Floats] = []
    while z.shape[0] >= smallest and len(found) < MOST_MODES:
        seeds = rng.integers(0, z.shape[0], starts - 1)
        orders = rng.permuted(np.tile(np.arange(z.shape[0]), (cycles, 1)), axis=1)
        near = min(max(3 * (points.n_z + 1), z.shape[0] // 20), z.shape[0])
        theta = np.zeros((points.n_z + 1, points.n_w))
        count = largest_subsystem(z, w, bound, neighbourhoods(z, seeds, near), orders, theta)
        if count < smallest and found:
            break
        found.append(theta)
        rest = misfits(z, w, theta) > bound
        z, w = np.ascontiguousarray(z[rest]), np.ascontiguousarray(w[rest])
    return np.array(found)


def misfits(z: Floats, w: Floats, theta: Floats) -> Floats:
    """Return the largest residual, over the outputs, of each point."""
    return np.asarray(np.abs(w - z @ theta[:-1] - theta[-1]).max(axis=1, initial=0.0))
