"""The first rows of a run under coloured noise: what an autoregression says of them without a past."""

from functools import lru_cache

import numpy as np

from sysid.linear.forms import Floats


def opening(noise: Floats) -> Floats:
    """Return the weights that make the first rows of stationary noise white, as D(q) does the later ones.

    A row without a past as long as D(q) is foreseen from the rows there are, by the predictor of lower order,
    and its error counts as many times less as it is larger than an innovation: so the sum of squares is that
    of the exact likelihood.  The first row alone has the size of the noise itself; were it taken for an
    innovation, an initial state would follow it and nothing else.

    Parameters
    ----------
    noise : ndarray, shape (order + 1,)
        D(q), leading 1 included.

    Returns
    -------
    ndarray, shape (order, order)
        Row j makes row j of a run from rows 0 to j.  Where D(q) is not stationary, the rows for which its
        predictors of lower order are none are zero: without a past they say nothing.

    References
    ----------
    Durbin (1960), The fitting of time-series models, Revue de l'Institut International de Statistique 28.

    Examples
    --------
    Noise with r(k) = 0.8 r(k-1) + e(k) is larger than e by 1 / sqrt(1 - 0.8^2):

    >>> opening(np.array([1.0, -0.8]))
    array([[0.6]])
    """
    return _opening(tuple(noise.tolist()))


@lru_cache(maxsize=64)
def _opening(noise: tuple[float, ...]) -> Floats:
    order = len(noise) - 1
    weights = np.zeros((order, order))
    predictor, size = np.array(noise[1:]), 1.0
    for j in reversed(range(order)):
        reflection = predictor[j]
        left = 1.0 - reflection**2
        if left <= 0.0:
            break
        size *= np.sqrt(left)
        predictor = (predictor[:j] - reflection * predictor[:j][::-1]) / left
        weights[j, j] = size
        weights[j, :j] = size * predictor[::-1]
    weights.setflags(write=False)
    return weights
