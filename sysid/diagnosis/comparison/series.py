"""The judged rows of a comparison: residual and the signals it may depend on."""

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sysid.data import Record
from sysid.data.record import Mask
from sysid.linear.forms import Floats

Places = NDArray[np.int64]
# A cycle of a signal of one frequency has 2 pi of its time scales: so many means of the residual to each.
MEANS_PER_TIME_SCALE = 14


@dataclass(frozen=True)
class Series:
    """Residual, inputs, model output and its velocity on the judged rows.

    Attributes
    ----------
    record : Record
    judged : str
        Name of the set.
    places : ndarray of int, shape (n_rows,)
        Rows of the record, counted from 0.
    residual : ndarray, shape (n_rows,)
        Measurement less free run.
    u : ndarray, shape (n_rows, n_inputs)
        Inputs when they act on the output: delayed as in the model.
    output : ndarray, shape (n_rows,)
        The model's free run: unlike the measurement it holds no noise that would be part of the residual too.
    velocity : ndarray, shape (n_rows,)
        Its central difference [unit of the output per second].
    """

    record: Record
    judged: str
    places: Places
    residual: Floats
    u: Floats
    output: Floats
    velocity: Floats

    @cached_property
    def runs(self) -> tuple[slice, ...]:
        """Stretches of consecutive rows of one experiment."""
        starts = np.asarray(self.record.starts)
        number = np.searchsorted(starts, self.places, side="right")
        cuts = np.flatnonzero((np.diff(self.places) != 1) | (np.diff(number) != 0)) + 1
        edges = [0, *cuts.tolist(), self.places.size]
        return tuple(slice(a, b) for a, b in itertools.pairwise(edges))

    @cached_property
    def experiment(self) -> Places:
        """Number of the experiment of each row."""
        found = np.searchsorted(np.asarray(self.record.starts), self.places, side="right") - 1
        return np.asarray(found, dtype=np.int64)

    @property
    def mean_length(self) -> int:
        """Rows to be averaged so that the residual is seen on the time scale of the motion.

        The time scale is the ratio of the output's deviation to that of its velocity.  Far below
        it a residual holds little but quantisation and sensor noise.
        """
        speed = float(np.std(self.velocity)) * self.record.period
        if speed == 0.0:
            return 1
        scale = float(np.std(self.output)) / speed / MEANS_PER_TIME_SCALE
        return int(np.clip(round(scale), 1, max(self.places.size // 100, 1)))

    def seconds(self, first: int, last: int) -> tuple[float, float]:
        """Return start and end [s] of rows of the series, from the start of their experiment."""
        a, b = int(self.places[first]), int(self.places[last])
        origin = max(start for start in self.record.starts if start <= a)
        return (a - origin) * self.record.period, (b - origin + 1) * self.record.period


def judged_series(record: Record, judged: str, rows: Mask, free_run: Floats, delay: int) -> Series:
    """Return the series of the rows that are judged.

    Parameters
    ----------
    record : Record
    judged : str
    rows : ndarray of bool, shape (n_samples,)
        With a measured output.
    free_run : ndarray, shape (n_samples,)
    delay : int
        Samples from input to output.
    """
    velocity, u = np.zeros(record.n_samples), np.empty_like(record.u)
    for part in record.slices:
        if part.stop - part.start > 1:
            velocity[part] = np.gradient(free_run[part], record.period)
        acting = np.maximum(np.arange(part.stop - part.start) - delay, 0)
        u[part] = record.u[part][acting]
    places = np.flatnonzero(rows)
    residual = record.y[places, 0] - free_run[places]
    return Series(record, judged, places, residual, u[places], free_run[places], velocity[places])
