"""What every recursive estimator offers: update, run, snapshot, save and restore."""

import json
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import DataError, ModelError, UsageError
from sysid.recursive.kernels import regressor_rows

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

SCHEMA = 1
LEVEL_TOLERANCE = 1e-9
"""An input this close to a level, relative to the largest level, is that level."""


@dataclass(frozen=True)
class Snapshot:
    """State of the estimate after some samples.

    Attributes
    ----------
    samples : int
        Updates so far.
    theta : ndarray, shape (order * (1 + n_levels),)
        a_1 .. a_n, then mu_1j .. mu_nj for each level j, eq. (3.8c) of Giri et al.
    order : int
        Order n of the linear system.
    levels : tuple of float
        The input levels V_j.
    """

    samples: int
    theta: Floats
    order: int
    levels: tuple[float, ...]

    @property
    def a(self) -> Floats:
        """Coefficients a_1 .. a_n of A(q) = 1 + a_1 q^-1 + ..., shape (order,)."""
        return self.theta[: self.order]

    @property
    def composite(self) -> Floats:
        """The matrix M of eq. (3.9), mu_ij = b_i d_j, shape (order, n_levels)."""
        return self.theta[self.order :].reshape(len(self.levels), self.order).T


class Levels:
    """The input levels of an experiment: numbers them, refuses any other value."""

    def __init__(self, levels: ArrayLike) -> None:
        try:
            self.values = np.array(levels, dtype=np.float64)
        except (TypeError, ValueError) as problem:
            raise UsageError(f"levels must be a sequence of numbers ({problem})") from None
        values = self.values
        if values.ndim != 1 or values.size == 0 or not np.all(np.isfinite(values)):
            raise UsageError(f"levels are {levels!r}: give a sequence of finite numbers")
        if np.any(values == 0.0):
            raise UsageError("one of the levels is 0: zero is always allowed, so leave it out")
        if np.unique(values).size != values.size:
            raise UsageError(f"levels {values.tolist()} are not distinct: give each once")
        self._number: dict[float, int] = {0.0: -1} | {value: j for j, value in enumerate(values.tolist())}
        self._tolerance = LEVEL_TOLERANCE * float(np.abs(values).max())

    def number(self, u: float) -> int:
        """Return the number of the level of one input value, -1 for zero."""
        found = self._number.get(u)
        return self._nearest(u, "the input") if found is None else found

    def numbers(self, u: Floats) -> Indices:
        """Return the number of the level of each input value, shape (n_samples,)."""
        found = np.full(u.size, -2, dtype=np.int64)
        for value, number in self._number.items():
            found[np.abs(u - value) <= self._tolerance] = number
        for row in np.flatnonzero(found == -2)[:1]:
            self._nearest(float(u[row]), f"input value {row}")
        return found

    def _nearest(self, u: float, what: str) -> int:
        for value, number in self._number.items():
            if abs(u - value) <= self._tolerance:
                return number
        allowed = ", ".join(f"{value:g}" for value in sorted(self._number))
        raise DataError(
            f"{what} is {u:g}, which is none of the levels {allowed}: the polynomial representation holds "
            "only there; use these levels alone or name further ones"
        )


