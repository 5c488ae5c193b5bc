"""Forward and backward passes over one experiment: regressors, states, sensitivities, adjoints."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.local_linear import kernels, sweeps
from sysid.local_linear.recursion import Respond, recursion
from sysid.local_linear.structure import Course

Floats = NDArray[np.float64]


def _engine(course: Course, respond: Respond | None, n_outputs: int | None = None) -> Respond:
    if respond is not None:
        return respond
    return recursion(course.sizes.n_states, course.sizes.n_outputs if n_outputs is None else n_outputs)


def regressors(
    course: Course,
    *,
    starts: bool = False,
    state: Floats | None = None,
    out: Floats | None = None,
    respond: Respond | None = None,
) -> Floats:
    """Return Phi of (17) by one matrix recursion, shape (n_samples, n_outputs, n_columns).

    Parameters
    ----------
    course : Course
    starts : bool
        Whether columns for the entries of x(0) follow those of G.
    state : ndarray, shape (n_states, n_states, channels), optional
        Where the recursion stands, zero at first; overwritten, so that the next block of rows can go on.
    out : ndarray, optional
        To be filled.
    respond : callable, optional
        The batch recursion; the compiled one by default.
    """
    sizes = course.sizes
    n, channels = sizes.n_states, sizes.channels
    n_samples = course.A.shape[0]
    run = _engine(course, respond)
    if out is None:
        out = np.empty((n_samples, sizes.n_outputs, sizes.n_linear + (n if starts else 0)))
    x = np.zeros((n, n, channels)) if state is None else state
    for row in range(n):
        run(course.A, course.C, course.z, row, out, row * channels, x[row])
    if starts:
        run(course.A, course.C, np.zeros((n_samples, 1, n)), 0, out, sizes.n_linear, np.eye(n))
    return out


@dataclass(frozen=True)
class Flight:
    """A simulation, and what drives its sensitivities.

    Attributes
    ----------
    x : ndarray, shape (n_samples + 1, n_states)
        States x(0) ... x(n_samples) of (1).
    drives : ndarray, shape (n_samples, 1, n_models * n_states)
        p kron x, what the entries of A act on.
    moves : ndarray, shape (n_samples, n_states, 2 * n_models * n_scheduling)
        How widths and centres move x(k+1) at a given x(k).
    """

    x: Floats
    drives: Floats
    moves: Floats


def fly(course: Course, G: Floats, start: Floats | None = None, *, into: Flight | None = None) -> Flight:
    """Simulate the states of (1) from a start, zero by default.

    Parameters
    ----------
    course : Course
    G : ndarray, shape (n_states, channels)
    start : ndarray, shape (n_states,), optional
    into : Flight, optional
        One of the same sizes, to be filled.
    """
    sizes = course.sizes
    n, s, q, n_samples = sizes.n_states, sizes.n_models, sizes.n_scheduling, course.A.shape[0]
    flight = into or Flight(
        np.empty((n_samples + 1, n)), np.empty((n_samples, 1, s * n)), np.empty((n_samples, n, 2 * s * q))
    )
    gains = np.empty((sizes.n_inputs + 1 + n, n, s))
    gains[:-n], gains[-n:] = G.reshape(n, s, -1).transpose(2, 0, 1), course.local.transpose(2, 1, 0)
    flight.x[0] = 0.0 if start is None else start
    run = sweeps.forward(n, s, sizes.n_inputs + 1, q)
    run(course.A, course.weights, course.slopes, course.inputs, gains, flight.x, flight.drives, flight.moves)
    return flight


def sensitivities(
    course: Course,
    flight: Flight,
    *,
    sign: float = 1.0,
    state: tuple[Floats, Floats] | None = None,
    out: Floats | None = None,
    respond: Respond | None = None,
) -> Floats:
    """Return the derivative of the simulated output by eta, (42)-(43), shape (n_samples, n_outputs, n_eta).

    Parameters
    ----------
    course : Course
    flight : Flight
    sign : {1, -1}
        -1 for the derivative of the residual.
    state : pair of ndarray, optional
        Where the recursions stand, shapes (n_states, n_states, n_models * n_states) and (n_states, 2 *
        n_models
        * n_scheduling); zero at first, overwritten.
    out : ndarray, optional
        To be filled.
    respond : callable, optional
        The batch recursion; the compiled one by default.
    """
    sizes = course.sizes
    n, s, n_samples = sizes.n_states, sizes.n_models, course.A.shape[0]
    run = _engine(course, respond)
    if out is None:
        out = np.empty((n_samples, sizes.n_outputs, sizes.n_eta))
    by_A, by_weights = state or (np.zeros((n, n, s * n)), np.zeros((n, 2 * s * sizes.n_scheduling)))
    C = sign * course.C
    for row in range(n):
        run(course.A, C, flight.drives, row, out, row * s * n, by_A[row])
    kernels.output_slopes(n, sizes.n_outputs)(flight.x, sign, out, n * n * s)
    run(course.A, C, flight.moves, -1, out, sizes.n_dynamic, by_weights)
    return out


@dataclass(frozen=True)
class Pull:
    """The derivative of sum_k r(k)' y(k) for a fixed r.

    Attributes
    ----------
    by_eta : ndarray, shape (n_eta,)
    mu : ndarray, shape (n_samples, n_states)
        Adjoint of x(k+1).
    """

    by_eta: Floats
    mu: Floats


def pull_back(course: Course, flight: Flight, r: Floats) -> Pull:
    """Return the gradient of sum_k r(k)' y(k) by one backward pass, whatever the number of parameters."""
    sizes = course.sizes
    n, s, q, p = sizes.n_states, sizes.n_models, sizes.n_scheduling, sizes.n_outputs
    mu = np.empty((course.A.shape[0], n))
    by_eta = np.zeros(sizes.n_eta)
    by_A, by_C, by_weights = np.split(by_eta, [n * n * s, sizes.n_dynamic])
    run = sweeps.backward(n, s, q, p)
    run(course.A, course.C, np.ascontiguousarray(r), flight.x, flight.drives, flight.moves, mu,
        by_A.reshape(n, s * n), by_C.reshape(p, n), by_weights)  # fmt: skip
    return Pull(by_eta, mu)


