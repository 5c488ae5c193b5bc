"""Nonlinearities with memory: hysteresis relay and hysteresis, as printed and as physically meant.

Before the first sample the input was ``previous_input`` and the output ``initial_output``, both
zero unless said otherwise: a relay that has never been switched gives 0.
"""

import math
from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sysid.distributions import Distribution, PiecewiseUniform, Uniform
from sysid.errors import ModelError, UsageError
from sysid.nonlinearities.base import Floats, OneParameterMap, checked_sequence
from sysid.nonlinearities.kernels import (
    PieceArrays,
    direction_play_pieces,
    direction_play_response,
    direction_relay_pieces,
    direction_relay_response,
    play_pieces,
    play_response,
    schmitt_pieces,
    schmitt_response,
)


class MemoryMap(OneParameterMap):
    """A map whose output depends on the input so far; ``u`` is one sequence in time."""

    def __call__(self, u: ArrayLike, *parameters: float) -> Floats:
        """Return the output x, shape (n_samples,).

        Raises
        ------
        ModelError
            If the parameter is negative or not finite.
        UsageError
            If the input is not one finite sequence.
        """
        return self._response(checked_sequence(self.name, u), *self._checked(parameters))[0]

    def slope(self, u: ArrayLike, *parameters: float) -> Floats:
        """Return dx/da, shape (n_samples,); the right derivative where x has a kink in a."""
        return self._response(checked_sequence(self.name, u), *self._checked(parameters))[1]

    def moment(self, distribution: Uniform, *parameters: float) -> float:
        """Return q = E[x(k) u(k)] in closed form, in the stationary state under i.i.d. inputs.

        Parameters
        ----------
        distribution : Uniform
            A symmetric uniform distribution on [-b, b].
        *parameters : float
            The threshold a < b.

        Raises
        ------
        UsageError
            If the distribution is another one or does not reach the threshold.

        Examples
        --------
        >>> SchmittTrigger().moment(Uniform.symmetric(4.0), 1.0)
        1.875
        """
        b, a = self._width(distribution, *self._checked(parameters))
        return self._moment(b, a)

    def moment_by_quadrature(self, distribution: Uniform, *parameters: float) -> float:
        """Return E[x(k) u(k)] by quadrature over the input and what the map remembers of the past."""
        b, a = self._width(distribution, *self._checked(parameters))

        def given_input(u: float) -> float:
            def given_memory(memory: float) -> float:
                return float(self._remembering(memory)._response(np.array([u]), a)[0][0])

            return u * self._memory(b, a).expectation(given_memory, (u - a, u, u + a))

        return distribution.expectation(given_input, (-a, a, 2 * a - b, b - 2 * a))

    def _width(self, distribution: Uniform, a: float) -> tuple[float, float]:
        if not isinstance(distribution, Uniform) or distribution.low != -distribution.high:
            raise UsageError(f"{self.name}: the moment is known for Uniform(-b, b), not {distribution!r}.")
        if a >= distribution.high:
            raise UsageError(
                f"{self.name}: the input reaches only {distribution.high:g}; "
                f"widen it beyond the threshold {a:g}."
            )
        return distribution.high, a

    @abstractmethod
    def _moment(self, b: float, a: float) -> float:
        """Return E[x u] for inputs uniform on [-b, b]."""

    @abstractmethod
    def _memory(self, b: float, a: float) -> Distribution:
        """Return the stationary distribution of what the map remembers."""

    @abstractmethod
    def _remembering(self, memory: float) -> "MemoryMap":
        """Return the map with that memory."""

    @abstractmethod
    def _response(self, u: Floats, a: float) -> tuple[Floats, Floats]:
        """Return x and dx/da of checked arguments."""


@dataclass(frozen=True)
class HysteresisRelay(MemoryMap):
    """Hysteresis relay as printed, ``x_re`` in Eq. (1.4) of Bai (2002).

    sgn u for |u| > a; otherwise 1 when the input falls, -1 when it rises, held when it stays.

    Examples
    --------
    >>> HysteresisRelay()([2.0, 0.5, 0.7, 0.7, -2.0], 1.0)
    array([ 1.,  1., -1., -1., -1.])
    """

    previous_input: float = 0.0
    initial_output: float = 0.0
    name = "hysteresis-relay"
    title = "Hysteresis relay (printed)"

    def __post_init__(self) -> None:
        _check_state(self.name, previous_input=self.previous_input, initial_output=self.initial_output)

    def _response(self, u: Floats, a: float) -> tuple[Floats, Floats]:
        x = direction_relay_response(u, a, self.previous_input, self.initial_output)
        return x, np.zeros(u.size)

    def _moment(self, b: float, a: float) -> float:
        # Inside the band x is the sign of u(k-1) - u(k), whose mean given u is -u/b.
        return (b**2 - a**2) / (2 * b) - a**3 / (3 * b**2)

    def _memory(self, b: float, a: float) -> Distribution:
        return Uniform.symmetric(b)

    def _remembering(self, memory: float) -> "HysteresisRelay":
        return HysteresisRelay(previous_input=memory)

    def piece_arrays(self, u: Floats, lower: float, upper: float) -> PieceArrays:
        """Return the arrays of :meth:`pieces` without any check, for estimators' inner loops.

        ``u`` must be a contiguous, writeable float array of shape (n_samples,).
        """
        return direction_relay_pieces(u, lower, upper, self.previous_input, self.initial_output)


