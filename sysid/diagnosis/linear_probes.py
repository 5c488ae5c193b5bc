"""Directions in which an effect outside any list would show in a linear model with effects."""

from collections.abc import Iterator

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear_chain import Chain, Data
from sysid.diagnosis.linear_kernels import tangent

DEGREES = (2, 3, 4, 5)
EXTRA_LAGS = 8


def probe_directions(chain: Chain, data: Data, point: Floats) -> Floats:
    """Return the directions, shape (n_probes, n_rows).

    Functions of the input, the modelled output and its speed, of their products and of time, added to
    the output and, through the model's dynamics with its effects, to its input; and further lags of the
    input.
    """
    run = chain.run(data, point)
    if run is None:
        return np.empty((0, data.u.size))
    n = chain.order
    functions = np.array(list(_functions(data, run.z)))
    _, by_position, by_speed = chain.drive_slopes(data, point, run)
    through = tangent(
        run.z, run.v, point[:n], point[n : 2 * n], data.begin, False, False,
        bool(chain.drives), by_position, by_speed, functions,
    )[2 * n :]  # fmt: skip
    through = chain.through_sensor(data, point, run, through)
    lags = [_lagged(data, data.u, lag) for lag in range(2 * n + EXTRA_LAGS + 1)]
    return np.vstack([functions, through, lags])


def _functions(data: Data, z: Floats) -> Iterator[Floats]:
    u_before = _lagged(data, data.u, 1)
    speed = z - _lagged(data, z, 1)
    rise = data.u - u_before
    signals = [_scaled(signal) for signal in (data.u, z, speed)]
    for signal in signals:
        for degree in DEGREES:
            yield np.polynomial.legendre.Legendre.basis(degree)(np.clip(signal / 3.0, -1.0, 1.0))
        yield np.sign(signal)
    u, position, velocity = signals
    rise, before = _scaled(rise), _scaled(u_before)
    yield from (u * position, u * velocity, position * velocity, u * before, np.sign(rise), np.abs(rise))
    yield from (u * np.sign(velocity), position * np.abs(velocity), position**2 * velocity, u * np.abs(rise))
    yield from (u**2 * before, u * before**2, position**2 * u, np.sign(velocity) * np.abs(position))
    time = np.arange(data.u.size) - np.repeat(data.begin[:-1], np.diff(data.begin))
    time = 2.0 * time / max(float(time.max()), 1.0) - 1.0
    for factor in (np.ones(time.size), u, position):
        for degree in (0, 1, 2, 3):
            yield factor * np.polynomial.legendre.Legendre.basis(degree)(time)


def _scaled(signal: Floats) -> Floats:
    return signal / (float(np.std(signal)) or 1.0)


def _lagged(data: Data, signal: Floats, lag: int) -> Floats:
    """Delay a signal by whole samples within each experiment."""
    out = np.zeros_like(signal)
    for i, j in zip(data.begin[:-1], data.begin[1:], strict=True):
        out[i + lag : j] = signal[i : max(j - lag, i)]
    return out
