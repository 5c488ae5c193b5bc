"""Searches of a linear model from other poles: does another end at the least cost."""

from collections.abc import Iterator, Sequence

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.levenberg import Minimum, minimise
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.structures.structure import WHITE
from sysid.linear.forms import Complexes

# Searches agree when their root mean square errors differ by this share.
AGREEMENT = 1e-3
# Searches of a round, and standard deviations of the logarithm by which time constants are stretched.
RESTARTS, SPREADS, RESTART_SEED = 12, (0.4, 0.15, 0.05), 3
# By how much poles on the unit circle are drawn in.
DRAWN_IN = (1.0 - 1e-6, 1.0 - 1e-4, 0.99)
# Where a real pole is tried instead of another, and radius and angle of pairs.
REAL_POLES = (-0.5, 0.3, 0.7, 0.9, 0.97)
PAIRS = ((0.5, 0.5), (0.8, 0.2), (0.8, 0.8), (0.8, 2.0))


def restarted(chain: Chain, data: Data, best: Minimum) -> tuple[Minimum, bool]:
    """Search again from moved parameters; tell whether another search ends at the least cost."""
    rng, ends = np.random.default_rng(RESTART_SEED), [best]
    for _ in range(2):
        # Where the best of the first searches stands alone, more set out from there.
        for spread in (SPREADS[number % len(SPREADS)] for number in range(RESTARTS)):
            end = _from_moved_poles(chain, data, ends[0].point, spread, rng)
            if end is not None:
                ends.append(end)
        ends.sort(key=lambda end: end.cost)
        if _found_again(ends):
            break
    return ends[0], _found_again(ends)


def _from_moved_poles(
    chain: Chain, data: Data, point: Floats, spread: float, rng: np.random.Generator
) -> Minimum | None:
    """Search from poles whose time constants are stretched at random, conjugate ones alike."""
    n = chain.order
    poles = np.roots(np.concatenate([[1.0], point[:n]])).astype(complex)
    stretch = np.exp(spread * rng.standard_normal(n))
    stretch = np.where(poles.imag != 0.0, stretch[0], stretch)
    moved = np.exp(np.log(np.where(poles == 0.0, 1e-6, poles)) * stretch)
    return from_poles(chain, data, point, moved, WHITE)


def from_poles(chain: Chain, data: Data, point: Floats, poles: Complexes, noise: Floats) -> Minimum | None:
    """Search from a point with other poles, the other parameters first; None if that diverges."""
    n, start = chain.order, point.copy()
    start[:n] = np.real(np.poly(poles))[1:]
    linear = np.arange(start.size) >= n
    end = minimise(chain, data, start, noise, free=linear, iterations=2)
    return None if end is None else minimise(chain, data, end.point, noise)


def with_best(chain: Chain, data: Data, point: Floats, free: Mask) -> Floats:
    """Return a point whose free parameters, all of which the output follows linearly, are the best ones.

    Of slow poles the starts are nearly alike in what they do, so that a damped search crawls from one of them
    to the others and leaves the rest to other poles.  They are solved for, and once more for what rounding
    left.
    """
    for _ in range(2 if free.any() else 0):
        run = chain.run(data, point)
        if run is None:
            return point
        lines = chain.slopes(data, point, run, WHITE, free)
        lengths = np.linalg.norm(lines, axis=1)
        if not np.isfinite(lengths).all() or not lengths.all():
            return point
        error = chain.error(data, run, WHITE)
        step = np.linalg.lstsq((lines / lengths[:, np.newaxis]).T, error, rcond=1e-13)[0] / lengths
        moved = point.copy()
        moved[free] += step
        after = chain.run(data, moved)
        if after is None or np.sum(chain.error(data, after, WHITE) ** 2) >= np.sum(error**2):
            return point
        point = moved
    return point


def from_within_the_circle(chain: Chain, data: Data, point: Floats) -> Minimum | None:
    """Search from poles drawn in a little: several on the unit circle are outside it by rounding."""
    for radius in DRAWN_IN:
        start = point.copy()
        start[: chain.order] *= radius ** np.arange(1, chain.order + 1)
        linear = np.arange(start.size) >= chain.order
        minimum = minimise(chain, data, start, WHITE, free=linear, iterations=2)
        if minimum is not None:
            return minimise(chain, data, minimum.point, WHITE)
    return None


def exchanged_poles(point: Floats, order: int) -> Iterator[Complexes]:
    """Yield the poles of a point with a real one, or a conjugate pair, in other places."""
    poles = np.roots(np.concatenate([[1.0], point[:order]])).astype(complex)
    for i in np.flatnonzero(poles.imag == 0.0).tolist():
        for place in REAL_POLES:
            yield np.append(np.delete(poles, i), place)
    for i in np.flatnonzero(poles.imag > 0.0).tolist():
        rest = np.delete(poles, [i, int(np.argmin(np.abs(poles - poles[i].conj())))])
        for radius, angle in PAIRS:
            pole = radius * np.exp(1j * angle)
            yield np.append(rest, [pole, pole.conj()])


def _found_again(ends: Sequence[Minimum]) -> bool:
    """Tell whether a second of the searches ended at the least cost."""
    return len(ends) > 1 and ends[1].cost <= ends[0].cost * (1.0 + AGREEMENT) ** 2
