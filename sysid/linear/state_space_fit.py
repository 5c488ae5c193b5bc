"""Fit of state-space models by their free run, from subspace estimates."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.errors import DataError, IdentifiabilityError, UsageError
from sysid.linear.forms import Complexes, Floats
from sysid.linear.output_error import FINE_STEP, INITIAL_STATES, make_segments, whole_number
from sysid.linear.reduction import Structure
from sysid.linear.restarts import COARSE_STEP, agreement, same_error, same_output, search_from_many
from sysid.linear.sections import Sections, sections_of_poles
from sysid.linear.selection import standard_error
from sysid.linear.state_space import StateSpaceFit
from sysid.linear.state_space_starts import first_starts, further_starts
from sysid.linear.subspace import Run, factorise
from sysid.linear.uncertainty import autoregression
from sysid.separable.descent import Minimum, Residual, levenberg_marquardt

LARGEST_ORDER = 10
MOST_ORDER = 30
# The search runs on at most this many rows; what it finds is linear in no more than they tell.
SEARCHED_ROWS = 20_000
EVALUATIONS, TRIAL_EVALUATIONS = 150, 30
REWEIGHTINGS = 2
# An error within this share of the best is equal; so is one within a standard error from so many blocks.
PRACTICAL_SHARE, BLOCKS = 0.01, (20, 10, 5)
FRUITLESS_ORDERS = 3
DEEPEST = 40


def fit_state_space(
    record: Record,
    order: int | None = None,
    *,
    direct: bool = False,
    initial_state: str = "estimate",
    rows: Mask | None = None,
) -> StateSpaceFit:
    """Fit a state-space model by its free-run error, from subspace estimates.

    Of one output it is an output-error model in other coordinates, and found as one
    (`sysid.linear.fit_output_error`).  For several, PO-MOESP and PI-MOESP give two starts; A, B, C, D and
    initial states are then searched together, outputs weighed by what is left of them, from further starts
    until two ends agree in error and outputs.  An iterate with a pole outside the unit circle is not taken.

    Parameters
    ----------
    record : Record
        With any number of inputs and outputs.
    order : int, optional
        Number of states; by default the smallest of 1 to 10 whose free run over the validation rows is within
        one standard error, or 1 %, of the best.
    direct : bool
        Whether an input acts on an output at once.
    initial_state : {"estimate", "rest"}
        Whether each experiment starts from a state of its own, with an offset in each output; or from rest
        without one.
    rows : ndarray of bool, shape (n_samples,), optional
        Rows of the fit; estimation and validation rows by default.

    Returns
    -------
    StateSpaceFit

    Raises
    ------
    UsageError, DataError, IdentifiabilityError
        If an option makes no sense, outputs are missing, or there are too few rows.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> from sysid.linear import simulate_state_space
    >>> u = np.random.default_rng(0).standard_normal((400, 2))
    >>> A, B = [[0.8, 0.3], [-0.3, 0.8]], [[1.0, 0.0], [0.0, 0.5]]
    >>> y = simulate_state_space(A, B, [[1.0, 0.0], [1.0, 1.0]], np.zeros((2, 2)), u)
    >>> fit = fit_state_space(make_record(u, y, period=0.1), order=2, initial_state="rest")
    >>> np.round(fit.poles, 6)
    array([0.8+0.3j, 0.8-0.3j])
    """
    from threadpoolctl import threadpool_limits

    check_record(record)
    if initial_state not in INITIAL_STATES:
        raise UsageError(f"initial state is {initial_state!r}: choose estimate or rest")
    if order is not None and not 1 <= (order := whole_number("order", order)) <= MOST_ORDER:
        raise UsageError(f"order is {order}: give a number from 1 to {MOST_ORDER}")
    free_start = initial_state == "estimate"
    with threadpool_limits(1):
        validation: dict[int, float] = {}
        known: tuple[Complexes, ...] = ()
        if order is None:
            order, validation, known = _chosen_order(record, direct, free_start)
        trial = _Trial(record.learning if rows is None else rows, direct, free_start, known, precise=True)
        fit = _fit(record, order, trial)
    return _result(record, fit, validation)


@dataclass(frozen=True)
class _Trial:
    """What a fit is asked for; ``known`` are poles from which to search, too."""

    rows: Mask
    direct: bool
    free_start: bool
    known: tuple[Complexes, ...]
    precise: bool


@dataclass(frozen=True)
class _Search:
    model: Sections
    runs: tuple[Run, ...]
    converged: bool
    agreeing: int
    status: str


def _fit(record: Record, order: int, trial: _Trial) -> _Search:
    return _fit_one(record, order, trial) if record.y.shape[1] == 1 else _fit_several(record, order, trial)


def _fit_one(record: Record, order: int, trial: _Trial) -> _Search:
    """Fit a model of one output: an output-error model in other coordinates, so the search is that one's."""
    segments = make_segments(record, trial.rows)
    runs = tuple(Run(s.u, s.y[:, np.newaxis], s.used) for s in segments)
    _check_enough(record, runs, order, trial.free_start)
    structure = Structure(order, 0 if trial.direct else 1, trial.free_start, trial.free_start)
    found = search_from_many(segments, structure, trial.known, FINE_STEP if trial.precise else COARSE_STEP)
    search = found.search
    model = sections_of_poles(search.reflections, record.u.shape[1], trial.direct, trial.free_start)
    model = model.with_linear_part(runs, np.ones(1))
    return _Search(model, runs, search.converged, found.agreeing, f"{search.message}; {found.sentence}")


