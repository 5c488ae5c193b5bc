"""Orders, knots and oversampling of a Wiener-Hammerstein model, chosen on validation rows."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.errors import DataError, SysidError, UsageError
from sysid.lft.wiener_hammerstein.checks import check_enough, checked_form, checked_intervals, checked_orders
from sysid.lft.wiener_hammerstein.initial_state import run_from
from sysid.lft.wiener_hammerstein.model import WienerHammerstein
from sysid.lft.wiener_hammerstein.multistart import Multistart, fit_of
from sysid.lft.wiener_hammerstein.result import WienerHammersteinFit
from sysid.lft.wiener_hammerstein.search import COARSE_STEP, LEADING_ROWS, Found, Screening, refine, search
from sysid.linear.forms import Floats
from sysid.linear.output_error import make_segments
from sysid.linear.restarts import shortened
from sysid.linear.selection import PRACTICAL_SHARE, VALIDATION_BLOCKS, standard_error
from sysid.linear.simulation import first_rows
from sysid.nonlinearities.spline import Extrapolation

SHAPES = ("wiener-hammerstein", "wiener", "hammerstein")
LARGEST_EQUAL_ORDER, LARGEST_ORDER_ALONE = 4, 6
# Structures are compared with a map of so many intervals, which then are chosen in turn.
COMPARED_INTERVALS = 24
INTERVALS = (10, 20, 40, 80)
OVERSAMPLINGS = (1, 2)


@dataclass(frozen=True)
class Candidate:
    """One structure that was tried.

    Attributes
    ----------
    orders : (int, int)
    intervals : int
        Between the knots of the map.
    oversampling : int
    validation_rms : float
        Free-run error on the validation rows, fitted on the estimation rows.
    """

    orders: tuple[int, int]
    intervals: int
    oversampling: int
    validation_rms: float

    @property
    def size(self) -> int:
        """Number of parameters; a map between samples counts as one more."""
        return 2 * sum(self.orders) + self.intervals + self.oversampling - 1


@dataclass(frozen=True)
class WienerHammersteinChoice:
    """The accepted model and how it was chosen.

    Attributes
    ----------
    fit : WienerHammersteinFit
        Refitted on estimation and validation rows.
    accepted : WienerHammersteinFit
        The same structure fitted on estimation rows only: its validation error is an honest one.
    candidates : tuple of Candidate
    reason : str
        One sentence.
    """

    fit: WienerHammersteinFit
    accepted: WienerHammersteinFit
    candidates: tuple[Candidate, ...]
    reason: str


@dataclass(frozen=True)
class _Trial:
    model: WienerHammerstein
    screening: Screening
    squared: Floats
    candidate: Candidate


def choose_wiener_hammerstein(
    record: Record,
    *,
    orders: tuple[int, int] | None = None,
    knots: int | None = None,
    oversampling: int | None = None,
    shape: str = "wiener-hammerstein",
    delay: int = 0,
    degree: int = 3,
    extrapolation: Extrapolation = "linear",
    initial_state: str = "estimate",
    rows: Mask | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> WienerHammersteinChoice:
    """Choose a Wiener-Hammerstein model by its free-run error on validation rows, then refit it.

    Orders come first: equal ones, then their neighbours, on some of the estimation rows.  Then knots and
    oversampling are chosen on all of them, and lower orders are tried again with that map.  Each time the
    simplest candidate is taken whose squared error on the validation rows is, block by block, within one
    standard error of the best one's, or within 1 %.

    Parameters
    ----------
    record : Record
    orders, knots, oversampling
        Fixed if given; otherwise orders up to 5, 10 to 80 intervals and a map at or between samples are
        tried.
    shape : {"wiener-hammerstein", "wiener", "hammerstein"}
        Whether both blocks may have poles, only the front one, or only the back one.
    delay, degree, extrapolation, initial_state
        See `fit_wiener_hammerstein`.
    rows : ndarray of bool, shape (n_samples,), optional
        Rows of the last fit; estimation and validation rows by default.
    progress : callable, optional
        Called with the number of fits done and to do.

    Returns
    -------
    WienerHammersteinChoice

    Raises
    ------
    DataError, UsageError, IdentifiabilityError
        If the record has no validation rows, or if no structure can be fitted.
    """
    form = checked_form(check_record(record), delay, degree, extrapolation, initial_state)
    if not record.validation.any():
        raise DataError(
            "the record has no validation rows to choose a structure by: give orders, knots and oversampling"
        )
    if shape not in SHAPES:
        raise UsageError(f"shape is {shape!r}: choose one of {', '.join(SHAPES)}")
    compared = COMPARED_INTERVALS if knots is None else checked_intervals(knots)
    search_ = Multistart(make_segments(record, record.estimation), form)
    chooser = _Chooser(record, search_, progress)
    chosen_orders = chooser.orders if shape == "wiener-hammerstein" else partial(chooser.one_sided, shape)
    best = chosen_orders(compared) if orders is None else chooser.trial(checked_orders(orders), compared)
    intervals = INTERVALS if knots is None else (compared,)
    accepted, minimum = chooser.maps(
        best, intervals, OVERSAMPLINGS if oversampling is None else (oversampling,)
    )
    accepted, minimum = chooser.simplified(accepted, minimum)
    last = Multistart(make_segments(record, rows), form)
    final = refine(last.settled, minimum.model, accepted.candidate.intervals)
    chooser.step()
    return WienerHammersteinChoice(
        fit=fit_of(record, final, accepted.screening, accepted.candidate.intervals),
        accepted=fit_of(record, minimum, accepted.screening, accepted.candidate.intervals),
        candidates=tuple(trial.candidate for trial in chooser.trials),
        reason=_reason(record, accepted.candidate, chooser.trials),
    )


class _Chooser:
    """Fits candidates on estimation rows and compares them on validation rows."""

    def __init__(self, record: Record, search_: Multistart, progress: Callable[[int, int], None] | None):
        self.record, self.search, self.progress = record, search_, progress
        self.trials: list[_Trial] = []
        self.done, self.total = 0, LARGEST_EQUAL_ORDER + 4 + len(INTERVALS) * len(OVERSAMPLINGS) + 1

    def step(self) -> None:
        """Tell that one more fit is done."""
        self.done += 1
        if self.progress is not None:
            self.progress(min(self.done, self.total), self.total)

    def orders(self, intervals: int) -> _Trial:
        """Try equal orders and then the neighbours of the best."""
        for n in range(1, LARGEST_EQUAL_ORDER + 1):
            before = min((t.candidate.validation_rms for t in self.trials), default=np.inf)
            self._tried([(n, n)], intervals, final=n == LARGEST_EQUAL_ORDER)
            now = min((t.candidate.validation_rms for t in self.trials), default=np.inf)
            if now > before * (1.0 - PRACTICAL_SHARE):
                break
        front, back = self._simplest(self.trials).candidate.orders
        near = [(front - 1, back), (front, back - 1), (front + 1, back), (front, back + 1)]
        self._tried([pair for pair in near if sum(pair) > 0], intervals)
        return self._simplest(self.trials)

    def one_sided(self, shape: str, intervals: int) -> _Trial:
        """Try rising orders of the only block with poles."""
        for n in range(1, LARGEST_ORDER_ALONE + 1):
            before = min((t.candidate.validation_rms for t in self.trials), default=np.inf)
            pair = (n, 0) if shape == "wiener" else (0, n)
            self._tried([pair], intervals, final=n == LARGEST_ORDER_ALONE)
            now = min((t.candidate.validation_rms for t in self.trials), default=np.inf)
            if now > before * (1.0 - PRACTICAL_SHARE):
                break
        return self._simplest(self.trials)

    def trial(self, orders: tuple[int, int], intervals: int) -> _Trial:
        """Fit one structure on some of the estimation rows."""
        check_enough(self.search.segments, orders, intervals + self.search.form.map.degree)
        known = [t for t in self.trials if t.candidate.orders == orders]
        screening = known[0].screening if known else self.search.screened(orders)
        found = search(shortened(self.search.settled, LEADING_ROWS), screening.model, intervals, COARSE_STEP)
        trial = self._compared(found, screening, intervals)
        self.trials.append(trial)
        self.step()
        return trial

    def maps(
        self, best: _Trial, intervals: tuple[int, ...], oversamplings: tuple[int, ...]
    ) -> tuple[_Trial, Found]:
        """Fit maps of these numbers of intervals on all estimation rows; return the chosen one."""
        self.total = self.done + len(intervals) * len(oversamplings) + 1
        found: list[tuple[_Trial, Found]] = []
        model = best.model
        for oversampling in oversamplings:
            for count in intervals:
                try:
                    check_enough(self.search.segments, model.orders, count + model.map.degree)
                    start = replace(model, oversampling=oversampling)
                    end = refine(self.search.settled, start, count)
                except SysidError:
                    if not found and (oversampling, count) == (oversamplings[-1], intervals[-1]):
                        raise
                    continue
                trial = self._compared(end, best.screening, count)
                found.append((trial, end))
                self.trials.append(trial)
                self.step()
                model = trial.model
        chosen = self._simplest([trial for trial, _ in found])
        return next(pair for pair in found if pair[0] is chosen)

    def simplified(self, accepted: _Trial, minimum: Found) -> tuple[_Trial, Found]:
        """Go back to lower orders that were tried, where they do as well with the chosen map.

        Orders are compared with a map that may be too coarse, or act at samples only: higher ones make up for
        it.
        """
        while True:
            chosen = accepted.candidate
            front, back = chosen.orders
            pool = [(accepted, minimum)]
            for orders in ((front - 1, back), (front, back - 1)):
                known = [trial for trial in self.trials if trial.candidate.orders == orders]
                if known:
                    start = replace(known[-1].model, oversampling=chosen.oversampling)
                    end = refine(self.search.settled, start, chosen.intervals)
                    pool.append((self._compared(end, known[-1].screening, chosen.intervals), end))
                    self.trials.append(pool[-1][0])
            best = self._simplest([trial for trial, _ in pool])
            if best is accepted:
                return accepted, minimum
            accepted, minimum = next(pair for pair in pool if pair[0] is best)

    def _tried(self, pairs: list[tuple[int, int]], intervals: int, final: bool = True) -> None:
        """Try orders that were not tried; where none could be fitted in the end, say why."""
        problem: SysidError | None = None
        for pair in pairs:
            if any(trial.candidate.orders == pair for trial in self.trials):
                continue
            try:
                self.trial(pair, intervals)
            except SysidError as caught:
                problem = caught
        if final and not self.trials and problem is not None:
            raise problem

    def _compared(self, found: Found, screening: Screening, intervals: int) -> _Trial:
        record, model = self.record, found.model
        squares = []
        for part in record.slices:
            if record.validation[part].any():
                u, y = record.u[part, 0], record.y[part, 0]
                if record.estimation[part].any() or model.resting:
                    error = y - model.simulate(u)
                else:  # a run of its own begins in a state of its own
                    error = y - run_from(model, u, y, first_rows(y, 0, sum(model.orders))[0], found.rms)
                squares.append(error[record.validation[part]] ** 2)
        squared = np.concatenate(squares)
        rms = float(np.sqrt(squared.mean()))
        return _Trial(model, screening, squared, Candidate(model.orders, intervals, model.oversampling, rms))

    def _simplest(self, trials: list[_Trial]) -> _Trial:
        """Return the simplest trial that is as good as the best one."""
        best = min(trials, key=lambda trial: trial.candidate.validation_rms)
        equal = [trial for trial in trials if _equal(trial, best)]
        return min(equal, key=lambda trial: (trial.candidate.size, trial.candidate.validation_rms))


def _equal(trial: _Trial, best: _Trial) -> bool:
    if trial.candidate.validation_rms <= best.candidate.validation_rms * (1.0 + PRACTICAL_SHARE):
        return True
    difference = trial.squared - best.squared
    return bool(difference.mean() <= max(standard_error(difference, count) for count in VALIDATION_BLOCKS))


def _reason(record: Record, accepted: Candidate, trials: list[_Trial]) -> str:
    unit = record.unit(record.outputs[0])
    own = f"{accepted.validation_rms:.4g} {unit}".strip()
    between = (
        "a map at samples"
        if accepted.oversampling == 1
        else f"a map at {accepted.oversampling} points a sampling period"
    )
    return (
        f"Of {len(trials)} structures, orders {accepted.orders[0]} and {accepted.orders[1]} with "
        f"{accepted.intervals} intervals and {between} is the simplest whose free-run error on the "
        f"validation rows, {own}, is within one standard error or 1 % of the best."
    )
