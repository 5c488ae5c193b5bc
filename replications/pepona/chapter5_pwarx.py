"""The same systems without their structure: equivalent PWARX models, and Table 5.3."""

from collections.abc import Mapping
from itertools import product

import numpy as np
from numpy.typing import NDArray

from replications.pepona.chapter import printed_values
from replications.pepona.chapter5_setting import EXAMPLES, Example
from sysid.lft import rows_of

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

ESTIMATES = tuple(name for name in EXAMPLES["5.2"].true if not name.startswith("h"))

PRINTED_TABLE_5_2 = {name: printed_values()[f"5.2/{name}"] for name in ESTIMATES}
"""The estimates of Example 5.2 as printed."""

PAIRS = tuple(product((1, 2), repeat=2))
"""The modes (i, j) of w(k) and w(k-1) in (5.28)."""


PRINTED_TABLE_5_3 = {f"{i},{j}": printed_values()[f"table-5.3/lft/{i},{j}"] for i, j in PAIRS}
"""The last column of Table 5.3 as printed [%]."""


def submodel(values: Mapping[str, float], i: int, j: int) -> Floats:
    r"""Return :math:`\Theta_{i,j}` of (5.28), for (y(k-1), y(k-2), y(k-3), u(k-1), u(k-2), u(k-3), 1)."""
    now, before = (np.array([values[f"theta{m}_{c}"] for c in (1, 2, 3)]) for m in (i, j))
    g = values["g1"]
    return np.array(
        [-values["a1"], now[0], g * before[0], values["b1"], now[1], g * before[1], now[2] + g * before[2]]
    )


def relative_errors(found: Mapping[str, float], true: Mapping[str, float]) -> dict[str, float]:
    """Return the last column of Table 5.3 [%] of an estimate, by "i,j"."""
    errors = {}
    for i, j in PAIRS:
        exact = submodel(true, i, j)
        errors[f"{i},{j}"] = _percent(submodel(found, i, j), exact)
    return errors


def _percent(found: Floats, exact: Floats) -> float:
    return float(100.0 * np.linalg.norm(found - exact) / np.linalg.norm(exact))


def table_5_3_lft() -> dict[str, float]:
    """Return the last column of Table 5.3 [%] from the printed estimates."""
    return relative_errors(PRINTED_TABLE_5_2, EXAMPLES["5.2"].true)


ROUNDING = 5e-5
"""Half of the last printed decimal of Table 5.2."""


def table_5_3_slack() -> dict[str, float]:
    """Return how far the rounding of the printed estimates can move each entry of the last column [%]."""
    true = EXAMPLES["5.2"].true
    slack = dict.fromkeys(table_5_3_lft(), 0.0)
    for name, printed in PRINTED_TABLE_5_2.items():
        ends = [relative_errors({**PRINTED_TABLE_5_2, name: printed + s * ROUNDING}, true) for s in (-1, 1)]
        for pair in slack:
            slack[pair] += 0.5 * abs(ends[1][pair] - ends[0][pair])
    return slack


def table_5_3_unrounded() -> float:
    """Return how closely one set of estimates that rounds to Table 5.2 gives all four printed entries [%]."""
    from scipy.optimize import least_squares

    true, names = EXAMPLES["5.2"].true, tuple(PRINTED_TABLE_5_2)
    start = np.array(list(PRINTED_TABLE_5_2.values()))

    def missed(steps: Floats) -> Floats:
        values = dict(zip(names, (start + ROUNDING * steps).tolist(), strict=True))
        found = relative_errors(values, true)
        return np.array([found[pair] - PRINTED_TABLE_5_3[pair] for pair in found])

    fit = least_squares(missed, np.zeros(len(names)), bounds=(-1.0, 1.0), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return float(np.abs(fit.fun).max())


def direct_errors(u: Floats, y: Floats) -> dict[str, float]:
    """Return the first column of Table 5.3 [%]: each mode of (5.28) by least squares, partition known.

    NaN for a mode with fewer samples than parameters.
    """
    example = EXAMPLES["5.2"]
    rows = rows_of(example.structure, u, y)
    labels = example.model.map.mode(rows.z)
    now, before = labels[rows.now], labels[rows.now - 1]
    later, earlier = rows.z[rows.now], rows.z[rows.now - 1]
    columns = np.column_stack(
        [-rows.known[:, 0], later[:, 0], earlier[:, 0], rows.known[:, 1], later[:, 1], earlier[:, 1]]
    )
    regressors = np.column_stack([columns, np.ones(rows.y.size)])
    errors = {}
    for i, j in PAIRS:
        here = (now == i - 1) & (before == j - 1)
        exact = submodel(example.true, i, j)
        enough = int(here.sum()) >= exact.size
        found = np.linalg.lstsq(regressors[here], rows.y[here], rcond=None)[0] if enough else np.nan * exact
        errors[f"{i},{j}"] = _percent(found, exact)
    return errors


def pwarx_points(example: Example, u: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return the regressors r of (5.28), and y, for a fit that ignores the structure."""
    lags = sorted(_lags(example))
    first = max(delay for _, delay in lags)
    columns = [(u if signal == "u" else y)[first - d : y.size - d] for signal, d in lags]
    return np.column_stack(columns), y[first:]


def n_parameters(example: Example) -> tuple[int, int]:
    """Return the numbers of parameters of the LFT model and of the equivalent PWARX model."""
    modes = len(example.theta)
    width = len(_lags(example)) + 1
    lft = example.structure.n_linear + modes * (len(example.structure.z_lags) + 1)
    return lft, modes ** (example.structure.n_g + 1) * width


def _lags(example: Example) -> set[tuple[str, int]]:
    s = example.structure
    known = {("y", i) for i in range(1, s.n_a + 1)} | {("u", delay) for delay in s.b_lags}
    return known | {(name, d + lag) for name, d in s.z_lags for lag in range(s.n_g + 1)}


def mode_counts(example: Example, u: Floats, y: Floats) -> Integers:
    """Return how many samples each mode of the equivalent PWARX model holds, all combinations."""
    rows = rows_of(example.structure, u, y)
    labels = example.model.map.mode(rows.z)
    modes = len(example.theta)
    powers = range(example.structure.n_g + 1)
    codes = sum(labels[rows.now - lag] * modes**lag for lag in powers)
    return np.bincount(np.asarray(codes), minlength=modes ** len(powers))
