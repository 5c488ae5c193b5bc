"""The formulas of Borges (2006) as they are printed, mended where the print errs: the oracle of the tests."""

import numpy as np
from numpy.typing import NDArray

from sysid.local_linear.structure import Course

Floats = NDArray[np.float64]


def kronecker_regressors(course: Course) -> Floats:
    """Return Phi by (8), shape (n_samples * n_outputs, n_linear), columns in the order of vec(G).

    Row block k is the sum over j < k of (p(j) kron u(j))' kron (C A(k-1) ... A(j+1)): the product runs
    backwards in time.  The time is quadratic in the number of samples.
    """
    sizes = course.sizes
    blocks = []
    for k in range(course.A.shape[0]):
        total = np.zeros((sizes.n_outputs, sizes.n_linear))
        product = course.C
        for j in range(k - 1, -1, -1):
            total += np.kron(course.z[j], product)
            product = product @ course.A[j]
        blocks.append(total)
    return np.vstack(blocks)


def redundant_directions(A: Floats, C: Floats) -> Floats:
    """Return M of (13), mended, whose columns are changes of (vec A, vec C) by a change of coordinates.

    Row by row the mended matrix is [sum_i Pi_i' kron (A Pi_i') - A' kron I; I kron C], taken from
    d(A_i) = A_i S - S A_i and dC = C S for vec(S).

    Parameters
    ----------
    A : ndarray, shape (n_models, n_states, n_states)
    C : ndarray, shape (n_outputs, n_states)
    """
    s, n = A.shape[0], A.shape[1]
    side_by_side = np.hstack(list(A))
    selectors = [np.eye(n, s * n, i * n) for i in range(s)]
    dynamics = sum(
        (np.kron(pick.T, side_by_side @ pick.T) for pick in selectors), start=np.zeros((n * n * s, n * n))
    )
    dynamics = dynamics - np.kron(side_by_side.T, np.eye(n))
    return np.vstack([dynamics, np.kron(np.eye(n), C)])
