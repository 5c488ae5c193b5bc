"""k-plane clustering with restarts, its clusters then made polyhedra (clusterwise regression)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid._compile import compiled
from sysid.nonlinearities.piecewise_affine.descent import assign, classifier, descend, directions, roam
from sysid.nonlinearities.piecewise_affine.fit import PiecewiseAffineFit, finished
from sysid.nonlinearities.piecewise_affine.kernels import fill_costs, fit_modes
from sysid.nonlinearities.piecewise_affine.points import Points, neighbourhoods

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]

WHO = "k-plane clustering"
REFINED = 3
"""So many of the best different clusterings are made polyhedra, and the best map is kept."""
PATIENCE = 30
"""Its separators then move along random directions until so many in turn do not help."""


def k_plane(
    z: ArrayLike,
    w: ArrayLike,
    modes: int,
    *,
    rng: np.random.Generator,
    restarts: int = 20,
    min_points: int | None = None,
) -> PiecewiseAffineFit:
    """Fit a piecewise affine map by k-plane clustering.

    Points go to the submodel that explains them best, submodels are fitted to their points, until
    nothing changes; this ends in a local minimum, so it starts from several random neighbourhoods.
    Where two submodels meet, a point's residual does not tell its mode: separators are therefore put
    where they cost least in squared residuals, each point goes to the region it lies in, and
    separators and submodels are improved together until no step of one separator helps.

    Parameters
    ----------
    z : array_like, shape (n_points,) or (n_points, n_z)
    w : array_like, shape (n_points,) or (n_points, n_w)
    modes : int
        Number of submodels, each in a region of its own.
    rng : numpy.random.Generator
    restarts : int
    min_points : int, optional
        Points a mode holds at least; n_z + 2 unless given.

    Returns
    -------
    PiecewiseAffineFit
        ``agreement`` is the share of the restarts that reached the best clustering.

    Raises
    ------
    UsageError, IdentifiabilityError
        If the points cannot be used; see `Points`.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> z = rng.uniform(-2, 2, 100)
    >>> fit = k_plane(z, np.where(z > 0, z, -0.5 * z), 2, rng=rng)
    >>> fit.map.theta.round(9) + 0.0
    array([[-0.5,  0. ],
           [ 1. ,  0. ]])
    """
    points = Points.of(z, w, who=WHO)
    least = points.enough(modes, min_points, WHO)
    if modes == 1:
        return finished(points, np.zeros((1, points.n_z + 1)), "one mode: least squares", exact=True)
    labels, costs = clusterings(points, modes, restarts, least, rng)
    ways = directions(points, rng, 2 * (points.n_z + 1))
    best_rows, best_cost = None, np.inf
    for one in _different(labels, costs):
        rows, cost = polyhedra(points, one, modes, ways, least)
        if cost < best_cost:
            best_rows, best_cost = rows, cost
    reached = float(np.mean(costs <= costs.min() * (1.0 + 1e-6) + 1e-18 * points.n))
    if best_rows is None:
        status = (
            f"no clustering of {modes} modes could be parted by hyperplanes with {least} points in each "
            "region, so one affine map is returned: ask for fewer modes"
        )
        return finished(points, np.zeros((1, points.n_z + 1)), status, agreement=reached)
    best_rows, _ = roam(points, best_rows, best_cost, rng, least, patience=PATIENCE)
    status = f"{reached:.0%} of {restarts} restarts agree on the best clustering"
    if reached * restarts < 2 and restarts > 1:
        status += "; a better one may exist: take more restarts or fewer modes"
    centring = directions(points, rng, 60)
    return finished(points, best_rows, status, agreement=reached, centring=centring)


def clusterings(
    points: Points, modes: int, restarts: int, least: int, rng: np.random.Generator
) -> tuple[Labels, Floats]:
    """Return labels (restarts, n_points) and sums of squares (restarts,) of k-plane clusterings."""
    seeds = rng.integers(0, points.n, (max(restarts, 1), modes))
    near = min(max(3 * (points.n_z + 1), points.n // (8 * modes)), points.n)
    labels = np.empty((seeds.shape[0], points.n), dtype=np.intp)
    costs = np.empty(seeds.shape[0])
    members = neighbourhoods(points.z, seeds.ravel(), near).reshape(*seeds.shape, near)
    _cluster(points.z, points.w, members, least, labels, costs)
    return labels, costs


def polyhedra(points: Points, labels: Labels, modes: int, ways: Floats, least: int) -> tuple[Floats, float]:
    """Return separators (scaled) and the sum of squares of the map that a clustering leads to."""
    theta, _ = points.fitted(labels, modes)
    costs = points.costs(theta)
    two = np.partition(costs, 1, axis=1)
    rows = classifier(points, labels, modes, two[:, 1] - two[:, 0])
    return descend(points, assign(points, costs, rows, ways), ways, least)


def _different(labels: Labels, costs: Floats) -> list[Labels]:
    """Return the best few clusterings whose costs differ."""
    kept: list[int] = []
    for index in np.argsort(costs, kind="stable"):
        if not np.isfinite(costs[index]) or len(kept) == REFINED:
            break
        if not kept or costs[index] > costs[kept[-1]] * (1.0 + 1e-6) + 1e-12:
            kept.append(int(index))
    return [labels[index] for index in kept]


@compiled
def _cluster(z: Floats, w: Floats, members: Labels, least: int, labels: Labels, costs: Floats) -> None:
    """Run k-plane clustering from given neighbourhoods; a lost mode makes a cost infinite.

    ``members`` (starts, modes, size) are the points that each submodel is fitted to at first.
    """
    n, n_z = z.shape
    starts, modes, size = members.shape
    theta = np.zeros((modes, n_z + 1, w.shape[1]))
    counts = np.zeros(modes, np.intp)
    squared = np.empty((n, modes))
    for start in range(starts):
        now = labels[start]
        for i in range(modes):
            now[:] = -1
            for a in range(size):
                now[members[start, i, a]] = 0
            fit_modes(z, w, now, theta[i : i + 1], counts[i : i + 1])
        costs[start] = np.inf
        now[:] = -1
        for _ in range(100):
            fill_costs(z, w, theta, squared)
            moved = 0
            for k in range(n):
                best = 0
                for i in range(1, modes):
                    if squared[k, i] < squared[k, best]:
                        best = i
                moved += best != now[k]
                now[k] = best
            if moved == 0:
                break
            total = fit_modes(z, w, now, theta, counts)
            smallest = n
            for i in range(modes):
                smallest = min(smallest, counts[i])
            costs[start] = total if smallest >= least else np.inf
            if smallest < least:
                break
