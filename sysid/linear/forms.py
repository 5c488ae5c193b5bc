"""Forms of a stable denominator: poles, second-order sections, reflection coefficients, polynomial."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

# Largest modulus of a pole that a start may have; the search itself may go on to the unit circle.
LARGEST_START = 0.9999995

# An alternation that dies out sooner is none.
LEAST_ALTERNATION = 0.3


def section_coefficients(reflections: Floats) -> tuple[Floats, Floats]:
    """Return a1, a2 of each section from its reflection coefficients.

    A section 1 + a1 q^-1 + a2 q^-2 with a2 = k2 and a1 = k1 (1 + k2) has both poles inside the unit
    circle exactly when abs(k1) < 1 and abs(k2) < 1; k1 = -1 puts a pole at 1, an integrator.  With an odd
    number of coefficients the last section is 1 + k1 q^-1.

    Examples
    --------
    >>> import numpy as np
    >>> section_coefficients(np.array([-0.5, 0.6, 0.3]))
    (array([-0.8,  0.3]), array([0.6, 0. ]))
    """
    order = reflections.size
    a1, a2 = np.zeros((order + 1) // 2), np.zeros((order + 1) // 2)
    a2[: order // 2] = reflections[1::2]
    a1[:] = reflections[::2] * (1.0 + a2)
    return a1, a2


def reflections_from_poles(poles: Complexes) -> Floats:
    """Return the reflection coefficients of sections with these poles, made stable.

    Poles outside the unit circle are mirrored into it.  Complex pairs make a section each; real
    poles are paired by size, slow with slow.
    """
    poles = np.asarray(poles, dtype=np.complex128)
    modulus = np.abs(poles)
    outside = modulus > 1.0
    poles = np.where(outside, poles / np.where(outside, modulus**2, 1.0), poles)
    poles = np.where(
        np.abs(poles) > LARGEST_START, poles * LARGEST_START / np.maximum(np.abs(poles), 1e-300), poles
    )
    upper = poles[poles.imag > 1e-12]
    real = np.sort(poles[np.abs(poles.imag) <= 1e-12].real)[::-1]
    reflections: list[float] = []
    for pole in upper:
        reflections.extend(_section(-2.0 * pole.real, abs(pole) ** 2))
    for first, second in zip(real[: real.size // 2 * 2 : 2], real[1::2], strict=True):
        reflections.extend(_section(-(first + second), first * second))
    if real.size % 2:
        reflections.append(-float(real[-1]))
    return np.array(reflections)


def _section(a1: float, a2: float) -> tuple[float, float]:
    a2 = max(a2, -0.998)
    return float(np.clip(a1 / (1.0 + a2), -1.0, 1.0)), float(a2)


def poles_of(reflections: Floats) -> Complexes:
    """Return the poles, those of largest modulus first."""
    found: list[complex] = []
    a1, a2 = section_coefficients(reflections)
    for j, (first, second) in enumerate(zip(a1.tolist(), a2.tolist(), strict=True)):
        if 2 * j + 1 < reflections.size:
            # The quadratic formula that does not cancel.
            root = np.sqrt(complex(first * first - 4.0 * second))
            large = -0.5 * (first + root) if abs(first + root) >= abs(first - root) else -0.5 * (first - root)
            found.extend([complex(large), complex(second / large if large != 0 else 0.0)])
        else:
            found.append(complex(-first))
    return np.array(sorted(found, key=lambda pole: (-round(abs(pole), 12), -pole.imag)), dtype=np.complex128)


def without_alternation(poles: Complexes) -> Complexes | None:
    """Return the poles with those on the negative real axis mirrored; None if there are none to speak of.

    A pole there alternates from one sample to the next, which no sampled plant does by itself: an order
    that is hard to see often ends so, at a minimum that all common starts lead to.

    Examples
    --------
    >>> without_alternation(np.array([0.5, -0.9])), without_alternation(np.array([0.5, -0.1]))
    (array([0.5, 0.9]), None)
    """
    alternates = (np.imag(poles) == 0.0) & (np.real(poles) < -LEAST_ALTERNATION)
    return np.where(alternates, -poles, poles) if alternates.any() else None


def denominator(reflections: Floats) -> Floats:
    """Return A(q), shape (order + 1,), with leading 1."""
    a1, a2 = section_coefficients(reflections)
    product = np.ones(1)
    for first, second in zip(a1, a2, strict=True):
        product = np.convolve(product, [1.0, first, second])
    return product[: reflections.size + 1]


def kautz_numerators(reflections: Floats) -> Floats:
    """Return the numerators over A of the Kautz columns, shape (order, order)."""
    return section_numerators(*section_coefficients(reflections), reflections.size)


def section_numerators(a1: Floats, a2: Floats, order: int) -> Floats:
    """Return the numerators over A of the Kautz columns of sections, shape (order, order)."""
    sections = [
        np.array([1.0, f, s][: 2 + (2 * j + 1 < order)]) for j, (f, s) in enumerate(zip(a1, a2, strict=True))
    ]
    rows = np.zeros((order, order))
    for j, section in enumerate(sections):
        common = np.ones(1)
        for i, other in enumerate(sections):
            if i != j:
                common = np.convolve(common, other[::-1] if i < j else other)
        if section.size == 3:
            rows[2 * j] = np.convolve(common, [1.0, 1.0])
            rows[2 * j + 1] = np.convolve(common, [1.0, -1.0])
        else:
            rows[2 * j] = common
    return rows
