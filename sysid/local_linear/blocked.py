"""Long records: parameters, cost and Kaufman's linearisation from blocks of rows, by R alone."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.local_linear.passes import regressors
from sysid.local_linear.recursion import Respond
from sysid.local_linear.structure import Experiment, Sizes, course
from sysid.separable.factor import BlockedQR

Floats = NDArray[np.float64]

BLOCK = 1000


@dataclass(frozen=True)
class BlockedCost:
    """Parameters and cost at one eta.

    Attributes
    ----------
    theta : ndarray, shape (n_linear,)
    cost : float
    R : ndarray
        Triangular factor of [Phi y].
    """

    theta: Floats
    cost: float
    R: Floats


def phi_blocks(
    sizes: Sizes, eta: Floats, experiment: Experiment, block: int = BLOCK, respond: Respond | None = None
) -> Iterator[tuple[slice, Floats]]:
    """Yield rows and their regressors, block by block; states go on from one to the next."""
    state = np.zeros((sizes.n_states, sizes.n_states, sizes.channels))
    out = np.empty((block, sizes.n_outputs, sizes.n_linear + sizes.n_eta + 1))
    for first in range(0, experiment.n_samples, block):
        rows = slice(first, min(first + block, experiment.n_samples))
        part = Experiment(experiment.inputs[rows], experiment.scheduling[rows])
        yield (
            rows,
            regressors(course(sizes, eta, part), state=state, out=out[: part.n_samples], respond=respond),
        )


def blocked_cost(
    sizes: Sizes, eta: Floats, experiment: Experiment, y: Floats, block: int = BLOCK
) -> BlockedCost:
    """Return parameters and projected cost with the memory of one block.

    Algorithm 1 of Borges (2005) mended: the last block counts too, and Q, which takes as much memory as Phi
    and N^2 / N_b operations to accumulate, is not formed.  The factor of [Phi y] alone holds the result.

    Parameters
    ----------
    sizes : Sizes
    eta : ndarray, shape (n_eta,)
    experiment : Experiment
    y : ndarray, shape (n_samples, n_outputs)
    block : int
        Samples of a block.
    """
    factor = BlockedQR(sizes.n_linear + 1)
    for rows, phi in phi_blocks(sizes, eta, experiment, block):
        phi[:, :, sizes.n_linear] = y[rows]
        factor.update(phi.reshape(-1, phi.shape[2])[:, : sizes.n_linear + 1])
    theta, cost = factor.solve(sizes.n_linear)
    return BlockedCost(theta, cost, factor.r)


@dataclass(frozen=True)
class BlockedLinearisation:
    """Kaufman's linearisation at one eta.

    Attributes
    ----------
    theta, cost
        As in `BlockedCost`.
    jacobian : ndarray, shape (n_eta + 1, n_eta)
        A matrix J with the J'J of Kaufman's Jacobian.
    residual : ndarray, shape (n_eta + 1,)
        A vector r with the J'r and r'r of the projected residual.
    """

    theta: Floats
    cost: float
    jacobian: Floats
    residual: Floats


def blocked_kaufman(
    sizes: Sizes, eta: Floats, experiment: Experiment, y: Floats, block: int = BLOCK
) -> BlockedLinearisation:
    """Return Kaufman's normal matrix from R of [Phi D y], two passes over the data.

    The first gives theta, the second the sensitivities D at it.
    """
    from sysid.local_linear.passes import fly, sensitivities

    first = blocked_cost(sizes, eta, experiment, y, block)
    G = first.theta.reshape(sizes.n_states, -1)
    n, s, q, n_linear = sizes.n_states, sizes.n_models, sizes.n_scheduling, sizes.n_linear
    factor = BlockedQR(n_linear + sizes.n_eta + 1)
    x = np.zeros(n)
    state = (np.zeros((n, n, s * n)), np.zeros((n, 2 * s * q)))
    for rows, phi in phi_blocks(sizes, eta, experiment, block):
        part = Experiment(experiment.inputs[rows], experiment.scheduling[rows])
        one = course(sizes, eta, part)
        flight = fly(one, G, x)
        x = flight.x[-1].copy()
        phi[:, :, n_linear:-1] = sensitivities(one, flight, sign=-1.0, state=state)
        phi[:, :, -1] = y[rows]
        factor.update(phi.reshape(-1, phi.shape[2]))
    corner = factor.r[n_linear:, n_linear:]
    return BlockedLinearisation(first.theta, first.cost, corner[:, :-1], corner[:, -1])
