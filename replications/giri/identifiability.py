"""What the four levels tell of the nonlinearity, and what the paper's rules make of its own example."""

from dataclasses import astuple
from functools import lru_cache

import numpy as np

from replications.giri import setting
from replications.giri.setting import Floats
from sysid.excitation import impulse_levels
from sysid.linear.simulation import simulate_polynomial
from sysid.nonlinearities import SEGMENT, Segments
from sysid.recursive import ProjectionGradient, Snapshot, recover

PERIODS = 1500
UNKNOWNS = ("K1", "K2", "D1", "D2", "L1", "L2")

OTHER = Segments(K1=1.0, K2=2.0, D1=2.5, D2=-1.0, L1=2.5, L2=0.0)
"""Other dead zones and preloads with the slopes and offsets of the example."""


@lru_cache(maxsize=1)
def converged() -> Snapshot:
    """Return the estimate of the printed algorithm after a long noise-free run."""
    estimator = ProjectionGradient(setting.ORDER, setting.LEVELS, radius=setting.LARGE_RADIUS)
    u, y = setting.experiment(PERIODS)
    estimator.run(u, y, every=u.size)
    return estimator.snapshot()


def determined_directions() -> int:
    """Return the rank of dF(V_1 .. V_4) / d(K1, K2, D1, D2, L1, L2): at most the four levels."""
    slopes = SEGMENT.slope(np.array(setting.LEVELS), *astuple(setting.SEGMENTS))
    return int(np.linalg.matrix_rank(slopes))


def response(segments: Segments, u: Floats) -> Floats:
    """Return the output of the example's plant with another nonlinearity."""
    return simulate_polynomial([0.0, *setting.B], [1.0, *setting.A], segments(u))


def identifiability_numbers() -> dict[str, float]:
    """Return what is recovered under every rule, and two maps that no allowed input tells apart."""
    estimate = converged()
    first = recover(estimate)
    unit = recover(estimate, normalisation="unit-norm")
    symmetric = recover(estimate, "symmetric")
    dead_zone = recover(estimate, "dead-zone")
    preload = recover(estimate, "preload")
    u = impulse_levels(setting.LEVELS, setting.ORDER, 50)
    inside = np.where(u == setting.LEVELS[2], 1.5, u)
    return {
        **{f"recovered/{name}": getattr(first, name) for name in ("K1", "K2", "H1", "H2")},
        **{f"recovered/b{i + 1}": float(value) for i, value in enumerate(first.b)},
        **{f"recovered/a{i + 1}": float(value) for i, value in enumerate(first.a)},
        "recovered/singular_value_ratio": first.ratio,
        **{f"recovered/unit-norm/{name}": getattr(unit, name) for name in ("K1", "K2", "H1", "H2")},
        "recovered/unit-norm/b_squared": float(unit.b @ unit.b),
        **{f"rule/symmetric/{name}": getattr(symmetric, name) for name in UNKNOWNS[2:]},
        **{f"rule/dead-zone/{name}": getattr(dead_zone, name) for name in UNKNOWNS[2:]},
        **{f"rule/preload/{name}": getattr(preload, name) for name in UNKNOWNS[2:]},
        "identifiability/unknowns": float(len(UNKNOWNS)),
        "identifiability/determined": float(determined_directions()),
        "identifiability/difference_at_levels": _difference(u),
        "identifiability/difference_inside": _difference(inside),
    }


def _difference(u: Floats) -> float:
    return float(np.max(np.abs(response(setting.SEGMENTS, u) - response(OTHER, u))))
