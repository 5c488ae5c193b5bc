"""Global search over a box of one or two parameters of any regressors."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import UsageError
from sysid.separable.cells import MAX_MINIMA
from sysid.separable.descent import Status
from sysid.separable.estimate import SeparableFit
from sysid.separable.factor import finite, project

Floats = NDArray[np.float64]


def search(
    regressors: Callable[[Floats], Floats],
    y: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike,
    *,
    points: int = 65,
    knots: Sequence[ArrayLike] | None = None,
    constant_cells: bool = False,
) -> SeparableFit:
    r"""Global minimum of the projected cost over a box of one or two parameters.

    The cost is evaluated on a grid, and every local minimum of the grid is refined without
    derivatives inside its neighbouring points, so kinks do no harm.  When the ``knots`` at which
    the regressors change are known the grid is made of the cells between them: their midpoints if
    the regressors are constant inside (the search is then exact), knots and midpoints otherwise.

    Parameters
    ----------
    regressors : callable
        Function of eta, shape (n_eta,), giving Phi, shape (n_rows, n_linear).
    y : array_like, shape (n_rows,)
        Data.
    lower, upper : array_like, shape (n_eta,)
        Bounds; n_eta is 1 or 2.
    points : int
        Grid points per parameter where no knots are given.
    knots : sequence of array_like, optional
        Knots of each parameter.
    constant_cells : bool
        The regressors do not change between knots.

    Returns
    -------
    SeparableFit
        The best minimum, all local minima, and for constant cells the cell.

    Raises
    ------
    UsageError
        If the bounds are not ordered or there are more than two parameters.

    Examples
    --------
    >>> import numpy as np
    >>> u = np.linspace(-2, 2, 41)
    >>> clipped = lambda eta: np.clip(u, -eta[0], eta[0])[:, None]
    >>> search(clipped, 3 * np.clip(u, -1.234, 1.234), [0.1], [2.0]).eta.round(6).tolist()
    [1.234]
    """
    data = finite(y)
    low, high = _box(lower, upper)
    axes = [
        _axis(low[i], high[i], points, None if knots is None else knots[i], constant_cells)
        for i in range(low.size)
    ]

    def cost(eta: Floats) -> float:
        return project(regressors(eta), data).cost

    shape = tuple(axis.size for axis in axes)
    profile = np.array(
        [cost(np.array([axes[i][k] for i, k in enumerate(index)])) for index in np.ndindex(shape)]
    )
    profile = profile.reshape(shape)
    starts = _grid_minima(profile)
    found = []
    for index in starts:
        eta = np.array([axes[i][k] for i, k in enumerate(index)])
        value = float(profile[index])
        if not constant_cells:
            around = [
                (axes[i][max(k - 1, 0)], axes[i][min(k + 1, shape[i] - 1)]) for i, k in enumerate(index)
            ]
            eta, value = _refine(cost, eta, value, around)
        found.append((*eta, value))
    found.sort(key=lambda row: row[-1])
    minima = np.array(found)
    best = minima[0, :-1]
    final = project(regressors(best), data)
    intervals = []
    for i in range(low.size):
        if constant_cells and knots is not None:
            edges = _edges(low[i], high[i], knots[i])
            k = int(np.searchsorted(edges, best[i])) - 1
            intervals.append((float(edges[k]), float(edges[k + 1])))
        else:
            intervals.append((float(best[i]), float(best[i])))
    factor = np.zeros((final.rank, low.size + final.theta.size))
    factor[:, low.size + final.columns] = final.r
    return SeparableFit(
        eta=best,
        theta=final.theta,
        residual=final.residual,
        jacobian_factor=factor,
        status=Status.GLOBAL if constant_cells else Status.GRID,
        cells=tuple(intervals),
        minima=minima[:MAX_MINIMA],
        n_minima=len(found),
    )


def _box(lower: ArrayLike, upper: ArrayLike) -> tuple[Floats, Floats]:
    low, high = np.atleast_1d(np.asarray(lower, dtype=float)), np.atleast_1d(np.asarray(upper, dtype=float))
    if low.shape != high.shape or low.size not in (1, 2):
        raise UsageError(
            f"a global search takes one or two parameters, not bounds of shapes {low.shape}, {high.shape}"
        )
    for i in range(low.size):
        if not (np.isfinite(low[i]) and np.isfinite(high[i]) and low[i] < high[i]):
            raise UsageError(
                f"bounds [{low[i]:g}, {high[i]:g}] of parameter {i} are not an interval: give lower < upper"
            )
    return low, high


def _edges(low: float, high: float, knots: ArrayLike) -> Floats:
    inner = np.unique(np.asarray(knots, dtype=float))
    return np.concatenate([[low], inner[(inner > low) & (inner < high)], [high]])


def _axis(low: float, high: float, points: int, knots: ArrayLike | None, constant: bool) -> Floats:
    if knots is None:
        return np.linspace(low, high, points)
    edges = _edges(low, high, knots)
    middles = (edges[1:] + edges[:-1]) / 2
    return middles if constant else np.sort(np.concatenate([edges, middles]))


def _grid_minima(profile: Floats) -> list[tuple[int, ...]]:
    """Grid points not higher than any neighbour, the lowest first; of a plateau one is kept."""
    padded = np.pad(profile, 1, constant_values=np.inf)
    lowest = np.ones(profile.shape, dtype=bool)
    for shift in np.ndindex((3,) * profile.ndim):
        step = np.array(shift) - 1
        if not step.any():
            continue
        neighbour = padded[tuple(slice(1 + s, 1 + s + n) for s, n in zip(step, profile.shape, strict=True))]
        earlier = next(s for s in step if s) < 0
        lowest &= (profile < neighbour) if earlier else (profile <= neighbour)
    indices = sorted(map(tuple, np.argwhere(lowest).tolist()), key=lambda index: float(profile[index]))
    return indices or [tuple(int(i) for i in np.unravel_index(int(np.argmin(profile)), profile.shape))]


def _refine(
    cost: Callable[[Floats], float], eta: Floats, value: float, around: list[tuple[float, float]]
) -> tuple[Floats, float]:
    """Refine a grid minimum inside the box of its neighbours without derivatives."""
    from scipy.optimize import minimize, minimize_scalar

    if eta.size == 1:
        low, high = around[0]
        result = minimize_scalar(
            lambda a: cost(np.array([a])),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 1e-10 * (high - low)},
        )
        point = np.array([float(result.x)])
    else:
        size = np.array([high - low for low, high in around])
        inwards = np.sign(np.mean(around, axis=1) - eta)
        simplex = eta + np.vstack([np.zeros(2), np.diag(0.3 * size * np.where(inwards == 0, 1.0, inwards))])
        options: Any = {
            "xatol": 1e-9 * float(size.max()),
            "fatol": 0.0,
            "maxfev": 400,
            "initial_simplex": simplex,
        }
        simplex_result = minimize(cost, eta, method="Nelder-Mead", bounds=around, options=options)
        point = np.asarray(simplex_result.x, dtype=float)
    refined = cost(point)
    return (point, refined) if refined < value else (eta, value)
