"""One record of each example, drawn once and not selected, as figures 4.1 to 4.4 show it."""

from typing import Any

import numpy as np

from replications.pepona import setting
from replications.pepona.chapter4_study import ExampleRun
from replications.pepona.setting import Example, Floats, delayed
from sysid.lft import initial_estimate

POINTS = 241
SHOWN = 400
"""Points of the scatter that are kept: more make a blot."""


def shown(example: Example, seed: int) -> dict[str, Any]:
    """Return map, estimates with their band and samples of one record."""
    rng = np.random.default_rng([seed, int(10 * float(example.case))])
    signals = setting.experiment(example, example.samples, rng)
    data = signals.u, signals.y
    fitted, form = ExampleRun(example.case).supported_fit(data)
    fitted = fitted.oriented(example.d or [1.0])
    first = initial_estimate(data, form)
    grid = np.linspace(fitted.map.knots[0], fitted.map.knots[-1], POINTS)
    low, high = fitted.map_band(grid)
    early = np.linspace(first.map.knots[0], first.map.knots[-1], POINTS)
    z = np.convolve(signals.u, [0.0, *fitted.d])[: signals.u.size] if example.d else signals.z
    kept = np.linspace(form.largest_lag, signals.u.size - 1, SHOWN).astype(int)
    rows = np.linspace(0, first.z.size - 1, SHOWN).astype(int)
    return {
        "z": grid.tolist(),
        "true": example.function(grid).tolist(),
        "fitted": fitted.map(grid).tolist(),
        "low": low.tolist(),
        "high": high.tolist(),
        "knots": fitted.map.knots.tolist(),
        "samples_z": z[kept].tolist(),
        "samples_w": _map_samples(example, fitted.map(z), signals.y, signals.u, fitted)[kept].tolist(),
        "initial_z": early.tolist(),
        "initial_map": first.map(early).tolist(),
        "initial_true": example.function(early).tolist(),
        "initial_samples_z": first.z[rows].tolist(),
        "initial_samples_v": first.v[rows].tolist(),
        "initial_on_grid": first.map(grid).tolist(),
        "n_knots": form.knots,
    }


def _map_samples(example: Example, w: Floats, y: Floats, u: Floats, fitted: Any) -> Floats:
    """Return what is left of y for w(k) when the model takes everything else out: map plus noise."""
    left = y.copy()
    if "a1" in example.true:
        left += float(fitted.a[1]) * delayed(y)
    if "b1" in example.true:
        left -= float(fitted.b[0]) * delayed(u)
    if "g1" in example.true:
        left -= float(fitted.g[1]) * delayed(w)
    return left
