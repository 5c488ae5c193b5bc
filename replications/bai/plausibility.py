"""Whether a printed row is what the stated protocol gives, and whether it is too good for one draw."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2


@dataclass(frozen=True)
class Plausibility:
    """How a printed row of estimates lies among the runs.

    Attributes
    ----------
    mahalanobis : float
        Distance of the row from the mean of the runs, in their covariance.
    p_value : float
        Share of runs at least as far away: small for an implausible row.
    closer_share : float
        Share of runs that, printed with the same decimals, would be at least as close to the true
        values: small for a row that is too good.
    """

    mahalanobis: float
    p_value: float
    closer_share: float


def plausibility(
    runs: np.ndarray, printed: Sequence[float], decimals: Sequence[int], true: Sequence[float]
) -> Plausibility:
    """Compare a printed row with the estimates of many runs.

    Parameters
    ----------
    runs : ndarray, shape (n_runs, n_parameters)
        Estimates.
    printed, decimals : sequence
        The row, and the number of decimals of each entry.
    true : sequence of float
        True values.

    Examples
    --------
    >>> runs = np.random.default_rng(0).standard_normal((2000, 2))
    >>> row = plausibility(runs, [0.0, 0.0], [2, 2], [0.0, 0.0])
    >>> row.p_value > 0.99, row.closer_share < 0.001
    (True, True)
    """
    factor = np.linalg.cholesky(np.cov(runs, rowvar=False))

    def squared(points: np.ndarray, centre: np.ndarray) -> np.ndarray:
        return np.asarray(np.sum(np.linalg.solve(factor, (points - centre).T) ** 2, axis=0))

    mean, centre = runs.mean(axis=0), np.asarray(true, dtype=float)
    row = np.asarray(printed, dtype=float)[None]
    distance = float(squared(row, mean)[0])
    p_value = _share(squared(runs, mean) >= distance)
    rounded = np.column_stack([np.round(column, d) for column, d in zip(runs.T, decimals, strict=True)])
    # The slack keeps runs that print the same digits on the side of the printed row.
    closer = _share(squared(rounded, centre) <= squared(row, centre)[0] * (1 + 1e-9))
    return Plausibility(float(np.sqrt(distance)), p_value, closer)


def _share(hits: np.ndarray) -> float:
    """Share of hits, the observation itself counted: never zero."""
    return (1 + int(np.sum(hits))) / (hits.size + 1)


def rounded_share(runs: np.ndarray, printed: float, decimals: int, true: float) -> float:
    """Share of runs that print at least as close to the true value as the printed number.

    Examples
    --------
    >>> rounded_share(np.array([0.96, 0.99, 1.004, 1.2]), 1.0, 2, 1.0)
    0.4
    """
    return _share(np.abs(np.round(runs, decimals) - true) <= abs(printed - true) + 1e-12)


def combined_probability(shares: Sequence[float]) -> float:
    """Probability that independent rows are together as good as this (Fisher's combination).

    Examples
    --------
    >>> round(combined_probability([0.5] * 4), 3)
    0.698
    """
    return float(chi2.sf(-2 * np.sum(np.log(shares)), 2 * len(shares)))
