"""Starts for effects whose free-run error has several minima."""

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.levenberg import minimise
from sysid.diagnosis.linear_chain import Chain, Data

WHITE = np.ones(1)
RETRIEVALS = 6


def further_starts(chain: Chain, data: Data, point: Floats) -> list[Floats]:
    """Return values of the parameters before those of the last effect, besides ``point``."""
    choice = chain.choices[-1]
    if choice.name == "out_rectify" and choice.form.name == "full-wave":
        return _with_signs(chain, data, point)
    return []


def _with_signs(chain: Chain, data: Data, point: Floats) -> list[Floats]:
    """Return starts for a rectified output: guess the signs, fit, take the signs of the fit, and again.

    The first guesses are the sign of the fit without the rectifier, and that of its fit to the output
    less part of its mean: where the rectifier folds much of the signal over, the mean is its trace.
    """
    plain = Chain(chain.order, chain.choices[:-1], chain.constant, chain.free_start)
    size = float(np.sqrt(np.mean(data.y[data.used] ** 2)))
    found = []
    for share in (0.0, 0.5, 1.0):
        middle = share * float(np.mean(data.y[data.used]))
        guess = _fit(plain, data, point, data.y - middle)
        for _ in range(RETRIEVALS):
            if guess is None:
                break
            run = plain.run(data, guess)
            if run is None:
                break
            sign = np.where(run.y < -1e-9 * size, -1.0, 1.0)
            guess = _fit(plain, data, guess, sign * data.y)
        if guess is not None:
            found.append(guess)
    return found


def _fit(chain: Chain, data: Data, point: Floats, y: Floats) -> Floats | None:
    """Fit a chain to another output."""
    other = Data(data.u, y, data.used, data.begin, data.period)
    end = minimise(chain, other, point, WHITE, iterations=8)
    return None if end is None else end.point
