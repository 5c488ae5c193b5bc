"""What Chapter 5 can be held against without a study: identifiability, smoothing, bounds."""

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from replications.pepona.chapter5_setting import BOUNDARY, EXAMPLES, Example, experiment
from sysid.bounds import least_squares_bound
from sysid.lft import PiecewiseStructure, identifiability, inversion, rows_of, smooth
from sysid.lft.continuous import Hinges
from sysid.lft.joint import jacobian

Floats = NDArray[np.float64]

AS_IN_5_14 = PiecewiseStructure(0, (1,), 0, (("y", 1), ("u", 1)))
"""The map's arguments of (5.14) at time k, so that g0 = 1."""
AS_IN_5_15 = PiecewiseStructure(0, (1,), 0, (("y", 2), ("u", 2)))
"""The same system with the arguments one sample older, (5.15)."""

RECORDS = {"5.1": 400, "5.2": 40, "5.3": 40}
"""Records over which the information is averaged: 40,000 samples."""


def theory_numbers() -> dict[str, float]:
    """Return what holds of the structures and of the smoother."""
    return {**_identifiability(), **_smoothing()}


def _identifiability() -> dict[str, float]:
    """Return the free directions of both forms of Example 5.1 (5.14), and how far their outputs differ."""
    rng = np.random.default_rng(514)
    u, e, b1, g1 = rng.uniform(-1, 1, 300), 0.1 * rng.standard_normal(300), 0.7, 0.4
    first, second = np.zeros(300), np.zeros(300)
    w = np.zeros(300)
    for k in range(2, 300):
        w[k] = first[k - 1] * u[k - 1] ** 2
        first[k] = b1 * u[k - 1] + g1 * w[k - 1] + e[k]
        second[k] = b1 * u[k - 1] + g1 * second[k - 2] * u[k - 2] ** 2 + e[k]
    numbers = {"identifiability/5.15/difference": float(np.abs(first - second).max())}
    for name, structure in (("5.14", AS_IN_5_14), ("5.15", AS_IN_5_15)):
        found = identifiability(structure)
        numbers[f"identifiability/{name}/common"] = float(len(found.common))
        numbers[f"identifiability/{name}/free"] = float(len(found.free))
    for case in ("5.1", "5.2", "5.3"):
        found = identifiability(EXAMPLES[case].structure, EXAMPLES[case].model.g)
        numbers[f"identifiability/{case}/free"] = float(len(found.free))
    return numbers


def _smoothing() -> dict[str, float]:
    """Return what (5.21) does where G(q) has its zeros inside, and outside, the unit circle."""
    rng = np.random.default_rng(521)
    v = rng.standard_normal(1004)
    numbers: dict[str, float] = {}
    for name, g in (("inside", EXAMPLES["5.3"].model.g), ("outside", np.array([2.0]))):
        filter_ = np.append(1.0, g)
        r = np.convolve(v, filter_, mode="valid")
        forward = np.zeros(r.size)
        for k in range(400):
            forward[k] = r[k] - sum(c * forward[k - i] for i, c in enumerate(g, 1) if k >= i)
        truth, middle = v[g.size :], slice(300, 400)
        numbers |= {
            f"smoothing/{name}/growth": inversion(g).forward,
            f"smoothing/{name}/recursion_error": float(np.abs(forward - truth)[middle].max()),
            f"smoothing/{name}/least_norm_error": float(np.abs(smooth(r, g)[g.size :] - truth)[middle].max()),
        }
    return numbers


@cache
def bound_std(case: str) -> Mapping[str, float]:
    """Return the standard deviations at the Cramér-Rao bound of a known partition; of 5.1, of the kink."""
    example = EXAMPLES[case]
    rng = np.random.default_rng(522)
    pairs = [experiment(example, rng) for _ in range(RECORDS[case])]
    rows = rows_of(example.structure, [u for u, _ in pairs], [y for _, y in pairs])
    n = rows.lengths[0]
    if case == "5.1":
        return _kink_bound(example, Hinges(rows, 0, (0,)), n)
    model = example.model
    columns = jacobian(example.structure, rows, model.map.mode(rows.z), model.linear, model.map.theta)
    covariance = least_squares_bound([columns], example.noise_std**2, n)
    names = [name for name in example.true if name not in BOUNDARY[case]]
    return dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))


def _kink_bound(example: Example, problem: Hinges, n: int) -> dict[str, float]:
    """Return the bound of a1, alpha1, alpha2 and tau for a continuous map with an offset."""
    (left, _), (right, _) = example.theta
    linear = np.array([example.linear[0], left, 0.0, right - left])
    eta = np.array([0.0])
    columns = np.column_stack([problem.derivative(eta)[0] @ linear, problem.regressors(eta)])
    covariance = least_squares_bound([columns], example.noise_std**2, n)
    # From (-tau, a1, left slope, offset, change of slope) to the parameters of the text.
    turn = np.array([[0, 1, 0, 0, 0], [0, 0, 1, 0, 1], [0, 0, 1, 0, 0], [-1, 0, 0, 0, 0]], dtype=float)
    sizes = np.sqrt(np.diag(turn @ covariance @ turn.T))
    return dict(zip(("a1", "alpha1", "alpha2", "tau"), sizes.tolist(), strict=True))