class Recursive(ABC):
    """A recursive estimator of a Hammerstein system driven at a few input levels.

    At the levels V_j any static map F equals a polynomial P with P(0) = F(0) = 0 (eqs. (3.2)-(3.5) of
    Giri et al.), so that y(t) = Phi(t)^T theta + eta(t) is linear in theta = (a_i, b_i d_j) with
    d_j = F(V_j) / V_j.

    Parameters
    ----------
    order : int
        Order n of the linear system.
    levels : array_like, shape (n_levels,)
        Values the input takes beside zero, distinct and not zero.
    start : array_like, shape (order * (1 + n_levels),), optional
        First estimate; zero by default.

    Raises
    ------
    UsageError
        If the order is not positive, a level is zero or repeated, or the start has the wrong length.
    """

    algorithm: ClassVar[str]
    _registered: ClassVar[dict[str, type["Recursive"]]] = {}

    def __init__(self, order: int, levels: ArrayLike, *, start: ArrayLike | None = None) -> None:
        if isinstance(order, bool) or not isinstance(order, int | np.integer) or order < 1:
            raise UsageError(f"the order is {order!r}: give an integer from 1")
        self.order = int(order)
        self._levels = Levels(levels)
        n_parameters = self.order * (1 + self._levels.values.size)
        self._theta = np.zeros(n_parameters) if start is None else np.array(start, dtype=np.float64)
        if self._theta.shape != (n_parameters,) or not np.all(np.isfinite(self._theta)):
            raise UsageError(
                f"the start has shape {self._theta.shape}: give {n_parameters} finite numbers, "
                f"{self.order} for a and {self.order} for each of {self._levels.values.size} levels"
            )
        self._phi = np.zeros(n_parameters)
        self.samples = 0

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        cls._registered[cls.algorithm] = cls

    @property
    def levels(self) -> tuple[float, ...]:
        """The input levels."""
        return tuple(self._levels.values.tolist())

    @property
    def theta(self) -> Floats:
        """The present estimate (a copy), shape (order * (1 + n_levels),)."""
        return self._theta.copy()

    @property
    def regressor(self) -> Floats:
        """The regressor (3.8b) of the next sample (a copy), shape (order * (1 + n_levels),)."""
        return self._phi.copy()

    def update(self, u: float, y: float) -> float:
        """Take one sample of a stream.

        Parameters
        ----------
        u : float
            Input of this sample: zero or a level.
        y : float
            Output of this sample.

        Returns
        -------
        float
            Prediction error e(t) = y(t) - Phi(t)^T theta(t - 1), eq. (4.1b).

        Raises
        ------
        DataError
            If y is not finite or u is no level; the estimate is then as before.
        """
        try:
            u, y = float(u), float(y)
        except (TypeError, ValueError):
            raise DataError(
                f"sample {self.samples} is (u, y) = ({u!r}, {y!r}): give two real numbers"
            ) from None
        number = self._levels.number(u)
        if not math.isfinite(y):
            raise DataError(
                f"output value {self.samples} is {y}: leave the sample out with `restart()` after a gap, or "
                "fill it"
            )
        self.samples += 1
        return self._step(number, self._levels.values[number] if number >= 0 else 0.0, y)

    def run(self, u: ArrayLike, y: ArrayLike, *, every: int = 1) -> tuple[Floats, Floats]:
        """Take many samples in one compiled loop; the same numbers as `update` one by one.

        Parameters
        ----------
        u, y : array_like, shape (n_samples,)
        every : int
            Keep the estimate after every so many samples.

        Returns
        -------
        kept : ndarray, shape (n_samples // every, n_parameters)
            Estimates after every, 2 every, ... samples.
        errors : ndarray, shape (n_samples,)
            Prediction errors.

        Raises
        ------
        DataError
            If the lengths differ, a value is not finite or an input is no level.
        """
        if every < 1:
            raise UsageError(f"every is {every}: keep the estimate after every 1 or more samples")
        signal, output = checked_pair(u, y)
        numbers = self._levels.numbers(signal)
        kept, errors = np.empty((signal.size // every, self._theta.size)), np.empty(signal.size)
        self._steps(numbers, output, errors, kept, every)
        self.samples += signal.size
        return kept, errors

    def restart(self) -> None:
        """Forget the lagged samples, not the estimate: after a gap, with the plant at rest again."""
        self._phi[:] = 0.0

    def snapshot(self) -> Snapshot:
        """Return the present estimate by name."""
        return Snapshot(self.samples, self.theta, self.order, self.levels)

    def to_json(self) -> str:
        """Return the whole state as JSON text; `from_json` goes on from it to the bit."""
        state: dict[str, Any] = {
            "schema": SCHEMA,
            "algorithm": self.algorithm,
            "order": self.order,
            "levels": list(self.levels),
            "samples": self.samples,
            "theta": self._theta.tolist(),
            "regressor": self._phi.tolist(),
            "settings": self._settings(),
        }
        return json.dumps(state, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Restore an estimator from `to_json`; called on `Recursive` it restores any of them.

        Raises
        ------
        ModelError
            If the text is no state of such an estimator.
        """
        try:
            state = json.loads(text)
        except json.JSONDecodeError as problem:
            raise ModelError(f"the state is not JSON (line {problem.lineno}): save it with to_json") from None
        if not isinstance(state, Mapping) or state.get("schema") != SCHEMA:
            raise ModelError(f"the state is not of schema {SCHEMA}: save it with to_json of this version")
        kind = cls._registered.get(str(state.get("algorithm")))
        if kind is None or not issubclass(kind, cls):
            raise ModelError(
                f"the state is of the algorithm {state.get('algorithm')!r}, which {cls.__name__} cannot "
                f"restore: use one of {', '.join(sorted(cls._registered))}"
            )
        try:
            made = kind._restored(state)
            made._theta[:] = finite(state["theta"], made._theta.shape)
            made._phi[:] = finite(state["regressor"], made._phi.shape)
            made.samples = int(state["samples"])
        except (KeyError, TypeError, ValueError) as problem:
            raise ModelError(
                f"the state is damaged ({type(problem).__name__}: {problem}): save it anew with to_json"
            ) from None
        assert isinstance(made, cls)
        return made

    @classmethod
    @abstractmethod
    def _restored(cls, state: Mapping[str, Any]) -> "Recursive":
        """Make the estimator from its settings."""

    @abstractmethod
    def _settings(self) -> dict[str, Any]:
        """Return what `_restored` needs beside order and levels."""

    @abstractmethod
    def _step(self, number: int, value: float, y: float) -> float:
        """Take one sample."""

    @abstractmethod
    def _steps(self, numbers: Indices, y: Floats, errors: Floats, kept: Floats, every: int) -> None:
        """Take many samples."""


def regressors(u: ArrayLike, y: ArrayLike, order: int, levels: ArrayLike) -> Floats:
    """Return the regressors (3.8b) of a record that begins at rest, one row a sample.

    Parameters
    ----------
    u, y : array_like, shape (n_samples,)
    order : int
    levels : array_like, shape (n_levels,)

    Returns
    -------
    ndarray, shape (n_samples, order * (1 + n_levels))

    Examples
    --------
    >>> regressors([2.0, 0.0, 0.0], [0.0, 5.0, 1.0], order=1, levels=[-2.0, 2.0]).tolist()
    [[0.0, 0.0, 0.0], [-0.0, 0.0, 2.0], [-5.0, 0.0, 0.0]]
    """
    signal, output = checked_pair(u, y)
    known = Levels(levels)
    rows = np.empty((signal.size, order * (1 + known.values.size)))
    regressor_rows(order, known.values, known.numbers(signal), output, rows)
    return rows


def checked_pair(u: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    """Return input and output as sequences of finite floats of one length."""
    try:
        signal = np.ascontiguousarray(u, dtype=np.float64)
        output = np.ascontiguousarray(y, dtype=np.float64)
    except (TypeError, ValueError) as problem:
        raise DataError(f"input and output must be sequences of numbers ({problem})") from None
    if signal.shape != output.shape or signal.ndim != 1:
        raise DataError(
            f"input of shape {signal.shape} and output of shape {output.shape} differ: "
            "give one channel each, of equal length"
        )
    for name, values in (("input", signal), ("output", output)):
        for row in np.flatnonzero(~np.isfinite(values))[:1]:
            raise DataError(f"{name} value {row} is {values[row]}: cut the record there or fill the value")
    return signal, output


def finite(values: Any, shape: tuple[int, ...]) -> Floats:
    """Return finite numbers of the shape that a saved state must have."""
    array = np.array(values, dtype=np.float64)
    if array.shape != shape or not np.all(np.isfinite(array)):
        raise ValueError(f"numbers of shape {array.shape} where finite ones of shape {shape} belong")
    return array
