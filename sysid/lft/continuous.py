"""Continuous piecewise affine maps in a linear system: kinks instead of jumps, fitted at once."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import ModelError
from sysid.lft.identifiability import require_identifiable
from sysid.lft.piecewise import PiecewiseLft, Rows, rows_of
from sysid.nonlinearities.piecewise_affine import PiecewiseAffineMap
from sysid.separable import SeparableFit, fit

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Hinges:
    r"""The regression of :math:`f(z) = c^T \phi + \sum_i d_i \max(h_i^T \phi, 0)` in a linear system.

    Linear are (a, b, c, d), nonlinear g and, of each :math:`h_i`, all entries but one, which is 1.

    Attributes
    ----------
    rows : Rows
    n_g : int
        Order of G.
    fixed : tuple of int
        The entry of each h that is 1.
    """

    rows: Rows
    n_g: int
    fixed: tuple[int, ...]

    @property
    def width(self) -> int:
        """Number of arguments of the map and the one behind."""
        return int(self.rows.phi.shape[1])

    def hinges(self, eta: Floats) -> Floats:
        """Return the vectors h, shape (n_hinges, n_z + 1)."""
        free = eta[self.n_g :].reshape(len(self.fixed), self.width - 1)
        return np.array([np.insert(row, place, 1.0) for row, place in zip(free, self.fixed, strict=True)])

    def free(self, hinges: Floats) -> Floats:
        """Return the entries of h that are searched."""
        return np.concatenate([np.delete(h / h[p], p) for h, p in zip(hinges, self.fixed, strict=True)])

    def regressors(self, eta: Floats) -> Floats:
        """Return measured regressors, and G(q) of the arguments and of the hinges."""
        basis = np.hstack([self.rows.phi, np.maximum(self.rows.phi @ self.hinges(eta).T, 0.0)])
        return np.hstack([self.rows.known, self._filtered(basis, eta[: self.n_g])])

    def derivative(self, eta: Floats) -> Floats:
        """Return the derivative by g and by the free entries of h."""
        phi, known = self.rows.phi, self.rows.known.shape[1]
        inside = phi @ self.hinges(eta).T
        basis = np.hstack([phi, np.maximum(inside, 0.0)])
        slopes = np.zeros((eta.size, self.rows.y.size, known + basis.shape[1]))
        for lag in range(1, self.n_g + 1):
            slopes[lag - 1, :, known:] = self.rows.delayed(basis, lag)
        row = self.n_g
        for i, place in enumerate(self.fixed):
            for j in (j for j in range(self.width) if j != place):
                moved = np.where(inside[:, i] > 0.0, phi[:, j], 0.0)
                slopes[row, :, known + self.width + i] = self._filtered(moved, eta[: self.n_g])
                row += 1
        return slopes

    def _filtered(self, signal: Floats, g: Floats) -> Floats:
        total = self.rows.delayed(signal, 0)
        for lag, coefficient in enumerate(g, 1):
            total = total + coefficient * self.rows.delayed(signal, lag)
        return total


@dataclass(frozen=True)
class ContinuousFit:
    """Result of `fit_continuous`.

    Attributes
    ----------
    model : PiecewiseLft
        Its map is continuous.
    hinges : ndarray, shape (n_modes - 1, n_z + 1)
        Where the slope changes: h' (z, 1) = 0; of a scalar z, ``(1, -tau)``.
    covariance : ndarray
        Of the linear part, theta row by row, and the hinges row by row, in this order.
    cost : float
        Sum of squared prediction errors.
    status : str
        Why the search stopped.
    """

    model: PiecewiseLft
    hinges: Floats
    covariance: Floats
    cost: float
    status: str

    def __repr__(self) -> str:
        """Give the parameters and the status."""
        listed = ", ".join(f"{name}={value:.4g}" for name, value in self.model.values.items())
        return f"ContinuousFit({listed}; {self.status})"


def fit_continuous(u: ArrayLike | Sequence[Floats], y: ArrayLike, start: PiecewiseLft) -> ContinuousFit:
    r"""Refine a model by the prediction error under the condition that its map is continuous.

    The submodels then meet at the boundary, which the map's values determine: the boundary is a smooth
    parameter with a standard error of its own.  Separable least squares over g and the hinges.

    Parameters
    ----------
    u, y : array_like, shape (n_samples,), or lists of such
        Input and output.
    start : PiecewiseLft
        Any number of modes of a scalar z, or two modes of a vector.

    Returns
    -------
    ContinuousFit

    Raises
    ------
    IdentifiabilityError
        If a regressor is common to the linear part and the map.
    ModelError
        If the map has more than two modes of a vector z.

    Examples
    --------
    >>> from sysid.lft.piecewise import PiecewiseStructure
    >>> rng = np.random.default_rng(1)
    >>> u = rng.uniform(-2, 2, 300)
    >>> structure = PiecewiseStructure(1, (), 0, (("u", 0),))
    >>> hinge = PiecewiseAffineMap.of_breakpoints([[-0.5, 0.0], [1.0, 0.0]], [0.0])
    >>> y = PiecewiseLft.of(structure, [-0.8], hinge).simulate(u, rng.uniform(-0.1, 0.1, 300))
    >>> near = PiecewiseAffineMap.of_breakpoints(hinge.theta, [0.3])
    >>> found = fit_continuous(u, y, PiecewiseLft.of(structure, [-0.5], near))
    >>> (found.model.map.tau.round(1) + 0.0).tolist()
    [0.0]
    """
    structure = start.structure
    require_identifiable(structure)
    rows = rows_of(structure, u, y)
    first = _hinges_of(start.map)
    slopes = np.abs(first[:, :-1]) * np.maximum(rows.z.std(axis=0), 1e-300)
    problem = Hinges(rows, structure.n_g, tuple(int(i) for i in np.argmax(slopes, axis=1)))
    found = fit(problem, rows.y, np.concatenate([start.g, problem.free(first)]), jacobian="golub-pereyra")
    hinges = problem.hinges(found.eta)
    known, common, sizes = np.split(found.theta, [structure.n_known, structure.n_known + problem.width])
    theta = common + np.vstack([np.zeros(problem.width), np.cumsum(sizes[:, np.newaxis] * hinges, axis=0)])
    linear = np.concatenate([known, found.eta[: structure.n_g]])
    model = PiecewiseLft.of(structure, linear, _map_of(theta, hinges))
    covariance = _covariance(problem, structure.n_known, found, hinges, sizes)
    return ContinuousFit(model, hinges, covariance, found.cost, found.status.value)


def _hinges_of(map_: PiecewiseAffineMap) -> Floats:
    """Return where a map changes its mode."""
    if map_.n_z == 1:
        return np.column_stack([np.ones(map_.modes - 1), -map_.tau[: map_.modes - 1]])
    if map_.regions != 2:
        raise ModelError(
            f"a continuous map of {map_.n_z} arguments has two modes here, this one has {map_.modes}: "
            "give two modes, or one argument"
        )
    return map_.hyperplane[np.newaxis]


def _map_of(theta: Floats, hinges: Floats) -> PiecewiseAffineMap:
    if hinges.shape[1] > 2:
        return PiecewiseAffineMap(theta, np.vstack([np.zeros(hinges.shape[1]), hinges[0]]))
    tau = -hinges[:, 1]
    if np.any(np.diff(tau) <= 0.0):
        raise ModelError(f"the kinks {tau.tolist()} crossed each other: start with fewer modes")
    return PiecewiseAffineMap.of_breakpoints(theta, tau)


def _covariance(problem: Hinges, n_known: int, found: SeparableFit, hinges: Floats, sizes: Floats) -> Floats:
    """Carry the covariance of the search over to linear part, theta and hinges."""
    n_g, width, n_hinges = problem.n_g, problem.width, len(problem.fixed)
    n_eta = found.eta.size
    n_linear = n_known + n_g
    turn = np.zeros((n_linear + (n_hinges + 1) * width + n_hinges * width, n_eta + found.theta.size))
    turn[:n_known, n_eta : n_eta + n_known] = np.eye(n_known)
    turn[n_known:n_linear, :n_g] = np.eye(n_g)
    place_of_hinges = n_linear + (n_hinges + 1) * width
    for mode in range(n_hinges + 1):
        rows = slice(n_linear + mode * width, n_linear + (mode + 1) * width)
        turn[rows, n_eta + n_known : n_eta + n_known + width] = np.eye(width)
        for i in range(mode):
            turn[rows, n_eta + n_known + width + i] = hinges[i]
            turn[rows, n_g + i * (width - 1) : n_g + (i + 1) * (width - 1)] = sizes[i] * _entries(problem, i)
    for i in range(n_hinges):
        rows = slice(place_of_hinges + i * width, place_of_hinges + (i + 1) * width)
        turn[rows, n_g + i * (width - 1) : n_g + (i + 1) * (width - 1)] = _entries(problem, i)
    return np.asarray(turn @ found.covariance @ turn.T)


def _entries(problem: Hinges, i: int) -> Floats:
    """Where the searched entries of the i-th hinge stand, shape (n_z + 1, n_z)."""
    return np.delete(np.eye(problem.width), problem.fixed[i], axis=1)
