"""The noise floor: how much of the error no model of the record could explain."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.comparison.periods import EQUAL, Periodic, periodic_part
from sysid.linear.forms import Floats
from sysid.result_files import finite

# Rows that the one-step predictor learns at most, and the fewest of a stretch worth learning.
TARGETS, FEWEST_TARGETS = 20_000, 60
# Most lags of each signal that enter linearly, and those of each input that enter bent, too.
OUTPUT_LAGS, INPUT_LAGS, MODEL_LAGS, ERROR_LAGS = 30, 15, 3, 5
SHAPED_LAGS = 3
# Quantiles of a signal at which its piecewise linear functions bend.
KNOTS = (0.05, 0.15, 0.3, 0.5, 0.7, 0.85, 0.95)
# Regressions, each with the prediction errors of the one before; by then these hardly change.
PASSES = 5
ROWS_PER_REGRESSOR = 8
# Spectrum of the free run's error: rows of a segment, and bands of which the quietest counts.
LONGEST_SEGMENT, SEGMENTS, QUIET_BANDS = 256, 4, 12
# Of so many equal bands the quietest lies by so many standard deviations below their mean.
QUIETEST_OF_BANDS = 1.63
# A window of Hann joins neighbouring lines, and segments that overlap by a half tell the same in part.
LINES_JOINED, SEGMENTS_JOINED = 1.5, 1.2
# Two estimates that differ by more than this factor are both told.
WIDE = 1.25
ONE_STEP = "one-step error of a nonparametric nonlinear autoregression"
QUIET = "the quietest frequencies of the error if noise is white"


@dataclass(frozen=True)
class NoiseFloor:
    """An estimate of the noise in the output.

    Attributes
    ----------
    rms : float
        In the unit of the output; NaN if it cannot be had.
    nrmse : float
        As a share of the output's deviation on the judged rows.
    method : str
        How it was had, or why not.
    repeated : bool
        Whether it rests on repetitions, and so holds slow disturbances too.
    upper : float
        A cautious estimate in the unit of the output; not below ``rms``.
    """

    rms: float
    nrmse: float
    method: str
    repeated: bool
    upper: float

    @property
    def upper_nrmse(self) -> float:
        """The cautious estimate as a share of the output's deviation."""
        return self.nrmse * self.upper / self.rms if self.rms > 0.0 else self.nrmse

    @property
    def wide(self) -> bool:
        """Whether the two estimates are so far apart that both are told."""
        return bool(self.upper > WIDE * self.rms)

    def to_json(self) -> dict[str, Any]:
        """Return the form of the JSON file."""
        return {
            "nrmse": finite(self.nrmse),
            "rms": finite(self.rms),
            "interval": [finite(self.nrmse), finite(self.upper_nrmse)],
            "method": self.method,
            "from_repetitions": self.repeated,
        }


def noise_floor(record: Record, free_run: Floats, judged: Mask) -> NoiseFloor:
    """Estimate the noise floor: from periods, from repeats, or by two bounds.

    Without repetitions there are two.  A flexible one-step predictor leaves noise and what it could not
    learn of the system.  The error of the model's free run at its quietest frequencies, where the system
    hardly answers, is nearly all noise: taken for the level of white noise, it is seldom far too large.  The
    smaller one is the estimate; of coloured noise it is a lower bound.

    Parameters
    ----------
    record : Record
    free_run : ndarray, shape (n_samples,)
        Of the model that is compared; its error bounds the floor from above.
    judged : ndarray of bool, shape (n_samples,)

    Returns
    -------
    NoiseFloor
    """
    y = record.y[judged, 0]
    spread, error = float(np.std(y)), float(np.sqrt(np.mean((y - free_run[judged]) ** 2)))
    everywhere = np.ones(record.n_samples, dtype=bool)
    periodic = [p for part in record.slices if (p := periodic_part(record, part, everywhere)) is not None]
    repeated = True
    if periodic:
        rms = upper = _from_periods(periodic)
        count = max(p.count for p in periodic)
        method = f"scatter between {count} periods of the input"
    elif (repeats := _from_repeats(record)) is not None:
        rms, count = repeats
        upper = rms
        method = f"scatter between {count} experiments with the same input"
    else:
        repeated = False
        upper = min(one_step_floor(record, free_run), error)
        rms = min(quiet_floor(record, free_run), upper)
        method = ONE_STEP if upper <= WIDE * rms else f"{QUIET}, to {ONE_STEP}"
    if not np.isfinite(rms) or spread == 0.0:
        nothing = float("nan")
        return NoiseFloor(
            nothing, nothing, "not estimated: too few rows, or a constant output", False, nothing
        )
    return NoiseFloor(rms, rms / spread, method, repeated, upper)


