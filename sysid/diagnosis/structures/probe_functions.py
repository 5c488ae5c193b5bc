"""Functions of the signals of a model in which an effect outside any list would show."""

from collections.abc import Iterator

import numpy as np

from sysid.diagnosis.effects.base import Floats

DEGREES = (2, 3, 4, 5)
DRIFT_DEGREES = (0, 1, 2, 3)
# The polynomials' range, in standard deviations of their signal.
RANGE = 3.0
# Lags of the input beyond those of the model.
EXTRA_LAGS = 8
# Which of the functions ask the same: whether a curve, a product, a drift, a gain that varies is missing.
_KINDS = (
    slice(0, 5),
    slice(5, 10),
    slice(10, 15),
    slice(15, 29),
    slice(29, 33),
    slice(33, 37),
    slice(37, 41),
)
FUNCTIONS = _KINDS[-1].stop


def probe_functions(
    u: Floats, u_before: Floats, position: Floats, speed: Floats, time: Floats
) -> Iterator[Floats]:
    """Yield functions of input, position and speed, of their products, and of time.

    Parameters
    ----------
    u, u_before : ndarray, shape (n_rows,)
        Input, and the input a sample before.
    position, speed : ndarray, shape (n_rows,)
        Of the model.
    time : ndarray, shape (n_rows,)
        From -1 to 1.
    """
    rise = _scaled(u - u_before)
    signals = [_scaled(signal) for signal in (u, position, speed)]
    for signal in signals:
        for degree in DEGREES:
            yield _legendre(degree, np.clip(signal / RANGE, -1.0, 1.0))
        yield np.sign(signal)
    u, position, speed = signals
    before = _scaled(u_before)
    yield from (u * position, u * speed, position * speed, u * before, np.sign(rise), np.abs(rise))
    yield from (u * np.sign(speed), position * np.abs(speed), position**2 * speed, u * np.abs(rise))
    yield from (u**2 * before, u * before**2, position**2 * u, np.sign(speed) * np.abs(position))
    for factor in (np.ones(u.size), u, position):
        for degree in DRIFT_DEGREES:
            yield factor * _legendre(degree, time)


def families(n_probes: int) -> list[slice]:
    """Return which of a structure's probes ask the same.

    Parameters
    ----------
    n_probes : int
        Of `probe_functions` for each place where they are added, one after the other, and of other
        directions behind them.

    Examples
    --------
    >>> families(2 * FUNCTIONS + 11)[-2:]
    [slice(78, 82, None), slice(82, 93, None)]
    >>> families(9)
    [slice(0, 9, None)]
    """
    places = n_probes // FUNCTIONS
    found = [
        slice(place * FUNCTIONS + kind.start, place * FUNCTIONS + kind.stop)
        for place in range(places)
        for kind in _KINDS
    ]
    rest = slice(places * FUNCTIONS, n_probes)
    return [*found, rest] if rest.stop > rest.start else found


def _legendre(degree: int, x: Floats) -> Floats:
    return np.asarray(np.polynomial.legendre.Legendre.basis(degree)(x))


def _scaled(signal: Floats) -> Floats:
    return np.asarray(signal / (float(np.std(signal)) or 1.0))
