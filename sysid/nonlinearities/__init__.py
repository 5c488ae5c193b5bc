"""Input nonlinearities of known structure: values, slopes, moments and exact pieces.

``NONLINEARITIES`` lists all of them by name; ``nonlinearity(name)`` finds one.  `PiecewiseAffine`,
`Quantiser`, `MonotonePieces` and `sine` are fully known maps with their preimages.
"""

from collections.abc import Mapping
from types import MappingProxyType

from sysid.errors import UsageError
from sysid.nonlinearities.base import Nonlinearity, OneParameterMap
from sysid.nonlinearities.hard import (
    DEAD_ZONE,
    EVEN_DEAD_ZONE,
    PRELOAD,
    RELAY,
    SATURATION,
    TWO_SIDED_DEAD_ZONE,
    TWO_SIDED_PRELOAD,
    TWO_SIDED_RELAY,
    TWO_SIDED_SATURATION,
    HardMap,
    StaticMap,
    TwoSidedMap,
)
from sysid.nonlinearities.known import SIGN, MonotonePieces, PiecewiseAffine, Quantiser, sine
from sysid.nonlinearities.memory import (
    HYSTERESIS,
    HYSTERESIS_RELAY,
    PLAY,
    SCHMITT_TRIGGER,
    Hysteresis,
    HysteresisRelay,
    MemoryMap,
    Play,
    SchmittTrigger,
)
from sysid.nonlinearities.preimages import KnownMap, Preimage
from sysid.nonlinearities.segment import SEGMENT, SegmentMap, Segments
from sysid.nonlinearities.spline import (
    Spline,
    absolute_power_basis,
    equal_knots,
    quantile_knots,
    spline_basis,
    supported_knots,
)
from sysid.separable.pieces import AffinePieces

__all__ = [
    "DEAD_ZONE",
    "EVEN_DEAD_ZONE",
    "HYSTERESIS",
    "HYSTERESIS_RELAY",
    "NONLINEARITIES",
    "PLAY",
    "PRELOAD",
    "RELAY",
    "SATURATION",
    "SCHMITT_TRIGGER",
    "SEGMENT",
    "SIGN",
    "TWO_SIDED_DEAD_ZONE",
    "TWO_SIDED_PRELOAD",
    "TWO_SIDED_RELAY",
    "TWO_SIDED_SATURATION",
    "AffinePieces",
    "HardMap",
    "Hysteresis",
    "HysteresisRelay",
    "KnownMap",
    "MemoryMap",
    "MonotonePieces",
    "Nonlinearity",
    "OneParameterMap",
    "PiecewiseAffine",
    "Play",
    "Preimage",
    "Quantiser",
    "SchmittTrigger",
    "SegmentMap",
    "Segments",
    "Spline",
    "StaticMap",
    "TwoSidedMap",
    "absolute_power_basis",
    "equal_knots",
    "nonlinearity",
    "quantile_knots",
    "sine",
    "spline_basis",
    "supported_knots",
]

NONLINEARITIES: Mapping[str, Nonlinearity] = MappingProxyType(
    {
        entry.name: entry
        for entry in (
            PRELOAD,
            DEAD_ZONE,
            SATURATION,
            RELAY,
            HYSTERESIS_RELAY,
            HYSTERESIS,
            SCHMITT_TRIGGER,
            PLAY,
            EVEN_DEAD_ZONE,
            TWO_SIDED_PRELOAD,
            TWO_SIDED_DEAD_ZONE,
            TWO_SIDED_SATURATION,
            TWO_SIDED_RELAY,
        )
    }
)
"""All nonlinearities by name."""


def nonlinearity(name: str) -> Nonlinearity:
    """Return the nonlinearity of that name.

    Raises
    ------
    UsageError
        If there is none of that name.

    Examples
    --------
    >>> nonlinearity("dead-zone")([-3.0, 0.5, 3.0], 1.0)
    array([-2.,  0.,  2.])
    """
    if name not in NONLINEARITIES:
        raise UsageError(f"There is no nonlinearity {name!r}; choose one of {', '.join(NONLINEARITIES)}.")
    return NONLINEARITIES[name]
