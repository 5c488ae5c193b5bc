"""Free run and one-step prediction of linear models."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.errors import ModelError, UsageError
from sysid.linear.forms import Floats
from sysid.linear.kernels import polynomial_filter, state_space_filter
from sysid.linear.responses import responses

if TYPE_CHECKING:
    from sysid.linear.output_error import OutputErrorFit

# Rows from which the initial state of an experiment without estimation rows is estimated, where no skipped
# window says more: so many for each state.
ROWS_PER_STATE = 10
FEWEST_ROWS_PER_STATE = 2
PERIOD_TOLERANCE = 0.01


@dataclass(frozen=True)
class Prediction:
    """Outputs of a model over all rows of a record.

    Attributes
    ----------
    free_run : ndarray, shape (n_samples,)
        Simulated from the input alone, one continuous run in each experiment.
    one_step : ndarray, shape (n_samples,)
        The free run plus what the autoregressive model of the residual foresees from the
        measured past.
    starts : tuple of str
        How the initial state of each experiment was found.
    """

    free_run: Floats
    one_step: Floats
    starts: tuple[str, ...]


def simulate_polynomial(
    b: ArrayLike, a: ArrayLike, u: ArrayLike, initial_state: ArrayLike | None = None
) -> Floats:
    """Simulate y = B/A u.

    Parameters
    ----------
    b, a : array_like
        Coefficients by rising powers of q^-1; ``a[0]`` must be 1.
    u : array_like, shape (n_samples,)
    initial_state : array_like, shape (max(len(a), len(b)) - 1,), optional
        State of the transposed direct form; at rest by default.

    Returns
    -------
    ndarray, shape (n_samples,)

    Raises
    ------
    ModelError
        If ``a[0]`` is not 1 or the state has the wrong length.

    Examples
    --------
    >>> simulate_polynomial([0.0, 1.0], [1.0, -0.5], [1.0, 0.0, 0.0, 0.0])
    array([0.  , 1.  , 0.5 , 0.25])
    """
    b_array, a_array = np.array(b, dtype=np.float64), np.array(a, dtype=np.float64)
    if a_array.size == 0 or a_array[0] != 1.0:
        first = a_array[0] if a_array.size else float("nan")
        raise ModelError(f"a[0] is {first:g}, it must be 1: divide both polynomials by it")
    length = max(b_array.size, a_array.size)
    b_array = np.pad(b_array, (0, length - b_array.size))
    a_array = np.pad(a_array, (0, length - a_array.size))
    state = np.zeros(length - 1) if initial_state is None else np.array(initial_state, dtype=np.float64)
    if state.size != length - 1:
        raise ModelError(f"the initial state has {state.size} elements, {length - 1} are needed")
    signal = np.ascontiguousarray(u, dtype=np.float64)
    y = np.empty_like(signal)
    polynomial_filter(b_array, a_array, signal, state, y)
    return y


def simulate_state_space(
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike,
    u: ArrayLike,
    initial_state: ArrayLike | None = None,
) -> Floats:
    """Simulate x(k+1) = A x(k) + B u(k), y(k) = C x(k) + D u(k).

    Parameters
    ----------
    A, B, C, D : array_like
        Shapes (order, order), (order, n_inputs), (n_outputs, order), (n_outputs, n_inputs).
    u : array_like, shape (n_samples, n_inputs)
    initial_state : array_like, shape (order,), optional
        At rest by default.

    Returns
    -------
    ndarray, shape (n_samples, n_outputs)

    Raises
    ------
    ModelError
        If the shapes do not fit together.

    Examples
    --------
    >>> simulate_state_space([[0.5]], [[1.0]], [[1.0]], [[0.0]], [[1.0], [0.0], [0.0]]).ravel()
    array([0. , 1. , 0.5])
    """
    matrices = tuple(np.ascontiguousarray(matrix, dtype=np.float64) for matrix in (A, B, C, D))
    signal = np.ascontiguousarray(u, dtype=np.float64)
    order = matrices[0].shape[0]
    state = np.zeros(order) if initial_state is None else np.array(initial_state, dtype=np.float64)
    shapes = [matrix.shape for matrix in matrices]
    if signal.ndim != 2 or any(len(shape) != 2 for shape in shapes):
        raise ModelError("A, B, C, D and u must have two dimensions: give u the shape (n_samples, n_inputs)")
    n_outputs = shapes[2][0]
    expected = [(order, order), (order, signal.shape[1]), (n_outputs, order), (n_outputs, signal.shape[1])]
    if shapes != expected or state.shape != (order,):
        raise ModelError(
            f"shapes of A, B, C, D are {shapes} and of the state {state.shape}, they must be {expected} and "
            f"{(order,)} for {signal.shape[1]} inputs"
        )
    y = np.empty((signal.shape[0], n_outputs))
    state_space_filter(matrices[0], matrices[1], matrices[2], matrices[3], signal, state, y)
    return y


def predict(fit: "OutputErrorFit", record: Record, rows: Mask | None = None) -> Prediction:
    """Predict every row of a record.

    The initial state of an experiment is estimated on its rows of the fit; in an experiment
    without any, on its first rows: the skipped ones or, where these are too few, ten for each state.

    Parameters
    ----------
    fit : OutputErrorFit
    record : Record
    rows : ndarray of bool, shape (n_samples,), optional
        Rows that may be used for initial states; estimation and validation rows by default.

    Returns
    -------
    Prediction
    """
    check_fits(check_record(record), fit.inputs, fit.outputs, fit.period)

    def run(part: slice, used: Mask, fitted: bool) -> Floats:
        return run_free(fit, record.u[part], record.y[part, 0], used)

    return predict_experiments(record, rows, fit.order, fit.uncertainty.noise, fit.structure.free_start, run)


def check_fits(record: Record, inputs: tuple[str, ...], outputs: tuple[str, ...], period: float) -> None:
    """Raise UsageError if a record has other channels or another period than the one of a fit."""
    shape, wanted = (record.u.shape[1], record.y.shape[1]), (len(inputs), len(outputs))
    if shape != wanted:
        raise UsageError(
            f"the record has {shape[0]} inputs and {shape[1]} outputs, the model was fitted to {wanted[0]} "
            f"({', '.join(inputs)}) and {wanted[1]} ({', '.join(outputs)}): choose the same columns"
        )
    if abs(record.period - period) > PERIOD_TOLERANCE * period:
        raise UsageError(
            f"the record is sampled at {record.period:g} s and the model was fitted at {period:g} s: "
            "resample the record (sysid.data.resample)"
        )


def predict_experiments(
    record: Record,
    rows: Mask | None,
    order: int,
    noise: Floats,
    free_start: bool,
    run: Callable[[slice, Mask, bool], Floats],
    output: int = 0,
) -> Prediction:
    """Run every experiment of a record and say where its initial state comes from.

    Parameters
    ----------
    record : Record
    rows : ndarray of bool, shape (n_samples,), or None
        Rows that may be used for initial states; estimation and validation rows by default.
    order : int
        Number of states.
    noise : ndarray
        Polynomial of the residual's autoregression, for the one-step prediction.
    free_start : bool
        Initial states are estimated; otherwise experiments start at rest.
    run : callable
        Gives the free run of an experiment from its rows in the record, the rows for its initial
        state, and whether these are rows of the fit.
    output : int
        Column of the record's outputs that is predicted.

    Returns
    -------
    Prediction
    """
    chosen = record.learning if rows is None else rows
    free_run, one_step = np.empty(record.n_samples), np.empty(record.n_samples)
    notes = []
    for part in record.slices:
        y = record.y[part, output]
        used = chosen[part] & np.isfinite(y)
        fitted = bool(used.any())
        note = "estimated on the rows of the fit"
        if not fitted:
            used, count = first_rows(y, record.skip.get(str(record.split[part][0]), 0), order)
            note = f"estimated on the first {count} rows" if count else "at rest: no output is measured there"
        free_run[part] = run(part, used, fitted)
        one_step[part] = free_run[part] + foreseen(y - free_run[part], noise)
        notes.append(note if free_start else "at rest")
    return Prediction(free_run, one_step, tuple(notes))


def predict_outputs(
    record: Record,
    rows: Mask | None,
    order: int,
    noises: Sequence[Floats],
    free_start: bool,
    run: Callable[[slice, Mask, bool], Floats],
) -> Prediction:
    """Run every experiment of a record once for all outputs; see `predict_experiments`.

    Parameters
    ----------
    record, rows, order, free_start
        As in `predict_experiments`.
    noises : sequence of ndarray
        Polynomial of each output's residual.
    run : callable
        As there; gives all outputs, shape (n_rows, n_outputs).

    Returns
    -------
    Prediction
        With arrays of shape (n_samples, n_outputs) if there are several outputs.
    """
    runs: dict[int | None, Floats] = {}

    def column(place: int, part: slice, used: Mask, fitted: bool) -> Floats:
        if part.start not in runs:
            runs[part.start] = run(part, used, fitted)
        return np.ascontiguousarray(runs[part.start][:, place])

    found = [
        predict_experiments(record, rows, order, noise, free_start, partial(column, place), output=place)
        for place, noise in enumerate(noises)
    ]
    if len(found) == 1:
        return found[0]
    free_run, one_step = (np.column_stack([getattr(p, n) for p in found]) for n in ("free_run", "one_step"))
    return Prediction(free_run, one_step, found[0].starts)


def run_free(fit: "OutputErrorFit", u: Floats, y: Floats, used: Mask) -> Floats:
    """Simulate one experiment, its initial state estimated on the rows ``used`` if the model has one.

    A few rows do not determine a state of high order.  So the estimate is a Bayesian one: the
    model's error is known from its fit, and before anything is measured the free response over the
    whole experiment is held to be no larger than the output itself.
    """
    forced, starts = responses(u, fit.structure, fit.reflections, fit.weights)
    if not fit.structure.free_start or not used.any():
        return forced
    target = y[used] - forced[used]
    columns = starts / np.maximum(np.linalg.norm(starts, axis=1, keepdims=True), 1e-300)
    size = max(float(np.std(y[used])), fit.output_std) * np.sqrt(y.size)
    ridge = (fit.rms / size) * np.eye(columns.shape[0])
    stacked = np.vstack([columns[:, used].T, ridge])
    weights = np.linalg.lstsq(stacked, np.concatenate([target, np.zeros(ridge.shape[0])]), rcond=None)[0]
    return np.asarray(forced + weights @ columns)


def first_rows(y: Floats, skip: int, order: int) -> tuple[Mask, int]:
    """Choose the first rows of an experiment for its initial state; return them and their number."""
    count = skip if skip >= FEWEST_ROWS_PER_STATE * order else ROWS_PER_STATE * order
    used = np.isfinite(y) & (np.arange(y.size) < count)
    return used, int(used.sum())


def foreseen(residual: Floats, noise: Floats) -> Floats:
    """Return -(d1 r(k-1) + d2 r(k-2) + ...), the part of the residual its past tells; gaps count as zero."""
    known = np.where(np.isfinite(residual), residual, 0.0)
    told = np.zeros_like(known)
    for lag in range(1, min(noise.size, known.size)):
        told[lag:] -= noise[lag] * known[:-lag]
    return told
