"""Orthogonal elimination of linear parameters: thin QR, and the triangular factor alone in blocks."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack, solve_triangular

from sysid.errors import DataError, IdentifiabilityError, UsageError

Floats = NDArray[np.float64]

PANEL = 4
# Columns that LAPACK eliminates at a time.
BLOCK = 32
RANK_TOLERANCE = 1e-12
"""A column is dependent when its part outside the others is this small relative to its norm."""


@dataclass(frozen=True)
class Projection:
    r"""Linear parameters eliminated: :math:`\min_\theta \|y - \Phi\theta\|^2`.

    Attributes
    ----------
    theta : ndarray, shape (n_linear,)
        Minimiser; coefficients of dependent columns are zero.
    residual : ndarray, shape (n_rows,)
        :math:`(I - QQ^T) y`.
    q, r : ndarray, shapes (n_rows, rank) and (rank, rank)
        Thin QR factors of the independent columns.
    columns : ndarray of int, shape (rank,)
        The independent columns, in the order of ``r``.
    """

    theta: Floats
    residual: Floats
    q: Floats
    r: Floats
    columns: NDArray[np.intp]

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return float(self.residual @ self.residual)

    @property
    def rank(self) -> int:
        """Number of independent regressors."""
        return int(self.r.shape[0])


def project(regressors: ArrayLike, y: ArrayLike) -> Projection:
    r"""Eliminate the linear parameters by a thin QR factorisation.

    Parameters
    ----------
    regressors : array_like, shape (n_rows, n_linear)
        The matrix :math:`\Phi`.
    y : array_like, shape (n_rows,)
        Data.

    Returns
    -------
    Projection
        Parameters, residual and factors.

    Examples
    --------
    >>> import numpy as np
    >>> line = np.column_stack([np.ones(4), np.arange(4.0)])
    >>> project(line, [1.0, 3.0, 5.0, 7.0]).theta.round(12).tolist()
    [1.0, 2.0]
    """
    phi = np.asarray(regressors, dtype=float)
    data = np.asarray(y, dtype=float)
    if phi.ndim != 2 or data.shape != (phi.shape[0],):
        raise UsageError(
            f"regressors of shape {phi.shape} do not match data of shape {data.shape}: "
            "give (n_rows, n_linear) and (n_rows,)"
        )
    n_rows, n_linear = phi.shape
    if n_rows < n_linear:
        raise IdentifiabilityError(
            f"{n_rows} rows cannot determine {n_linear} linear parameters: give more data"
        )
    q, r = np.linalg.qr(phi)
    columns = np.arange(n_linear)
    norms = np.sqrt(np.einsum("ij,ij->j", phi, phi))
    if n_linear and np.any(np.abs(np.diag(r)) <= RANK_TOLERANCE * norms):
        q, r, columns = _independent_columns(phi, norms)
    coefficients = q.T @ data
    theta = np.zeros(n_linear)
    theta[columns] = solve_triangular(r, coefficients)
    residual = data - q @ coefficients
    # A second pass removes the part of the residual that rounding left in the range of Q.
    residual -= q @ (q.T @ residual)
    return Projection(theta, residual, q, r, columns)


def _independent_columns(phi: Floats, norms: Floats) -> tuple[Floats, Floats, NDArray[np.intp]]:
    """Greedy QR with column pivoting on unit-norm columns; dependent columns are left out."""
    scale = np.where(norms > 0, norms, 1.0)
    factored, pivots, _, _, _ = lapack.dgeqp3(phi / scale)
    diagonal = np.abs(np.diag(factored))
    rank = int(np.sum(diagonal > RANK_TOLERANCE * max(float(diagonal[0]), 1.0)))
    columns = np.sort(pivots[:rank] - 1)
    q, r = np.linalg.qr(phi[:, columns])
    return q, r, columns


@dataclass
class BlockedQR:
    r"""The triangular factor of a tall matrix, from blocks of its rows; Q is never formed.

    Memory is that of one block.  With the columns ordered as :math:`[\Phi\; D\; y]` the factor holds
    :math:`\theta`, the cost and everything a Gauss-Newton step in the nonlinear parameters needs
    (the QR form of Borges (2006), eqs. (21)-(26)).

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> phi, y = rng.standard_normal((1000, 3)), rng.standard_normal(1000)
    >>> factor = BlockedQR(4)
    >>> for rows in np.split(np.column_stack([phi, y]), 10):
    ...     factor.update(rows)
    >>> bool(np.allclose(factor.solve(3)[0], np.linalg.lstsq(phi, y)[0]))
    True
    """

    n_columns: int
    n_rows: int = 0
    r: Floats = field(init=False)

    def __post_init__(self) -> None:
        self.r = np.zeros((self.n_columns, self.n_columns), order="F")

    def update(self, rows: ArrayLike) -> None:
        """Take in a block of rows, shape (n_rows, n_columns)."""
        block = np.asarray(rows, dtype=float)
        if block.ndim != 2 or block.shape[1] != self.n_columns:
            raise UsageError(f"a block of shape {block.shape} does not have {self.n_columns} columns")
        self.r = fold(self.r, np.array(block.T, order="C"))
        self.n_rows += block.shape[0]

    def solve(self, n_linear: int) -> tuple[Floats, float]:
        """Return the coefficients of the first ``n_linear`` columns, and the cost; the data come last."""
        factor = self.r[:n_linear, :n_linear]
        norms = np.sqrt(np.einsum("ij,ij->j", factor, factor))
        if np.any(np.abs(np.diag(factor)) <= RANK_TOLERANCE * norms):
            column = int(np.argmin(np.abs(np.diag(factor)) / np.where(norms > 0, norms, np.inf)))
            raise IdentifiabilityError(
                f"regressor column {column} depends on the columns before it: "
                "remove it or use an input that excites it"
            )
        theta = solve_triangular(factor, self.r[:n_linear, -1])
        remainder = self.r[n_linear:, -1]
        return theta, float(remainder @ remainder)


def fold(triangle: Floats | None, rows: Floats) -> Floats:
    """Fold rows, shape (n_columns, n_rows), under a triangular factor; both are used up.

    The factor of (triangle over rows) is returned; its structure is exploited and nothing is copied.
    """
    n_columns = rows.shape[0]
    if triangle is None:
        triangle = np.zeros((n_columns, n_columns), order="F")
    if rows.shape[1] == 0:
        return triangle
    rows = np.ascontiguousarray(rows)
    folded = lapack.dtpqrt(0, min(PANEL, n_columns), triangle, rows.T, overwrite_a=1, overwrite_b=1)[0]
    return np.asarray(folded)


def triangle(matrix: Floats) -> Floats:
    """Return the R factor of a matrix."""
    return folded_up(np.array(matrix, dtype=float, order="F"))


def folded_up(matrix: Floats) -> Floats:
    """Return the R factor of a matrix, which is used up; one stored by columns is not copied."""
    rows, columns = matrix.shape
    if not rows or not columns:
        return np.zeros((min(rows, columns), columns))
    factored = lapack.dgeqrf(matrix, lwork=BLOCK * columns, overwrite_a=1)[0]
    return np.asarray(np.triu(factored[:columns]), dtype=float)


def finite(y: ArrayLike) -> Floats:
    """Return the data as floats; a NaN or infinite value is an error that names its row."""
    data = np.asarray(y, dtype=float)
    bad = np.flatnonzero(~np.isfinite(data))
    if bad.size:
        raise DataError(
            f"data value {int(bad[0])} is {data.flat[bad[0]]}: remove the row or fill it before the fit"
        )
    return data
