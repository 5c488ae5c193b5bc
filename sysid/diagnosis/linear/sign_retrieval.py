"""The signs that a rectifier hides, without a start: the square of a linear model is linear in products."""

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.kernels import simulate
from sysid.diagnosis.linear.rows import Data

# Time constants of the Laguerre functions, in samples.
TIME_CONSTANTS = (1.5, 3.0, 6.0, 12.0, 25.0, 50.0)
FUNCTIONS, ROWS_PER_PRODUCT = 8, 4
ALTERNATIONS = 40


def retrieved_signs(data: Data, x: Floats, constant: bool, count: int = 3) -> list[Floats]:
    """Return guesses of the sign of a linear model's output of which only the size is known.

    With z = Phi c in a few Laguerre functions of the input, z^2 is linear in the products c_i c_j.  Their
    matrix, by least squares from the measured y^2, has rank one but for noise: its first eigenvector is
    c up to its sign.  From there c and the signs of Phi c are fitted in turn to y.

    Parameters
    ----------
    data : Data
        With the size as output.
    x : ndarray, shape (n_rows,)
        Input of the linear model.
    constant : bool
        Whether the model has a constant.
    count : int
        Most guesses, the one that reproduces the size best first.

    Returns
    -------
    list of ndarray, shape (n_rows,)
        Signs on the used rows, zero elsewhere.

    References
    ----------
    Candès, Strohmer & Voroninski (2013), PhaseLift, Communications on Pure and Applied Mathematics 66.
    Gerchberg & Saxton (1972), Optik 35.

    Examples
    --------
    >>> u, z = np.random.default_rng(0).uniform(-1, 1, 400), np.zeros(400)
    >>> for k in range(1, 400):
    ...     z[k] = 0.8 * z[k - 1] + u[k - 1]
    >>> data = Data(u, abs(z), np.ones(400, dtype=bool), np.array([0, 400]), 1.0)
    >>> sign = retrieved_signs(data, u, constant=False)[0]
    >>> float(abs(np.mean(sign * np.sign(z)))) > 0.98
    True
    """
    size = data.y[data.used]
    n_functions = min(FUNCTIONS, int(np.sqrt(2 * size.size / ROWS_PER_PRODUCT)) - 1)
    if n_functions < 1 or not size.any():
        return []
    found: list[tuple[float, Floats]] = []
    for time_constant in TIME_CONSTANTS:
        columns = _laguerre(data, x, float(np.exp(-1.0 / time_constant)), n_functions)[:, data.used].T
        if constant:
            columns = np.column_stack([columns, np.ones(size.size)])
        if not columns.any(axis=0).all():
            continue
        Q = np.linalg.qr(columns)[0]
        found += [_alternated(Q, size, start) for start in _leading(Q, size)]
    guesses = []
    for _, z in sorted(found, key=lambda item: item[0])[:count]:
        sign = np.zeros(data.y.size)
        sign[data.used] = np.where(z < 0.0, -1.0, 1.0)
        guesses.append(sign)
    return guesses


def _leading(Q: Floats, size: Floats) -> list[Floats]:
    """Return the two leading eigenvectors of the matrix of products."""
    i, j = np.triu_indices(Q.shape[1])
    products = Q[:, i] * Q[:, j] * np.where(i == j, 1.0, 2.0)
    scale = np.linalg.norm(products, axis=0)
    scale[scale == 0.0] = 1.0
    values = np.linalg.lstsq(products / scale, size**2, rcond=1e-6)[0] / scale
    C = np.zeros((Q.shape[1], Q.shape[1]))
    C[i, j] = C[j, i] = values
    vectors = np.linalg.eigh(C)[1]
    return [vectors[:, -1 - place] for place in range(min(2, Q.shape[1]))]


def _alternated(Q: Floats, size: Floats, c: Floats) -> tuple[float, Floats]:
    """Fit the coefficients and take their signs in turn; return the squared error of the size, and z."""
    sign = np.sign(Q @ c)
    for _ in range(ALTERNATIONS):
        c = Q.T @ (sign * size)
        following = np.sign(Q @ c)
        if np.array_equal(following, sign):
            break
        sign = following
    z = Q @ c
    return float(np.sum((size - np.abs(z)) ** 2)), z


def _laguerre(data: Data, x: Floats, pole: float, count: int) -> Floats:
    """Return the responses of Laguerre functions, shape (count, n_rows)."""
    a, rest = np.array([-pole]), np.zeros((data.n_experiments, 1))
    found = np.empty((count, x.size))
    simulate(x, a, np.array([np.sqrt(1.0 - pole**2)]), 0.0, rest, data.begin, found[0])
    for i in range(1, count):
        # (q^-1 - pole) / (1 - pole q^-1): a direct path and one with a delay.
        simulate(found[i - 1], a, np.array([1.0 - pole**2]), 0.0, rest, data.begin, found[i])
        found[i] -= pole * found[i - 1]
    return found
