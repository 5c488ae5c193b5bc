"""A map of a fitted model as a comparison shows it, on a grid over its data."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sysid.diagnosis.wording import NORMAL_95
from sysid.linear.forms import Floats
from sysid.result_files import finite

GRID = 200
DENSITY_CELLS = 40
# The band is told where this share of the data lies, without as much at each end.
INNER = 0.95


@dataclass(frozen=True, eq=False)
class FittedMap:
    """A map of the model for a figure: on a grid over its data, with its 95 % band.

    Attributes
    ----------
    sentence : str
        What it looks like.
    quantity, unit : str
        What goes into the map.
    result_unit : str
    value : ndarray, shape (n_points,)
        Grid over the data.
    centre, lower, upper : ndarray, shape (n_points,)
        The map there, with its 95 % band.
    density : ndarray, shape (n_points,)
        Of the data there.
    knots : ndarray, shape (n_knots,)
    bend, bend_deviation : ndarray, shape (n_points,)
        What the map has beyond its nearest straight line, with the standard deviation.
    """

    heading: ClassVar[str] = "Static map of the model, with its 95 % band and the data it rests on"
    result: ClassVar[str] = "w"

    sentence: str
    quantity: str
    unit: str
    result_unit: str
    value: Floats
    centre: Floats
    lower: Floats
    upper: Floats
    density: Floats
    knots: Floats
    bend: Floats
    bend_deviation: Floats

    @property
    def bend_lower(self) -> Floats:
        """Lower end of the 95 % interval of the bend."""
        return self.bend - NORMAL_95 * self.bend_deviation

    @property
    def bend_upper(self) -> Floats:
        """Upper end of the 95 % interval of the bend."""
        return self.bend + NORMAL_95 * self.bend_deviation

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        columns = (
            "value", "centre", "lower", "upper", "density", "knots", "bend", "bend_lower", "bend_upper",
        )  # fmt: skip
        return {
            "quantity": self.quantity,
            "unit": self.unit,
            "result": self.result,
            "result_unit": self.result_unit,
            **{name: [finite(v) for v in getattr(self, name)] for name in columns},
        }


def density_on(grid: Floats, z: Floats) -> Floats:
    """Return the density of data within the range of a grid, at its points, shape (n_points,)."""
    counts, edges = np.histogram(z, bins=DENSITY_CELLS, range=(grid[0], grid[-1]))
    cell = np.clip(np.searchsorted(edges, grid, side="right") - 1, 0, DENSITY_CELLS - 1)
    return np.asarray(counts[cell] / (max(z.size, 1) * np.diff(edges)[cell]))


def inner_range(z: Floats) -> tuple[float, float]:
    """Return the range of all but the outermost data."""
    low, high = np.quantile(z, [0.5 - INNER / 2, 0.5 + INNER / 2])
    return float(low), float(high)
