"""A linear block of a Wiener-Hammerstein model: stable by construction, its output linear in its weights."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import ModelError
from sysid.linear.forms import (
    Complexes,
    Floats,
    denominator,
    poles_of,
    reflections_from_poles,
    section_coefficients,
    section_numerators,
)


@dataclass(frozen=True, eq=False)
class LinearBlock:
    """A stable transfer function B/A with B of the degree of A.

    Attributes
    ----------
    reflections : ndarray, shape (order,)
        Reflection coefficients of the sections of A, each in (-1, 1).
    weights : ndarray, shape (order + 1,)
        Of the Kautz columns, and of the direct term.

    Examples
    --------
    >>> LinearBlock.from_polynomials([0.5, 0.0], [1.0, -0.5]).b.round(12)
    array([0.5, 0. ])
    """

    reflections: Floats
    weights: Floats

    def __post_init__(self) -> None:
        if self.weights.shape != (self.reflections.size + 1,):
            raise ModelError(
                f"a block of order {self.reflections.size} takes {self.reflections.size + 1} weights, "
                f"{self.weights.size} were given"
            )

    @classmethod
    def from_polynomials(cls, b: ArrayLike, a: ArrayLike) -> "LinearBlock":
        """Return the block B/A; poles outside the unit circle are mirrored into it.

        Parameters
        ----------
        b, a : array_like
            Coefficients by rising powers of q^-1, ``b`` no longer than ``a``; ``a[0]`` is 1.
        """
        numerator, poly = np.array(b, dtype=np.float64), np.array(a, dtype=np.float64)
        if poly.size == 0 or poly[0] != 1.0 or numerator.size > poly.size:
            raise ModelError(
                f"b has {numerator.size} coefficients and a is {poly.tolist()}: a must begin with 1 and be "
                "at least as long as b"
            )
        return cls.from_poles(np.roots(poly).astype(np.complex128), numerator)

    @classmethod
    def from_poles(cls, poles: Complexes, b: Floats) -> "LinearBlock":
        """Return the block with these poles and the numerator ``b``, by rising powers of q^-1."""
        reflections = reflections_from_poles(poles)
        numerator = np.pad(b, (0, reflections.size + 1 - b.size))
        return cls(reflections, np.asarray(np.linalg.solve(numerator_basis(reflections).T, numerator)))

    @property
    def order(self) -> int:
        """Degree of A."""
        return int(self.reflections.size)

    @property
    def a(self) -> Floats:
        """Coefficients of A, the leading 1 included."""
        return denominator(self.reflections)

    @property
    def b(self) -> Floats:
        """Coefficients of B from q^0 on."""
        return np.asarray(self.weights @ numerator_basis(self.reflections))

    @property
    def poles(self) -> Complexes:
        """Zeros of A."""
        return poles_of(self.reflections)

    @property
    def zeros(self) -> Complexes:
        """Zeros of B."""
        return np.asarray(np.roots(self.b), dtype=np.complex128)

    @property
    def sections(self) -> tuple[Floats, Floats]:
        """Coefficients a1 and a2 of the second-order sections."""
        return section_coefficients(self.reflections)

    def response(self, frequencies: ArrayLike) -> Complexes:
        """Return the frequency response at normalised frequencies [rad/sample]."""
        delay = np.exp(-1j * np.asarray(frequencies, dtype=np.float64))
        return np.asarray(np.polyval(self.b[::-1], delay) / np.polyval(self.a[::-1], delay))

    def padded(self, order: int) -> "LinearBlock":
        """Return the same block with poles at zero added up to an order."""
        more = np.zeros(order - self.order, dtype=np.complex128)
        return LinearBlock.from_poles(np.concatenate([self.poles, more]), self.b) if more.size else self

    def scaled(self, factor: float) -> "LinearBlock":
        """Return the block with its gain multiplied."""
        return LinearBlock(self.reflections, self.weights * factor)


def numerator_basis(reflections: Floats) -> Floats:
    """Return the numerators of the Kautz columns, late by one sample, and of the direct term, one a row."""
    return _basis(*section_coefficients(reflections), reflections.size)


def coordinates(block: LinearBlock) -> Floats:
    """Return the derivatives of (a1_1, a2_1, ..., numerator) by (reflections, weights).

    Square of size 2 order + 1; the numerator is written in the columns it has at the point itself.  When the
    poles move and the weights stay, the numerator moves with the columns: these are affine in the
    coefficients of each section, so that a difference over a step of one is the derivative.
    """
    order = block.order
    a1, a2 = block.sections
    chain = np.eye(2 * order + 1)
    for place in range(0, order - 1, 2):
        k1, k2 = block.reflections[place : place + 2]
        chain[place, place : place + 2] = 1.0 + k2, k1
    here = _basis(a1, a2, order)
    moved = np.empty((order + 1, order))
    for place in range(order):
        first, second = a1.copy(), a2.copy()
        (second if place % 2 else first)[place // 2] += 1.0
        moved[:, place] = block.weights @ (_basis(first, second, order) - here)
    chain[order:, :order] = np.linalg.solve(here.T, moved) @ chain[:order, :order]
    return chain


def _basis(a1: Floats, a2: Floats, order: int) -> Floats:
    basis = np.zeros((order + 1, order + 1))
    basis[:order, 1:] = section_numerators(a1, a2, order)
    product = np.ones(1)
    for first, second in zip(a1, a2, strict=True):
        product = np.convolve(product, [1.0, first, second])
    basis[order] = product[: order + 1]
    return basis
