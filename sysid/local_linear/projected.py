"""Projected gradient search, (13)-(15): steps that no change of the state's coordinates can make."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from sysid.local_linear.problem import At
from sysid.local_linear.structure import Sizes
from sysid.separable.factor import triangle

Floats = NDArray[np.float64]
LARGEST_DAMPING = 1e16


def tangent(sizes: Sizes, eta: Floats) -> Floats:
    """Return directions in which eta moves when the state's coordinates change, (n_eta, n_states^2).

    These are the columns of M, eq. (13) mended, in the order of eta: dA_i = A_i S - S A_i, dC = C S.

    Examples
    --------
    >>> import numpy as np
    >>> sizes = Sizes(n_states=2, n_models=2, n_inputs=1, n_outputs=1, n_scheduling=1)
    >>> eta = np.random.default_rng(0).standard_normal(sizes.n_eta)
    >>> int(np.linalg.matrix_rank(tangent(sizes, eta)))
    4
    """
    A, C, widths, centres = sizes.unpack(eta)
    n = sizes.n_states
    found = []
    for change in np.eye(n * n).reshape(-1, n, n):
        found.append(sizes.pack(A @ change - change @ A, C @ change, 0.0 * widths, 0.0 * centres))
    return np.column_stack(found)


def complement(sizes: Sizes, eta: Floats) -> Floats:
    """Return an orthonormal basis of what is orthogonal to `tangent`: Q_2 of (14) with the identity."""
    directions = tangent(sizes, eta)
    q, _ = np.linalg.qr(directions, mode="complete")
    return np.asarray(q[:, np.linalg.matrix_rank(directions) :])


def identity_step(jacobian: Floats, residual: Floats, damping: float, basis: Floats | None = None) -> Floats:
    """Return the step of (15), -Q (Q'J'JQ + damping I)^-1 Q'J'r, by a QR factorisation."""
    seen = jacobian if basis is None else jacobian @ basis
    n = seen.shape[1]
    rows = np.block([[seen, residual[:, np.newaxis]], [np.sqrt(damping) * np.eye(n), np.zeros((n, 1))]])
    factor = triangle(rows)
    step = -solve_triangular(factor[:n, :n], factor[:n, n])
    return np.asarray(step if basis is None else basis @ step)


@dataclass(frozen=True)
class Descent:
    """A descent with the damping lambda I.

    Attributes
    ----------
    eta : ndarray
    point : At
    costs : tuple of float
        Cost at the start and after each linearisation.
    """

    eta: Floats
    point: At
    costs: tuple[float, ...]


def identity_descent(
    problem: Callable[[Floats], At], start: Floats, iterations: int, *, projected: bool = False
) -> Descent:
    """Descend by (15): a step that lowers the cost divides lambda by ten, another multiplies it.

    Parameters
    ----------
    problem : callable
        Returns the problem at eta.
    start : ndarray, shape (n_eta,)
    iterations : int
        Linearisations.
    projected : bool
        Whether steps are orthogonal to changes of coordinates.
    """
    eta, point = np.asarray(start, dtype=float), problem(start)
    costs, damping = [point.cost], 1e-2 * point.cost
    for _ in range(iterations):
        jacobian, residual = point.linearise()
        basis = complement(point.problem.sizes, eta) if projected else None
        while True:
            trial = eta + identity_step(jacobian, residual, damping, basis)
            there = problem(trial)
            if there.cost < point.cost:
                eta, point, damping = trial, there, damping / 10.0
                break
            damping *= 10.0
            if damping > LARGEST_DAMPING:
                return Descent(eta, point, (*costs, point.cost))
        costs.append(point.cost)
    return Descent(eta, point, tuple(costs))
