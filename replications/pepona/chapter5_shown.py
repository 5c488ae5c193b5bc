"""The experiments that figures 5.1 to 5.4 are drawn from."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from replications.pepona.chapter5_runs import alternate, stages
from replications.pepona.chapter5_setting import EXAMPLES, experiment
from sysid.lft import rows_of
from sysid.lft.alternating import recovered
from sysid.nonlinearities.piecewise_affine import modes_against_delta

Floats = NDArray[np.float64]

DELTAS = np.geomspace(0.15, 3.0, 14)
"""Bounds of the curve in figure 5.3."""
POINTS = 300
"""Samples drawn of a cloud."""


def shown(seed: int, smoke: bool) -> dict[str, Any]:
    """Return the data of figures 5.1 to 5.4 of one experiment an example."""
    return {"5.1": _first_iteration(seed), "5.2": _sequence("5.2", seed), "5.3": _clouds(seed, smoke)}


def _first_iteration(seed: int) -> dict[str, Any]:
    """Return v and the map's output in the first iteration, as in figure 5.1."""
    example = EXAMPLES["5.1"]
    rng = np.random.default_rng([seed, 51])
    u, y = experiment(example, rng)
    rows = rows_of(example.structure, u, y)
    found = alternate(example, u, y, "global", rng)
    v = recovered(example.structure, rows, found.history[0])
    first = stages(example, "global")[0](rows.z, v, rng).map
    grid = np.linspace(-example.input, example.input, 201)
    return {
        "u": rows.z[:, 0],
        "v": v,
        "w": first(rows.z),
        "grid": grid,
        "map": first(grid[:, np.newaxis]),
        "true": example.model.map(grid[:, np.newaxis]),
        "last": found.model.map(grid[:, np.newaxis]),
        "iterations": found.iterations,
    }


def _sequence(case: str, seed: int) -> dict[str, Any]:
    """Return the estimates of the linear part by iteration, as in figures 5.2 and 5.4."""
    example = EXAMPLES[case]
    rng = np.random.default_rng([seed, int(case[-1])])
    found = alternate(example, *experiment(example, rng), "global", rng)
    return {
        "names": list(example.structure.linear_names()),
        "history": found.history,
        "true": list(example.linear),
        "iterations": found.iterations,
        "status": found.status,
    }


def _clouds(seed: int, smoke: bool) -> dict[str, Any]:
    """Return samples (v, z) and modes against delta in iterations 1, 3 and the last, as in figure 5.3."""
    example = EXAMPLES["5.3"]
    rng = np.random.default_rng([seed, 3])
    u, y = experiment(example, rng)
    found = alternate(example, u, y, "global", rng)
    rows = rows_of(example.structure, u, y)
    clouds = []
    for j in (1, 3, found.iterations):
        v = recovered(example.structure, rows, found.history[j - 1])
        curve = modes_against_delta(rows.z, v, DELTAS[::3] if smoke else DELTAS, rng=rng)
        clouds.append(
            {
                "iteration": j,
                "y": rows.z[:POINTS, 0],
                "v": v[:POINTS],
                "mode": example.model.map.mode(rows.z[:POINTS]),
                "deltas": curve.deltas,
                "modes": curve.modes,
                "knee": curve.knee,
                "spread": float(np.quantile(np.abs(v - found.maps[j - 1](rows.z)), 0.95)),
            }
        )
    return _sequence("5.3", seed) | {"clouds": clouds}
