"""Printing errors of the paper: each printed form shown wrong by a number, its correction shown right."""

from collections.abc import Callable

import numpy as np

from replications.errata import Erratum
from replications.lacy import setting
from replications.lacy.notation import Notation
from sysid.linear import simulate_polynomial
from sysid.wiener import Criterion

_ORDER, _SAMPLES = 2, 11
_STEP = 2e-2
_STENCIL = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
"""Central difference of eighth order."""


def errata() -> list[Erratum]:
    """Return every erratum with its numbers."""
    return [
        _system(),
        _decomposition(),
        _gradient(),
        _hessian(),
        _size_of_u(),
        _average(),
        _captions(),
    ]


def _signals(samples: int = _SAMPLES) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2001)
    return rng.standard_normal(samples), rng.standard_normal(samples)


def difference(function: Callable[[np.ndarray], np.ndarray | float], point: np.ndarray) -> np.ndarray:
    """Return the derivative of a function by central differences of eighth order, one row a component."""
    rows = []
    for direction in np.eye(point.size):
        moved = [
            weight
            * (np.asarray(function(point + k * _STEP * direction)) - function(point - k * _STEP * direction))
            for k, weight in _STENCIL.items()
        ]
        rows.append(sum(moved) / _STEP)
    return np.array(rows)


def _system() -> Erratum:
    """(29): coefficients in descending powers of q, printed with powers of q^-1."""
    literal = np.roots([0.9048, -1.0300, 1.0])  # 0.9048 - 1.03 q^-1 + q^-2 times q^2
    corrected = np.roots(setting.A)
    return Erratum(
        "system",
        "(29)",
        r"G(q^{-1}) = \frac{0.4450\,q^{-1} + 0.4299}{q^{-2} - 1.0300\,q^{-1} + 0.9048}",
        r"G(q^{-1}) = \frac{0.4450\,q^{-1} + 0.4299\,q^{-2}}{1 - 1.0300\,q^{-1} + 0.9048\,q^{-2}}",
        "excess of the largest pole modulus over one (negative or zero: stable, counted as zero)",
        max(float(np.max(np.abs(literal))) - 1.0, 0.0),
        max(float(np.max(np.abs(corrected))) - 1.0, 0.0),
        "A spring, mass and dashpot cannot be unstable. The coefficients are those of "
        "$(0.4450\\,q + 0.4299) / (q^2 - 1.03\\,q + 0.9048)$: read with $q$ instead of $q^{-1}$ they "
        "are a stable oscillator with $G(1) = 1.0001$.",
    )


def literal_growth() -> float:
    """Return how much the literal reading of (29) grows from sample 30 to 60 after an impulse."""
    scale = 0.9048
    impulse = np.zeros(61)
    impulse[0] = 1.0
    y = simulate_polynomial([0.4299 / scale, 0.4450 / scale, 0], [1, -1.03 / scale, 1 / scale], impulse)
    return float(np.max(np.abs(y[50:])) / np.max(np.abs(y[20:31])))


def _decomposition() -> Erratum:
    """(13): a parenthesis closes too early."""
    # As printed the product exists only for p = 2n + 1.
    u, y = _signals(3 * _ORDER + 1)
    paper = Notation(u, y, _ORDER)
    theta = np.array([0.3, -0.2, 0.7, 0.1, -0.4])
    qy, phi, psi = paper.Q @ y, paper.Phi, paper.Psi
    reference = float(np.sum((qy - phi @ theta) ** 2))
    off = theta - psi @ qy
    remainder = float(off @ phi.T @ phi @ off)
    eye = np.eye(phi.shape[0])
    printed = float(qy @ (eye - phi) @ np.linalg.inv(phi.T @ phi) @ phi.T @ qy) + remainder
    corrected = float(qy @ (eye - phi @ np.linalg.inv(phi.T @ phi) @ phi.T) @ qy) + remainder
    return Erratum(
        "decomposition",
        "(13), fourth line",
        r"\hat y^TQ^T(I_p - \Phi)(\Phi^T\Phi)^{-1}\Phi^TQ\hat y + \dots",
        r"\hat y^TQ^T\left(I_p - \Phi(\Phi^T\Phi)^{-1}\Phi^T\right)Q\hat y + \dots",
        "relative difference from $J_{LS}^2$ of (12) at $p = 2n + 1$, where the printed product exists",
        abs(printed - reference) / reference,
        abs(corrected - reference) / reference,
        "For any other $p$ the printed matrices do not fit together.",
    )


