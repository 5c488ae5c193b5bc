"""Covariance of a Wiener-Hammerstein model when its residual is coloured."""

from dataclasses import dataclass

import numpy as np

from sysid.lft.wiener_hammerstein.kernels import all_pole_rows
from sysid.lft.wiener_hammerstein.reduction import Point, blocks_of_rows, searched_columns
from sysid.linear.forms import Floats
from sysid.linear.reduction import RANK_TOLERANCE, Segment
from sysid.linear.uncertainty import autoregression
from sysid.separable.factor import fold


@dataclass(frozen=True)
class Uncertainty:
    """Covariance, and the autoregressive model of the residual it rests on.

    Attributes
    ----------
    covariance : ndarray, shape (n_parameters, n_parameters)
        Of the model's ``vector``; zero for the two weights that are held.
    noise : ndarray, shape (order + 1,)
        D(q), leading 1: the residual is white noise through 1/D.
    noise_std : float
        Standard deviation of that white noise.
    """

    covariance: Floats
    noise: Floats
    noise_std: float


def parameter_covariance(point: Point) -> Uncertainty:
    """Return the covariance of the parameters at a minimum.

    With Jacobian J and residual covariance V the estimate has the covariance (J'J)^-1 J'VJ (J'J)^-1; V is
    that of an autoregressive model of the residual, so that J'VJ = sigma^2 |J/D|^2, each column of J filtered
    by 1/D.
    """
    problem, model = point.problem, point.model
    p = problem.n_basis
    residuals = [s.y - model.simulate(s.u[:, 0])[: s.y.size] for s in problem.segments]
    noise, noise_std = autoregression([r[s.used] for r, s in zip(residuals, problem.segments, strict=True)])
    chain = searched_columns(problem, model)
    meat: Floats | None = None
    for segment in problem.segments:
        meat = _filtered(segment, point, chain, noise, meat)
    assert meat is not None
    bread = point.triangle[:, :-1]
    scale = np.linalg.norm(bread, axis=0)
    scale[scale == 0.0] = 1.0
    inverse = np.linalg.pinv(bread / scale, rcond=RANK_TOLERANCE)
    X = ((meat / scale) @ inverse @ inverse.T) / scale
    n_parameters = bread.shape[1]
    share = problem.n_rows / max(problem.n_rows - n_parameters, 1)
    # From [map, searched] to the order of the model's vector.
    places = np.concatenate([problem.free.size + np.arange(p), np.flatnonzero(problem.free)])
    covariance = np.zeros((problem.free.size + p,) * 2)
    covariance[np.ix_(places, places)] = noise_std**2 * share * (X.T @ X)
    return Uncertainty(covariance, noise, noise_std)


def _filtered(
    segment: Segment, point: Point, chain: Floats, noise: Floats, triangle: Floats | None
) -> Floats:
    """Fold the Jacobian of one experiment, its columns filtered by 1/D, under a triangle."""
    p, order = point.problem.n_basis, noise.size - 1
    before = np.zeros((order, p + chain.shape[1]))
    for rows, _, used in blocks_of_rows(segment, point.model, derivatives=True):
        jacobian = np.column_stack([rows[:, :p], rows[:, p:-1] @ chain])
        jacobian[~used] = 0.0
        both = np.vstack([before, jacobian])
        all_pole_rows(noise, both, order)
        before = both[both.shape[0] - order :].copy()
        triangle = fold(triangle, both[order:].T)
    assert triangle is not None
    return triangle
