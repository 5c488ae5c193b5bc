"""Regions of the data in which an error may be concentrated."""

import itertools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.data import Record
from sysid.data.units import per_second
from sysid.diagnosis.comparison.series import Series
from sysid.diagnosis.ports.reversals import NEAR_ZERO
from sysid.diagnosis.wording import quantity
from sysid.linear.forms import Floats

LEVELS = (0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95)
BARS = 10
OUTER_SHARE = 0.005
WINDOWS = 20
SMALLEST_SHARE, LARGEST_SHARE = 0.015, 0.6
SMALLEST_BAR, FEWEST_ROWS = 0.003, 12
LENGTH_UNITS = ("m", "mm", "µm", "cm", "km", "rad", "deg", "°")


@dataclass(frozen=True)
class Region:
    """Part of the data.

    Attributes
    ----------
    place : dict
        Its bounds, as in the JSON file.
    words : str
        ``"the output y is above 8.1 V"``, to stand after *while*; for times
        ``"between 3 and 4 s"``.
    bar : bool
        Whether it is one of the bars that are drawn; these do not overlap.
    """

    place: dict[str, Any]
    words: str
    bar: bool = False


@dataclass(frozen=True)
class Division:
    """Rows divided by one signal into cells, and regions as sums of cells.

    Attributes
    ----------
    kind : {"time", "input", "output", "velocity", "velocity-sign", "experiment"}
    signal, unit : str
    cell : ndarray of int, shape (n_rows,)
        Cell of each row.
    members : ndarray, shape (n_regions, n_cells)
        1 where a cell belongs to a region.
    regions : tuple of Region
    source : Division or None
        The division of all rows, of which this is one on other rows.
    """

    kind: str
    signal: str
    unit: str
    cell: NDArray[np.int64]
    members: Floats
    regions: tuple[Region, ...]
    source: "Division | None" = None
    data_share: Floats = field(init=False)

    def __post_init__(self) -> None:
        """Count the rows of each region."""
        object.__setattr__(self, "data_share", self.share(np.ones(self.cell.size)))

    def share(self, weights: Floats) -> Floats:
        """Return the share of non-negative weights in each region."""
        sums = np.bincount(self.cell, weights, minlength=self.members.shape[1])
        return np.asarray(self.members @ sums / max(float(sums.sum()), 1e-300))

    def on(self, cell: NDArray[np.int64]) -> "Division":
        """Return the same regions on other rows, whose cells are given."""
        return Division(self.kind, self.signal, self.unit, cell, self.members, self.regions, self)


def divisions(series: Series) -> tuple[Division, ...]:
    """Divide the judged rows by time, inputs, output, velocity, its sign, and experiment."""
    record = series.record
    output = record.outputs[0]
    unit = record.unit(output)
    moving, rate = moving_signal(record)
    found = [_by_time(series)]
    for index, name in enumerate(record.inputs):
        found.append(_by_level(series.u[:, index], "input", f"input {name}", record.unit(name)))
    found.append(_by_level(series.output, "output", f"output {output}", unit))
    found.append(_by_level(series.velocity, "velocity", moving, rate))
    found.append(_by_sign(series.velocity, moving, rate))
    found.append(_by_reversal(series, moving, rate))
    if np.ptp(series.experiment) > 0:
        found.append(by_experiment(series))
    return tuple(kept for division in found if (kept := _usable(division)) is not None)


def moving_signal(record: Record) -> tuple[str, str]:
    """Return what the rate of change of the output is called, and its unit."""
    output = record.outputs[0]
    unit = record.unit(output)
    name = "velocity" if unit in LENGTH_UNITS else f"rate of change of {output}"
    return name, per_second(unit)


def _usable(division: Division) -> Division | None:
    """Keep the regions that hold enough rows, and leave enough outside, to be compared."""
    drawn = np.array([region.bar for region in division.regions])
    smallest = np.where(drawn, max(SMALLEST_BAR, FEWEST_ROWS / division.cell.size), SMALLEST_SHARE)
    keep = (division.data_share >= smallest) & (division.data_share <= np.where(drawn, 0.99, LARGEST_SHARE))
    if not keep.any():
        return None
    regions = tuple(region for region, kept in zip(division.regions, keep, strict=True) if kept)
    return Division(
        division.kind, division.signal, division.unit, division.cell, division.members[keep], regions
    )


def _by_time(series: Series) -> Division:
    """Divide each experiment into equal windows; neighbouring ones are joined by two and four."""
    n, several = series.places.size, bool(np.ptp(series.experiment) > 0)
    cell = np.empty(n, dtype=np.int64)
    members, regions, begun = [], [], 0
    for number in np.unique(series.experiment):
        rows = np.flatnonzero(series.experiment == number)
        windows = max(round(WINDOWS * rows.size / n), 1)
        cell[rows] = begun + np.arange(rows.size) * windows // rows.size
        of_experiment = f" of experiment {series.record.experiments[int(number)]}" if several else ""
        for width in (1, 2, 4):
            for first in range(begun, begun + windows - width + 1, width):
                chosen = rows[(cell[rows] >= first) & (cell[rows] < first + width)]
                start, end = series.seconds(int(chosen[0]), int(chosen[-1]))
                place = {
                    "set": series.judged,
                    "from_s": start,
                    "to_s": end,
                    "first_row": int(series.places[chosen[0]]) + 1,
                    "last_row": int(series.places[chosen[-1]]) + 1,
                }
                words = f"between {quantity(start, '', 4)} and {quantity(end, '', 4)} s{of_experiment}"
                members.append((first, first + width))
                regions.append(Region(place, words, bar=width == 1))
        begun += windows
    cells = np.arange(begun)
    table = np.array([(cells >= first) & (cells < last) for first, last in members], dtype=float)
    return Division("time", "time", "s", cell, table, tuple(regions))


