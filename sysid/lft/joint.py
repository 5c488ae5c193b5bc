"""All parameters of a piecewise affine LFT model at once, by their one-step prediction error."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import ModelError
from sysid.lft.boundaries import Boundaries, improve, middle, regions_of
from sysid.lft.identifiability import require_identifiable
from sysid.lft.piecewise import Integers, PiecewiseLft, PiecewiseStructure, Rows, rows_of
from sysid.nonlinearities.piecewise_affine import PiecewiseAffineMap
from sysid.separable import SeparableFit, fit

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class JointFit:
    """Result of `fit_joint`.

    Attributes
    ----------
    model : PiecewiseLft
        The model.
    labels : ndarray of int, shape (n_w,)
        Mode of each row of the map's arguments.
    covariance : ndarray, shape (n_parameters, n_parameters)
        Of the parameters in the order of `PiecewiseStructure.names`, the partition taken as known.
    cost : float
        Sum of squared prediction errors.
    costs : tuple of float
        Cost after each round of parameters and boundaries.
    status : str
        Why it stopped.
    """

    model: PiecewiseLft
    labels: Integers
    covariance: Floats
    cost: float
    costs: tuple[float, ...]
    status: str

    @property
    def std_errors(self) -> dict[str, float]:
        """Standard error of each parameter, the partition taken as known."""
        sizes = np.sqrt(np.diag(self.covariance))
        names = self.model.structure.names(self.model.map.theta.shape[0])
        return dict(zip(names, sizes.tolist(), strict=True))

    def __repr__(self) -> str:
        """Give parameters with standard errors and the status."""
        errors = self.std_errors
        listed = ", ".join(f"{n}={v:.4g}+-{errors[n]:.2g}" for n, v in self.model.values.items())
        return f"JointFit({listed}; {self.status})"


@dataclass(frozen=True)
class GivenPartition:
    r"""The regression with known modes: bilinear in g and (a, b, theta).

    The regressors at :math:`\eta = g` are the measured ones and :math:`G(q)` of the arguments of
    the map, each in the columns of its mode.
    """

    rows: Rows
    design: Floats

    @classmethod
    def of(cls, rows: Rows, labels: Integers, n_modes: int) -> "GivenPartition":
        """Place the arguments of each sample in the columns of its mode."""
        width = rows.phi.shape[1]
        design = np.zeros((rows.phi.shape[0], n_modes * width))
        for mode in range(n_modes):
            here = labels == mode
            design[here, mode * width : (mode + 1) * width] = rows.phi[here]
        return cls(rows, design)

    def regressors(self, eta: Floats) -> Floats:
        """Return the measured regressors and G(q) of the design."""
        moved = self.design[self.rows.now]
        for lag, coefficient in enumerate(eta, 1):
            moved = moved + coefficient * self.design[self.rows.now - lag]
        return np.hstack([self.rows.known, moved])

    def derivative(self, eta: Floats) -> Floats:
        """Return the derivative by each coefficient of G."""
        slopes = np.zeros((eta.size, self.rows.y.size, self.rows.known.shape[1] + self.design.shape[1]))
        for lag in range(1, eta.size + 1):
            slopes[lag - 1, :, self.rows.known.shape[1] :] = self.design[self.rows.now - lag]
        return slopes


def fit_given_partition(
    structure: PiecewiseStructure, rows: Rows, labels: Integers, n_modes: int, start: ArrayLike
) -> tuple[Floats, Floats, SeparableFit]:
    r"""Minimise the one-step prediction error with the mode of every sample known.

    Parameters
    ----------
    structure : PiecewiseStructure
    rows : Rows
    labels : ndarray of int, shape (n_w,)
        Mode of each row of ``rows.phi``.
    n_modes : int
    start : array_like, shape (n_g,)
        Starting coefficients of G.

    Returns
    -------
    linear : ndarray, shape (n_linear,)
        :math:`\eta_L` of (5.9).
    theta : ndarray, shape (n_modes, n_z + 1)
    found : SeparableFit
    """
    problem = GivenPartition.of(rows, labels, n_modes)
    found = fit(problem, rows.y, start, jacobian="golub-pereyra", tolerance=1e-9)
    known, theta = np.split(found.theta, [structure.n_known])
    return np.concatenate([known, found.eta]), theta.reshape(n_modes, -1), found


def jacobian(
    structure: PiecewiseStructure, rows: Rows, labels: Integers, linear: Floats, theta: Floats
) -> Floats:
    """Return the derivative of the prediction by all parameters in the order of their names."""
    problem = GivenPartition.of(rows, labels, theta.shape[0])
    g = linear[structure.n_known :]
    phi = problem.regressors(g)
    w = problem.design @ theta.ravel()
    delayed = [rows.delayed(w, lag) for lag in range(1, structure.n_g + 1)]
    return np.column_stack([phi[:, : structure.n_known], *delayed, phi[:, structure.n_known :]])


def fit_joint(
    u: ArrayLike | Sequence[Floats],
    y: ArrayLike,
    start: PiecewiseLft,
    *,
    max_rounds: int = 30,
    rng: np.random.Generator | None = None,
) -> JointFit:
    r"""Refine a model by the prediction error over (a, b, g, theta) and the boundaries.

    With the partition given the problem is separable and is solved by variable projection; with the
    parameters given the boundaries are improved by exact line minimisation.  The two alternate until
    no sample changes its mode.  Unlike Table 5.1 of Pepona's thesis the noise enters as it does in
    the data, white, so the estimate is not biased where z holds lagged outputs.

    Parameters
    ----------
    u, y : array_like, shape (n_samples,), or lists of such
        Input and output.
    start : PiecewiseLft
        Such as the result of `fit_alternating`; its map gives the number of modes and the first partition.
    max_rounds : int
        Limit of rounds.
    rng : Generator, optional
        Draws lines of search.

    Returns
    -------
    JointFit

    Raises
    ------
    IdentifiabilityError
        If a regressor is common to the linear part and the map.
    ModelError
        If a mode is left with too few samples.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> structure = PiecewiseStructure(1, (), 1, (("u", 1),))
    >>> relay = PiecewiseAffineMap.of_breakpoints([[1.0, -1.0], [1.0, 1.0]], [-0.2])
    >>> plant = PiecewiseLft.of(structure, [-0.5, 0.3], relay)
    >>> u = rng.uniform(-1, 1, 500)
    >>> y = plant.simulate(u, 0.01 * rng.standard_normal(500))
    >>> near = PiecewiseAffineMap.of_breakpoints(relay.theta, [-0.4])
    >>> found = fit_joint(u, y, PiecewiseLft.of(structure, [-0.4, 0.0], near))
    >>> found.model.linear.round(2).tolist()
    [-0.5, 0.3]
    """
    structure = start.structure
    require_identifiable(structure)
    rows = rows_of(structure, u, y)
    draw = np.random.default_rng(0) if rng is None else rng
    separators, owners, n_modes = start.map.separators, start.map.owners, start.map.modes
    regions = regions_of(separators, rows.phi)
    g, costs, status = start.g, [], "stopped at the limit of rounds: raise max_rounds"
    for _ in range(max_rounds):
        _require_samples(owners[regions], n_modes, rows.phi.shape[1])
        linear, theta, found = fit_given_partition(structure, rows, owners[regions], n_modes, g)
        g = linear[structure.n_known :]
        costs.append(found.cost)
        target = rows.y - rows.known @ linear[: structure.n_known]
        boundaries = Boundaries(rows, theta[owners], np.append(1.0, g), target)
        trial = improve(boundaries, separators, draw)
        moved = regions_of(trial, rows.phi)
        if np.array_equal(owners[moved], owners[regions]):
            status = "converged: no line of boundaries lowers the prediction error"
            break
        separators, regions = trial, moved
    if not found.status.converged:
        status = f"{status}; parameters: {found.status.value}"
    map_ = PiecewiseAffineMap(theta, middle(separators, rows, draw), owners)
    model = PiecewiseLft.of(structure, linear, map_)
    labels = owners[regions]
    covariance = _covariance(jacobian(structure, rows, labels, linear, theta), found.cost)
    return JointFit(model, labels, covariance, found.cost, tuple(costs), status)


def _require_samples(labels: Integers, n_modes: int, width: int) -> None:
    counts = np.bincount(labels, minlength=n_modes)
    if counts.min() < width:
        mode = int(counts.argmin())
        raise ModelError(
            f"mode {mode + 1} holds {counts[mode]} samples, fewer than its {width} parameters: "
            "start with fewer modes"
        )


def _covariance(rows: Floats, cost: float) -> Floats:
    """Return the covariance at a least-squares minimum, by QR."""
    from scipy.linalg import solve_triangular

    n_rows, n_columns = rows.shape
    factor = np.linalg.qr(rows, mode="r")
    diagonal = np.abs(np.diag(factor))
    if not np.all(diagonal > 1e-10 * np.linalg.norm(factor, axis=0)):
        return np.full((n_columns, n_columns), np.nan)
    inverse = solve_triangular(factor, np.eye(n_columns))
    return np.asarray(cost / max(n_rows - n_columns, 1) * inverse @ inverse.T)
