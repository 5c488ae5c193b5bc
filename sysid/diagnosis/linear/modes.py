"""Standard errors where a shape fits about as well elsewhere: a delay by one sample, a lag that is a pole."""

from collections.abc import Iterator

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.levenberg import Minimum, minimise
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.linear.trades import traded

# Points of the grid on either side from which other minima are searched.
NEIGHBOURS = 2
# A start from which the others lower the error no further than this, in noise variances, leads nowhere.
HOPELESS, UNLIKELY = 200.0, 12.0
# Another minimum lies this many standard errors away; nearer, it is the same one.
APART = 3.0
ITERATIONS, FULL_ITERATIONS = 4, 25


def errors_over_minima(
    chain: Chain, data: Data, point: Floats, noise: Floats, cost: float, variance: float, errors: Floats
) -> Floats:
    """Return standard errors that hold other minima in which a shape is as likely.

    A minimum counts with its likelihood and the width of the best one; the error is the root mean square
    distance from the best value.

    Parameters
    ----------
    chain : Chain
    data : Data
    point : ndarray
        The best minimum.
    noise : ndarray
        D(q) of the noise.
    cost, variance : float
        Sum of squares at the best minimum, and the noise variance.
    errors : ndarray
        Standard errors at the best minimum alone.

    Returns
    -------
    ndarray, like ``errors``
    """
    places, weights = [point], [1.0]
    for index, minimum in _others(chain, data, point, noise, cost + HOPELESS * variance):
        if minimum is None or not np.isfinite(errors[index]):
            continue
        worse = (minimum.cost - cost) / variance
        apart = min(abs(minimum.point[index] - other[index]) for other in places)
        if worse < UNLIKELY and apart > APART * errors[index]:
            places.append(minimum.point)
            weights.append(float(np.exp(-0.5 * max(worse, 0.0))))
    squares = (np.array(places) - point) ** 2
    return np.sqrt(errors**2 + np.average(squares, axis=0, weights=weights))


def _others(
    chain: Chain, data: Data, point: Floats, noise: Floats, most: float
) -> Iterator[tuple[int, Minimum | None]]:
    """Yield minima that may lie elsewhere, with the position of the shape that is searched there."""
    for index, values in _shapes(chain, data):
        for value in _neighbours(values, float(point[index])):
            yield index, _other(chain, data, point, noise, (index, value), most)
    for index, moved in traded(chain, data, point):
        yield index, minimise(chain, data, moved, noise, iterations=FULL_ITERATIONS)


def _shapes(chain: Chain, data: Data) -> Iterator[tuple[int, Floats]]:
    """Yield the position in a point of each shape that is counted in samples, and its grid.

    The numerator can stand for a shift by a sample; it cannot for a level or a width.
    """
    y = data.y[data.used]
    for choice, place in zip(chain.choices, chain.places(data), strict=True):
        for number, parameter in enumerate(choice.form.parameters):
            if parameter.grid is not None and parameter.grid.scale == "period":
                yield place.start + number, parameter.grid.values(data.u, y, data.period)


def _neighbours(values: Floats, value: float) -> list[float]:
    place = int(np.searchsorted(values, value))
    return [*values[max(place - NEIGHBOURS, 0) : place], *values[place : place + NEIGHBOURS]]


def _other(
    chain: Chain, data: Data, point: Floats, noise: Floats, shape: tuple[int, float], most: float
) -> Minimum | None:
    """Search with a shape elsewhere: the others first, then all."""
    index, value = shape
    start, rest = point.copy(), np.ones(point.size, dtype=bool)
    start[index], rest[index] = value, False
    minimum = minimise(chain, data, start, noise, free=rest, iterations=ITERATIONS)
    if minimum is None or minimum.cost > most:
        return None
    return minimise(chain, data, minimum.point, noise, iterations=FULL_ITERATIONS)
