"""The signals of a record or of arrays, by name and lag."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.data.record import Mask, Record
from sysid.errors import DataError, ModelError, UsageError
from sysid.lft.structure import Lag, LftStructure

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

Data = Record | tuple[ArrayLike, ArrayLike]
"""A record, or input and output as arrays ``(u, y)`` of one experiment."""

OUTPUT = -1


@dataclass(frozen=True, eq=False)
class Signals:
    """Inputs and one output, experiments one after another.

    Attributes
    ----------
    u : ndarray, shape (n_samples, n_inputs)
    y : ndarray, shape (n_samples,)
        NaN where nothing was measured.
    starts : tuple of int
        First row of each experiment.
    inputs : tuple of str
        Names of the inputs.
    output : str
    learning : ndarray of bool, shape (n_samples,)
        Rows of a fit unless others are asked for.
    """

    u: Floats
    y: Floats
    starts: tuple[int, ...]
    inputs: tuple[str, ...]
    output: str
    learning: Mask

    @property
    def n_samples(self) -> int:
        """Number of rows."""
        return self.y.size

    def channel(self, signal: str) -> int:
        """Return the column of an input by its name, -1 for the output.

        Raises
        ------
        ModelError
            If there is no signal of that name.
        """
        if signal in self.inputs:
            return self.inputs.index(signal)
        if signal in ("y", self.output):
            return OUTPUT
        number = 1 if signal == "u" else int(signal[1:]) if signal[:1] == "u" and signal[1:].isdigit() else 0
        if not 1 <= number <= len(self.inputs):
            choice = ", ".join(dict.fromkeys((*self.inputs, self.output)))
            raise ModelError(f"there is no signal {signal!r}: choose among {choice}")
        return number - 1

    def channels(self, lags: Sequence[Lag]) -> Indices:
        """Return the column of each lag's signal."""
        return np.array([self.channel(signal) for signal, _ in lags], dtype=np.int64)

    def lagged(self, lags: Sequence[Lag], times: Indices) -> Floats:
        """Return the lagged samples at some rows, shape (n_times, n_lags)."""
        out = np.empty((times.size, len(lags)))
        for column, (signal, delay) in enumerate(lags):
            channel = self.channel(signal)
            out[:, column] = (self.y if channel == OUTPUT else self.u[:, channel])[times - delay]
        return out

    def runs(self) -> tuple[slice, ...]:
        """Return the rows of each experiment."""
        ends = (*self.starts[1:], self.n_samples)
        return tuple(slice(a, b) for a, b in zip(self.starts, ends, strict=True))

    def age(self) -> Indices:
        """Return how many rows each row stands behind the start of its experiment."""
        return np.concatenate([np.arange(run.stop - run.start, dtype=np.int64) for run in self.runs()])


def signals_of(data: Data) -> Signals:
    """Return the signals of a record or of ``(u, y)``.

    Raises
    ------
    DataError, UsageError
        If there are several outputs, lengths differ or values are not finite.
    """
    if isinstance(data, Record):
        if len(data.outputs) != 1:
            raise UsageError(
                f"the record has {len(data.outputs)} outputs ({', '.join(data.outputs)}): take one at a time"
            )
        return Signals(data.u, data.y[:, 0], data.starts, data.inputs, data.outputs[0], data.learning)
    if not isinstance(data, tuple) or len(data) != 2:
        raise UsageError(f"data is of type {type(data).__name__}: give a record, or the pair (u, y)")
    u, y = np.asarray(data[0], dtype=float), np.asarray(data[1], dtype=float)
    u = u[:, np.newaxis] if u.ndim == 1 else u
    if y.ndim != 1 or u.ndim != 2 or u.shape[0] != y.size:
        raise DataError(f"u of shape {u.shape} and y of shape {y.shape} do not match: give one row a sample")
    if not np.isfinite(u).all():
        raise DataError(f"u is not finite in row {int(np.argmin(np.isfinite(u).all(axis=1)))}: fill it first")
    names = ("u",) if u.shape[1] == 1 else tuple(f"u{i + 1}" for i in range(u.shape[1]))
    return Signals(u, y, (0,), names, "y", np.ones(y.size, dtype=bool))


def usable_rows(signals: Signals, structure: LftStructure, rows: Mask | None) -> Indices:
    """Return the rows of a fit: those asked for that have all their lags in one experiment, measured."""
    chosen = signals.learning if rows is None else np.asarray(rows)
    if chosen.shape != (signals.n_samples,) or chosen.dtype != np.bool_:
        raise UsageError(
            f"rows has shape {chosen.shape} and type {chosen.dtype}: give one truth value for each of "
            f"{signals.n_samples} rows"
        )
    times = np.flatnonzero(chosen & (signals.age() >= structure.largest_lag)).astype(np.int64)
    measured = np.isfinite(signals.y)
    needed = {0, *range(1, structure.n_a + 1)}
    for signal, delay in structure.z_lags:
        if signals.channel(signal) == OUTPUT:
            needed |= {delay + i for i in range(structure.n_g + 1)}
    for delay in needed:
        times = times[measured[times - delay]]
    return times
