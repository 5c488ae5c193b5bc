"""Order, delay, direct term and constant of a linear model, chosen on validation rows."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.errors import SysidError
from sysid.linear.forms import Complexes, Floats
from sysid.linear.output_error import OutputErrorFit, fit_output_error, whole_number
from sysid.linear.simulation import first_rows, predict, run_free

LARGEST_ORDER = 8
# An error within this share of the best counts as equal, however small its standard error.
PRACTICAL_SHARE = 0.01
# Errors are correlated over an unknown time: the largest standard error from these numbers of blocks counts.
VALIDATION_BLOCKS = (20, 10, 5)
# Delays of the first scan [samples], and the rows it looks at.
COARSE_DELAYS = (0, 1, 2, 3, 4, 6, 8, 11, 15, 20, 27)
SCANNED_ROWS = 10_000
DEAD_TIME_SHARE = 0.05
LEADING_DELAYS = 2
FRUITLESS_ORDERS = 3


@dataclass(frozen=True)
class Candidate:
    """One structure that was tried.

    Attributes
    ----------
    order, delay : int
    constant : bool
    validation_rms : float
        Free-run error on the validation rows, fitted on the estimation rows.
    restarts_agree : bool
        Whether searches from different starts ended at the same error.
    """

    order: int
    delay: int
    constant: bool
    validation_rms: float
    restarts_agree: bool


@dataclass(frozen=True)
class Choice:
    """The accepted model and how it was chosen.

    Attributes
    ----------
    fit : OutputErrorFit
        Refitted on estimation and validation rows.
    accepted : OutputErrorFit
        The same structure fitted on estimation rows only: its validation error is an honest one.
    restarts_agree : bool
        Whether the searches for this structure from different starts agreed.
    candidates : tuple of Candidate
    reason : str
        One sentence.
    """

    fit: OutputErrorFit
    accepted: OutputErrorFit
    restarts_agree: bool
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
    of the best one's, or within 1 %: smaller differences are not worth a parameter.  A constant is
    left out if the error stays within 1 % without it.

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
    check_record(record)
    order = None if order is None else whole_number("order", order)
    delay = None if delay is None else whole_number("delay", delay)
    if order is not None and delay is not None and constant is not None:
        return _fixed(record, order, delay, constant, initial_state)
    orders = range(1, LARGEST_ORDER + 1) if order is None else range(order, order + 1)
    delays = suggested_delays(record, _first(record.estimation), initial_state) if delay is None else (delay,)
    first_constant = initial_state == "estimate" if constant is None else constant
    steps = len(orders) * len(delays)
    trials: list[_Trial] = []
    last_problem: SysidError | None = None
    for place, n in enumerate(orders):
        for lag in _leading_delays(trials, delays, n):
            try:
                trials.append(_try(record, n, lag, first_constant, initial_state, trials))
            except SysidError as problem:
                last_problem = problem
        if progress is not None:
            progress((place + 1) * len(delays), steps)
        if _stalled(trials, n):
            break
    if not trials:
        assert last_problem is not None
        raise last_problem
    accepted, best = _simplest(record, trials)
    if constant is None and first_constant:
        without = _try(record, accepted.fit.order, accepted.fit.delay, False, initial_state, trials)
        trials.append(without)
        if without.candidate.validation_rms <= accepted.candidate.validation_rms * (1.0 + PRACTICAL_SHARE):
            accepted = without
    return _choice(record, accepted, trials, _reason(record, accepted, best, len(trials)))


def _choice(record: Record, accepted: _Trial, trials: list[_Trial], reason: str) -> Choice:
    return Choice(
        fit=_refit(record, accepted.fit, record.learning),
        accepted=_refit(record, accepted.fit, record.estimation),
        restarts_agree=accepted.fit.restarts_agree,
        candidates=tuple(trial.candidate for trial in trials),
        reason=reason,
    )


def _refit(record: Record, accepted: OutputErrorFit, rows: Mask) -> OutputErrorFit:
    """Refit the accepted model to the last digit on other rows, from where it is."""
    structure = accepted.structure
    return fit_output_error(
        record,
        structure.order,
        delay=structure.delay,
        constant=structure.constant,
        initial_state="estimate" if structure.free_start else "rest",
        rows=rows,
        start=accepted.poles,
    )


def _first(rows: Mask) -> Mask:
    """Keep the first rows."""
    kept = rows.copy()
    kept[np.flatnonzero(rows)[SCANNED_ROWS:]] = False
    return kept


def _leading_delays(trials: list[_Trial], delays: tuple[int, ...], order: int) -> tuple[int, ...]:
    """Return the delays to try: from order 4 on only 1 and the two that did best with orders 2 and 3."""
    seen = [trial.candidate for trial in trials if trial.candidate.order in (2, 3)]
    if order < 4 or not seen:
        return delays
    best = {lag: min((c.validation_rms for c in seen if c.delay == lag), default=np.inf) for lag in delays}
    leading = sorted(delays, key=lambda lag: best[lag])[:LEADING_DELAYS]
    return tuple(sorted({1, *leading} & set(delays)))


def _stalled(trials: list[_Trial], order: int) -> bool:
    """Tell whether three orders in a row brought nothing worth having."""
    before = [t.candidate.validation_rms for t in trials if t.candidate.order <= order - FRUITLESS_ORDERS]
    after = [t.candidate.validation_rms for t in trials if t.candidate.order > order - FRUITLESS_ORDERS]
    return bool(before) and bool(after) and min(after) > min(before) * (1.0 - PRACTICAL_SHARE)


def _fixed(record: Record, order: int, delay: int, constant: bool, initial_state: str) -> Choice:
    trial = _try(record, order, delay, constant, initial_state, [])
    return _choice(record, trial, [trial], "The structure was given.")


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
    squared = _validation_squares(fit, record)
    rms = float(np.sqrt(squared.mean()))
    return _Trial(fit, squared, Candidate(order, delay, constant, rms, fit.restarts_agree))


def _validation_squares(fit: OutputErrorFit, record: Record) -> Floats:
    """Return the squared free-run errors by which structures are compared.

    The run over the validation rows goes on from the estimation rows.  If a test set is an
    experiment of its own, a run that starts anew on the validation rows, with as few rows for its
    initial state as the test will have, counts as much: a state that needs a long past is of no use
    there.
    """
    free_run = predict(fit, record, rows=record.estimation).free_run
    squares = (record.y[:, 0] - free_run) ** 2
    fresh = [part for part in record.slices if not record.learning[part].any()]
    if not fresh or not fit.structure.free_start:
        return np.asarray(squares[record.validation])
    skip = max(record.skip.get(str(record.split[part][0]), 0) for part in fresh)
    compared = []
    for part in record.slices:
        rows = part.start + np.flatnonzero(record.validation[part])
        if rows.size == 0:
            continue
        whole = slice(int(rows[0]), int(rows[-1]) + 1)
        y = np.where(record.validation[whole], record.y[whole, 0], np.nan)
        used, _ = first_rows(y, skip, fit.order)
        anew = (y - run_free(fit, record.u[whole], y, used)) ** 2
        late = np.arange(y.size) >= min(skip, y.size // 2)
        compared.append(0.5 * (squares[whole] + anew)[late & record.validation[whole]])
    return np.concatenate(compared)


def _known_poles(before: list[_Trial], order: int, delay: int) -> list[Complexes]:
    poles = [t.fit.poles for t in before if t.fit.order == order]
    return poles + [
        t.fit.poles for t in before if t.fit.order in (order - 1, order - 2) and t.fit.delay == delay
    ]


def _simplest(record: Record, trials: list[_Trial]) -> tuple[_Trial, _Trial]:
    """Return the simplest trial that is as good as the best one, and the best one.

    A structure whose searches end at different errors is left out where others are reproducible:
    refitted on more rows it could become another model.
    """
    trials = [trial for trial in trials if trial.fit.restarts_agree] or trials
    best = min(trials, key=lambda trial: trial.candidate.validation_rms)
    equal = [trial for trial in trials if _equal(trial, best)]
    fewest = min(_size(record, trial) for trial in equal)
    simple = [trial for trial in equal if _size(record, trial) == fewest]
    return min(simple, key=lambda trial: trial.candidate.validation_rms), best


def _size(record: Record, trial: _Trial) -> int:
    """Return the number of parameters; a dead time counts as one."""
    return trial.fit.structure.n_parameters(len(record.inputs)) + int(trial.fit.delay > 1)


def _equal(trial: _Trial, best: _Trial) -> bool:
    """Tell whether a trial is within one standard error, or 1 %, of the best."""
    if trial.candidate.validation_rms <= best.candidate.validation_rms * (1.0 + PRACTICAL_SHARE):
        return True
    difference = trial.squared - best.squared
    return bool(difference.mean() <= max(standard_error(difference, count) for count in VALIDATION_BLOCKS))


def standard_error(values: Floats, count: int) -> float:
    """Return the standard error of the mean of a correlated series from the means of its blocks."""
    means = np.array([block.mean() for block in np.array_split(values, count) if block.size])
    return float(means.std(ddof=1) / np.sqrt(means.size))


def _reason(record: Record, accepted: _Trial, best: _Trial, count: int) -> str:
    a, b = accepted.candidate, best.candidate
    unit = record.unit(record.outputs[0])
    runs = "validation rows"
    if any(not record.learning[part].any() for part in record.slices) and accepted.fit.structure.free_start:
        runs += ", continued and started anew"
    own, least = f"{a.validation_rms:.3g} {unit}".strip(), f"{b.validation_rms:.3g} {unit}".strip()
    if accepted is best:
        return (
            f"Of {count} structures, order {a.order} with delay {a.delay} has the smallest free-run error on "
            f"the {runs}, {own}, and no simpler one comes within one standard error of it."
        )
    return (
        f"Of {count} structures, order {a.order} with delay {a.delay} is the simplest whose free-run error "
        f"on the {runs}, {own}, is within one standard error or 1 % of the best, "
        f"{least} (order {b.order}, delay {b.delay})."
    )


def suggested_delays(record: Record, rows: Mask, initial_state: str = "estimate") -> tuple[int, ...]:
    """Return the delays worth trying: 1, and those around the best one of a second-order model.

    Models of equal order and different delay have the same number of parameters, so that their
    errors on the rows of the fit can be compared.  A coarse scan comes first.  Of delays that are
    equal within 5 % the shortest counts: a slow response looks like a dead time too.

    Parameters
    ----------
    record : Record
    rows : ndarray of bool, shape (n_samples,)
    initial_state : {"estimate", "rest"}

    Returns
    -------
    tuple of int, ascending
    """
    longest = int(rows.sum()) // 20
    errors: dict[int, float] = {}
    poles: dict[int, Complexes] = {}

    def scan(delay: int, start: Complexes | None = None) -> None:
        try:
            fit = fit_output_error(
                record, 2, delay=delay, initial_state=initial_state, rows=rows, start=start, precise=False
            )
        except SysidError:
            errors[delay] = np.inf
        else:
            errors[delay], poles[delay] = fit.rms, fit.poles

    for delay in (lag for lag in COARSE_DELAYS if lag <= longest):
        scan(delay)
    best = min(errors, key=lambda lag: errors[lag])
    while new := [lag for lag in (best - 1, best + 1) if 0 <= lag <= longest and lag not in errors]:
        for delay in new:
            scan(delay, poles.get(best))  # one sample further the poles are nearly the same
        best = min(errors, key=lambda lag: errors[lag])
    first = min(lag for lag in errors if errors[lag] <= (1.0 + DEAD_TIME_SHARE) * errors[best])
    return tuple(sorted({1, max(first - 1, 0), first, first + 1}))
