"""Choice of order, number of local models and restart by the free run over rows that were held out.

Where a local model is hardly ever in charge, the rows of the fit do not determine it, and a search may end at
a model that grows without bound as soon as the schedule moves elsewhere.  The error on the rows of the fit
does not tell; a free run over other rows does.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sysid.data import Record
from sysid.data.record import Mask
from sysid.errors import IdentifiabilityError
from sysid.linear.simulation import predict_experiments
from sysid.local_linear.model import LocalLinearModel
from sysid.local_linear.problem import At, Jacobian, Problem
from sysid.local_linear.search import check_enough, drawn_starts, given_start, search
from sysid.local_linear.signals import Scaled, scale
from sysid.local_linear.simulation import free_run
from sysid.local_linear.structure import Sizes
from sysid.separable.descent import Minimum, descend

Floats = NDArray[np.float64]

ORDERS, MODELS = range(1, 5), range(1, 7)
WINDOW = 8_000
"""Rows of the searches that decide the structure: choosing must not take longer than the fit it is for."""
EQUAL_SHARE = 0.05
"""An error within this share of the smallest is as good: the simplest of these structures is taken."""
FRUITLESS = 2
"""Structures without gain after which larger ones are not tried."""
BOUND = 10.0
"""A free run is bounded if it stays within so many standard deviations of the output from its mean."""
ROWS_PER_UNKNOWN = 4
GROWTH_TOLERANCE = 1e-3
FINAL_EVALUATIONS = 100
GRID = 1_000
MOST_GAIN = 1e100


@dataclass(frozen=True)
class Search:
    """What does not change from one structure to the next.

    Attributes
    ----------
    record : Record
    phi : ndarray, shape (n_samples, n_scheduling)
    names : tuple of str
        Of the scheduling inputs.
    initial_state : {"estimate", "rest"}
    jacobian : str
    restarts, seed : int
    """

    record: Record
    phi: Floats
    names: tuple[str, ...]
    initial_state: str
    jacobian: Jacobian
    restarts: int
    seed: int

    def problem(self, order: int, models: int, rows: Mask) -> tuple[Problem, Scaled]:
        """Return the problem on some rows, and its units."""
        scaled = scale(self.record, self.phi, rows)
        u, y = self.record.u, self.record.y
        sizes = Sizes(order, models, u.shape[1], y.shape[1], self.phi.shape[1])
        free_start = self.initial_state == "estimate"
        found = Problem(sizes, scaled.experiments, scaled.y, scaled.used, free_start, self.jacobian)
        check_enough(found, scaled, self.names)
        return found, scaled


@dataclass(frozen=True)
class Trial:
    """Where one search ended, and how its free run does on the validation rows.

    Attributes
    ----------
    minimum : Minimum
    model : LocalLinearModel
        In the units of the record.
    problem : Problem
    scaled : Scaled
    squares : ndarray, shape (n_validation,)
        Squared error relative to the variance of each output, mean over outputs.
    bounded : bool
    """

    minimum: Minimum[At]
    model: LocalLinearModel
    problem: Problem
    scaled: Scaled
    squares: Floats
    bounded: bool

    @property
    def error(self) -> float:
        """Validation error relative to the size of the output."""
        mean = float(np.mean(self.squares))
        return float(np.sqrt(mean)) if np.isfinite(mean) else np.inf


@dataclass(frozen=True)
class Choice:
    """The chosen structure and restart.

    Attributes
    ----------
    accepted : Trial
        Fitted on the estimation rows.
    ends : tuple of Trial
        Where all searches for its structure ended, the best on validation rows first.
    validation : dict
        Error of each structure (order, models), relative to the size of the output.
    """

    accepted: Trial
    ends: tuple[Trial, ...]
    validation: dict[tuple[int, int], float]


def choose(
    task: Search,
    order: int | None,
    models: int | None,
    progress: Callable[[int, int], None] | None = None,
) -> Choice:
    """Choose what is not given, and the restart, by the validation error.

    The simplest structure within 5 % of the smallest error is taken, and of its searches the best one; on a
    long record the structure is decided by searches on its first rows.

    Raises
    ------
    IdentifiabilityError
        If no structure can be determined by the rows.
    """
    window = _first(task.record)
    searched: dict[tuple[int, int], tuple[Trial, ...]] = {}
    problems: list[IdentifiabilityError] = []
    total = (1 if order else len(ORDERS)) * (1 if models else len(MODELS))

    def attempt(n: int, s: int) -> float:
        try:
            searched[n, s] = trials(task, n, s, window)
        except IdentifiabilityError as problem:
            problems.append(problem)
            return np.inf
        if progress is not None:
            progress(len(searched), total)
        return searched[n, s][0].error

    _explore(attempt, [order] if order else list(ORDERS), [models] if models else list(MODELS))
    if not searched:
        raise problems[0]
    best = min((ends[0] for ends in searched.values()), key=lambda trial: trial.error)
    near = [ends for ends in searched.values() if not ends[0].error > best.error * (1.0 + EQUAL_SHARE)]
    ends = min(near, key=lambda ends: ends[0].problem.n_unknowns)
    accepted = _on_all_rows(task, ends[0], window)
    return Choice(accepted, ends, {structure: ends[0].error for structure, ends in searched.items()})


def _explore(attempt: Callable[[int, int], float], orders: list[int], numbers: list[int]) -> None:
    """Try structures from small to large; stop where larger ones bring nothing."""
    best, idle_orders = np.inf, 0
    for n in orders:
        before, row, idle = best, np.inf, 0
        for s in numbers:
            error = attempt(n, s)
            idle = 0 if error < row else idle + 1
            row = min(row, error)
            if idle >= FRUITLESS:
                break
        best = min(best, row)
        idle_orders = 0 if best < before else idle_orders + 1
        if idle_orders >= FRUITLESS:
            break


def trials(task: Search, order: int, models: int, rows: Mask) -> tuple[Trial, ...]:
    """Search one structure from all starts; return every end, the best on the validation rows first.

    Ends of the short searches count too: one that was stopped early may do better elsewhere.
    """
    problem, scaled = task.problem(order, models, rows)
    if sum(int(used.sum()) for used in problem.used) * problem.sizes.n_outputs < (
        ROWS_PER_UNKNOWN * problem.n_unknowns
    ):
        raise IdentifiabilityError(
            f"{problem.n_unknowns} unknowns are too many to be chosen from {int(rows.sum())} rows: take "
            "fewer local models or a lower order"
        )
    starts = drawn_starts(problem, scaled, task.restarts, np.random.default_rng(task.seed))
    ends = [end for end in search(problem, starts, every=True) if _is_finite(end, scaled)]
    if not ends:
        raise IdentifiabilityError(
            "every search for local linear models ended at parameters beyond all numbers: take fewer local "
            "models, or another scheduling signal"
        )
    found = [judged(task, problem, scaled, end) for end in ends]
    return tuple(sorted(found, key=lambda trial: trial.error))


def _is_finite(end: Minimum[At], scaled: Scaled) -> bool:
    """Tell whether B and O are numbers in the units of the record: nothing holds them where p_i is 1e-300."""
    largest = float(np.abs(end.point.gains()).max())
    return largest < MOST_GAIN * min(1.0, float(scaled.u_size.min()))


def judged(task: Search, problem: Problem, scaled: Scaled, end: Minimum[At]) -> Trial:
    """Return an end of a search with its free run over the validation rows."""
    model = scaled.physical(LocalLinearModel.of(problem.sizes, end.x, end.point.gains()))
    record, rows = task.record, task.record.validation
    with np.errstate(all="ignore"):
        missed = np.column_stack(list(_errors(task, model, scaled)))[rows]
        squares = np.asarray(np.mean(np.square(missed / np.std(record.y[rows], axis=0)), axis=1))
        sizes = np.std(record.y[record.estimation], axis=0)
        bounded = bool(np.all(np.abs(missed) <= BOUND * sizes))
    return Trial(end, model, problem, scaled, np.where(np.isfinite(squares), squares, np.inf), bounded)


def _errors(task: Search, model: LocalLinearModel, scaled: Scaled) -> Iterator[Floats]:
    """Yield the free-run error of each output, initial states estimated on the estimation rows."""
    record, free_start = task.record, task.initial_state == "estimate"
    for o in range(record.y.shape[1]):

        def run(part: slice, used: Mask, fitted: bool, o: int = o) -> Floats:
            return free_run(
                model, record.u[part], task.phi[part], record.y[part], used, 1.0 / scaled.y_size, free_start
            )[:, o]

        order = model.sizes.n_states
        found = predict_experiments(record, record.estimation, order, np.ones(1), free_start, run, output=o)
        yield record.y[:, o] - found.free_run


def _first(record: Record) -> Mask:
    """Return the estimation rows, the first of each experiment where there are many."""
    rows = np.array(record.estimation)
    for part in record.slices:
        chosen = np.flatnonzero(rows[part])
        rows[part][chosen[WINDOW:]] = False
    return rows


def _on_all_rows(task: Search, trial: Trial, window: Mask) -> Trial:
    """Go on from a trial on all estimation rows, if it was searched on a part of them."""
    rows = task.record.estimation
    if np.array_equal(rows, window):
        return trial
    sizes = trial.problem.sizes
    problem, scaled = task.problem(sizes.n_states, sizes.n_models, rows)
    with np.errstate(all="ignore"):
        end = descend(
            problem,
            given_start(problem, trial.model, scaled),
            tolerance=1e-8,
            max_evaluations=FINAL_EVALUATIONS,
        )
    return judged(task, problem, scaled, end)


def growth(model: LocalLinearModel, phi: Floats) -> float:
    """Return the largest size of an eigenvalue of the mixed A over visited scheduling values."""
    visited = phi if phi.shape[0] <= GRID else phi[:: phi.shape[0] // GRID]
    mixed = np.einsum("ks,sij->kij", model.weights(visited), model.A)
    return float(np.abs(np.linalg.eigvals(mixed)).max())


def refit(task: Search, accepted: Trial) -> tuple[Minimum[At], Problem, Scaled, bool]:
    """Fit a chosen model again on estimation and validation rows.

    No rows are left that could tell whether the free run of the result stays bounded.  So where a mixture of
    local models, at a scheduling value of the record's learning rows, grows faster than in the chosen model
    and at all, A, C and the weights stay as they were and B and O alone are fitted again; the last value
    returned says whether all were.
    """
    sizes, rows = accepted.problem.sizes, task.record.learning
    problem, scaled = task.problem(sizes.n_states, sizes.n_models, rows)
    start = given_start(problem, accepted.model, scaled)
    with np.errstate(all="ignore"):
        end = descend(problem, start, tolerance=1e-8, max_evaluations=FINAL_EVALUATIONS)
    visited = task.phi[rows]
    allowed = max(1.0, growth(accepted.model, visited)) * (1.0 + GROWTH_TOLERANCE)
    if _is_finite(end, scaled):
        model = scaled.physical(LocalLinearModel.of(problem.sizes, end.x, end.point.gains()))
        if growth(model, visited) <= allowed:
            return end, problem, scaled, True
    point = problem(start)
    return replace(end, x=start, point=point, costs=(point.cost,)), problem, scaled, False
