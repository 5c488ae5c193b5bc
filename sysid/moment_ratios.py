"""Parameters of a map from ratios of its input moments: Bai (2002), eqs. (3.5)-(3.16), corrected."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from sysid.errors import IdentifiabilityError, UsageError

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


def _checked(ratios: Sequence[float], *widths: float) -> None:
    """Refuse ratios and half-widths from which no equation can be built."""
    if not all(math.isfinite(c) for c in ratios):
        raise IdentifiabilityError(
            f"the ratios of moments {[float(c) for c in ratios]} are not all finite: "
            "an input did not excite the system; use wider inputs or more samples"
        )
    if not all(b > 0 and math.isfinite(b) for b in widths):
        raise UsageError(f"half-widths of inputs {list(widths)} must be positive: give b > 0")
    if widths[0] == widths[1]:
        raise IdentifiabilityError(
            f"both inputs have the half-width {widths[0]:g}, which leaves no equation: use two widths"
        )


def _solved(matrix: Floats, right: Floats) -> Floats:
    if np.linalg.matrix_rank(matrix) < len(right):
        raise IdentifiabilityError(
            "the two moment equations are dependent: use inputs that weigh the two sides differently"
        )
    return np.asarray(np.linalg.solve(matrix, right))


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
    _checked([c], b1, b2)
    square = 3 * (c * b2 - b1) * b1 * b2 / (c * b1 - b2) if c * b1 != b2 else math.inf
    return Solution(np.array([math.sqrt(abs(square))]), 0 <= square <= min(b1, b2) ** 2)


def dead_zone(c: float, b1: float, b2: float) -> Solution:
    """Solve the cubic (3.16) for its root between 0 and the smaller half-width.

    Without a real root there the nearest end of the interval is returned as irregular.
    """
    _checked([c], b1, b2)
    end = min(b1, b2)
    roots = np.roots([c * b1 - b2, 0.0, 3 * b1 * b2 * (b1 - c * b2), 2 * b1 * b2 * (c * b2**2 - b1**2)])
    real = roots.real[np.abs(roots.imag) < 1e-9 * max(b1, b2)]
    inside = real[(real > 0) & (real < end)]
    if inside.size:
        return Solution(inside[:1], True)
    return Solution(np.clip(real[np.argmin(np.abs(real - end / 2))], 0, end).reshape(1), False)


def two_sided_relay(c1: float, c2: float, b1: float, b2: float, d1: float, d2: float) -> Solution:
    r"""Solve the equations after (3.8) with their lost column and factor restored.

    The unknowns are :math:`a_1^2, a_2^2`; with :math:`D = d_1 d_2^2 + d_2 d_1^2`

    .. math::
        (b_2 - c_1 b_1)(a_1^2 + a_2^2) &= 2 b_1^2 b_2 - 2 c_1 b_1 b_2^2 \\
        (1 - 2 b_1 c_2 d_2^2/D) a_1^2 + (1 - 2 b_1 c_2 d_1^2/D) a_2^2 &= 2 b_1^2 - 4 b_1 c_2 d_1^2 d_2^2/D
    """
    _checked([c1, c2], b1, b2, d1, d2)
    d = d1 * d2**2 + d2 * d1**2
    matrix = np.array(
        [[b2 - c1 * b1, b2 - c1 * b1], [1 - 2 * b1 * c2 * d2**2 / d, 1 - 2 * b1 * c2 * d1**2 / d]]
    )
    right = np.array([2 * b1**2 * b2 - 2 * c1 * b1 * b2**2, 2 * b1**2 - 4 * b1 * c2 * d1**2 * d2**2 / d])
    squares = _solved(matrix, right)
    limits = np.array([min(b1, b2, d1), min(b1, b2, d2)]) ** 2
    return Solution(np.sqrt(np.abs(squares)), bool(np.all((squares >= 0) & (squares <= limits))))


def preload_sum(c1: float, b1: float, b2: float) -> float:
    """Return a1 + a2 of a two-sided preload, the first row of (3.12)."""
    _checked([c1], b1, b2)
    if b2 * c1 == b1:
        return math.inf
    return 4 * (b1**2 - b2**2 * c1) / (3 * (b2 * c1 - b1))


def two_sided_preload(c1: float, c2: float, b1: float, b2: float, b3: float) -> Solution:
    """Solve (3.12) with b3 in place of the printed b2 on the right of its second row.

    ``c2`` must be the ratio of the plain moments E[xu]; the third input has a nonzero mean, so the
    correlations of eq. (3.2) do not deliver it (see `preload_from_offset`).
    """
    _checked([c1, c2], b1, b2, b3)
    matrix = np.array([[1.0, 1.0], [b3 * c2 / 2 - b1 / 4, b3 * c2 / 4 - b1 / 4]])
    right = np.array([preload_sum(c1, b1, b2), b1**2 / 3 - 2 * b3**2 * c2 / 3])
    parameters = _solved(matrix, right)
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
    static, slip = float(np.sum(scaled_beta)), 1 - float(np.sum(alpha))
    if static == 0 or slip == 0 or not math.isfinite(total):
        raise IdentifiabilityError(
            f"the sums of beta {static:g} and of alpha {1 - slip:g} with c = {float(c1):g} give no static "
            "gain to turn the offset of the output into a2 - a1: use more samples or other inputs"
        )
    difference = 2 * mean * q * slip / static
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