def _from_periods(parts: list[Periodic]) -> float:
    """Return the root of the variance between periods, pooled over experiments."""
    squares = sum(float(((p.y - p.y.mean(axis=0)) ** 2).sum()) for p in parts)
    freedom = sum((p.count - 1) * p.length for p in parts)
    return float(np.sqrt(squares / freedom))


def _from_repeats(record: Record) -> tuple[float, int] | None:
    """Return the noise between experiments of equal input, and the largest number of repeats.

    The first tenth of each, in which different initial states die away, is left out.
    """
    groups: list[list[slice]] = []
    spread = np.maximum(record.u.std(axis=0), 1e-300)
    for part in record.slices:
        for group in groups:
            rows = min(part.stop - part.start, group[0].stop - group[0].start)
            apart = record.u[part][:rows] - record.u[group[0]][:rows]
            if rows >= FEWEST_TARGETS and bool((np.abs(apart) <= EQUAL * spread).all()):
                group.append(part)
                break
        else:
            groups.append([part])
    squares, freedom, largest = 0.0, 0, 0
    for group in (g for g in groups if len(g) > 1):
        rows = min(part.stop - part.start for part in group)
        y = np.array([record.y[part, 0][rows // 10 : rows] for part in group])
        y = y[:, np.isfinite(y).all(axis=0)]
        squares += float(((y - y.mean(axis=0)) ** 2).sum())
        freedom += (len(group) - 1) * y.shape[1]
        largest = max(largest, len(group))
    return (float(np.sqrt(squares / freedom)), largest) if freedom else None


def one_step_floor(record: Record, free_run: Floats) -> float:
    """Return the one-step error of a flexible predictor, in the unit of the output.

    Past outputs, inputs, the model's free run and past prediction errors enter linearly over many
    lags; the latest of each, their differences and products enter by piecewise linear functions, too.
    The regression is repeated with the prediction errors of the pass before (extended least squares:
    Billings, 2013, Nonlinear system identification, section 3.4), so that noise in past outputs does
    not add to the error.  White noise cannot be foreseen, so that its size is found; of coloured noise
    only the part that is new in each row counts, and the floor is a lower bound.

    Parameters
    ----------
    record : Record
    free_run : ndarray, shape (n_samples,)

    Returns
    -------
    float
        NaN where there are too few rows.
    """
    total = int(np.isfinite(record.y[:, 0]).sum())
    output_lags = int(np.clip(total // 40, 2, OUTPUT_LAGS))
    input_lags = int(np.clip(total // (60 * len(record.inputs)), 1, INPUT_LAGS))
    stretches, left = [], TARGETS
    for part in reversed(record.slices):  # the test sets are mostly at the end
        rows = _longest_measured(record, part)
        if left < FEWEST_TARGETS or rows.size < FEWEST_TARGETS:
            continue
        rows = rows[:left]
        left -= rows.size
        stretches.append(_Stretch(record, free_run, rows, output_lags, input_lags))
    if not stretches:
        return float("nan")
    errors = [np.zeros(stretch.y.size) for stretch in stretches]
    floors: list[float] = []
    for _ in range(PASSES):
        blocks = [stretch.regressors(error) for stretch, error in zip(stretches, errors, strict=True)]
        linear, signals = (np.vstack(parts) for parts in zip(*blocks, strict=True))
        target = np.concatenate([stretch.y[stretch.first :] for stretch in stretches])
        whole = np.column_stack([np.ones(target.size), linear, _shapes(signals)])
        whole = whole[:, : max(target.size // ROWS_PER_REGRESSOR, 1)]
        rest, rank = _left_over(whole, target)
        floors.append(float(np.sqrt(rest @ rest / max(target.size - rank, 1))))
        place = 0
        for stretch, error in zip(stretches, errors, strict=True):
            count = stretch.y.size - stretch.first
            error[stretch.first :] = rest[place : place + count]
            place += count
    return min(floors)


def quiet_floor(record: Record, free_run: Floats) -> float:
    """Return the size of white noise whose level is that of the error at its quietest frequencies.

    Parameters
    ----------
    record : Record
    free_run : ndarray, shape (n_samples,)

    Returns
    -------
    float
        In the unit of the output; infinite where there are too few rows.
    """
    stretches = [rows for part in record.slices if (rows := _longest_measured(record, part)).size]
    longest = max((rows.size for rows in stretches), default=0)
    length = min(LONGEST_SEGMENT, longest // SEGMENTS) // 2 * 2
    if length < 4 * QUIET_BANDS:
        return float("inf")
    window = np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 2
    powers = []
    for rows in stretches:
        error = record.y[rows, 0] - free_run[rows]
        for first in range(0, rows.size - length + 1, length // 2):
            part = error[first : first + length]
            powers.append(np.abs(np.fft.rfft(window * (part - part.mean()))[1:-1]) ** 2)
    mean = np.mean(powers, axis=0) / np.sum(window**2)
    bands = np.array([band.mean() for band in np.array_split(mean, QUIET_BANDS)])
    freedom = len(powers) / SEGMENTS_JOINED * mean.size / QUIET_BANDS / LINES_JOINED
    lowered = max(1.0 - QUIETEST_OF_BANDS / np.sqrt(freedom), 0.25)
    return float(np.sqrt(bands.min() / lowered))


def _longest_measured(record: Record, part: slice) -> NDArray[np.int64]:
    """Return the longest stretch of consecutive rows with a measured output."""
    rows = part.start + np.flatnonzero(np.isfinite(record.y[part, 0]))
    return max(np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1), key=len)


class _Stretch:
    """Consecutive rows: the regressors that do not change from pass to pass, and those that do."""

    def __init__(
        self, record: Record, free_run: Floats, rows: NDArray[np.int64], output_lags: int, input_lags: int
    ) -> None:
        self.y = np.ascontiguousarray(record.y[rows, 0])
        self.first = max(output_lags, input_lags, MODEL_LAGS, ERROR_LAGS)
        u, model = record.u[rows], free_run[rows]
        n_inputs = u.shape[1]
        past = [self._lagged(self.y, lag) for lag in range(1, output_lags + 1)]
        model_past = [self._lagged(model, lag) for lag in range(MODEL_LAGS + 1)]
        inputs = [self._lagged(u[:, i], lag) for i in range(n_inputs) for lag in range(input_lags + 1)]
        self.linear = np.column_stack([*model_past, *past, *inputs])
        latest = [model_past[0], model_past[0] - model_past[1]]
        latest += [self._lagged(u[:, i], lag) for i in range(n_inputs) for lag in range(SHAPED_LAGS)]
        self.signals = np.column_stack(latest)

    def _lagged(self, values: Floats, lag: int) -> Floats:
        return values[self.first - lag : values.size - lag]

    def regressors(self, error: Floats) -> tuple[Floats, Floats]:
        """Return the linear regressors and the signals that enter nonlinearly, given prediction errors."""
        foreseen = self.y - error
        one, two = self._lagged(foreseen, 1), self._lagged(foreseen, 2)
        past = [self._lagged(error, lag) for lag in range(1, ERROR_LAGS + 1)]
        return np.column_stack([*past, self.linear]), np.column_stack([one, one - two, self.signals])


def _left_over(columns: Floats, target: Floats) -> tuple[Floats, int]:
    """Return what least squares leaves of the target, and the rank."""
    size = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(size > 0.0, size, 1.0)
    Q, R = np.linalg.qr(scaled)
    left, values, _ = np.linalg.svd(R)
    basis = Q @ left[:, values > 1e-9 * values[0]]
    return np.asarray(target - basis @ (basis.T @ target)), int(basis.shape[1])


def _shapes(signals: Floats) -> Floats:
    """Return piecewise linear functions of each signal and the products of all pairs."""
    spread = signals.std(axis=0)
    scaled = (signals - signals.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    knots = np.quantile(scaled, KNOTS, axis=0)
    hinges = [np.maximum(scaled - knot, 0.0) for knot in knots]
    first, second = np.triu_indices(scaled.shape[1])
    return np.hstack([*hinges, scaled[:, first] * scaled[:, second]])
