"""The signal before a moving average: minimum-norm smoothing, Eq. (5.21) of Pepona's thesis."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def smooth(residual: ArrayLike, g: ArrayLike, lengths: Sequence[int] | None = None) -> Floats:
    r"""Return the smallest v with :math:`v_k + g_1 v_{k-1} + \dots + g_n v_{k-n} = r_k`.

    N equations hold N + n unknowns.  Of all solutions the one of least norm,
    :math:`v = T^T (T T^T)^{-1} r` with the banded matrix T of the filter, stays bounded wherever the
    zeros of G lie, and costs O(N n^2) by Cholesky's factor of the band; one step of refinement
    removes what forming :math:`T T^T` loses.

    Parameters
    ----------
    residual : array_like, shape (n_rows,)
        r, the output less what measured signals explain.
    g : array_like, shape (n_g,)
        Coefficients g_1, ...; g_0 = 1.
    lengths : sequence of int, optional
        Rows of each experiment; one experiment by default.

    Returns
    -------
    ndarray, shape (n_rows + n_g * n_experiments,)
        v, each experiment from n_g samples before its first row.

    Examples
    --------
    >>> v = smooth([1.0, 2.0, 3.0], [2.0])
    >>> (v[1:] + 2.0 * v[:-1]).round(12).tolist()
    [1.0, 2.0, 3.0]
    """
    r = np.asarray(residual, dtype=float)
    filter_ = np.concatenate([[1.0], np.asarray(g, dtype=float)])
    ends = np.cumsum([r.size] if lengths is None else lengths)
    return np.concatenate([_least_norm(part, filter_) for part in np.split(r, ends[:-1])])


def _least_norm(r: Floats, filter_: Floats) -> Floats:
    from scipy.linalg import cho_solve_banded, cholesky_banded

    if filter_.size == 1:
        return r.copy()
    width = min(filter_.size, r.size)
    band = np.zeros((width, r.size))
    for lag in range(width):
        band[lag] = filter_[: filter_.size - lag] @ filter_[lag:]
    factor = (cholesky_banded(band, lower=True, check_finite=False), True)
    v = np.convolve(cho_solve_banded(factor, r, check_finite=False), filter_[::-1])
    missed = r - np.convolve(v, filter_, mode="valid")
    return np.asarray(v + np.convolve(cho_solve_banded(factor, missed, check_finite=False), filter_[::-1]))


@dataclass(frozen=True)
class Inversion:
    """What inverting G(q) sample by sample would do.

    Attributes
    ----------
    zeros : ndarray of complex
        Zeros of G in the z plane.
    forward, backward : float
        Growth of a disturbance a sample when v is recovered forward or backward in time; above 1 it
        blows up.
    """

    zeros: NDArray[np.complex128]
    forward: float
    backward: float

    def __str__(self) -> str:
        """Say which recursion is stable."""
        if not self.zeros.size:
            return "G(q) = 1: nothing to invert"
        if abs(self.forward - 1) < 1e-9 or abs(self.backward - 1) < 1e-9:
            return "G(q) has a zero on the unit circle: v is not determined at that frequency"
        if self.forward < 1:
            return (
                f"all zeros of G(q) lie inside the unit circle: errors decay forward in time, by "
                f"{self.forward:.3g} a sample"
            )
        if self.backward < 1:
            return (
                f"all zeros of G(q) lie outside the unit circle: the recursion forward in time grows by "
                f"{self.forward:.3g} a sample, backward it decays by {self.backward:.3g}"
            )
        return (
            f"G(q) has zeros on both sides of the unit circle: a recursion blows up in either direction "
            f"(by {self.forward:.3g} a sample forward, {self.backward:.3g} backward); the least-norm "
            "solution does not"
        )


def inversion(g: ArrayLike) -> Inversion:
    """Return where the zeros of G lie and what a recursion for v would do.

    Parameters
    ----------
    g : array_like, shape (n_g,)
        Coefficients g_1, ...

    Examples
    --------
    >>> print(inversion([2.0]))
    all zeros of G(q) lie outside the unit circle: the recursion forward in time grows by 2 a sample, \
backward it decays by 0.5
    """
    coefficients = np.trim_zeros(np.concatenate([[1.0], np.asarray(g, dtype=float)]), "b")
    zeros = np.roots(coefficients).astype(complex)
    if not zeros.size:
        return Inversion(zeros, 0.0, 0.0)
    sizes = np.abs(zeros)
    return Inversion(zeros, float(sizes.max()), float(1.0 / sizes.min()))
