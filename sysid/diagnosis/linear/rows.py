"""The rows of a record as a chain runs over them: each experiment up to its last row that counts."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.effects.base import EffectParameter, Floats, Grid, Map
from sysid.diagnosis.structures.rows import end_of_search
from sysid.errors import DataError

# Least value of a shape whose bound is zero, as a share of the largest one on its grid.
LEAST_SHAPE = 1e-6


@dataclass(frozen=True, eq=False)
class Data:
    """Rows of all experiments one after the other.

    Attributes
    ----------
    u, y : ndarray, shape (n_rows,)
    used : ndarray of bool, shape (n_rows,)
    begin : ndarray of int, shape (n_experiments + 1,)
    period : float
    """

    u: Floats
    y: Floats
    used: Mask
    begin: np.ndarray
    period: float

    @cached_property
    def _tried(self) -> dict[Grid, Floats]:
        return {}

    @cached_property
    def all_used(self) -> bool:
        """Whether every row is one of the fit."""
        return bool(self.used.all())

    @cached_property
    def runs(self) -> np.ndarray:
        """Where runs of used rows begin and end, shape (n_runs, 2); none crosses experiments."""
        edges = np.zeros(self.used.size + 1, dtype=bool)
        edges[self.begin] = True
        edges[1:-1] |= self.used[1:] != self.used[:-1]
        places = np.flatnonzero(edges)
        parts = np.column_stack([places[:-1], places[1:]])
        return np.ascontiguousarray(parts[self.used[parts[:, 0]]])

    @property
    def n_experiments(self) -> int:
        """Number of experiments."""
        return self.begin.size - 1

    def by_experiment(self, apply: Map, sequence: Floats, p: Floats) -> Floats:
        """Apply a map to the rows of each experiment."""
        if self.begin.size == 2:
            return apply(sequence, p, self.period)
        parts = zip(self.begin[:-1], self.begin[1:], strict=True)
        return np.concatenate([apply(sequence[i:j], p, self.period) for i, j in parts])

    def tried(self, grid: Grid) -> Floats:
        """Return the values at which a shape is tried first, looked for once."""
        if grid not in self._tried:
            self._tried[grid] = grid.values(self.u, self.y[self.used], self.period)
        return self._tried[grid]

    def least(self, parameter: EffectParameter) -> float:
        """Return the lower bound of a parameter of an effect.

        A shape stays a little away from zero, where a relative step of its difference would vanish.
        """
        if parameter.grid is None or parameter.minimum != 0.0:
            return parameter.minimum
        return LEAST_SHAPE * float(self.tried(parameter.grid).max())

    def lagged(self, signal: Floats, lag: int) -> Floats:
        """Delay a signal by whole samples within each experiment."""
        out = np.zeros_like(signal)
        for i, j in zip(self.begin[:-1], self.begin[1:], strict=True):
            out[i + lag : j] = signal[i : max(j - lag, i)]
        return out


def data_of(record: Record, rows: Mask) -> Data:
    """Return the experiments with chosen rows, each up to its last chosen one."""
    parts = _parts(record, rows)
    if not parts:
        raise DataError("no row is chosen for the fit: mark rows as train, est or val")
    index = np.concatenate(parts)
    used = rows[index]
    y = np.where(used, record.y[index, 0], 0.0)
    begin = np.cumsum([0, *(part.size for part in parts)])
    return Data(np.ascontiguousarray(record.u[index, 0]), y, used, begin, record.period)


def on_record(record: Record, lines: Floats, rows: Mask) -> Floats:
    """Return lines over the rows of `data_of` as columns over all rows of the record."""
    columns = np.zeros((record.n_samples, lines.shape[0]))
    columns[np.concatenate(_parts(record, rows))] = lines.T
    return columns


def _parts(record: Record, rows: Mask) -> list[np.ndarray]:
    """Return the indices of each experiment with chosen rows, up to its last chosen one."""
    parts = []
    for part in record.slices:
        inside = np.flatnonzero(rows[part])
        if inside.size:
            parts.append(np.arange(part.start, part.start + inside[-1] + 1))
    return parts


def for_search(data: Data, free_start: bool) -> Data:
    """Return the first rows, enough for a search; all where each experiment has its own start."""
    stop = end_of_search((data.u, data.y), data.used)
    if stop == data.u.size or (free_start and data.n_experiments > 1):
        return data
    begin = np.array([*data.begin[:-1][data.begin[:-1] < stop], stop])
    return Data(data.u[:stop], data.y[:stop], data.used[:stop], begin, data.period)
