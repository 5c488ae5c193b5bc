"""Wiener-Hammerstein models as plain values."""

from typing import Any

import numpy as np

from sysid.errors import DataError
from sysid.lft.linear_block import LinearBlock
from sysid.lft.wiener_hammerstein.model import WienerHammerstein
from sysid.nonlinearities.spline import Spline

KIND, SCHEMA = "sysid-wiener-hammerstein-model", 1


def to_json(model: WienerHammerstein) -> dict[str, Any]:
    """Return plain values; a and b of the blocks are for the reader, the rest is what the model is."""
    return {
        "kind": KIND,
        "schema": SCHEMA,
        "front": _block_to_json(model.front),
        "map": {
            "knots": model.map.knots.tolist(),
            "coefficients": model.map.coefficients.tolist(),
            "degree": model.map.degree,
            "extrapolation": model.map.extrapolation,
        },
        "back": _block_to_json(model.back),
        "delay": model.delay,
        "oversampling": model.oversampling,
        "resting": model.resting,
    }


def from_json(content: dict[str, Any]) -> WienerHammerstein:
    """Return the model of plain values; whatever is wrong with them raises.

    Examples
    --------
    >>> import numpy as np
    >>> gain = LinearBlock(np.zeros(0), np.ones(1))
    >>> model = WienerHammerstein(gain, Spline([-1.0, 1.0], [0.0, 0.0, 1.0, 2.0]), gain)
    >>> from_json(to_json(model)).simulate([0.5]).tolist() == model.simulate([0.5]).tolist()
    True
    """
    if content["kind"] != KIND or content["schema"] != SCHEMA:
        raise DataError("it is of another kind or version")
    curve = content["map"]
    spline = Spline(
        np.array(curve["knots"], dtype=np.float64),
        np.array(curve["coefficients"], dtype=np.float64),
        int(curve["degree"]),
        curve["extrapolation"],
    )
    return WienerHammerstein(
        _block_from_json(content["front"]),
        spline,
        _block_from_json(content["back"]),
        delay=int(content["delay"]),
        oversampling=int(content["oversampling"]),
        resting=bool(content["resting"]),
    )


def _block_to_json(block: LinearBlock) -> dict[str, list[float]]:
    return {
        "a": block.a.tolist(),
        "b": block.b.tolist(),
        "reflections": block.reflections.tolist(),
        "weights": block.weights.tolist(),
    }


def _block_from_json(content: dict[str, Any]) -> LinearBlock:
    reflections = np.array(content["reflections"], dtype=np.float64)
    weights = np.array(content["weights"], dtype=np.float64)
    if not (np.isfinite(weights).all() and (np.abs(reflections) < 1.0).all()):
        raise DataError("a block is not stable or not finite")
    return LinearBlock(reflections, weights)
