"""What the paper's example is made of."""

from dataclasses import astuple

import numpy as np
from numpy.typing import NDArray

from sysid.excitation import impulse_levels
from sysid.linear.simulation import simulate_polynomial
from sysid.nonlinearities import Segments
from sysid.recursive import interpolation_coefficients

Floats = NDArray[np.float64]

ORDER = 2
A = (-1.5, 0.56)
B = (1.0, -2.0)
SEGMENTS = Segments(K1=1.0, K2=2.0, D1=1.0, D2=-2.0, L1=1.0, L2=-2.0)
LEVELS = (-6.0, -3.0, 3.0, 6.0)
PERIOD = ORDER * (len(LEVELS) + 3)
"""Samples of a period, T = n (4 + 3) of (5.1)."""

PRINTED_THETA = (0.56, -1.5, 1.66, -3.33, 1.33, -2.66, 1.0, -2.0, 1.0, -2.0)
"""The vector theta* as the paper prints it."""

LARGE_RADIUS = 1e3
"""A projection radius that is never reached."""

H1, H2 = SEGMENTS.offsets
TRUE = {"a1": A[0], "a2": A[1], "b2": B[1], "K1": SEGMENTS.K1, "K2": SEGMENTS.K2, "H1": H1, "H2": H2}
"""Everything that can be identified, with b_1 = 1."""

PARAMETERS = tuple(TRUE)


def gains() -> Floats:
    """Return d_j = F(V_j) / V_j, eq. (3.5)."""
    return interpolation_coefficients(LEVELS, SEGMENTS)


def composite() -> Floats:
    """Return M = b d^T, eq. (3.9), shape (2, 4)."""
    return np.outer(B, gains())


def theta_star() -> Floats:
    """Return the true composite parameters in the order of (3.8c), shape (10,)."""
    return np.concatenate([A, composite().T.ravel()])


def experiment(
    periods: int, disturbance: Floats | None = None, equation_error: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return input and output of so many periods of (5.1), from rest.

    Parameters
    ----------
    periods : int
        Number of periods.
    disturbance : ndarray, optional
        z of (2.1a), added to the output.
    equation_error : ndarray, optional
        eta of (3.8a); it passes through 1/A.
    """
    u = impulse_levels(LEVELS, ORDER, periods)
    y = simulate_polynomial([0.0, *B], [1.0, *A], SEGMENTS(u))
    if disturbance is not None:
        y += disturbance
    if equation_error is not None:
        y += simulate_polynomial([1.0], [1.0, *A], equation_error)
    return u, y


def numbers() -> dict[str, float]:
    """Return the set-up as the studies use it, under the names of the claims."""
    found = {f"setting/a{i + 1}": value for i, value in enumerate(A)}
    found |= {f"setting/b{i + 1}": value for i, value in enumerate(B)}
    found |= {
        f"setting/{name}": value
        for name, value in zip(("K1", "K2", "D1", "D2", "L1", "L2"), astuple(SEGMENTS), strict=True)
    }
    found |= {f"setting/V{j + 1}": value for j, value in enumerate(LEVELS)}
    return found | {"setting/period": float(impulse_levels(LEVELS, ORDER).size)}