def _gradient() -> Erratum:
    """(22): y^T is missing."""
    u, y = _signals()
    paper = Notation(u, y, _ORDER)
    problem = Criterion(u, _ORDER)
    reference = difference(lambda point: problem.value(point), y)
    scale = float(np.max(np.abs(reference)))
    printed = paper.gradient(np.ones(y.size))
    corrected = paper.gradient(y)
    return Erratum(
        "gradient",
        "(22)",
        r"2\sum_i R^{T(i-1)}P^T\,\Pi^\perp_\Phi Q\hat y\,Q^T\Psi^T e_{n+1-i,2n+1}",
        r"2\sum_i R^{T(i-1)}P^T\,\Pi^\perp_\Phi Q\hat y\,\hat y^TQ^T\Psi^T e_{n+1-i,2n+1}",
        "largest relative difference from finite differences of eighth order (print: the missing factor "
        "read as ones)",
        float(np.max(np.abs(printed - reference))) / scale,
        float(np.max(np.abs(corrected - reference))) / scale,
        r"The scalar $\hat y^TQ^T\Psi^Te_{n+1-i}$ is $\hat a_{n+1-i}$, so the whole sum is "
        r"$2A(\hat\theta)^Tr$: "
        "the residual filtered backwards by the equation-error filter. No projector is needed.",
    )


def _hessian() -> Erratum:
    """(23): y^T is missing in the last product."""
    u, y = _signals()
    paper = Notation(u, y, _ORDER)
    problem = Criterion(u, _ORDER)
    reference = difference(problem.gradient, y)
    scale = float(np.max(np.abs(reference)))
    printed = paper.hessian(np.ones(y.size))
    corrected = paper.hessian(y)
    return Erratum(
        "hessian",
        "(23), last product",
        r"-\,Q\hat y\,Q^T\,\Pi^\perp_\Phi P R^{i-1}e_{j,n+p}e^T_{n+1-i,2n+1}",
        r"-\,Q\hat y\,\hat y^TQ^T\,\Pi^\perp_\Phi P R^{i-1}e_{j,n+p}e^T_{n+1-i,2n+1}",
        "largest relative difference from finite differences of the gradient (print: the missing factor "
        "read as ones)",
        float(np.max(np.abs(printed - reference))) / scale,
        float(np.max(np.abs(corrected - reference))) / scale,
        r"With it (23) to (27) are right. The same matrix is $2(A^TA - WW^T)$ with $W$ of $2n+1$ columns.",
    )


def fast_form_errors() -> tuple[float, float]:
    """Return the relative differences of the fast gradient and Hessian from finite differences."""
    u, y = _signals()
    problem = Criterion(u, _ORDER)
    gradient = difference(lambda point: problem.value(point), y)
    hessian = difference(problem.gradient, y)
    return (
        float(np.max(np.abs(problem.gradient(y) - gradient)) / np.max(np.abs(gradient))),
        float(np.max(np.abs(problem.hessian(y) - hessian)) / np.max(np.abs(hessian))),
    )


def _size_of_u() -> Erratum:
    """(24): the size of U(i)."""
    u, y = _signals()
    paper = Notation(u, y, _ORDER)
    rows = paper.U_of(1).shape[0]
    n_plus_p, p = y.size, y.size - _ORDER
    return Erratum(
        "size-of-u",
        "(24)",
        r"U(i) = e_{i,n+p}\hat y^T + \hat y e_{i,n+p}^T \in \mathbb R^{p\times p}",
        r"U(i) \in \mathbb R^{(n+p)\times(n+p)}",
        "rows of $U(i)$ less those of the stated size",
        float(rows - p),
        float(rows - n_plus_p),
        "Only then does $Q\\,U(j)\\,Q^T$ in (23) exist.",
    )


def _average() -> Erratum:
    """(31): the average signal."""
    y = _signals()[1] + 3.0
    reference = float(np.mean(y))
    n_plus_p = y.size
    n = _ORDER
    printed = 1 / n + (n_plus_p - n) * float(np.sum(y))
    return Erratum(
        "average",
        "below (31)",
        r"\bar y = 1/n + p\sum_{i=1}^{n+p} y(i)",
        r"\bar y = \frac{1}{n+p}\sum_{i=1}^{n+p} y(i)",
        "difference from the mean",
        abs(printed - reference),
        abs(float(np.sum(y)) / n_plus_p - reference),
        "The denominator was set on the line.",
    )


def _captions() -> Erratum:
    """Figures 3, 5, 7, 9: example numbers of the captions."""
    off = [abs(one.printed_example - one.number) for one in setting.EXAMPLES.values()]
    return Erratum(
        "captions",
        "captions of figures 3, 5, 7, 9",
        r"\text{examples 3, 5, 6, 7}",
        r"\text{examples 1, 2, 3, 4}",
        "largest difference from the numbers of the examples in the text",
        float(max(off)),
        0.0,
        "The captions keep the numbers of a longer list of examples.",
    )
