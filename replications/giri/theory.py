"""What a small disturbance does to the printed algorithm, exactly: no simulation.

While z is small against the signals the regressors are those of the noise-free steady state, and
the parameter error obeys a linear recursion with the period of the input, driven by eta = A z.
"""

from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import quad
from scipy.linalg import solve_discrete_lyapunov

from replications.giri import setting
from replications.giri.convergence import stationary_rows
from replications.giri.setting import Floats


def _steps() -> list[tuple[Floats, Floats]]:
    """Return the maps of (theta error, z(t-1), z(t-2)), and what z(t) adds, of each sample of a period."""
    found = []
    p = setting.theta_star().size
    for row in stationary_rows():
        gain = row / (1.0 + row @ row)
        step = np.zeros((p + 2, p + 2))
        step[:p, :p] = np.eye(p) - np.outer(gain, row)
        step[:p, p:] = np.outer(gain, setting.A)
        step[p + 1, p] = 1.0
        found.append((step, np.concatenate([gain, [1.0, 0.0]])))
    return found


def mean_norm(covariance: Floats) -> float:
    r"""Return E||x|| of a Gaussian vector of zero mean, by one integral.

    :math:`\frac{1}{2\sqrt\pi}\int_0^\infty \left(1 - \prod_i(1 + 2s\lambda_i)^{-1/2}\right)s^{-3/2}ds`,
    in the variable log s.
    """
    values = np.maximum(np.linalg.eigvalsh(covariance), 0.0)
    scale = float(values.sum())

    def integrand(logarithm: float) -> float:
        s = np.exp(logarithm)
        return float(-np.expm1(-0.5 * np.sum(np.log1p(2.0 * s * values / scale))) / np.sqrt(s))

    total, _ = quad(integrand, -50.0, 50.0, limit=200, epsabs=1e-10, epsrel=1e-9)
    return float(total / (2.0 * np.sqrt(np.pi)) * np.sqrt(scale))


def independent_ratio(variance: float, mean_eta: float) -> float:
    """Return mean ||theta error|| over mean |eta| for independent z of this variance.

    Exact for a Gaussian z; for another the error is a sum over many samples and nearly Gaussian.
    """
    steps = _steps()
    total, noise = np.eye(steps[0][0].shape[0]), np.zeros_like(steps[0][0])
    for step, entry in steps:
        total = step @ total
        noise = step @ noise @ step.T + variance * np.outer(entry, entry)
    covariance = solve_discrete_lyapunov(total, noise)
    norms = []
    for step, entry in steps:
        covariance = step @ covariance @ step.T + variance * np.outer(entry, entry)
        norms.append(mean_norm(covariance[:-2, :-2]))
    return float(np.mean(norms)) / mean_eta


def periodic_ratio(disturbance: ArrayLike) -> float:
    """Return mean ||theta error|| over mean |eta| for a disturbance with the period of the input."""
    z = np.asarray(disturbance, dtype=np.float64)
    eta = z + setting.A[0] * np.roll(z, 1) + setting.A[1] * np.roll(z, 2)
    rows = stationary_rows()
    p = rows.shape[1]
    total, forced = np.eye(p), np.zeros(p)
    for row, value in zip(rows, eta, strict=True):
        gain = row / (1.0 + row @ row)
        total = total - np.outer(gain, row @ total)
        forced = forced - gain * (row @ forced - value)
    error = np.linalg.solve(np.eye(p) - total, forced)
    norms = []
    for row, value in zip(rows, eta, strict=True):
        error = error - row / (1.0 + row @ row) * (row @ error - value)
        norms.append(float(np.linalg.norm(error)))
    return float(np.mean(norms) / np.mean(np.abs(eta)))


def mean_absolute_uniform() -> float:
    """Return E|z0 + a1 z1 + a2 z2| for independent uniform z on [-1, 1].

    The mean over a box is the third difference of the third antiderivative of |x|, sgn(x) x^4 / 24.
    """
    widths = np.abs([1.0, *setting.A])
    signs = np.array(list(product((-1.0, 1.0), repeat=widths.size)))
    corners = signs @ widths
    antiderivative = np.sign(corners) * corners**4 / 24.0
    return float(np.prod(signs, axis=1) @ antiderivative / np.prod(2.0 * widths))


def theory_numbers() -> dict[str, float]:
    """Return the ratios that the studies must find."""
    coefficients = np.array([1.0, *setting.A])
    gaussian = float(np.sqrt(2.0 / np.pi * coefficients @ coefficients))
    alternating = (-1.0) ** np.arange(setting.PERIOD)
    return {
        "noise_ratio/gaussian/theory": independent_ratio(1.0, gaussian),
        "noise_ratio/uniform/theory": independent_ratio(1.0 / 3.0, mean_absolute_uniform()),
        "noise_ratio/constant/theory": periodic_ratio(np.ones(setting.PERIOD)),
        "noise_ratio/alternating/theory": periodic_ratio(alternating),
    }