def _by_level(signal: Floats, kind: str, name: str, unit: str) -> Division:
    """Divide by level: bars of equal width, and everything above, below, between and beyond some levels."""
    levels = np.unique(np.quantile(signal, LEVELS))
    low, high = np.quantile(signal, [OUTER_SHARE, 1.0 - OUTER_SHARE])
    steps = np.linspace(low, high, BARS + 1)[1:-1] if high > low else np.empty(0)
    edges = np.unique(np.concatenate([levels, steps]))
    cell = np.searchsorted(edges, signal, side="left")
    upper = np.append(edges, np.inf)  # a cell holds what is above its lower and not above its upper edge
    lower = np.insert(edges, 0, -np.inf)
    members, regions = [], []

    def add(chosen: NDArray[np.bool_], place: dict[str, Any], words: str, bar: bool = False) -> None:
        members.append(chosen.astype(float))
        regions.append(Region({"signal": name, "unit": unit} | place, words, bar))

    for level in levels.tolist():
        shown = quantity(level, unit)
        add(lower >= level, {"above": level}, f"the {name} is above {shown}")
        add(upper <= level, {"up_to": level}, f"the {name} is at most {shown}")
    for a, b in zip(levels[: levels.size // 2].tolist(), levels[::-1].tolist(), strict=False):
        inside = (lower >= a) & (upper <= b)
        shown = f"{quantity(a, unit)} and {quantity(b, unit)}"
        add(inside, {"above": a, "up_to": b}, f"the {name} is between {shown}")
        add(~inside, {"up_to": a, "or_above": b}, f"the {name} is beyond {shown}")
    bounds = [-np.inf, *steps.tolist(), np.inf]
    for a, b in itertools.pairwise(bounds):
        place, words = _step_words(a, b, name, unit)
        add((lower >= a) & (upper <= b), place, words, bar=True)
    return Division(kind, name, unit, cell, np.array(members), tuple(regions))


def _step_words(a: float, b: float, name: str, unit: str) -> tuple[dict[str, Any], str]:
    if not np.isfinite(a):
        return {"up_to": b}, f"the {name} is at most {quantity(b, unit)}"
    if not np.isfinite(b):
        return {"above": a}, f"the {name} is above {quantity(a, unit)}"
    return {"above": a, "up_to": b}, f"the {name} is between {quantity(a, unit)} and {quantity(b, unit)}"


def _by_sign(velocity: Floats, name: str, unit: str) -> Division:
    """Divide by the sign of the velocity, what is near zero apart."""
    bound = NEAR_ZERO * float(np.sqrt(np.mean(velocity**2)))
    cell = np.where(velocity > bound, 2, np.where(velocity < -bound, 0, 1))
    shown = quantity(bound, unit)
    regions = (
        Region({"signal": name, "unit": unit, "up_to": -bound}, f"the {name} is negative", bar=True),
        Region(
            {"signal": name, "unit": unit, "above": -bound, "up_to": bound},
            f"the {name} is near zero (within ±{shown})",
            bar=True,
        ),
        Region({"signal": name, "unit": unit, "above": bound}, f"the {name} is positive", bar=True),
    )
    return Division("velocity-sign", name, unit, cell, np.eye(3), regions)


def _by_reversal(series: Series, name: str, unit: str) -> Division:
    """Divide into rows close to a change of the velocity's sign, and others."""
    bound = NEAR_ZERO * float(np.sqrt(np.mean(series.velocity**2)))
    reach = 2 * series.mean_length
    cell = np.zeros(series.velocity.size, dtype=np.int64)
    for run in series.runs:
        velocity = series.velocity[run]
        moving = np.flatnonzero(np.abs(velocity) > bound)
        for a, b in zip(moving[:-1].tolist(), moving[1:].tolist(), strict=True):
            if velocity[a] * velocity[b] < 0.0:  # from motion in one direction to motion in the other
                crossing = a + int(np.argmin(np.abs(velocity[a : b + 1])))
                cell[run][max(crossing - reach, 0) : crossing + reach + 1] = 1
    seconds = quantity(reach * series.record.period, "s")
    place = {"signal": name, "unit": unit, "reversal_within_s": reach * series.record.period}
    drawn = bool(cell.mean() <= LARGEST_SHARE)  # of a fast motion nearly all rows are close to a reversal
    region = Region(place, f"the {name} changes its sign (within {seconds})", bar=drawn)
    return Division("velocity-sign", name, unit, cell, np.array([[0.0, 1.0]]), (region,))


def by_experiment(series: Series) -> Division:
    """Divide by experiment."""
    numbers, cell = np.unique(series.experiment, return_inverse=True)
    regions = tuple(
        Region({"experiment": (name := series.record.experiments[int(n)])}, f"in experiment {name}", bar=True)
        for n in numbers
    )
    return Division("experiment", "experiment", "", cell, np.eye(numbers.size), regions)