@dataclass(frozen=True)
class SchmittTrigger(MemoryMap):
    """Hysteresis relay that holds its state: 1 when u > a, -1 when u < -a, else as before.

    Examples
    --------
    >>> SchmittTrigger()([0.5, 2.0, 0.5, 0.7, -2.0, 0.9], 1.0)
    array([ 0.,  1.,  1.,  1., -1., -1.])
    """

    initial_output: float = 0.0
    name = "hysteresis-relay-schmitt"
    title = "Hysteresis relay (Schmitt trigger)"

    def __post_init__(self) -> None:
        _check_state(self.name, initial_output=self.initial_output)

    def _response(self, u: Floats, a: float) -> tuple[Floats, Floats]:
        return schmitt_response(u, a, self.initial_output), np.zeros(u.size)

    def _moment(self, b: float, a: float) -> float:
        # Inside the band the output is that of an earlier sample, independent of u(k).
        return (b**2 - a**2) / (2 * b)

    def _memory(self, b: float, a: float) -> Distribution:
        return PiecewiseUniform((), masses=((-1.0, 0.5), (1.0, 0.5)))

    def _remembering(self, memory: float) -> "SchmittTrigger":
        return SchmittTrigger(initial_output=memory)

    def piece_arrays(self, u: Floats, lower: float, upper: float) -> PieceArrays:
        """Return the arrays of :meth:`pieces` without any check, for estimators' inner loops.

        ``u`` must be a contiguous, writeable float array of shape (n_samples,).  A random input
        has about N log N events; one whose swings only ever shrink has N^2 / 2.
        """
        return schmitt_pieces(u, lower, upper, self.initial_output)


@dataclass(frozen=True)
class Hysteresis(MemoryMap):
    """Hysteresis as printed, ``x_hy`` in Eq. (1.4) of Bai (2002).

    u - a when the input rises, u + a when it falls, held when it stays.

    Examples
    --------
    >>> Hysteresis()([2.0, 1.0, 1.0, 1.5], 0.5)
    array([1.5, 1.5, 1.5, 1. ])
    """

    previous_input: float = 0.0
    initial_output: float = 0.0
    name = "hysteresis"
    title = "Hysteresis (printed)"

    def __post_init__(self) -> None:
        _check_state(self.name, previous_input=self.previous_input, initial_output=self.initial_output)

    def _response(self, u: Floats, a: float) -> tuple[Floats, Floats]:
        return direction_play_response(u, a, self.previous_input, self.initial_output)

    def _moment(self, b: float, a: float) -> float:
        # The mean of sgn(u(k) - u(k-1)) given u(k) = u is u/b, and E[u^2]/b = b/3.
        return b**2 / 3 - a * b / 3

    def _memory(self, b: float, a: float) -> Distribution:
        return Uniform.symmetric(b)

    def _remembering(self, memory: float) -> "Hysteresis":
        return Hysteresis(previous_input=memory)

    def piece_arrays(self, u: Floats, lower: float, upper: float) -> PieceArrays:
        """Return the arrays of :meth:`pieces` without any check, for estimators' inner loops.

        ``u`` must be a contiguous, writeable float array of shape (n_samples,).
        """
        return direction_play_pieces(u, lower, upper, self.previous_input, self.initial_output)


@dataclass(frozen=True)
class Play(MemoryMap):
    """Play operator (backlash): x(k) = min(max(x(k-1), u(k) - a), u(k) + a).

    Examples
    --------
    >>> Play()([2.0, 1.8, 1.0, 1.5], 0.5)
    array([1.5, 1.5, 1.5, 1.5])
    """

    initial_output: float = 0.0
    name = "hysteresis-play"
    title = "Hysteresis (play operator)"

    def __post_init__(self) -> None:
        _check_state(self.name, initial_output=self.initial_output)

    def _response(self, u: Floats, a: float) -> tuple[Floats, Floats]:
        return play_response(u, a, self.initial_output)

    def _moment(self, b: float, a: float) -> float:
        # The output is uniform on [-(b - a), b - a]: where it may be left at the rate 1 - a/b it is
        # entered with the density 1/(2b).
        return (2 * b**3 / 3 - a * b**2 + a * (b - a) ** 2 / 3 + a**3 / 3) / (2 * b)

    def _memory(self, b: float, a: float) -> Distribution:
        return Uniform.symmetric(b - a)

    def _remembering(self, memory: float) -> "Play":
        return Play(initial_output=memory)

    def piece_arrays(self, u: Floats, lower: float, upper: float) -> PieceArrays:
        """Return the arrays of :meth:`pieces` without any check, for estimators' inner loops.

        ``u`` must be a contiguous, writeable float array of shape (n_samples,).  A random input
        has about N log N events; one whose swings only ever shrink has N^2 / 2.
        """
        return play_pieces(u, lower, upper, self.initial_output)


def _check_state(name: str, **state: float) -> None:
    for key, value in state.items():
        if not math.isfinite(value):
            raise ModelError(f"{name}: {key} is {value}; give a finite number.")


HYSTERESIS_RELAY = HysteresisRelay()
SCHMITT_TRIGGER = SchmittTrigger()
HYSTERESIS = Hysteresis()
PLAY = Play()
