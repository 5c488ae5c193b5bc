"""Linear models behind a quantiser."""

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.levenberg import Minimum
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.structures.cells import inside_cells, read_cells


def within_cells(chain: Chain, data: Data, minimum: Minimum, noise: Floats) -> Minimum:
    """Go on behind a quantiser by the cells that were read, if that lowers the error.

    Parameters
    ----------
    chain : Chain
    data : Data
    minimum : Minimum
        Of the squared error, where a search without slopes of the quantiser came to rest.
    noise : ndarray
        D(q) of the noise.

    Returns
    -------
    Minimum
        The same where there is no quantiser, or noise hides its steps.
    """
    read = read_cells(chain.choices, chain.places(data), minimum.point, data.y[data.used])
    if read is None:
        return minimum
    (cells, place), bounds = read, chain.bounds(data)

    def output(point: Floats) -> Floats:
        run = chain.run(data, np.clip(point, *bounds))
        return np.full(int(data.used.sum()), np.inf) if run is None else run.outputs[-2][data.used]

    def slopes(point: Floats) -> Floats:
        clipped = np.clip(point, *bounds)
        run = chain.run(data, clipped)
        assert run is not None  # it ran for the output
        J = chain.jacobian(data, clipped, run)[:, data.used].T
        J[:, place] = 0.0  # the readings alone tell the step
        return np.ascontiguousarray(J)

    start = minimum.point.copy()
    start[place] = cells.step
    point = np.clip(inside_cells(cells, output, slopes, start), *bounds)
    run = chain.run(data, point)
    if run is None:
        return minimum
    error = chain.error(data, run, noise)
    cost = float(error @ error)
    return Minimum(point, cost, True) if cost < minimum.cost else minimum
