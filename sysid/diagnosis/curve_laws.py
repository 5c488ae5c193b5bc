"""The simplest law that a free-form curve follows: a polynomial, or a line with kinks."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from sysid.diagnosis.effects.base import Floats

# A law is simple enough if it follows this share of what the curve has beyond a straight line.
ENOUGH = 0.95
MOST_KINKS = 4
# How often the places of the kinks are searched one after another.
SWEEPS = 3
# The segment from which slopes are counted holds at least this share of the data.
LEAST_DATA = 0.05
# Powers of a polynomial: lines are the model's own.
POWERS = (2, 3)
# So much data lies on either side of a kink.
LEAST_BESIDE = 0.02


@dataclass(frozen=True)
class Law:
    """A law with few parameters that follows a curve.

    Attributes
    ----------
    terms : tuple of str
        Factors of the parameters, in the signal.
    values : tuple of float
        The curve's own values of the parameters.
    units : tuple of int
        By which power of the signal's unit each parameter is divided, beside the unit of what it gives.
    follows : float
        Share of what the curve has beyond a straight line.
    """

    terms: tuple[str, ...]
    values: tuple[float, ...]
    units: tuple[int, ...]
    follows: float


def simplest_law(value: Floats, centre: Floats, density: Floats, signal: str, own: float) -> Law:
    """Return the law with the fewest parameters that follows a curve, else the one that follows it best.

    Parameters
    ----------
    value, centre, density : ndarray, shape (n_points,)
        The curve and the data it rests on.
    signal : str
        Name of what it depends on.
    own : float
        Slope that the law has without the curve: 1 where the curve is added to the signal.
    """
    weight = np.sqrt(density + 0.01 * density.mean())
    lines = np.column_stack([np.ones(value.size), value])
    laws: list[Law] = []
    for count in range(1, MOST_KINKS + 1):
        for powers in combinations(POWERS, count):
            laws.append(_polynomial(value, centre, weight, lines, signal, powers))
        laws.append(_kinked(value, centre, weight, lines, signal, own, count))
        best = max(laws, key=lambda law: law.follows)
        if best.follows >= ENOUGH:
            break
    return best


def _polynomial(
    value: Floats, centre: Floats, weight: Floats, lines: Floats, signal: str, powers: Sequence[int]
) -> Law:
    basis = np.column_stack([value**power for power in powers])
    weights, follows = _fitted(centre, weight, lines, basis)
    terms = tuple(f"{signal}**{power}" for power in powers)
    return Law(terms, tuple(weights[2:].tolist()), tuple(powers), follows)


def _fitted(centre: Floats, weight: Floats, lines: Floats, basis: Floats) -> tuple[Floats, float]:
    """Return the weights of lines and basis, and the share of what is beyond the lines that it follows."""
    columns = np.hstack([lines, basis]) * weight[:, np.newaxis]
    weights = np.asarray(np.linalg.lstsq(columns, weight * centre, rcond=None)[0], dtype=np.float64)
    alone = np.asarray(np.linalg.lstsq(columns[:, :2], weight * centre, rcond=None)[0], dtype=np.float64)
    left, all_of_it = (
        float(np.sum((weight * centre - columns[:, : w.size] @ w) ** 2)) for w in (weights, alone)
    )
    return weights, 1.0 - left / all_of_it if all_of_it > 0.0 else 1.0


def _kinked(
    value: Floats, centre: Floats, weight: Floats, lines: Floats, signal: str, own: float, count: int
) -> Law:
    """Return the line with so many kinks that follows a curve best, each place searched in turn."""
    passed = np.cumsum(weight**2) / np.sum(weight**2)
    inner = value[(passed > LEAST_BESIDE) & (passed < 1.0 - LEAST_BESIDE)]
    places: list[float] = []

    def follows(chosen: Sequence[float]) -> float:
        return _fitted(centre, weight, lines, _kinks(value, chosen))[1]

    for _ in range(count):
        places.append(max(inner, key=lambda place: follows([*places, place])))
        for _ in range(SWEEPS):
            for i in range(len(places)):
                others = places[:i] + places[i + 1 :]
                places[i] = max(inner, key=lambda place: follows([*others, place]))
    decimals = 2 - int(np.floor(np.log10(np.ptp(value))))
    places = sorted({round(float(place), decimals) for place in places})
    weights, share = _fitted(centre, weight, lines, _kinks(value, places))
    slopes = own + weights[1] + np.concatenate([[0.0], np.cumsum(weights[2:])])
    return _from_segments(places, slopes, _data_in(value, weight**2, places), signal, own, share)


def _kinks(value: Floats, places: Sequence[float]) -> Floats:
    kinks: Floats = np.maximum(value[:, np.newaxis] - np.asarray(places), 0.0)
    return kinks


def _data_in(value: Floats, density: Floats, places: Sequence[float]) -> Floats:
    """Return the share of the data in each segment between kinks."""
    segment = np.searchsorted(places, value)
    counts = np.bincount(segment, weights=density, minlength=len(places) + 1)
    return np.asarray(counts / counts.sum())


def _from_segments(
    places: Sequence[float], slopes: Floats, data: Floats, signal: str, own: float, follows: float
) -> Law:
    """Write a line with kinks outwards from one of its segments, whose slope the model takes over.

    For a map that is the steepest one with data: the other slopes are shares of it, of which a dead zone has
    zero.  For a force it is the one with most data.
    """
    steep = np.where(data >= LEAST_DATA, np.abs(slopes), 0.0) if own else data
    start = int(np.argmax(steep))
    reference = slopes[start] if own else 1.0
    terms, values = [], []
    for i, place in enumerate(places):
        upwards = i >= start
        step = slopes[i + 1] - slopes[i] if upwards else slopes[i] - slopes[i + 1]
        shifted = f"{signal} {'-' if place >= 0.0 else '+'} {abs(place):g}"
        terms.append(f"{'max' if upwards else 'min'}({shifted}, 0)")
        values.append(float(step / reference))
    return Law(tuple(terms), tuple(values), (1,) * len(terms), follows)
