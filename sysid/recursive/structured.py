"""Least squares that respects mu_ij = b_i d_j, from the triangle recursive least squares keeps."""

from dataclasses import dataclass

import numpy as np

from sysid.errors import IdentifiabilityError
from sysid.recursive.algorithms import RecursiveLeastSquares
from sysid.recursive.base import Floats, Snapshot
from sysid.recursive.recovery import rank_one
from sysid.separable import fit


@dataclass(frozen=True)
class _RankOneRows:
    """Rows R theta(b, a, d): linear in (a, d) when b is given, its largest element held at 1."""

    factor: Floats
    order: int
    fixed: int

    def regressors(self, eta: Floats) -> Floats:
        """Return R [I, kron(I, b)]."""
        return self.factor @ self._map(np.insert(eta, self.fixed, 1.0), identity=True)

    def derivative(self, eta: Floats) -> Floats:
        """Return the derivative with respect to each free element of b."""
        units = np.delete(np.eye(self.order), self.fixed, axis=0)
        return np.stack([self.factor @ self._map(unit, identity=False) for unit in units])

    def _map(self, b: Floats, *, identity: bool) -> Floats:
        n_levels = self.factor.shape[0] // self.order - 1
        found = np.zeros((self.factor.shape[0], self.order + n_levels))
        found[: self.order, : self.order] = float(identity) * np.eye(self.order)
        found[self.order :, self.order :] = np.kron(np.eye(n_levels), b[:, np.newaxis])
        return found


def structured(estimator: RecursiveLeastSquares) -> Snapshot:
    r"""Minimise the same sum of squares over parameters with :math:`\mu_{ij} = b_id_j`.

    The triangle [R z] holds everything of the data: the cost is :math:`\|R\theta - z\|^2` plus a
    constant.  The printed recovery takes the rank-one matrix nearest to M with every element weighted
    alike; this one weights by the information, which makes it efficient for white equation noise.

    Parameters
    ----------
    estimator : RecursiveLeastSquares
        After enough samples to determine every parameter.

    Returns
    -------
    Snapshot
        With composite parameters of rank one, for `recover`.

    Raises
    ------
    IdentifiabilityError
        If the composite parameters are zero or the descent did not converge.

    Examples
    --------
    >>> estimator = RecursiveLeastSquares(2, [-1.0, 1.0])
    >>> u = np.random.default_rng(0).choice([-1.0, 0.0, 1.0], 60)
    >>> x = np.where(u > 0, 1.0, 3.0 * u)
    >>> y = np.convolve(x, [0.0, 1.0, -2.0])[:60]
    >>> _ = estimator.run(u, y)
    >>> structured(estimator).composite.round(4)
    array([[ 3.,  1.],
           [-6., -2.]])
    """
    factor, target = estimator.triangle
    before = estimator.snapshot()
    if before.order == 1:  # a single row is of rank one as it is
        return before
    start = rank_one(before.composite, "unit-norm").b
    fixed = int(np.argmax(np.abs(start)))
    rows = _RankOneRows(factor, before.order, fixed)
    found = fit(rows, target, np.delete(start / start[fixed], fixed))
    if not found.status.converged:
        raise IdentifiabilityError(f"the structured least squares {found.status.value}")
    theta = rows._map(np.insert(found.eta, fixed, 1.0), identity=True) @ found.theta
    return Snapshot(before.samples, theta, before.order, before.levels)
