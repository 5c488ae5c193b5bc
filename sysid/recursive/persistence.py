"""Persistence of excitation: whether the regressors of a period span the parameter space."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import DataError, IdentifiabilityError

RANK_TOLERANCE = 1e-9
"""A direction is excited when its singular value, with columns of unit norm, exceeds this share."""


@dataclass(frozen=True)
class Excitation:
    """What a period of regressors excites.

    Attributes
    ----------
    n_parameters : int
        Number of parameters.
    rank : int
        Number of independent directions that are excited.
    smallest, largest : float
        Singular values of the rows, in the unit of the signals: the information matrix of the period has
        their squares as eigenvalues.
    """

    n_parameters: int
    rank: int
    smallest: float
    largest: float

    @property
    def persistent(self) -> bool:
        """Whether every direction is excited."""
        return self.rank == self.n_parameters

    def require(self) -> None:
        """Raise where a direction is not excited.

        Raises
        ------
        IdentifiabilityError
            If the rank is below the number of parameters.
        """
        if not self.persistent:
            raise IdentifiabilityError(
                f"the input excites {self.rank} of {self.n_parameters} directions (smallest singular value "
                f"{self.smallest:.1e}): use `impulse_levels` with every level, or a longer record"
            )


def excitation_of(rows: ArrayLike) -> Excitation:
    """Rank and singular values of regressors.

    Parameters
    ----------
    rows : array_like, shape (n_samples, n_parameters)
        Regressors of one period, or of a whole record.

    Returns
    -------
    Excitation

    Raises
    ------
    DataError
        If there are no rows or a value is not finite.

    Examples
    --------
    >>> excitation_of([[1.0, 0.0], [2.0, 0.0]])
    Excitation(n_parameters=2, rank=1, smallest=0.0, largest=2.23606797749979)
    """
    phi = np.asarray(rows, dtype=np.float64)
    if phi.ndim != 2 or phi.size == 0 or not np.all(np.isfinite(phi)):
        raise DataError(f"regressors of shape {phi.shape} are unusable: give finite rows, one a sample")
    p = phi.shape[1]
    singular = np.zeros(p)
    singular[: min(phi.shape)] = np.linalg.svd(phi, compute_uv=False)
    norms = np.linalg.norm(phi, axis=0)
    # Columns of unit norm, so that the rank does not depend on the units of input and output.
    scaled = np.linalg.svd(phi / np.where(norms > 0.0, norms, 1.0), compute_uv=False)
    rank = int(np.sum(scaled > RANK_TOLERANCE * max(float(scaled[0]), 1.0)))
    return Excitation(p, rank, float(singular[-1]), float(singular[0]))
