"""Order, delay, direct term and constant of a linear model, chosen on validation rows."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sysid.data import Record
from sysid.data.record import TEST_PREFIX, Mask
from sysid.errors import SysidError
from sysid.linear.forms import Complexes, Floats
from sysid.linear.output_error import OutputErrorFit, fit_output_error, make_segments
from sysid.linear.reduction import BLOCK_ROWS, fold
from sysid.linear.simulation import first_rows, predict, run_free

LARGEST_ORDER = 8
# An error within this share of the best counts as equal, however small its standard error.
PRACTICAL_SHARE = 0.01
VALIDATION_BLOCKS = 20
# A coefficient of the impulse response counts as present above this many standard errors.
PRESENT = 5.0
LONGEST_DELAY = 30


@dataclass(frozen=True)
class Candidate:
    """One structure that was tried.

    Attributes
    ----------
    order, delay : int
    constant : bool
    validation_rms : float
        Free-run error on the validation rows, fitted on the estimation rows.
    """

    order: int
    delay: int
    constant: bool
    validation_rms: float


@dataclass(frozen=True)
class Choice:
    """The accepted model and how it was chosen.

    Attributes
    ----------
    fit : OutputErrorFit
        Refitted on estimation and validation rows.
    accepted : OutputErrorFit
        The same structure fitted on estimation rows only: its validation error is an honest one.
    candidates : tuple of Candidate
    reason : str
        One sentence.
    """

    fit: OutputErrorFit
    accepted: OutputErrorFit
    candidates: tuple[Candidate, ...]
    reason: str


@dataclass(frozen=True)
class _Trial:
    fit: OutputErrorFit
    squared: Floats
    candidate: Candidate


def choose_output_error(
    record: Record,
    *,
    order: int | None = None,
    delay: int | None = None,
    constant: bool | None = None,
    initial_state: str = "estimate",
    progress: Callable[[int, int], None] | None = None,
) -> Choice:
    """Choose a linear model by its free-run error on validation rows, then refit it.

    Each structure is fitted on the estimation rows and run free over the validation rows.  The
    simplest one is taken whose squared error there is, block by block, within one standard error
    of the best one's, or within 1 %: smaller differences are not worth a parameter.

    Parameters
    ----------
    record : Record
    order, delay : int, optional
        Fixed if given; otherwise orders 1 to 8 and the delays the data suggest are tried.
    constant : bool, optional
        Fixed if given; never with ``initial_state="rest"`` otherwise.
    initial_state : {"estimate", "rest"}
    progress : callable, optional
        Called with the number of structures done and to do.

    Returns
    -------
    Choice

    Raises
    ------
    DataError, UsageError, IdentifiabilityError
        If no structure can be fitted.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> rng = np.random.default_rng(1)
    >>> u = rng.standard_normal(400)
    >>> y = np.convolve(u, 0.5 * 0.8 ** np.arange(60.0))[:400]
    >>> y = np.concatenate([np.zeros(3), y[:-3]]) + 0.01 * rng.standard_normal(400)
    >>> choice = choose_output_error(make_record(u, y, period=1.0))
    >>> choice.fit.order, choice.fit.delay
    (1, 3)
    """
    if order is not None and delay is not None and constant is not None:
        return _fixed(record, order, delay, constant, initial_state)
    orders = range(1, LARGEST_ORDER + 1) if order is None else range(order, order + 1)
    delays = suggested_delays(record, record.estimation) if delay is None else (delay,)
    first_constant = initial_state == "estimate" if constant is None else constant
    steps = len(orders) * len(delays)
    trials: list[_Trial] = []
    last_problem: SysidError | None = None
    for n in orders:
        for lag in delays:
            try:
                trials.append(_try(record, n, lag, first_constant, initial_state, trials))
            except SysidError as problem:
                last_problem = problem
            if progress is not None:
                progress(len(trials), steps)
    if not trials:
        assert last_problem is not None
        raise last_problem
    accepted, best = _simplest(record, trials)
    if constant is None and first_constant:
        without = _try(record, accepted.fit.order, accepted.fit.delay, False, initial_state, trials)
        trials.append(without)
        if _equal(record, without, accepted) and _equal(record, without, best):
            accepted = without
    structure = accepted.candidate
    fit = fit_output_error(
        record,
        structure.order,
        delay=structure.delay,
        constant=structure.constant,
        initial_state=initial_state,
        extra_starts=[accepted.fit.poles],
    )
    return Choice(fit, accepted.fit, tuple(trial.candidate for trial in trials), _reason(accepted, best, len(trials)))


def _fixed(record: Record, order: int, delay: int, constant: bool, initial_state: str) -> Choice:
    trial = _try(record, order, delay, constant, initial_state, [])
    fit = fit_output_error(
        record, order, delay=delay, constant=constant, initial_state=initial_state, extra_starts=[trial.fit.poles]
    )
    return Choice(fit, trial.fit, (trial.candidate,), "The structure was given.")


def _try(
    record: Record, order: int, delay: int, constant: bool, initial_state: str, before: list[_Trial]
) -> _Trial:
    """Fit one structure on estimation rows, starting from smaller and neighbouring ones too."""
    fit = fit_output_error(
        record,
        order,
        delay=delay,
        constant=constant,
        initial_state=initial_state,
        rows=record.estimation,
        extra_starts=_known_poles(before, order, delay),
        precise=False,
    )
    squared = _validation_errors(fit, record) ** 2
    rms = float(np.sqrt(squared.mean()))
    return _Trial(fit, squared, Candidate(order, delay, constant, rms))


def _validation_errors(fit: OutputErrorFit, record: Record) -> Floats:
    """Return the free-run errors by which structures are compared.

    The run over the validation rows is asked what the tests will ask: where test sets continue an
    experiment the run continues from the estimation rows; where they are experiments of their own
    it starts anew on the validation rows, with as few rows for its initial state as they will have.
    """
    fresh = [part for part in record.slices if not record.learning[part].any()]
    continued = any(
        record.learning[part].any() and np.char.startswith(record.split[part], TEST_PREFIX).any()
        for part in record.slices
    )
    if continued or not fresh or not fit.structure.free_start:
        free_run = predict(fit, record, rows=record.estimation).free_run
        return record.y[record.validation, 0] - free_run[record.validation]
    skip = max(record.skip.get(str(record.split[part][0]), 0) for part in fresh)
    errors = []
    for part in record.slices:
        rows = part.start + np.flatnonzero(record.validation[part])
        if rows.size == 0:
            continue
        whole = slice(int(rows[0]), int(rows[-1]) + 1)
        y = np.where(record.validation[whole], record.y[whole, 0], np.nan)
        used, _ = first_rows(y, skip, fit.order)
        error = y - run_free(fit, record.u[whole], y, used)
        errors.append(error[np.isfinite(error) & (np.arange(y.size) >= min(skip, y.size // 2))])
    return np.concatenate(errors)


def _known_poles(before: list[_Trial], order: int, delay: int) -> list[Complexes]:
    poles = [t.fit.poles for t in before if t.fit.order == order]
    return poles + [t.fit.poles for t in before if t.fit.order in (order - 1, order - 2) and t.fit.delay == delay]


def _simplest(record: Record, trials: list[_Trial]) -> tuple[_Trial, _Trial]:
    """Return the simplest trial that is as good as the best one, and the best one."""
    best = min(trials, key=lambda trial: trial.candidate.validation_rms)
    equal = [trial for trial in trials if _equal(record, trial, best)]
    fewest = min(trial.fit.structure.n_parameters(len(record.inputs)) for trial in equal)
    simple = [t for t in equal if t.fit.structure.n_parameters(len(record.inputs)) == fewest]
    return min(simple, key=lambda trial: trial.candidate.validation_rms), best


def _equal(record: Record, trial: _Trial, best: _Trial) -> bool:
    """Tell whether a trial is within one standard error, or 1 %, of the best."""
    if trial.candidate.validation_rms <= best.candidate.validation_rms * (1.0 + PRACTICAL_SHARE):
        return True
    blocks = np.array_split(trial.squared - best.squared, VALIDATION_BLOCKS)
    means = np.array([block.mean() for block in blocks if block.size])
    standard_error = means.std(ddof=1) / np.sqrt(means.size)
    return bool(means.mean() <= standard_error)


def _reason(accepted: _Trial, best: _Trial, count: int) -> str:
    a, b = accepted.candidate, best.candidate
    if accepted is best:
        return (
            f"Of {count} structures, order {a.order} with delay {a.delay} has the smallest free-run error on the "
            f"validation rows, {a.validation_rms:.4g}, and no simpler one comes within one standard error of it."
        )
    return (
        f"Of {count} structures, order {a.order} with delay {a.delay} is the simplest whose free-run error on the "
        f"validation rows, {a.validation_rms:.4g}, is within one standard error or 1 % of the best, "
        f"{b.validation_rms:.4g} (order {b.order}, delay {b.delay})."
    )


def suggested_delays(record: Record, rows: Mask) -> tuple[int, ...]:
    """Return the delays worth trying: 0, 1 and those where the input first shows.

    A long difference equation from u(k), u(k-1), ... is fitted by least squares; its leading
    coefficients are zero up to the dead time, whatever the noise, if the equation is long enough.

    Parameters
    ----------
    record : Record
    rows : ndarray of bool, shape (n_samples,)

    Returns
    -------
    tuple of int, ascending
    """
    segments = make_segments(record, rows)
    n_rows = sum(int(s.used.sum()) for s in segments)
    n_inputs = len(record.inputs)
    length = int(np.clip(n_rows // (10 * (n_inputs + 1)), 2, LONGEST_DELAY))
    triangle: Floats | None = None
    for segment in segments:
        usable = np.flatnonzero(segment.used)
        usable = usable[usable >= length]
        for first in range(0, usable.size, BLOCK_ROWS):
            k = usable[first : first + BLOCK_ROWS]
            inputs = [segment.u[k - lag, i] for i in range(n_inputs) for lag in range(length + 1)]
            outputs = [segment.y[k - lag] for lag in range(1, length + 1)]
            triangle = fold(triangle, np.vstack([*outputs, *inputs, np.ones(k.size), segment.y[k]]))
    if triangle is None:
        return (1,)
    left, right = triangle[:-1, :-1], triangle[:-1, -1]
    scale = np.linalg.norm(left, axis=0)
    scale[scale == 0.0] = 1.0
    inverse = np.linalg.pinv(left / scale, rcond=1e-10)
    values = inverse @ right
    noise = abs(triangle[-1, -1]) / np.sqrt(max(n_rows - values.size, 1))
    errors = np.maximum(noise * np.linalg.norm(inverse, axis=1), 1e-12 * np.abs(values).max())
    present = (np.abs(values) > PRESENT * errors)[length:-1].reshape(n_inputs, length + 1).any(axis=0)
    if not present.any():
        return (0, 1)
    first = int(np.argmax(present))
    return tuple(sorted({0, 1, max(first - 1, 0), first, first + 1}))
