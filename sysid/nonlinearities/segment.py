"""Two straight segments with preload and dead zone, a side each: Giri's hard nonlinearity."""

from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import ModelError
from sysid.nonlinearities.base import Floats, Nonlinearity, checked_input


@dataclass(frozen=True)
class SegmentMap(Nonlinearity):
    """Two segments of their own slope, each beyond its own dead zone and with its own preload.

    F(v) = K1 (v - D1) + L1 for v > D1, K2 (v - D2) + L2 for v < D2, 0 between (figure 2 of Giri,
    Rochdi and Chaoui).  D2 carries its sign, so D2 <= 0 <= D1; a slope or a preload may have any sign.

    Examples
    --------
    >>> SEGMENT([-3.0, 0.5, 3.0], 1.0, 2.0, 1.0, -2.0, 1.0, -2.0)
    array([-4.,  0.,  3.])
    """

    name: str = "segment"
    title: str = "Two segments with preload and dead zone"
    parameters: tuple[str, ...] = ("K1", "K2", "D1", "D2", "L1", "L2")

    def __call__(self, u: ArrayLike, *parameters: float) -> Floats:
        """Return the output x, in the shape of ``u``.

        Raises
        ------
        ModelError
            If a parameter is not finite or a dead zone has the wrong sign.
        UsageError
            If the input is not finite.
        """
        K1, K2, D1, D2, L1, L2 = self._checked(parameters)
        v = checked_input(self.name, u)
        positive, negative = K1 * (v - D1) + L1, K2 * (v - D2) + L2
        return np.where(v > D1, positive, np.where(v < D2, negative, 0.0))

    def slope(self, u: ArrayLike, *parameters: float) -> Floats:
        """Return dx/d(K1, K2, D1, D2, L1, L2), shape (..., 6); zero inside the dead zone."""
        K1, K2, D1, D2, _, _ = self._checked(parameters)
        v = checked_input(self.name, u)
        above, below = v > D1, v < D2
        zero = np.zeros_like(v)
        columns = (
            np.where(above, v - D1, zero),
            np.where(below, v - D2, zero),
            np.where(above, -K1, zero),
            np.where(below, -K2, zero),
            np.where(above, 1.0, zero),
            np.where(below, 1.0, zero),
        )
        return np.stack(columns, axis=-1)

    def _checked(self, parameters: tuple[float, ...]) -> tuple[float, ...]:
        if len(parameters) != len(self.parameters):
            raise ModelError(
                f"{self.name}: {len(parameters)} parameters were given; it takes {len(self.parameters)}: "
                f"{', '.join(self.parameters)}."
            )
        values = tuple(float(value) for value in parameters)
        for name, value in zip(self.parameters, values, strict=True):
            if not np.isfinite(value):
                raise ModelError(f"{self.name}: parameter {name} is {value}; give a finite number.")
        if values[2] < 0.0:
            raise ModelError(f"{self.name}: D1 is {values[2]:g}; the end of the dead zone must be >= 0.")
        if values[3] > 0.0:
            raise ModelError(f"{self.name}: D2 is {values[3]:g}; it carries its sign, so it must be <= 0.")
        return values


SEGMENT = SegmentMap()
"""Giri's map; the dead zone, the preload and their two-sided kin are special cases."""


@dataclass(frozen=True)
class Segments:
    """One `SegmentMap` with its parameters.

    Attributes
    ----------
    K1, K2 : float
        Slopes of the positive and the negative segment.
    D1, D2 : float
        Ends of the dead zone, D2 <= 0 <= D1, in the unit of the input.
    L1, L2 : float
        Outputs where the segments begin.

    Examples
    --------
    >>> Segments(1.0, 2.0, 1.0, -2.0, 1.0, -2.0).offsets
    (0.0, 2.0)
    """

    K1: float
    K2: float
    D1: float = 0.0
    D2: float = 0.0
    L1: float = 0.0
    L2: float = 0.0

    def __post_init__(self) -> None:
        SEGMENT._checked(astuple(self))

    def __call__(self, v: ArrayLike) -> Floats:
        """Return the output, in the shape of ``v``."""
        return SEGMENT(v, *astuple(self))

    @property
    def offsets(self) -> tuple[float, float]:
        """Where the two segments, prolonged, meet v = 0: (H1, H2), eq. (3.15)."""
        return self.L1 - self.K1 * self.D1, self.L2 - self.K2 * self.D2
