"""The alternating identification of Table 5.1: a piecewise affine map, then the linear part, and again."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import UsageError
from sysid.lft.identifiability import require_identifiable
from sysid.lft.piecewise import PiecewiseLft, PiecewiseStructure, Rows, rows_of
from sysid.lft.smoothing import Inversion, inversion, smooth
from sysid.nonlinearities.piecewise_affine import PiecewiseAffineFit, PiecewiseAffineMap, Stage

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class AlternatingFit:
    r"""Result of `fit_alternating`.

    Attributes
    ----------
    model : PiecewiseLft
        The last one.
    history : ndarray, shape (n_iterations + 1, n_linear)
        :math:`\eta_L` at the start and after each iteration.
    maps : tuple of PiecewiseAffineMap
        Map of each iteration.
    threshold : float
        :math:`\gamma` of (5.24).
    cost : float
        Sum of squared one-step prediction errors of the model.
    inversion : Inversion
        What inverting the last G(q) sample by sample would do.
    """

    model: PiecewiseLft
    history: Floats
    maps: tuple[PiecewiseAffineMap, ...]
    threshold: float
    cost: float
    inversion: Inversion

    @property
    def iterations(self) -> int:
        """Number of iterations."""
        return len(self.maps)

    @property
    def rate(self) -> float:
        """Ratio of the last two steps; the distance left to the fixed point is step rate / (1 - rate)."""
        steps = np.linalg.norm(np.diff(self.history, axis=0), axis=1)
        return float(steps[-1] / steps[-2]) if steps.size > 1 and steps[-2] > 0 else 0.0

    @property
    def converged(self) -> bool:
        """Whether the test (5.24) was met."""
        return _settled(self.history, self.threshold)

    @property
    def status(self) -> str:
        """Why the iteration stopped, and how far from its fixed point it may be."""
        return _status(self)

    def __repr__(self) -> str:
        """Give the parameters and the status."""
        listed = ", ".join(f"{name}={value:.4g}" for name, value in self.model.values.items())
        return f"AlternatingFit({listed}; {self.status})"


@dataclass(frozen=True)
class GivenRegions:
    """A map stage that knows the regions: least squares in each mode.

    Attributes
    ----------
    map : PiecewiseAffineMap
        Its regions are taken, its submodels are not.

    Examples
    --------
    >>> halves = GivenRegions(PiecewiseAffineMap.of_breakpoints([[0.0, 0.0], [0.0, 0.0]], [0.0]))
    >>> z = np.array([-2.0, -1.0, 1.0, 2.0])
    >>> halves(z, np.abs(z) + 1.0, np.random.default_rng(0)).map.theta.round(9).tolist()
    [[-1.0, 1.0], [1.0, 1.0]]
    """

    map: PiecewiseAffineMap

    def __call__(self, z: ArrayLike, w: ArrayLike, rng: np.random.Generator) -> PiecewiseAffineFit:
        """Fit the submodels."""
        points, data = np.asarray(z, dtype=float), np.asarray(w, dtype=float)
        phi = np.column_stack([points, np.ones(data.size)])
        labels = self.map.mode(points)
        theta = np.zeros((self.map.modes, phi.shape[1]))
        for mode in range(self.map.modes):
            here = labels == mode
            theta[mode] = np.linalg.lstsq(phi[here], data[here], rcond=None)[0]
        found = PiecewiseAffineMap(theta, self.map.separators, self.map.owners)
        values = found(points)
        cost = float(np.sum((data - values) ** 2))
        explained = np.zeros(data.size, dtype=bool)
        status = "least squares in given regions"
        return PiecewiseAffineFit(found, labels, values, cost, status, outliers=explained, exact=True)


def fit_alternating(
    u: ArrayLike | Sequence[Floats],
    y: ArrayLike,
    structure: PiecewiseStructure,
    stage: Stage | Sequence[Stage],
    *,
    start: ArrayLike | None = None,
    threshold: float = 1e-3,
    max_iterations: int = 50,
    constant: bool = False,
    rng: np.random.Generator | None = None,
) -> AlternatingFit:
    r"""Identify linear part and map in turn: Table 5.1 of Pepona's thesis.

    Each iteration recovers the map's output v from the data and the linear part, by (5.21), fits a map
    to the samples (v, z), and the linear part to the map's output, by (5.23).  It is simple, and
    biased where z holds lagged outputs and n_g > 0, as the noise of v is then coloured by 1/G(q) and
    correlated with z; `fit_joint` removes the bias.

    Parameters
    ----------
    u, y : array_like, shape (n_samples,), or lists of such
        Input and output.
    structure : PiecewiseStructure
    stage : Stage, or list of such
        Fits a map to the samples, such as ``KPlane(modes=2)``.  Of a list the j-th one serves in
        iteration j and the last one from there on: a bounded-error stage starts with a large bound.
    start : array_like, shape (n_linear,), optional
        :math:`\eta_L^0`; by default that of `initial_linear`.
    threshold : float
        :math:`\gamma` of (5.24).  Convergence is linear, so what is left at the stop is this share of
        the parameters times rate / (1 - rate); the status tells it.
    max_iterations : int
        Limit.
    constant : bool
        Whether (5.23) has a constant of its own.  The map's offset makes it redundant, so it is moved
        there after each iteration, divided by G(1).  Without it the offset and the mean of w move against
        A(q) or G(q) in small steps, and (5.24) may stop far from the fixed point.
    rng : Generator, optional
        For stages that draw.

    Returns
    -------
    AlternatingFit

    Raises
    ------
    IdentifiabilityError
        If a regressor is common to the linear part and the map.
    UsageError
        If the start has another length or the threshold is not positive.

    Examples
    --------
    >>> from sysid.nonlinearities.piecewise_affine import GlobalSearch
    >>> rng = np.random.default_rng(1)
    >>> u = rng.uniform(-2, 2, 300)
    >>> structure = PiecewiseStructure(1, (), 0, (("u", 0),))
    >>> hinge = PiecewiseAffineMap.of_breakpoints([[-0.5, 0.0], [1.0, 0.0]], [0.0])
    >>> y = PiecewiseLft.of(structure, [-0.8], hinge).simulate(u, rng.uniform(-0.1, 0.1, 300))
    >>> found = fit_alternating(u, y, structure, GlobalSearch(modes=2))
    >>> found.model.linear.round(1).tolist()
    [-0.8]
    """
    require_identifiable(structure)
    if not threshold > 0:
        raise UsageError(f"the stopping threshold is {threshold:g}: give a positive one, such as 0.001")
    rows = rows_of(structure, u, y)
    draw = np.random.default_rng(0) if rng is None else rng
    eta = initial_linear(structure, rows) if start is None else np.array(start, dtype=float)
    if eta.shape != (structure.n_linear,):
        raise UsageError(
            f"the start has {eta.size} values; the linear part has {structure.n_linear}: "
            f"{', '.join(structure.linear_names())}"
        )
    stages: Sequence[Stage] = [stage] if callable(stage) else stage
    history, maps = [eta], list[PiecewiseAffineMap]()
    while len(maps) < max_iterations and not _settled(np.array(history), threshold):
        now = stages[min(len(maps), len(stages) - 1)]
        map_ = now(rows.z, recovered(structure, rows, eta), draw).map
        eta, offset = linear_step(structure, rows, map_(rows.z), constant)
        maps.append(shifted(map_, offset, eta[structure.n_known :]))
        history.append(eta)
    model = PiecewiseLft.of(structure, eta, maps[-1])
    cost = float(np.sum((rows.y - model.predict(rows)) ** 2))
    return AlternatingFit(model, np.array(history), tuple(maps), threshold, cost, inversion(model.g))


def recovered(structure: PiecewiseStructure, rows: Rows, eta: Floats) -> Floats:
    """Return the signal v of (5.21): the output of the map that explains the data without error."""
    target = rows.y - rows.known @ eta[: structure.n_known]
    return smooth(target, eta[structure.n_known :], rows.lengths)


def linear_step(
    structure: PiecewiseStructure, rows: Rows, w: Floats, constant: bool = False
) -> tuple[Floats, float]:
    """Return the linear part by least squares from the regression (5.23), and its constant."""
    columns = [rows.known, *(rows.delayed(w, lag)[:, np.newaxis] for lag in range(1, structure.n_g + 1))]
    if constant:
        columns.append(np.ones((rows.y.size, 1)))
    solution = np.linalg.lstsq(np.hstack(columns), rows.y - rows.delayed(w, 0), rcond=None)[0]
    return np.asarray(solution[: structure.n_linear]), float(solution[-1]) if constant else 0.0


def shifted(map_: PiecewiseAffineMap, offset: float, g: Floats) -> PiecewiseAffineMap:
    """Return the map with a constant of the output moved into the offsets of all its modes."""
    gain = 1.0 + float(np.sum(g))
    if offset == 0.0 or gain == 0.0:
        return map_
    theta = map_.theta.copy()
    theta[:, -1] += offset / gain
    return PiecewiseAffineMap(theta, map_.separators, map_.owners)


def initial_linear(structure: PiecewiseStructure, rows: Rows) -> Floats:
    """Return the start of Example 5.2: the linear model with a constant of (5.27), and G(q) = 1."""
    columns = np.column_stack([rows.known, np.ones(rows.y.size)])
    known = np.linalg.lstsq(columns, rows.y, rcond=None)[0][:-1]
    return np.concatenate([known, np.zeros(structure.n_g)])


def _settled(history: Floats, threshold: float) -> bool:
    """Whether the last step meets (5.24)."""
    if len(history) < 2:
        return False
    return bool(np.linalg.norm(history[-1] - history[-2]) <= threshold * np.linalg.norm(history[-1]))


def _status(fit: AlternatingFit) -> str:
    if not fit.converged:
        turning = " (the number of modes still changes)" if len({m.modes for m in fit.maps[-5:]}) > 1 else ""
        return (
            f"stopped after {fit.iterations} iterations before the parameters settled{turning}: raise "
            "max_iterations, or the bound of the map stage"
        )
    reached = f"converged after {fit.iterations} iterations to a relative step of {fit.threshold:g}"
    if not 0.0 < fit.rate < 1.0:
        return reached
    left = float(np.linalg.norm(fit.history[-1] - fit.history[-2])) * fit.rate / (1.0 - fit.rate)
    return f"{reached}; at the last rate of {fit.rate:.2g} the fixed point is {left:.1g} away"
