"""Long records: effects are searched on some of the rows, the model is refitted on all.

Where the output is sampled much faster than it moves, each search row stands for several: the mean of the
input over them and the output at the first.  A model in continuous time has the same parameters then, and
the noise's memory from row to row no longer hides what happens slowly.  Of other records the search takes
the first rows of each experiment.
"""

from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.structures.structure import Structure, StructureFit

# Learning rows up to which a search takes all, and how many it takes of a longer record.
LONGEST, SEARCHED = 8_000, 6_000
FEWEST = 400
HELD_OUT_SHARE = 0.25
# Rows stand for one if so many are left, and if beyond half of the new Nyquist frequency the output, its
# trend taken off, has no more than this share of its power.
LEFT, LOST_POWER = 2_500, 1e-5


@runtime_checkable
class Portable(Protocol):
    """A structure that can be had for another record of the same plant."""

    def on(self, record: Record) -> Structure:
        """Return the same structure, as it was chosen so far, for another record."""
        ...


def rows_for_one(record: Record) -> int:
    """Return how many rows may stand for one without losing what the output does.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> t = np.arange(30_000.0)
    >>> [rows_for_one(make_record(t, np.sin(w * t), period=1.0)) for w in (0.01, 1.0)]
    [12, 1]
    """
    most = int(record.learning.sum()) // LEFT
    allowed = max(most, 1)
    for part in record.slices:
        y = record.y[part, 0][record.learning[part]]
        if y.size < FEWEST:
            continue
        trend = np.linspace(y[0], y[-1], y.size)
        power = np.abs(np.fft.rfft((y - trend) * np.hanning(y.size))) ** 2
        above = np.cumsum(power[::-1])[::-1]
        # The first frequency, as a share of the Nyquist frequency, above which next to nothing is left.
        first = int(np.argmax(above <= LOST_POWER * above[0])) / power.size
        allowed = min(allowed, int(0.5 / first) if above[-1] <= LOST_POWER * above[0] and first > 0.0 else 1)
    return max(allowed, 1)


def thinned(record: Record, count: int) -> tuple[Record, Mask]:
    """Return a record in which each row stands for several, and which rows of the whole are its first ones.

    Test rows and what is left over at an experiment's end are left out.
    """
    chosen = np.zeros(record.n_samples, dtype=bool)
    starts, names, at = [], [], 0
    for part, name in zip(record.slices, record.experiments, strict=True):
        learning = np.flatnonzero(record.learning[part])
        if learning.size < count:
            continue
        firsts = np.arange(part.start, part.start + learning[-1] + 2 - count, count)
        chosen[firsts] = True
        starts.append(at)
        names.append(name)
        at += firsts.size
    places = np.flatnonzero(chosen)
    short = replace(
        record,
        u=np.mean([record.u[places + i] for i in range(count)], axis=0),
        y=np.ascontiguousarray(record.y[places]),
        period=count * record.period,
        split=record.split[places],
        held_out=record.held_out[places],
        starts=tuple(starts),
        experiments=tuple(names),
    )
    return short, chosen


def shortened(record: Record) -> tuple[Record, Mask]:
    """Return a record of the first learning rows of each experiment, and where they are in the whole.

    Experiments keep their shares of the rows.  Where no validation row is left, the last quarter of each
    experiment's rows becomes one.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> long = make_record(np.sin(np.arange(40_000.0)), np.cos(np.arange(40_000.0)), period=1e-3)
    >>> short, rows = shortened(long)
    >>> short.n_samples, int(short.validation.sum()), bool(rows[:6000].all())
    (6000, 1500, True)
    """
    total = int(record.learning.sum())
    chosen = np.zeros(record.n_samples, dtype=bool)
    for part in record.slices:
        learning = part.start + np.flatnonzero(record.learning[part])
        if learning.size:
            count = min(max(learning.size * SEARCHED // total, FEWEST), learning.size)
            chosen[part.start : learning[count - 1] + 1] = True
    numbers = np.repeat(np.arange(len(record.starts)), [part.stop - part.start for part in record.slices])
    kept = numbers[chosen]
    starts = np.flatnonzero(np.diff(kept, prepend=-1))
    held_out = record.held_out[chosen]
    if not held_out.any():
        held_out = held_out.copy()
        for start, end in zip(starts.tolist(), [*starts[1:].tolist(), kept.size], strict=True):
            rows = start + np.flatnonzero(record.learning[chosen][start:end])
            held_out[rows[rows.size - int(rows.size * HELD_OUT_SHARE) :]] = True
    short = replace(
        record,
        u=np.ascontiguousarray(record.u[chosen]),
        y=np.ascontiguousarray(record.y[chosen]),
        split=record.split[chosen],
        held_out=held_out,
        starts=tuple(starts.tolist()),
        experiments=tuple(record.experiments[kept[start]] for start in starts),
    )
    return short, chosen


def carried(fit: StructureFit, rows: Mask) -> StructureFit:
    """Return a fit to a shortened record as a start for the whole: its output is not one there."""
    where = np.zeros(rows.size, dtype=bool)
    where[np.flatnonzero(rows)[fit.rows]] = True
    return replace(fit, rows=where)