def _fit_several(record: Record, order: int, trial: _Trial) -> _Search:
    """Search all entries together, from further starts until two ends agree in error and output."""
    runs = make_runs(record, trial.rows)
    _check_enough(record, runs, order, trial.free_start)
    factor = factorise(runs, _depth(runs, order))
    if factor is None:
        raise IdentifiabilityError(
            f"too few rows follow one another for a subspace estimate of order {order}: lower the order, "
            "or take a longer record"
        )
    spread = np.std(np.concatenate([run.y[run.used] for run in runs]), axis=0)
    weights = 1.0 / np.maximum(spread, 1e-300)
    size = float(np.linalg.norm(np.concatenate([run.y[run.used] for run in runs]) * weights))
    evaluations = EVALUATIONS if trial.precise else TRIAL_EVALUATIONS
    starts = first_starts(factor, order, trial.direct, trial.free_start, runs, weights)
    ends = sorted((_search(start, runs, weights, evaluations) for start in starts), key=_cost)
    agreeing = _agreeing(ends, size)
    further = further_starts(ends[0][0], runs, weights) if trial.precise else iter(())
    while agreeing < 2 and (start := next(further, None)) is not None:
        ends = sorted([*ends, _search(start, runs, weights, evaluations)], key=_cost)
        agreeing = _agreeing(ends, size)
    model, minimum = ends[0]
    for _ in range(REWEIGHTINGS):
        left = np.sqrt(np.mean(np.square(_residuals(model, runs)), axis=0))
        weights = 1.0 / np.maximum(left, 1e-9 * spread)
        model, minimum = _search(model, runs, weights, evaluations)
    sentence = agreement(agreeing, len(ends))
    return _Search(model, runs, minimum.status.converged, agreeing, f"{minimum.status.value}; {sentence}")


_End = tuple[Sections, Minimum[Residual]]


def _cost(end: _End) -> float:
    return end[1].cost


def _agreeing(ends: Sequence[_End], size: float) -> int:
    """Return how many ends have the error and the outputs of the first, itself included."""
    best = ends[0][1]
    return sum(
        same_error(best.cost, end.cost, size)
        and same_output(best.point.residual, end.point.residual, best.cost, size)
        for _, end in ends
    )


def make_runs(record: Record, rows: Mask) -> tuple[Run, ...]:
    """Cut the experiments that hold chosen rows, each from its first row to its last chosen one."""
    runs, left = [], SEARCHED_ROWS
    for part in record.slices:
        used = np.flatnonzero(rows[part])[:left]
        left -= used.size
        if used.size == 0:
            continue
        end = int(used[-1]) + 1
        u, y = record.u[part][:end], record.y[part][:end]
        missing = ~np.isfinite(y[used]).all(axis=1)
        if missing.any():
            row = (part.start or 0) + int(used[np.argmax(missing)])
            raise DataError(
                f"row {row + 1}: an output is missing and cannot be fitted: leave the row out of the fit"
            )
        flags = np.zeros(end, dtype=bool)
        flags[used] = True
        runs.append(Run(u, np.where(flags[:, np.newaxis], y, 0.0), flags))
    if not runs:
        raise DataError("no row is chosen for the fit: mark rows as train, est or val")
    return tuple(runs)


def _check_enough(record: Record, runs: Sequence[Run], order: int, free_start: bool) -> None:
    m, p = record.u.shape[1], record.y.shape[1]
    unknowns = order * (m + p) + p * (m + 1) + (order * len(runs) if free_start else 0)
    values = p * sum(int(run.used.sum()) for run in runs)
    if values < 2 * unknowns:
        raise IdentifiabilityError(
            f"{values} measured values cannot determine {unknowns} unknowns (order {order}): at least "
            f"{2 * unknowns} are needed; lower the order"
        )


