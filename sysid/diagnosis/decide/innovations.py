"""Whether innovations are new, or can be foreseen from what was measured before.

A free run that has lost the plant, as behind a gap that a shaft crosses now here and now there, leaves an
error that follows nothing in the run, so that it passes for noise with a memory.  But the innovations of such
noise follow nothing that was measured before them, in no linear and no other way.  Nor does their size, but
for the level of the output: that of samples taken too early or too late goes with how fast the output moves.
"""

from typing import NamedTuple

import numpy as np

from sysid.data.record import Mask, Record
from sysid.diagnosis.decide.evidence import remainder
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.structures.projection import orthonormal, without
from sysid.diagnosis.structures.structure import filtered

# Earlier samples of input and output that may foresee linearly, and samples of which products are taken.
LAGS, FURTHER = 12, 4
# Innovations are foreseen when so unlikely by chance, and by this share of their squares.
FORESEEN_P_VALUE, FORESEEN_SHARE = 1e-5, 0.02
# Samples by which the input comes before an innovation whose size goes with it, and knots of the function of
# the output's level that the size of a sensor's noise may be.
SIZE_LAGS, LEVELS = range(3), 16
# Rows for each direction that is tried.
ROWS_PER_DIRECTION = 4


class Foreseen(NamedTuple):
    """The chance that noise lets signals foresee as much of innovations, and what share.

    ``of_size`` tells whether it is their size that is foreseen.
    """

    p_value: float
    share: float
    of_size: bool = False

    @property
    def plainly(self) -> bool:
        """Whether the innovations are none."""
        return self.p_value < FORESEEN_P_VALUE and self.share > FORESEEN_SHARE


def foreseen(record: Record, rows: Mask, residual: Floats, noise: Floats) -> Foreseen:
    """Return how well bent functions of earlier measurements foresee the innovations of a residual.

    Parameters
    ----------
    record : Record
    rows : ndarray of bool, shape (n_samples,)
        Rows that may be looked at.
    residual : ndarray, shape (n_samples,)
        Measurement less free run.
    noise : ndarray
        D(q) of the noise.

    References
    ----------
    Billings & Voon (1986), International Journal of Control 44, on residuals of nonlinear models; here by an
    F-test of products and kinks beside the linear regressors.
    """
    times = _with_a_past(record, rows)
    innovations = np.zeros(rows.size)
    innovations[rows] = filtered(residual, rows, noise)
    linear, bent = _regressors(record, rows, residual, times)
    columns = linear.shape[1] + bent.shape[1]
    if times.size < ROWS_PER_DIRECTION * columns:
        return Foreseen(1.0, 0.0)
    known = orthonormal(linear)
    target = without(_normal_scores(without(innovations[times], known)), known)
    found = remainder(target, linear, without(bent, known))
    return Foreseen(found.p_value, found.explained / max(float(target @ target), 1e-300))


def uneven(record: Record, rows: Mask, residual: Floats, noise: Floats) -> Foreseen:
    """Return how well the input and the motion foretell the size of the innovations of a residual.

    Sensors are noisier at some levels than at others: what the output's level foretells is put aside.

    Parameters
    ----------
    record : Record
    rows : ndarray of bool, shape (n_samples,)
        Rows that may be looked at.
    residual : ndarray, shape (n_samples,)
        Measurement less free run.
    noise : ndarray
        D(q) of the noise.

    References
    ----------
    Breusch & Pagan (1979), Econometrica 47, 1287-1294; here of the ranks of sizes, which a few large
    innovations cannot move.
    """
    used = rows & np.isfinite(record.y[:, 0])
    innovations, run = np.zeros(rows.size), np.where(used, record.y[:, 0] - residual, 0.0)
    innovations[used] = filtered(residual, used, noise)
    times = np.flatnonzero(used & _within_experiments(record))
    if times.size < ROWS_PER_DIRECTION * LEVELS:
        return Foreseen(1.0, 0.0, of_size=True)
    drives = [record.u[:, 0], np.diff(record.u[:, 0], prepend=record.u[0, 0])]
    signals = [drive[times - lag] for drive in drives for lag in SIZE_LAGS]
    signals += [np.gradient(run)[times], np.gradient(np.gradient(run))[times]]
    sizes = [np.abs(signal - np.median(signal)) for signal in signals]
    columns = np.column_stack([power for size in sizes for power in (size, size**2)])
    knots = np.unique(np.quantile(run[times], np.linspace(0.0, 1.0, LEVELS)))
    levels = np.column_stack([np.interp(run[times], knots, hat) for hat in np.eye(knots.size)])
    target = _normal_scores(np.abs(innovations[times]))
    found = remainder(target, levels, columns)
    return Foreseen(found.p_value, found.explained / max(float(target @ target), 1e-300), of_size=True)


def _within_experiments(record: Record) -> Mask:
    """Return the rows whose neighbours, as far as sizes are looked at, belong to the same experiment."""
    inner = np.zeros(record.n_samples, dtype=bool)
    reach = len(SIZE_LAGS)
    for part in record.slices:
        inner[part.start + reach : part.stop - reach] = True
    return inner


def _normal_scores(values: Floats) -> Floats:
    """Return values that are as they would be in this order under a normal distribution.

    A disturbance that steps a few times has a few large innovations, which many directions can follow.
    """
    from scipy.special import ndtri

    ranks = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    return np.asarray(ndtri((ranks + 0.5) / values.size))


def _with_a_past(record: Record, rows: Mask) -> np.ndarray[tuple[int, ...], np.dtype[np.intp]]:
    """Return the rows before which enough rows of the same experiment lie."""
    used = rows & np.isfinite(record.y[:, 0])
    unbroken = np.zeros(rows.size, dtype=bool)
    for part in record.slices:
        run = np.concatenate([[0], np.cumsum(used[part])])
        whole = run[LAGS + 2 :] - run[: -LAGS - 2] == LAGS + 2  # the row and all before it that are looked at
        unbroken[part][LAGS + 1 :] = whole
    return np.flatnonzero(unbroken)


def _regressors(
    record: Record, rows: Mask, residual: Floats, times: np.ndarray[tuple[int, ...], np.dtype[np.intp]]
) -> tuple[Floats, Floats]:
    """Return linear functions of what was measured before some rows, and bent ones of the input among it."""

    def scaled(values: Floats) -> Floats:
        return np.asarray((values - values[rows].mean()) / (values[rows].std() or 1.0))

    y, u, r = (scaled(np.nan_to_num(values)) for values in (record.y[:, 0], record.u[:, 0], residual))
    lags = range(1, LAGS + 1)
    linear = [np.ones(times.size), *(signal[times - lag] for signal in (y, u, r) for lag in lags)]
    drives = [u[times - 1], scaled(np.diff(u, prepend=u[:1]))[times - 1], u[times - FURTHER]]
    drives += [np.abs(one) for one in drives]
    # A disturbance that comes in steps foresees itself in a bent way: only what goes with the input is the
    # plant's, and of a product only what its mean does not do.
    drives = [one - one.mean() for one in drives]
    moves = [scaled(np.diff(signal, prepend=signal[:1])) for signal in (y, r)]
    seen = [signal[times - 1] for signal in (y, r, *moves)] + [y[times - FURTHER]]
    seen += [np.abs(one) for one in seen]
    bent = [one * other for one in drives for other in seen]
    bent += [one * other for i, one in enumerate(drives) for other in drives[i:]]
    bent += drives
    return np.column_stack(linear), np.column_stack(bent)
