"""What every input nonlinearity offers, and the checks at its public boundary."""

import math
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import ModelError, UsageError
from sysid.nonlinearities.kernels import PieceArrays
from sysid.separable.pieces import AffinePieces

Floats = NDArray[np.float64]


class Nonlinearity(ABC):
    """An input nonlinearity x = N(u, a) with unit gain.

    Attributes
    ----------
    name : str
        Identifier in kebab-case, the key in ``NONLINEARITIES``.
    title : str
        Name for tables and figures.
    parameters : tuple of str
        Names of the parameters, in the order in which every method takes them.
    """

    name: str
    title: str
    parameters: tuple[str, ...]

    @abstractmethod
    def __call__(self, u: ArrayLike, *parameters: float) -> Floats:
        """Return the output x, in the shape of ``u``."""

    @abstractmethod
    def slope(self, u: ArrayLike, *parameters: float) -> Floats:
        """Return the derivative of x with respect to the parameters; the right one at a kink."""

    def _checked(self, parameters: tuple[float, ...]) -> tuple[float, ...]:
        if len(parameters) != len(self.parameters):
            raise ModelError(
                f"{self.name}: {len(parameters)} parameters were given; it takes {len(self.parameters)}: "
                f"{', '.join(self.parameters)}."
            )
        return tuple(
            checked_threshold(f"{self.name}: parameter {name}", value)
            for name, value in zip(self.parameters, parameters, strict=True)
        )


class OneParameterMap(Nonlinearity):
    """A nonlinearity with one threshold, affine in it between knots."""

    parameters: tuple[str, ...] = ("a",)

    @abstractmethod
    def piece_arrays(self, u: Floats, lower: float, upper: float) -> PieceArrays:
        """Return the arrays of :meth:`pieces` without any check, for estimators' inner loops.

        ``u`` must be a contiguous, writeable float array of shape (n_samples,).
        """

    def pieces(self, u: ArrayLike, lower: float, upper: float) -> AffinePieces:
        """Return the output as a function of the parameter on ``[lower, upper]``.

        Parameters
        ----------
        u : array_like, shape (n_samples,)
            Input.
        lower, upper : float
            Range of the parameter, ``0 <= lower < upper``.

        Raises
        ------
        UsageError
            If ``u`` is not one finite sequence or the range is empty or negative.
        """
        lower, upper = checked_range(self.name, lower, upper)
        return AffinePieces(lower, upper, *self.piece_arrays(checked_sequence(self.name, u), lower, upper))


def checked_threshold(what: str, value: float) -> float:
    """Return ``value`` as a nonnegative finite float."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (number >= 0.0 and math.isfinite(number)):
        raise ModelError(f"{what} is {value!r}; give a finite number >= 0.")
    return number


def checked_range(what: str, lower: float, upper: float) -> tuple[float, float]:
    """Return the ends of a parameter range ``0 <= lower < upper``."""
    if not (0.0 <= lower < upper and math.isfinite(upper)):
        raise UsageError(f"{what}: the range [{lower}, {upper}] is unusable; give finite 0 <= lower < upper.")
    return float(lower), float(upper)


def checked_input(what: str, u: ArrayLike) -> Floats:
    """Return ``u`` as a contiguous array of finite floats, of its own shape."""
    try:
        given = np.asarray(u)
    except ValueError:
        given = np.array(None)
    if given.dtype.kind not in "biuf":
        raise UsageError(
            f"{what}: the input is not an array of real numbers but {type(u).__name__}; give one."
        )
    values = np.require(given, np.float64, ["C", "W"])
    if not np.isfinite(values).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(values))[0])
        raise UsageError(
            f"{what}: the input at index {where[0] if len(where) == 1 else where} is {values[where]}; "
            "remove or fill values that are not finite."
        )
    return values


def checked_sequence(what: str, u: ArrayLike) -> Floats:
    """Return ``u`` as a contiguous sequence of finite floats, shape (n_samples,)."""
    values = checked_input(what, u)
    if values.ndim != 1:
        raise UsageError(
            f"{what}: the input has shape {values.shape}; give one sequence of shape (n_samples,)."
        )
    return values
