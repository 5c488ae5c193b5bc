"""Parameters of a map from ratios of its input moments: Bai (2002), eqs. (3.5)-(3.16), corrected."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from sysid.errors import IdentifiabilityError

Floats = NDArray[np.float64]


class Solution(NamedTuple):
    """Parameters found and whether the ratios allowed them.

    Attributes
    ----------
    parameters : ndarray
        Parameters of the nonlinearity.
    regular : bool
        False when a square was negative (its absolute value was used, as the paper does for (3.14)) or
        a root lay outside its interval: noise has pushed the ratio out of its range.
    """

    parameters: Floats
    regular: bool


def saturation(c: float, b1: float, b2: float) -> Solution:
    r"""Solve (3.14): :math:`a^2 = 3 (c b_2 - b_1) b_1 b_2 / (c b_1 - b_2)` for uniform inputs.

    Parameters
    ----------
    c : float
        Ratio q(f1)/q(f2).
    b1, b2 : float
        Half-widths of the two uniform inputs.

    Examples
    --------
    >>> q = lambda b: 1 / b * (b**2 / 2 - 1 / 6)
    >>> saturation(q(2.0) / q(3.0), 2.0, 3.0).parameters.round(12).tolist()
    [1.0]
    """
    square = 3 * (c * b2 - b1) * b1 * b2 / (c * b1 - b2)
    return Solution(np.array([np.sqrt(abs(square))]), square >= 0)


def dead_zone(c: float, b1: float, b2: float) -> Solution:
    """Solve the cubic (3.16) for its root in (0, b1), where b1 < b2.

    Without a real root there the nearest end of the interval is returned as irregular.
    """
    roots = np.roots([c * b1 - b2, 0.0, 3 * b1 * b2 * (b1 - c * b2), 2 * b1 * b2 * (c * b2**2 - b1**2)])
    real = roots.real[np.abs(roots.imag) < 1e-9 * max(b1, b2)]
    inside = real[(real > 0) & (real < b1)]
    if inside.size:
        return Solution(inside[:1], True)
    return Solution(np.clip(real[np.argmin(np.abs(real - b1 / 2))], 0, b1).reshape(1), False)


def two_sided_relay(c1: float, c2: float, b1: float, b2: float, d1: float, d2: float) -> Solution:
    r"""Solve the equations after (3.8) with their lost column and factor restored.

    The unknowns are :math:`a_1^2, a_2^2`; with :math:`D = d_1 d_2^2 + d_2 d_1^2`

    .. math::
        (b_2 - c_1 b_1)(a_1^2 + a_2^2) &= 2 b_1^2 b_2 - 2 c_1 b_1 b_2^2 \\
        (1 - 2 b_1 c_2 d_2^2/D) a_1^2 + (1 - 2 b_1 c_2 d_1^2/D) a_2^2 &= 2 b_1^2 - 4 b_1 c_2 d_1^2 d_2^2/D
    """
    d = d1 * d2**2 + d2 * d1**2
    matrix = np.array(
        [[b2 - c1 * b1, b2 - c1 * b1], [1 - 2 * b1 * c2 * d2**2 / d, 1 - 2 * b1 * c2 * d1**2 / d]]
    )
    right = np.array([2 * b1**2 * b2 - 2 * c1 * b1 * b2**2, 2 * b1**2 - 4 * b1 * c2 * d1**2 * d2**2 / d])
    squares = np.linalg.solve(matrix, right)
    return Solution(np.sqrt(np.abs(squares)), bool(np.all(squares >= 0)))


def preload_sum(c1: float, b1: float, b2: float) -> float:
    """Return a1 + a2 of a two-sided preload, the first row of (3.12)."""
    return 4 * (b1**2 - b2**2 * c1) / (3 * (b2 * c1 - b1))


def two_sided_preload(c1: float, c2: float, b1: float, b2: float, b3: float) -> Solution:
    """Solve (3.12) with b3 in place of the printed b2 on the right of its second row.

    ``c2`` must be the ratio of the plain moments E[xu]; the third input has a nonzero mean, so the
    correlations of eq. (3.2) do not deliver it (see `preload_from_offset`).
    """
    matrix = np.array([[1.0, 1.0], [b3 * c2 / 2 - b1 / 4, b3 * c2 / 4 - b1 / 4]])
    right = np.array([preload_sum(c1, b1, b2), b1**2 / 3 - 2 * b3**2 * c2 / 3])
    parameters = np.linalg.solve(matrix, right)
    return Solution(parameters, bool(np.all(parameters >= 0)))


def preload_from_offset(
    c1: float, b1: float, b2: float, alpha: Floats, scaled_beta: Floats, mean: float
) -> Solution:
    r"""Find a two-sided preload from two symmetric inputs and the offset of the output.

    Under a symmetric input the mean of x is :math:`(a_2 - a_1)/2`, and the output has the mean
    :math:`\bar y = \bar x \sum\beta/(1 - \sum\alpha)`; together with (3.12)'s first row this gives both
    parameters without the third input, whose nonzero mean breaks (3.2).

    Parameters
    ----------
    c1, b1, b2 : float
        Ratio of moments and half-widths of the inputs.
    alpha, scaled_beta : ndarray, shape (order,)
        Linear part from the first input.
    mean : float
        Mean of the output under the first input.
    """
    total = preload_sum(c1, b1, b2)
    q = b1**2 / 3 + b1 * total / 4
    gain = float(np.sum(scaled_beta)) / q / (1 - float(np.sum(alpha)))
    difference = 2 * mean / gain
    parameters = np.array([(total - difference) / 2, (total + difference) / 2])
    return Solution(parameters, bool(np.all(parameters >= 0)))


def any_map(
    moments: Sequence[Callable[[Floats], float]],
    ratios: Sequence[float],
    lower: Sequence[float],
    upper: Sequence[float],
) -> Solution:
    r"""Solve (3.5), :math:`c_i\,q(f_{i+1}, a) = q(f_1, a)`, for any nonlinearity numerically.

    Parameters
    ----------
    moments : sequence of callable
        q(f_i, a) as functions of the parameters, one more than there are ratios.
    ratios : sequence of float
        The ratios c_i.
    lower, upper : sequence of float
        Box that holds the parameters.

    Raises
    ------
    IdentifiabilityError
        If there are fewer ratios than parameters.
    """
    if len(ratios) < len(lower) or len(moments) != len(ratios) + 1:
        raise IdentifiabilityError(
            f"{len(moments)} moments and {len(ratios)} ratios cannot determine {len(lower)} parameters: "
            "use one more input distribution than there are parameters"
        )

    def equations(a: Floats) -> Floats:
        first = moments[0](a)
        return np.array([c * q(a) - first for c, q in zip(ratios, moments[1:], strict=True)])

    low, high = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    shares = np.stack(np.meshgrid(*[[0.2, 0.5, 0.8]] * low.size), axis=-1).reshape(-1, low.size)
    fits = [
        least_squares(
            equations, low + s * (high - low), bounds=(low, high), xtol=1e-14, ftol=1e-14, gtol=1e-14
        )
        for s in shares
    ]
    best = min(fits, key=lambda found: float(found.cost))
    return Solution(np.asarray(best.x), bool(best.cost < 1e-16 * max(1.0, moments[0](best.x) ** 2)))
