"""Fit of state-space models by their free run, from subspace estimates."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.errors import DataError, IdentifiabilityError, UsageError
from sysid.linear.forms import Floats
from sysid.linear.output_error import INITIAL_STATES, whole_number
from sysid.linear.sections import Sections, sections_of
from sysid.linear.selection import standard_error
from sysid.linear.state_space import StateSpaceFit
from sysid.linear.subspace import INSTRUMENTS, Factor, Run, factorise
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
AGREEMENT = 1e-3
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

    PO-MOESP and PI-MOESP give two starts; A, B, C, D and initial states are then searched together, outputs
    weighed by what is left of them.  An iterate with a pole outside the unit circle is not taken.

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
        if order is None:
            order, validation = _chosen_order(record, direct, free_start)
        fit = _fit(record, order, direct, free_start, record.learning if rows is None else rows, EVALUATIONS)
    return _result(record, fit, validation)


@dataclass(frozen=True)
class _Search:
    model: Sections
    runs: tuple[Run, ...]
    converged: bool
    agreeing: int
    status: str


def _fit(record: Record, order: int, direct: bool, free_start: bool, rows: Mask, evaluations: int) -> _Search:
    runs = make_runs(record, rows)
    _check_enough(record, runs, order, free_start)
    factor = factorise(runs, _depth(runs, order))
    if factor is None:
        raise IdentifiabilityError(
            f"too few rows follow one another for a subspace estimate of order {order}: lower the order, "
            "or take a longer record"
        )
    spread = np.std(np.concatenate([run.y[run.used] for run in runs]), axis=0)
    weights = 1.0 / np.maximum(spread, 1e-300)
    ends = []
    for start in _starts(factor, order, direct, free_start, runs, weights):
        ends.append(_search(start, runs, weights, evaluations))
    ends.sort(key=lambda end: end[1].cost)
    model, minimum = ends[0]
    for _ in range(REWEIGHTINGS if spread.size > 1 else 0):
        left = np.sqrt(np.mean(np.square(_residuals(model, runs)), axis=0))
        weights = 1.0 / np.maximum(left, 1e-9 * spread)
        model, minimum = _search(model, runs, weights, evaluations)
    floor = 1e-18 * sum(int(run.used.sum()) for run in runs) * spread.size
    near = sum(end[1].cost <= ends[0][1].cost * (1.0 + AGREEMENT) ** 2 + floor for end in ends)
    return _Search(model, runs, minimum.status.converged, near, minimum.status.value)


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


def _starts(
    factor: Factor, order: int, direct: bool, free_start: bool, runs: Sequence[Run], weights: Floats
) -> list[Sections]:
    found = []
    for kind in INSTRUMENTS:
        A, C = factor.dynamics(kind, order)
        model = sections_of(A, C, factor.n_inputs, direct=direct, constant=free_start, free_start=free_start)
        found.append(model.with_linear_part(runs, weights))
    return found


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


def _chosen_order(record: Record, direct: bool, free_start: bool) -> tuple[int, dict[int, float]]:
    """Return the smallest order that is as good as the best on the validation rows, and all errors."""
    size = np.std(record.y[record.validation], axis=0)
    size[size == 0.0] = 1.0
    squares: dict[int, Floats] = {}
    problem: IdentifiabilityError | None = None
    for order in range(1, LARGEST_ORDER + 1):
        try:
            search = _fit(record, order, direct, free_start, record.estimation, TRIAL_EVALUATIONS)
        except IdentifiabilityError as error:
            problem = error
            break
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
    return min(equal), {n: float(np.sqrt(s.mean())) for n, s in squares.items()}


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
    agreement = (
        "PO-MOESP and PI-MOESP lead to the same error"
        if search.agreeing > 1
        else "PO-MOESP and PI-MOESP lead to different errors: compare other orders"
    )
    return StateSpaceFit(
        A=A,
        B=B,
        C=C,
        D=D,
        offset=model.offset,
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
        status=f"{chosen}{search.status}; {agreement}",
        sections=model,
    )