def pull_back_slopes(
    course: Course, r: Floats, mu: Floats, *, starts: bool = False, respond: Respond | None = None
) -> Floats:
    """Return T of the second term of (29): (d Phi / d eta_j)' r for every j, without any d Phi.

    Phi' r is what one backward pass gives, mu' (p kron (u, 1)); its derivative needs the sensitivities of the
    adjoint, as many as there are nonlinear parameters, and two matrix products over time.

    Parameters
    ----------
    course : Course
    r : ndarray, shape (n_samples, n_outputs)
    mu : ndarray, shape (n_samples, n_states)
        `Pull.mu` for this r.
    starts : bool
        Whether rows for the entries of x(0) follow those of G.

    Returns
    -------
    ndarray, shape (n_linear, n_eta)
    """
    sizes = course.sizes
    n, s, q, p = sizes.n_states, sizes.n_models, sizes.n_scheduling, sizes.n_outputs
    n_samples, pairs = course.A.shape[0], n * s + p
    width = n * pairs + 2 * s * q
    run = _engine(course, respond, n)
    backwards = course.A.transpose(0, 2, 1)[::-1]
    drives = np.empty((n_samples, 1, pairs))
    kernels.row_products(mu, course.weights, drives, 0)
    drives[:, 0, n * s :] = r
    slopes = np.empty((n_samples, n, width))
    identity, last = np.eye(n), np.empty((n, width))
    for row in range(n):
        x = np.zeros((n, pairs))
        run(backwards, identity, np.ascontiguousarray(drives[::-1]), row, slopes, row * pairs, x)
        last[:, row * pairs : (row + 1) * pairs] = x
    by_local = mu @ course.local.transpose(1, 0, 2).reshape(n, s * n)
    mixed = np.einsum("kbe,kb->ke", course.A, mu)
    moves = np.empty((n_samples, n, 2 * s * q))
    kernels.weight_drives(course.weights, course.slopes, by_local.reshape(-1, s, n), mixed, moves)
    x = np.zeros((n, 2 * s * q))
    run(backwards, identity, np.ascontiguousarray(moves[::-1]), -1, slopes, n * pairs, x)
    last[:, n * pairs :] = x
    z = course.z[:, 0]
    found = np.tensordot(slopes, z[::-1], axes=(0, 0)).transpose(0, 2, 1)
    factors = (course.weights[:, np.newaxis, :, np.newaxis] * course.slopes).reshape(n_samples, -1)
    moved = np.empty((n_samples, 1, n * factors.shape[1]))
    kernels.row_products(mu, factors, moved, 0)
    by_z = (z.T @ moved[:, 0]).reshape(-1, n, factors.shape[1]).transpose(1, 0, 2)
    by_u = (course.inputs.T @ moved[:, 0]).reshape(-1, n, 2, s, q).transpose(1, 3, 0, 2, 4)
    own = -by_z.reshape(n, s, sizes.n_inputs + 1, 2, s, q)
    for i in range(s):
        own[:, i, :, :, i] += by_u[:, i]
    found[:, :, n * pairs :] += own.reshape(n, -1, 2 * s * q)
    table = found.reshape(sizes.n_linear, width)
    if starts:
        table = np.vstack([table, last])
    return table[:, _order(n, s, p, width)]


def _order(n: int, s: int, p: int, width: int) -> NDArray[np.intp]:
    """Return the columns of the backward batch in the order of eta.

    The batch is (row b of A_i or C, then (row a, model i) and outputs o); eta has (a, i, b), then (o, b).
    """
    index = np.arange(n * (n * s + p)).reshape(n, n * s + p)
    by_A = index[:, : n * s].reshape(n, n, s).transpose(1, 2, 0)
    by_C = index[:, n * s :].T
    return np.concatenate([by_A.ravel(), by_C.ravel(), np.arange(index.size, width)])
