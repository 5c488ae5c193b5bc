"""Structure of an LFT model, chosen by the free run on validation rows."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.data.record import Mask, Record
from sysid.errors import IdentifiabilityError, SysidError
from sysid.lft.estimate import Jacobian, fit_lft
from sysid.lft.free_run import refine_free_run
from sysid.lft.model import LftFit
from sysid.lft.signals import signals_of
from sysid.lft.structure import Lag, LftStructure
from sysid.linear.selection import PRACTICAL_SHARE, VALIDATION_BLOCKS, standard_error

Floats = NDArray[np.float64]

ORDERS = (1, 2, 3, 4)
FIRST_KNOTS, FURTHER_KNOTS = 5, (3, 8, 13)
LEADING = 2
# So many structures are refined by their free run; a trial does with so many evaluations.
REFINED, TRIAL_EVALUATIONS = 8, 30
ONE_STEP, FREE_RUN = "one-step", "free-run"
# Structures are compared by fits to so many rows at most.
SCREENED_ROWS = 10_000
LARGEST_DELAY = 10
# A delay of one sample is taken unless another one lowers the error by more than this share.
CLEARLY_BETTER = 0.02


@dataclass(frozen=True, eq=False)
class Trial:
    """One structure that was tried.

    Attributes
    ----------
    structure : LftStructure
    criterion : {"one-step", "free-run"}
        What the fit minimised.
    validation_rms : float
        Free-run error on the validation rows of a fit to estimation rows; infinite if it diverged
        or could not be fitted.
    problem : str
        Why it could not be fitted, or empty.
    squared : ndarray
        Squared free-run errors on the validation rows, by which it is compared.
    """

    structure: LftStructure
    criterion: str
    validation_rms: float
    problem: str = ""
    squared: Floats = field(default_factory=lambda: np.empty(0), repr=False)


@dataclass(frozen=True)
class LftChoice:
    """The accepted model and how its structure was chosen.

    Attributes
    ----------
    fit : LftFit
        Fitted to estimation and validation rows.
    accepted : LftFit
        The same structure fitted to estimation rows only: its validation error is an honest one.
    trials : tuple of Trial
        Best first; a single one if nothing was left to choose.
    reason : str
        One sentence.
    """

    fit: LftFit
    accepted: LftFit
    trials: tuple[Trial, ...]
    reason: str


def choose_lft(
    record: Record,
    given: Mapping[str, Any] | None = None,
    *,
    criterion: str | None = None,
    initial_state: str = "estimate",
    jacobian: Jacobian = "exact",
    starts: int = 3,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> LftChoice:
    """Choose what is not given of the structure by the free-run error on validation rows, then fit.

    Hammerstein, Wiener and Wiener-Hammerstein models, and maps fed by the output or by both, of
    orders 1 to 4 are fitted to estimation rows with 5 knots; the best are refined by their free
    run, and the best two then fitted with fewer and more knots.

    Parameters
    ----------
    record : Record
        With one output.
    given : mapping, optional
        Fields of `LftStructure` that are fixed.
    criterion : {"one-step", "free-run"}, optional
        What the fit minimises; chosen on validation rows, too, if not given.
    initial_state : {"estimate", "rest"}
        Whether free runs start from measured lags or from zero.
    jacobian, starts, seed
        See `fit_lft`.
    progress : callable, optional
        Called with the number of fits done and to do.

    Returns
    -------
    LftChoice

    Raises
    ------
    SysidError
        If no structure can be fitted; the reason is that of the simplest one.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> rng = np.random.default_rng(0)
    >>> u, y = rng.uniform(-2, 2, 900), np.zeros(900)
    >>> for k in range(1, 900):
    ...     y[k] = 0.7 * y[k - 1] + np.tanh(2 * u[k - 1]) + 0.05 * rng.standard_normal()
    >>> found = choose_lft(make_record(u, y, period=0.1), {"knots": 6}, criterion="one-step")
    >>> found.fit.structure.kind, found.fit.structure.n_a
    ('Hammerstein', 1)
    """
    fixed = dict(given or {})
    bench = _Bench(record, "rest" if initial_state == "rest" else "available", jacobian)
    first = _structures(record, fixed)
    criteria = (criterion,) if criterion else (ONE_STEP, FREE_RUN)
    trials: list[Trial] = []
    further = () if "knots" in fixed else FURTHER_KNOTS
    n_to_do = len(first) + REFINED + len(criteria) * LEADING * len(further) + 2

    def advance(done: int) -> None:
        if progress is not None:
            progress(min(done, n_to_do), n_to_do)

    if len(first) == 1 and len(criteria) == 1:
        structure, wanted = first[0], criteria[0]
    else:
        if not record.validation.any():
            raise IdentifiabilityError(
                "the record has no validation rows to choose a structure by: give the order of A, the lags "
                "of z and the criterion, or more rows"
            )
        for candidate in first:
            trials.append(bench.tried(candidate, ONE_STEP))
            advance(len(trials))
        if FREE_RUN in criteria:
            for trial in _leading(trials, REFINED):
                trials.append(bench.tried(trial.structure, FREE_RUN))
                advance(len(trials))
        trials = [trial for trial in trials if trial.criterion in criteria]
        for trial in _leading(trials, LEADING) if len(first) > 1 else []:
            for knots in further:
                trials.append(bench.tried(replace(trial.structure, knots=knots), trial.criterion))
                advance(len(trials))
        trials.sort(key=lambda trial: (trial.validation_rms, trial.structure.n_parameters))
        structure, wanted = _simplest(trials)
    accepted = fit_lft(record, structure, rows=record.estimation, jacobian=jacobian, starts=starts, seed=seed)
    fit = fit_lft(record, structure, start=accepted, jacobian=jacobian)
    advance(n_to_do - 1)
    if wanted == FREE_RUN:
        accepted = refine_free_run(
            record, accepted, rows=record.estimation, initial_state=bench.initial_state
        )
        fit = refine_free_run(record, accepted, initial_state=bench.initial_state)
    advance(n_to_do)
    return LftChoice(
        fit,
        accepted,
        tuple(trials) or (Trial(structure, wanted, np.nan),),
        _reason(trials, structure, wanted),
    )


def _structures(record: Record, fixed: Mapping[str, Any]) -> list[LftStructure]:
    """Return the structures to be tried, each once, the simpler ones first."""
    delay = 1 if {"z_lags", "b_lags"} <= fixed.keys() else likely_delay(record)

    def lags_of(names: Iterable[str], count: int) -> tuple[Lag, ...]:
        return tuple((name, delay + i) for i in range(count) for name in names)

    output: tuple[Lag, ...] = (("y", 1),)
    families: list[dict[str, Any]] = []
    for n in ORDERS:
        for name in record.inputs:  # one input through the map, the others beside it
            beside = lags_of([other for other in record.inputs if other != name], n)
            families += [
                {"n_a": n, "n_g": m, "b_lags": beside, "z_lags": lags_of([name], taps)}
                for taps in (1, 2)
                for m in (n - 1, n)
            ]
            families.append({"b_lags": beside, "z_lags": lags_of([name], n + 1)})
        every = lags_of(record.inputs, n)
        families.append({"n_a": n, "b_lags": every, "z_lags": output})
        # G would make columns of A and B that the map can all but stand for: the data tell them apart badly.
        families.append({"n_a": n, "b_lags": every, "z_lags": (*lags_of(record.inputs, 1), *output)})
    if {"n_a", "z_lags"} <= fixed.keys():  # what is left open then is simply absent
        families = [{}]
    defaults: dict[str, Any] = {"knots": FIRST_KNOTS, "overlap": "keep"}
    found: list[LftStructure] = []
    for family in families:
        structure = LftStructure(**{**defaults, **family, **fixed})
        if structure not in found:
            found.append(structure)
    return found


def likely_delay(record: Record) -> int:
    """Return the delay [samples] of the linear regression that predicts best one step ahead.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> u = np.random.default_rng(0).standard_normal(300)
    >>> y = np.convolve(u, [0.0, 0.0, 0.0, 1.0, 0.8])[:300]
    >>> likely_delay(make_record(u, y, period=1.0))
    3
    """
    signals = signals_of(record)
    times = np.flatnonzero(_screened_rows(record) & (signals.age() >= LARGEST_DELAY + 2)).astype(np.int64)
    if times.size < 20:
        return 1
    past = signals.lagged([("y", 1), ("y", 2)], times)
    ones, y = np.ones((times.size, 1)), signals.y[times]
    errors = []
    for delay in range(LARGEST_DELAY + 1):
        taps = signals.lagged([(name, delay + i) for name in record.inputs for i in (0, 1)], times)
        columns = np.column_stack([past, taps, ones])
        errors.append(float(np.sum((y - columns @ np.linalg.lstsq(columns, y)[0]) ** 2)))
    best = int(np.argmin(errors))
    return best if errors[best] < (1.0 - CLEARLY_BETTER) * errors[1] else 1


def _screened_rows(record: Record) -> Mask:
    rows = np.zeros(record.n_samples, dtype=bool)
    rows[np.flatnonzero(record.estimation)[:SCREENED_ROWS]] = True
    return rows


class _Bench:
    """Fits candidates to some estimation rows and scores their free run on the validation rows."""

    def __init__(self, record: Record, initial_state: str, jacobian: Jacobian) -> None:
        self.record, self.initial_state, self.jacobian = record, initial_state, jacobian
        self.rows = _screened_rows(record)

    def tried(self, structure: LftStructure, criterion: str) -> Trial:
        """Return how well a structure does."""
        try:
            fit = fit_lft(self.record, structure, rows=self.rows, jacobian=self.jacobian, tolerance=1e-6)
            if criterion == FREE_RUN:
                fit = refine_free_run(
                    self.record,
                    fit,
                    rows=self.rows,
                    initial_state=self.initial_state,
                    tolerance=1e-5,
                    max_evaluations=TRIAL_EVALUATIONS,
                )
        except SysidError as problem:
            return Trial(structure, criterion, np.inf, str(problem))
        run = fit.simulate(self.record, initial_state=self.initial_state, diverged="nan")
        error = (self.record.y[:, 0] - run)[self.record.validation]
        rms = float(np.sqrt(np.mean(error**2)))
        if not np.isfinite(rms):
            return Trial(structure, criterion, np.inf, "its free run diverges")
        return Trial(structure, criterion, rms, squared=error**2)


def _leading(trials: list[Trial], count: int) -> list[Trial]:
    """Return the best trials, those that could not be run left out."""
    usable = [trial for trial in trials if np.isfinite(trial.validation_rms)]
    return sorted(usable, key=lambda trial: trial.validation_rms)[:count]


def _simplest(trials: list[Trial]) -> tuple[LftStructure, str]:
    best = trials[0].validation_rms
    if not np.isfinite(best):
        simplest = min(trials, key=lambda trial: trial.structure.n_parameters)
        raise IdentifiabilityError(
            f"none of {len(trials)} structures could be fitted and run on the validation rows; the simplest: "
            f"{simplest.problem}"
        )
    near = [trial for trial in trials if _equal(trial, trials[0])]
    # A map of fewer signals is simpler to read.
    chosen = min(near, key=lambda t: (t.structure.n_parameters, len(t.structure.z_lags), t.validation_rms))
    return chosen.structure, chosen.criterion


def _equal(trial: Trial, best: Trial) -> bool:
    """Tell whether a trial is within one standard error, or 1 %, of the best."""
    if trial.validation_rms <= best.validation_rms * (1.0 + PRACTICAL_SHARE):
        return True
    if not np.isfinite(trial.validation_rms):
        return False
    difference = trial.squared - best.squared
    return bool(difference.mean() <= max(standard_error(difference, count) for count in VALIDATION_BLOCKS))


def _reason(trials: list[Trial], structure: LftStructure, criterion: str) -> str:
    fitted = "fitted by its one-step prediction" if criterion == ONE_STEP else "refined by its free run"
    if not trials:
        return f"The structure was given; it was {fitted}."
    return (
        f"The structure is the simplest of {len(trials)} fits whose free-run error on the validation rows is "
        f"within one standard error or 1 % of the best: {structure.words}, {fitted}."
    )
