"""Standard errors of physical parameters when the residual is coloured."""

from dataclasses import dataclass

import numpy as np

from sysid.linear.forms import Floats
from sysid.linear.kernels import polynomial_filter
from sysid.physics.problem import Problem

# Directions of the scaled Jacobian below this share of the largest count as not determined.
RANK_TOLERANCE = 1e-7
PART_OF_DIRECTION = 1e-2


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of the searched parameters, and the model of the residual it rests on.

    Attributes
    ----------
    covariance : ndarray, shape (n_searched, n_searched)
        In the units of the parameters; infinite where the record does not determine them.
    standard_errors : ndarray, shape (n_searched,)
    undetermined : tuple of str
        Parameters of which the record determines a combination only.
    noises : tuple of ndarray, shape (order + 1,)
        For each output D(q), leading 1: its residual is white noise through 1/D.
    noise_stds : tuple of float
        Standard deviation of that white noise.
    effective_noise : ndarray, shape (n_searched,)
        Standard deviation of white noise in which each parameter would be as uncertain: by it a prior
        is weighed.
    """

    covariance: Floats
    standard_errors: Floats
    undetermined: tuple[str, ...]
    noises: tuple[Floats, ...]
    noise_stds: tuple[float, ...]
    effective_noise: Floats

    @property
    def noise(self) -> Floats:
        """D(q) of the first output."""
        return self.noises[0]

    @property
    def noise_std(self) -> float:
        """Standard deviation of the white noise of the first output."""
        return self.noise_stds[0]


def parameter_uncertainty(problem: Problem, point: Floats, residual: Floats) -> Uncertainty:
    """Return the covariance (J'J)^-1 J'VJ (J'J)^-1, V that of an autoregressive model of the residual.

    The model has a unit root where the residual may wander; see `sysid.linear.unit_root`.
    J'VJ = sigma^2 |F'J|^2, where F' runs 1/D backwards in time.  Initial states count as parameters.  The row
    of a prior has the variance of the noise by which it was weighed.
    """
    from sysid.linear.uncertainty import autoregression

    J = problem.plain_jacobian(point)
    rows, count = problem.n_rows, len(problem.names)
    models = [
        autoregression([residual[part] for part, _, output in problem.runs() if output == o])
        for o in range(problem.weights.size)
    ]
    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0.0] = 1.0
    J /= scale
    wandering = [_wandering(problem, residual, o, *model) for o, model in enumerate(models)]
    left, sizes, right = np.linalg.svd(J, full_matrices=False)
    known = sizes > RANK_TOLERANCE * sizes[0]
    # (J'J)^-1 J' V J (J'J)^-1 = G'G with G = F'J (J'J)^-1 = F'U diag(1/s) V'.
    inverse = (right[known] / sizes[known, np.newaxis]) / scale
    lost = float(np.sqrt(rows / max(rows - point.size, 1)))
    G = lost * (_backwards(left[:rows, known], wandering, problem) @ inverse)[:, :count]
    white = (left[:rows, known] @ inverse)[:, :count]
    size = np.linalg.norm(white, axis=0)
    effective = np.where(
        size > 0.0, np.linalg.norm(G, axis=0) / np.where(size > 0.0, size, 1.0), lost * models[0][1]
    )
    covariance = G.T @ G
    if problem.priors:
        assert problem.noise is not None
        weighed = np.array([problem.noise[place] for place, _ in problem.priors])
        P = weighed[:, np.newaxis] * (left[rows:, known] @ inverse)[:, :count]
        covariance += P.T @ P
    loose = np.abs(right[~known][:, :count]).max(axis=0, initial=0.0) > PART_OF_DIRECTION
    covariance[loose, :] = covariance[:, loose] = np.inf
    undetermined = tuple(name for name, is_loose in zip(problem.names, loose, strict=True) if is_loose)
    return Uncertainty(
        covariance,
        np.sqrt(np.diag(covariance)),
        undetermined,
        tuple(noise for noise, _ in models),
        tuple(std / weight for (_, std), weight in zip(models, problem.weights.tolist(), strict=True)),
        effective,
    )


def _wandering(
    problem: Problem, residual: Floats, output: int, noise: Floats, std: float
) -> tuple[Floats, float]:
    """Return the noise of an output with a unit root, unless its residual proves that it has none."""
    from sysid.linear.unit_root import with_unit_root

    runs = [residual[rows] for rows, _, place in problem.runs() if place == output]
    found = with_unit_root(runs, noise)
    if found is noise:
        return noise, std
    driving = np.concatenate([np.convolve(run, found)[noise.size - 1 : run.size] for run in runs])
    return found, float(np.sqrt(np.mean(driving**2)))


def _backwards(columns: Floats, models: list[tuple[Floats, float]], problem: Problem) -> Floats:
    """Filter each column by sigma/D in reversed time, rows that are not used as zeros between."""
    filtered = np.empty_like(columns)
    for rows, segment, output in problem.runs():
        noise, std = models[output]
        b = np.zeros_like(noise)
        b[0] = std
        for column in range(columns.shape[1]):
            signal, out = np.zeros(segment.used.size), np.empty(segment.used.size)
            signal[segment.used] = columns[rows, column]
            polynomial_filter(b, noise, np.ascontiguousarray(signal[::-1]), np.zeros(noise.size - 1), out)
            filtered[rows, column] = out[::-1][segment.used]
    return filtered
