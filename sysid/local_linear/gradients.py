r"""Derivatives of the projected residual of Borges (2006), and which of them is one.

Approaches 1 (28)-(29), 2a (40) and 2b (41)-(43) of the paper, Kaufman's approximation, and the exact Jacobian
without any derivative of :math:`\Phi`.  2a and 2b are the derivative of the residual at a fixed
:math:`\theta_\ell`: they give the gradient of the projected cost, but are not the Jacobian of the projected
residual, as (37) and (39) claim.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack, solve_triangular

from sysid.errors import IdentifiabilityError
from sysid.local_linear import kernels
from sysid.local_linear.passes import Flight, fly, pull_back, pull_back_slopes, sensitivities
from sysid.local_linear.recursion import Respond, recursion
from sysid.local_linear.structure import Course
from sysid.separable.factor import PANEL, RANK_TOLERANCE

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Elimination:
    r"""The linear parameters eliminated by Householder reflections, (23)-(26); Q stays in factored form.

    Rows of zeros stand above :math:`\Phi`, which the factorisation fills with R: coordinates rotated by Q
    have a head (in the range of :math:`\Phi`) and a tail (orthogonal to it, as many rows as :math:`\Phi`).

    Attributes
    ----------
    R : ndarray, shape (n_linear, n_linear)
    reflections, blocks : ndarray
        LAPACK's form of Q.
    theta : ndarray, shape (n_linear,)
    tail : ndarray, shape (n_rows,)
        The projected residual in rotated coordinates.
    """

    R: Floats
    reflections: Floats
    blocks: Floats
    theta: Floats
    tail: Floats

    @property
    def n_linear(self) -> int:
        """Number of linear parameters."""
        return int(self.theta.size)

    @cached_property
    def cost(self) -> float:
        """Sum of squares of the projected residual, (12)."""
        return float(self.tail @ self.tail)

    def rotate(self, columns: Floats) -> tuple[Floats, Floats]:
        """Return head and tail of columns of shape (n_rows, n_columns)."""
        head = np.zeros((self.n_linear, columns.shape[1]), order="F")
        return _apply(self.reflections, self.blocks, head, np.asfortranarray(columns), "T")

    def back(self, head: Floats, tail: Floats) -> Floats:
        """Return the rows, shape (n_rows, n_columns), of rotated columns."""
        copy = np.array(tail, order="F")
        return _apply(self.reflections, self.blocks, np.asfortranarray(head), copy, "N")[1]

    @cached_property
    def residual(self) -> Floats:
        """The projected residual, (26)."""
        return self.back(np.zeros((self.n_linear, 1)), self.tail[:, np.newaxis])[:, 0]

    def solve_transposed(self, table: Floats) -> Floats:
        """Return inverse(R') times a table with n_linear rows."""
        return np.asarray(solve_triangular(self.R, table, trans="T", check_finite=False))


def _apply(
    reflections: Floats, blocks: Floats, head: Floats, tail: Floats, side: str
) -> tuple[Floats, Floats]:
    turned = lapack.dtpmqrt(
        0, reflections, blocks, head, tail, side="L", trans=side, overwrite_a=1, overwrite_b=1
    )
    return np.asarray(turned[0]), np.asarray(turned[1])


def eliminate(phi: Floats, y: Floats) -> Elimination:
    """Eliminate the linear parameters of rows of regressors, shape (n_rows, n_linear).

    Raises
    ------
    IdentifiabilityError
        If there are fewer rows than parameters, or a column depends on others.
    """
    n_rows, n_linear = phi.shape
    if n_rows < n_linear:
        raise IdentifiabilityError(
            f"{n_rows} output values cannot determine {n_linear} linear parameters: take a longer record, or "
            "a model with fewer states or local models"
        )
    norms = np.sqrt(np.einsum("ij,ij->j", phi, phi))
    empty = np.zeros((n_linear, n_linear), order="F")
    R, reflections, blocks, _ = lapack.dtpqrt(
        0, min(PANEL, n_linear), empty, np.array(phi, order="F"), overwrite_a=1, overwrite_b=1
    )
    if not np.all(np.abs(np.diag(R)) > RANK_TOLERANCE * norms):
        raise IdentifiabilityError(
            "the regressors of the local models depend on one another: the scheduling signal hardly visits "
            "one of the local models, or the input does not excite it; take fewer local models or a richer "
            "input"
        )
    head, tail = _apply(
        reflections, blocks, np.zeros((n_linear, 1), order="F"), np.array(y[:, np.newaxis]), "T"
    )
    theta = solve_triangular(R, head[:, 0], check_finite=False)
    return Elimination(R, reflections, blocks, np.asarray(theta), tail[:, 0])


def regressor_slopes(course: Course, *, respond: Respond | None = None) -> Floats:
    """Return d Phi / d eta of (30)-(32), shape (n_eta, n_samples, n_outputs, n_linear): large and slow."""
    sizes = course.sizes
    n, s, q, p = sizes.n_states, sizes.n_models, sizes.n_scheduling, sizes.n_outputs
    n_samples, channels, columns = course.A.shape[0], sizes.channels, sizes.n_linear
    run = respond or recursion(n, p)
    inner = np.empty((n_samples, n, columns))
    identity = np.eye(n)
    track = respond or recursion(n, n)
    for row in range(n):
        track(course.A, identity, course.z, row, inner, row * channels, np.zeros((n, channels)))
    out = np.zeros((sizes.n_eta, n_samples, p, columns))
    parameter = 0
    for a in range(n):
        for i in range(s):
            for b in range(n):
                drive = course.weights[:, i, np.newaxis] * inner[:, b]
                run(course.A, course.C, drive[:, np.newaxis], a, out[parameter], 0, np.zeros((n, columns)))
                parameter += 1
    for o in range(p):
        for b in range(n):
            out[parameter, :, o] = inner[:, b]
            parameter += 1
    steps = np.einsum("ieb,kbj->kiej", course.local, inner)
    mixed = np.einsum("ki,kiej->kej", course.weights, steps)
    for kind in range(2):
        for i in range(s):
            # z moves too: p_i slope ((e_i - p) kron (u, 1)) in the row of each column.
            own = np.zeros((n_samples, s, sizes.n_inputs + 1))
            own -= course.z.reshape(own.shape)
            own[:, i] += course.inputs
            for d in range(q):
                factor = course.weights[:, i] * course.slopes[:, kind, i, d]
                drive = factor[:, np.newaxis, np.newaxis] * (steps[:, i] - mixed)
                moved = factor[:, np.newaxis] * own.reshape(n_samples, channels)
                for row in range(n):
                    drive[:, row, row * channels : (row + 1) * channels] += moved
                run(course.A, course.C, drive, -1, out[parameter], 0, np.zeros((n, columns)))
                parameter += 1
    return out


def approach_1(course: Course, elimination: Elimination, *, respond: Respond | None = None) -> Floats:
    """Return the Jacobian (29) of the projected residual by all derivatives of Phi, shape (n_rows, n_eta)."""
    slopes = regressor_slopes(course, respond=respond)
    slopes = slopes.reshape(slopes.shape[0], -1, elimination.n_linear)
    moved = (slopes @ elimination.theta).T
    # From right to left: two products of a matrix and a vector for each parameter.
    correlated = np.einsum("jki,k->ij", slopes, elimination.residual)
    return -elimination.back(elimination.solve_transposed(correlated), elimination.rotate(moved)[1])


def approach_2a(course: Course, elimination: Elimination, *, respond: Respond | None = None) -> Floats:
    """Return (40), the derivative of the residual at a fixed theta by all derivatives of Phi."""
    slopes = regressor_slopes(course, respond=respond)
    return np.asarray(-(slopes.reshape(slopes.shape[0], -1, elimination.n_linear) @ elimination.theta).T)


def approach_2b(
    course: Course,
    G: Floats,
    *,
    out: Floats | None = None,
    into: Flight | None = None,
    respond: Respond | None = None,
) -> Floats:
    """Return (41), the derivative of the simulated output with the sign of the residual, (n_rows, n_eta).

    ``out`` and ``into`` (see `fly`) are filled if given: fresh memory costs as much as the computation.
    """
    found = sensitivities(course, fly(course, G, into=into), sign=-1.0, out=out, respond=respond)
    return found.reshape(-1, course.sizes.n_eta)


def kaufman(
    course: Course, elimination: Elimination, *, out: Floats | None = None, respond: Respond | None = None
) -> Floats:
    """Return Kaufman's Jacobian in rotated coordinates: the tail of 2b, without its part in Phi's range."""
    G = elimination.theta.reshape(course.sizes.n_states, -1)
    return elimination.rotate(approach_2b(course, G, out=out, respond=respond))[1]


def exact(
    course: Course, elimination: Elimination, *, out: Floats | None = None, respond: Respond | None = None
) -> tuple[Floats, Floats]:
    """Return head and tail of the exact Jacobian (29) in rotated coordinates, without any d Phi."""
    tail = kaufman(course, elimination, out=out, respond=respond)
    r = elimination.residual.reshape(-1, course.sizes.n_outputs)
    mu = np.empty((r.shape[0], course.sizes.n_states))
    kernels.adjoint(course.A, r @ course.C, mu)
    table = pull_back_slopes(course, r, mu, respond=respond)
    return -elimination.solve_transposed(table), tail


def cost_gradient(course: Course, elimination: Elimination, *, into: Flight | None = None) -> Floats:
    """Return the gradient of the projected cost (12) by one backward pass, shape (n_eta,)."""
    G = elimination.theta.reshape(course.sizes.n_states, -1)
    r = elimination.residual.reshape(-1, course.sizes.n_outputs)
    return -2.0 * pull_back(course, fly(course, G, into=into), r).by_eta


__all__ = [
    "Elimination",
    "approach_1",
    "approach_2a",
    "approach_2b",
    "cost_gradient",
    "eliminate",
    "exact",
    "kaufman",
    "regressor_slopes",
]
