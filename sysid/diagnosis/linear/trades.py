"""Where a zero or pole of the plant and that of a delay or lag can change places without any change."""

from collections.abc import Iterator

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.rows import Data

DELAYS, LAG = ("in_delay", "out_delay"), "out_lowpass"
# Roots with a larger imaginary part, as a share of their size, are half of a pair.
REAL = 1e-9


def traded(chain: Chain, data: Data, point: Floats) -> Iterator[tuple[int, Floats]]:
    """Yield the position of a delay or lag and a point with the same free run but for its first rows.

    A delay by a part p of a sample is (1 - p) + p q^-1, whose zero is -p / (1 - p): any negative zero of B(q)
    is that of another delay.  A lag has a pole like any other.
    """
    n = chain.order
    for choice, place in zip(chain.choices, chain.places(data), strict=True):
        if choice.name not in (*DELAYS, LAG):
            continue
        value = float(point[place.start]) / data.period
        if choice.name in DELAYS:
            whole, part = divmod(value, 1.0)
            for zero in _real_roots(point[n : 2 * n]):
                if zero < 0.0:
                    other = zero / (zero - 1.0)
                    moved = point.copy()
                    moved[n : 2 * n] = _exchanged(point[n : 2 * n], [1.0 - part, part], [1.0 - other, other])
                    moved[place.start] = (whole + other) * data.period
                    yield place.start, moved
        elif value > 0.0:
            own, a = float(np.exp(-1.0 / value)), np.concatenate([[1.0], point[:n]])
            for pole in _real_roots(a):
                if 0.0 < pole < 1.0:
                    moved = point.copy()
                    moved[:n] = _exchanged(a, [1.0, -own], [1.0, -pole])[1:]
                    moved[n : 2 * n] *= (1.0 - own) / (1.0 - pole)
                    moved[place.start] = -data.period / np.log(pole)
                    yield place.start, moved


def _real_roots(polynomial: Floats) -> Floats:
    roots = np.roots(polynomial).astype(complex)
    return np.asarray(roots[np.abs(roots.imag) <= REAL * np.abs(roots)].real)


def _exchanged(polynomial: Floats, into: list[float], out: list[float]) -> Floats:
    """Return a polynomial with one factor put in and another one, of which it has the root, taken out."""
    quotient, _ = np.polydiv(np.convolve(polynomial, into), np.array(out))
    return np.asarray(quotient)
