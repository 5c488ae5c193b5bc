"""Piecewise affine LFT models as plain values."""

from typing import Any

import numpy as np

from sysid.errors import DataError
from sysid.lft.piecewise import PiecewiseLft, PiecewiseStructure
from sysid.nonlinearities.piecewise_affine import PiecewiseAffineMap

KIND, SCHEMA = "sysid-piecewise-lft-model", 1


def to_json(model: PiecewiseLft) -> dict[str, Any]:
    """Return a model as JSON types.

    Examples
    --------
    >>> structure = PiecewiseStructure(1, (), 0, (("u", 0),))
    >>> relay = PiecewiseAffineMap.of_breakpoints([[0, -1], [0, 1]], [0.2])
    >>> model = PiecewiseLft.of(structure, [-0.5], relay)
    >>> from_json(to_json(model)).map.tau.tolist()
    [0.2]
    """
    structure, map_ = model.structure, model.map
    return {
        "kind": KIND,
        "schema": SCHEMA,
        "structure": {
            "n_a": structure.n_a,
            "b_lags": list(structure.b_lags),
            "n_g": structure.n_g,
            "z_lags": [list(lag) for lag in structure.z_lags],
        },
        "linear": model.linear.tolist(),
        "map": {
            "theta": map_.theta.tolist(),
            "separators": map_.separators.tolist(),
            "owners": map_.owners.tolist(),
        },
    }


def from_json(content: dict[str, Any]) -> PiecewiseLft:
    """Return the model of plain values; whatever is wrong with them raises."""
    if content["kind"] != KIND or content["schema"] != SCHEMA:
        raise DataError("it is of another kind or version")
    entries = dict(content["structure"])
    structure = PiecewiseStructure(
        entries["n_a"], tuple(entries["b_lags"]), entries["n_g"], tuple((s, d) for s, d in entries["z_lags"])
    )
    linear = np.array(content["linear"], dtype=np.float64)
    map_ = PiecewiseAffineMap(**{name: np.array(values) for name, values in content["map"].items()})
    if linear.shape != (structure.n_linear,) or not np.isfinite(linear).all():
        raise DataError(f"linear does not have {structure.n_linear} finite values")
    if map_.n_z != len(structure.z_lags) or map_.theta.ndim != 2:
        raise DataError("the map and the structure have different arguments")
    return PiecewiseLft.of(structure, linear, map_)