def _depth(runs: Sequence[Run], order: int) -> int:
    """Return the block rows of past and future: some more than the order, as long as rows allow."""
    channels = runs[0].u.shape[1] + runs[0].y.shape[1]
    longest = max(int(run.used.sum()) for run in runs)
    return int(np.clip(longest // (4 * channels), order + 1, min(max(2 * order, 10), DEEPEST)))


def _residuals(model: Sections, runs: Sequence[Run]) -> Floats:
    parts = [
        (model.response(run.u, start) - run.y)[run.used]
        for run, start in zip(runs, model.starts, strict=True)
    ]
    return np.concatenate(parts)


def _search(
    start: Sections, runs: Sequence[Run], weights: Floats, evaluations: int
) -> tuple[Sections, Minimum[Residual]]:
    """Descend in all entries together; the freedom of the state's coordinates is left to the damping."""
    free, base = start.free(), start.vector()

    def model(values: Floats) -> Sections:
        entries = base.copy()
        entries[free] = values
        return start.with_vector(entries)

    def residual(values: Floats) -> Floats:
        now = model(values)
        if not now.stable:
            return np.full(1, np.inf)
        return np.asarray((_residuals(now, runs) * weights).ravel())

    def jacobian(values: Floats) -> Floats:
        now = model(values)
        parts = [
            now.slopes(run, number)[1][run.used][:, :, free] * weights[:, np.newaxis]
            for number, run in enumerate(runs)
        ]
        return np.concatenate([part.reshape(-1, values.size) for part in parts])

    with np.errstate(all="ignore"):
        minimum = levenberg_marquardt(
            residual, jacobian, base[free], tolerance=1e-7, max_evaluations=evaluations
        )
    return model(minimum.x), minimum


def _chosen_order(
    record: Record, direct: bool, free_start: bool
) -> tuple[int, dict[int, float], tuple[Complexes, ...]]:
    """Return the smallest order that is as good as the best on the validation rows, all errors, its poles."""
    size = np.std(record.y[record.validation], axis=0)
    size[size == 0.0] = 1.0
    squares: dict[int, Floats] = {}
    poles: dict[int, Complexes] = {}
    problem: IdentifiabilityError | None = None
    for order in range(1, LARGEST_ORDER + 1):
        try:
            known = tuple(poles.values())[-2:]
            search = _fit(record, order, _Trial(record.estimation, direct, free_start, known, precise=False))
        except IdentifiabilityError as error:
            problem = error
            break
        poles[order] = search.model.poles
        free_run = _result(record, search, {}).predict(record, rows=record.estimation).free_run
        missed = (record.y - free_run.reshape(record.y.shape)) / size
        squares[order] = np.mean(missed[record.validation] ** 2, axis=1)
        best_before = min(
            (s.mean() for n, s in squares.items() if n <= order - FRUITLESS_ORDERS), default=0.0
        )
        recent = min(s.mean() for n, s in squares.items() if n > order - FRUITLESS_ORDERS)
        if best_before and recent > best_before * (1.0 - PRACTICAL_SHARE) ** 2:
            break
    if not squares:
        assert problem is not None
        raise problem
    best = min(squares, key=lambda n: float(squares[n].mean()))
    equal = [n for n in squares if _equal(squares[n], squares[best])]
    chosen = min(equal)
    return chosen, {n: float(np.sqrt(s.mean())) for n, s in squares.items()}, (poles[chosen],)


def _equal(squares: Floats, best: Floats) -> bool:
    if squares.mean() <= best.mean() * (1.0 + PRACTICAL_SHARE) ** 2:
        return True
    difference = squares - best
    return bool(difference.mean() <= max(standard_error(difference, count) for count in BLOCKS))


def _result(record: Record, search: _Search, validation: dict[int, float]) -> StateSpaceFit:
    model, runs = search.model, search.runs
    A, B, C, D = model.matrices()
    residual = _residuals(model, runs)
    cuts = np.cumsum([int(run.used.sum()) for run in runs])[:-1]
    noise = [autoregression(np.split(column, cuts)) for column in residual.T]
    measured = np.concatenate([run.y[run.used] for run in runs])
    chosen = f"order chosen from {len(validation)} on validation rows; " if validation else ""
    return StateSpaceFit(
        A=A,
        B=B,
        C=C,
        D=D,
        offset=model.offset,
        drift=model.drift,
        poles=model.poles,
        initial_state="estimate" if model.free_start else "rest",
        period=record.period,
        inputs=record.inputs,
        outputs=record.outputs,
        rms=np.sqrt(np.mean(residual**2, axis=0)),
        output_std=np.std(measured, axis=0),
        n_rows=measured.shape[0],
        noise=tuple(d for d, _ in noise),
        noise_std=np.array([std for _, std in noise]),
        validation=validation,
        converged=search.converged,
        restarts_agree=search.agreeing > 1,
        status=f"{chosen}{search.status}",
        sections=model,
    )
