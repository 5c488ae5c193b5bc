"""Directions in which an effect outside any list would show in a linear model with effects."""

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.structures.probe_functions import EXTRA_LAGS, probe_functions


def probe_directions(chain: Chain, data: Data, point: Floats, since: int = 0) -> Floats:
    """Return the directions, shape (n_probes, n_rows).

    Functions of the input, the modelled output and its speed, of their products and of time, added to
    the output and, through the model's dynamics with its effects, to its input; and further lags of the
    input.

    Parameters
    ----------
    chain : Chain
    data : Data
    point : ndarray
    since : int
        Least number of samples by which the input comes before the output.
    """
    run = chain.run(data, point)
    if run is None:
        return np.empty((0, data.u.size))
    n = chain.order
    speed = run.z - data.lagged(run.z, 1)
    time = np.arange(data.u.size) - np.repeat(data.begin[:-1], np.diff(data.begin))
    time = 2.0 * time / max(float(time.max()), 1.0) - 1.0
    functions, acting = (
        np.array(
            [*probe_functions(data.lagged(data.u, lag), data.lagged(data.u, lag + 1), run.z, speed, time)]
        )
        for lag in (since, 0)
    )
    none = np.zeros(point.size, dtype=bool)
    slopes = chain.drive_slopes(data, point, run, none[chain.layout(data).driving])
    own = none[: chain.n_linear(data)]
    through = chain.followed(data, point, run, slopes, acting, own)[: len(acting)]
    beside = chain.past_the_plant(data, point, acting)
    through = through if beside is None else through + beside
    through = chain.through_sensor(data, point, run, through)
    lags = [data.lagged(data.u, lag) for lag in range(since, 2 * n + EXTRA_LAGS + 1)]
    return np.vstack([functions, through, lags])
