"""Systems with one static map inside a linear part, written out as loops."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.lft import LftStructure, lags

Floats = NDArray[np.float64]

STRUCTURES = {
    "wiener": LftStructure(z_lags=lags("u", 1, 2, 3), knots=8),
    "hammerstein": LftStructure(n_a=1, n_g=1, z_lags=lags("u", 1), knots=8),
    "wiener-hammerstein": LftStructure(n_a=1, n_g=1, z_lags=lags("u", 1, 2), knots=8),
    "output in the map": LftStructure(n_a=1, b_lags=lags("u", 1), n_g=1, z_lags=lags("y", 2), knots=8),
    "both in the map": LftStructure(n_a=1, b_lags=lags("u", 0), n_g=1, z_lags=(("u", 1), ("y", 2)), knots=6),
}


def simulated(case: str, n: int, noise: float = 0.05, seed: int = 0) -> tuple[Floats, Floats]:
    """Return input and output of a system of each kind."""
    rng = np.random.default_rng(seed)
    u = rng.uniform(-2.5, 2.5, n)
    e = noise * rng.standard_normal(n)
    y, w, z = np.zeros(n), np.zeros(n), np.zeros(n)
    for k in range(3, n):
        if case == "wiener":
            z[k] = 0.8 * u[k - 1] + 0.48 * u[k - 2] - 0.36 * u[k - 3]
            y[k] = np.tanh(z[k]) + e[k]
        elif case == "hammerstein":
            w[k] = np.exp(0.5 * u[k - 1])
            y[k] = 0.6 * y[k - 1] + w[k] + 0.4 * w[k - 1] + e[k]
        elif case == "wiener-hammerstein":
            w[k] = np.arctan(0.6 * u[k - 1] - 0.8 * u[k - 2] - 1.0)
            y[k] = 0.4 * y[k - 1] + w[k] - 0.5 * w[k - 1] + e[k]
        elif case == "output in the map":
            w[k] = 0.8 * np.arctan(y[k - 2]) + 0.3 * np.cos(y[k - 2])
            y[k] = -0.4 * y[k - 1] + 1.2 * u[k - 1] + w[k] + 0.5 * w[k - 1] + e[k]
        else:
            w[k] = np.tanh(0.8 * u[k - 1] + 0.6 * y[k - 2])
            y[k] = 0.3 * y[k - 1] + 0.5 * u[k] + w[k] - 0.4 * w[k - 1] + e[k]
    return u, y


def predicted_by_hand(
    structure: LftStructure, u: Any, y: Any, a: Any, b: Any, g: Any, d: Any, curve: Any
) -> Any:
    """Return the one-step prediction row by row, from the printed equations alone."""

    def sample(signal: str, k: int) -> Any:
        return y[k] if signal == "y" else u[k]

    def w(k: int) -> Any:
        return curve(sum(d[i] * sample(s, k - delay) for i, (s, delay) in enumerate(structure.z_lags)))

    out = []
    for k in range(structure.largest_lag, len(y)):
        value = sum(-a[i] * y[k - 1 - i] for i in range(len(a)))
        value = value + sum(b[i] * sample(s, k - delay) for i, (s, delay) in enumerate(structure.b_lags))
        value = value + sum(([1.0, *g][i]) * w(k - i) for i in range(len(g) + 1))
        out.append(value)
    return np.array(out)
