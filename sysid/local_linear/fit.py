"""Fit of a composite local linear model to a measured record by its free run."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.errors import UsageError
from sysid.linear.uncertainty import autoregression
from sysid.local_linear.choice import Choice, Search, choose, refit
from sysid.local_linear.model import LocalLinearModel
from sysid.local_linear.problem import JACOBIANS, At, Jacobian, Problem
from sysid.local_linear.search import drawn_starts, given_start, linear_starts, search
from sysid.local_linear.signals import Scaled, schedule
from sysid.local_linear.simulation import free_run
from sysid.separable.descent import Minimum

if TYPE_CHECKING:
    from sysid.linear.simulation import Prediction

Floats = NDArray[np.float64]
INITIAL_STATES = ("estimate", "rest")
AGREEMENT = 1e-3


@dataclass(frozen=True)
class LocalLinearFit:
    """A fitted composite local linear model.

    Attributes
    ----------
    model : LocalLinearModel
        In the units of the record.
    scheduling : tuple of str
        Inputs that schedule; empty if a signal was given.
    initial_state : {"estimate", "rest"}
    inputs, outputs : tuple of str
    period : float
        Sampling period [s].
    rms, output_std : ndarray, shape (n_outputs,)
        Root mean square of the free-run residual, and standard deviation, on the rows of the fit.
    linear_rms : ndarray, shape (n_outputs,)
        The same for one linear model of this order.
    n_rows, n_parameters : int
    noise : tuple of ndarray
        For each output D(q), leading 1: its residual is white noise through 1/D.
    costs : tuple of float
        Cost after every step of the best search.
    converged, restarts_agree : bool
    status : str
    """

    model: LocalLinearModel
    scheduling: tuple[str, ...]
    initial_state: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    period: float
    rms: Floats
    output_std: Floats
    linear_rms: Floats
    n_rows: int
    n_parameters: int
    noise: tuple[Floats, ...]
    costs: tuple[float, ...]
    converged: bool
    restarts_agree: bool
    status: str

    @property
    def order(self) -> int:
        """Number of states."""
        return self.model.sizes.n_states

    def schedule(self, record: Record, scheduling: ArrayLike | None = None) -> Floats:
        """Return the scheduling signal of a record, shape (n_samples, n_scheduling)."""
        return schedule(record, self.scheduling if scheduling is None else scheduling)[1]

    def predict(
        self, record: Record, rows: Mask | None = None, *, scheduling: ArrayLike | None = None
    ) -> "Prediction":
        """Predict every row of a record.

        Parameters
        ----------
        record : Record
        rows : ndarray of bool, shape (n_samples,), optional
            Rows that may be used for initial states; estimation and validation rows by default.
        scheduling : array_like, shape (n_samples, n_scheduling), optional
            Needed if the model was fitted with a signal of its own.

        Returns
        -------
        Prediction
            With arrays of shape (n_samples, n_outputs) if there are several outputs.
        """
        from sysid.linear.simulation import Prediction, check_fits, predict_experiments

        check_fits(check_record(record), self.inputs, self.outputs, self.period)
        phi = self.schedule(record, scheduling)
        free_start = self.initial_state == "estimate"
        found = []
        for o, noise in enumerate(self.noise):

            def run(part: slice, used: Mask, fitted: bool, o: int = o) -> Floats:
                return self._run(record.u[part], phi[part], record.y[part], used)[:, o]

            found.append(predict_experiments(record, rows, self.order, noise, free_start, run, output=o))
        if len(found) == 1:
            return found[0]
        return Prediction(
            np.column_stack([one.free_run for one in found]),
            np.column_stack([one.one_step for one in found]),
            found[0].starts,
        )

    def _run(self, u: Floats, phi: Floats, y: Floats, used: Mask) -> Floats:
        weights = 1.0 / np.maximum(self.rms, 1e-12 * self.output_std)
        return free_run(self.model, u, phi, y, used, weights, self.initial_state == "estimate")

    def nrmse(self, record: Record, rows: Mask, *, scheduling: ArrayLike | None = None) -> Floats:
        """Return the free-run error over rows, relative to the deviation of each output from its mean.

        Fit in percent is 100 (1 - nrmse).
        """
        free_run = self.predict(record, scheduling=scheduling).free_run.reshape(record.y.shape)
        measured = record.y[rows]
        off = np.linalg.norm(measured - free_run[rows], axis=0)
        return np.asarray(off / np.linalg.norm(measured - measured.mean(axis=0), axis=0))

    def __repr__(self) -> str:
        sizes = self.model.sizes
        lines = [
            f"LocalLinearFit: {sizes.n_models} local models of order {sizes.n_states}, scheduled by "
            f"{', '.join(self.scheduling) or 'a given signal'}, {self.n_parameters} parameters, "
            f"{self.n_rows} rows"
        ]
        for name, rms, linear, size in zip(
            self.outputs, self.rms, self.linear_rms, self.output_std, strict=True
        ):
            lines.append(f"  {name}: rms {rms:.4g} of {size:.4g} ({linear:.4g} for one linear model)")
        return "\n".join([*lines, f"  {self.status}"])


def fit_local_linear(
    record: Record,
    order: int | None = None,
    models: int | None = None,
    *,
    scheduling: str | Sequence[str] | ArrayLike | None = None,
    initial_state: str = "estimate",
    rows: Mask | None = None,
    start: LocalLinearModel | None = None,
    restarts: int = 4,
    jacobian: Jacobian = "kaufman",
    seed: int = 0,
) -> LocalLinearFit:
    """Fit a composite local linear model by its free-run error.

    One linear model by PO-MOESP and one by PI-MOESP start all local models; centres are spread over the
    visited values and then, for each restart, drawn at random.  B and O are eliminated, the rest is searched
    together.  The searches see the estimation rows; which of them is taken, and order and number of local
    models where they are not given, is decided by the free run over the validation rows (see
    `choose_local_linear`), and the result is fitted again on both.

    Parameters
    ----------
    record : Record
        With any number of inputs and outputs.
    order : int, optional
        Number of states; chosen from 1 to 4 by default.
    models : int, optional
        Number of local models; chosen from 1 to 6 by default.
    scheduling : str, sequence of str or array_like, shape (n_samples, n_scheduling), optional
        Names of inputs, or a signal of its own; all inputs by default.
    initial_state : {"estimate", "rest"}
    rows : ndarray of bool, shape (n_samples,), optional
        Rows of the fit.  Then no rows are held out: the search with the smallest error on them is taken, and
        order and models must be given.
    start : LocalLinearModel, optional
        Where to begin instead; no rows are held out then.
    restarts : int
        Random starts beside the spread ones.
    jacobian : {"kaufman", "exact", "approach-2b"}
    seed : int
        Of the random starts.

    Returns
    -------
    LocalLinearFit

    Raises
    ------
    UsageError, DataError, ModelError, IdentifiabilityError
        If an option makes no sense, the scheduling does not vary, the start diverges, or there are too few
        rows.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> u = np.random.default_rng(0).uniform(-2, 2, 600)
    >>> x = np.zeros(601)
    >>> for k in range(600):
    ...     x[k + 1] = 0.7 * np.tanh(x[k]) + np.tanh(u[k])
    >>> record = make_record(u, x[:600], period=1.0)
    >>> fit = fit_local_linear(record, order=1, models=3, initial_state="rest")
    >>> bool(fit.rms[0] < 0.5 * fit.linear_rms[0])
    True
    """
    if rows is None and start is None:
        return choose_local_linear(
            record,
            order,
            models,
            scheduling=scheduling,
            initial_state=initial_state,
            restarts=restarts,
            jacobian=jacobian,
            seed=seed,
        ).fit
    if start is not None:
        order, models = order or start.sizes.n_states, models or start.sizes.n_models
    if order is None or models is None:
        raise UsageError(
            "order and models are chosen on validation rows: give both, or leave out the rows of the fit"
        )
    task = _task(record, order, models, scheduling, initial_state, restarts, jacobian, seed)
    problem, scaled = task.problem(order, models, record.learning if rows is None else rows)
    with threadpool_limits(1):
        if start is not None:
            starts = [given_start(problem, start, scaled)]
        else:
            starts = drawn_starts(problem, scaled, restarts, np.random.default_rng(seed))
        ends = search(problem, starts)
    agree = _agree(problem, ends)
    words = "lead to the same error" if agree else "lead to different errors"
    return _result(task, problem, scaled, ends[0], agree, f"the two best starts {words}")


@dataclass(frozen=True)
class LocalLinearChoice:
    """A chosen model on estimation rows, and again on estimation and validation rows.

    Attributes
    ----------
    fit, accepted : LocalLinearFit
        Fitted on estimation and validation rows, and on estimation rows only: its validation error is honest
        but for the choice.
    validation : dict
        Free-run error on validation rows of each structure (order, models) that was tried, relative to the
        size of the output.
    """

    fit: LocalLinearFit
    accepted: LocalLinearFit
    validation: dict[tuple[int, int], float]


def choose_local_linear(
    record: Record,
    order: int | None = None,
    models: int | None = None,
    *,
    scheduling: str | Sequence[str] | ArrayLike | None = None,
    initial_state: str = "estimate",
    restarts: int = 4,
    jacobian: Jacobian = "kaufman",
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> LocalLinearChoice:
    """Choose order, number of local models and restart by the free run over validation rows.

    Parameters and errors are those of `fit_local_linear`; ``progress`` is called with the structures that are
    done and the most there may be.

    Returns
    -------
    LocalLinearChoice
    """
    task = _task(record, order, models, scheduling, initial_state, restarts, jacobian, seed)
    with threadpool_limits(1):
        choice = choose(task, order, models, progress)
        chosen = choice.accepted
        end, problem, scaled, whole = refit(task, chosen)
    words = [_chosen_words(choice)]
    if not all(trial.bounded for trial in choice.ends):
        off = sum(not trial.bounded for trial in choice.ends)
        words.append(f"{off} of {len(choice.ends)} diverge there")
    if not chosen.bounded:
        words.append("so does the best: take fewer local models, or a scheduling signal that varies more")
    note = "; ".join(words)
    agree = _agree(problem, sorted((trial.minimum for trial in choice.ends), key=lambda m: m.cost)[:2])
    accepted = _result(task, chosen.problem, chosen.scaled, chosen.minimum, agree, note)
    if not accepted.converged:
        accepted = _stopped(accepted, f"stopped where the validation error was smallest; {note}")
    fit = _result(task, problem, scaled, end, agree, note)
    if not whole:
        kept = "A, C and the weights are those of the estimation rows, as a refit would grow without bound"
        fit = _stopped(fit, f"{kept}; {note}")
    return LocalLinearChoice(fit, accepted, choice.validation)


def _stopped(fit: LocalLinearFit, status: str) -> LocalLinearFit:
    """Return a fit that stopped for a good reason."""
    return replace(fit, converged=True, status=status)


def _chosen_words(choice: Choice) -> str:
    error = f"{100.0 * choice.accepted.error:.3g} % of the output"
    if len(choice.validation) == 1:
        return f"best of {len(choice.ends)} searches on the validation rows ({error})"
    found = f"of {len(choice.validation)} structures the simplest within 5 % of the best"
    return f"{found} on the validation rows ({error})"


def _task(
    record: Record,
    order: int | None,
    models: int | None,
    scheduling: str | Sequence[str] | ArrayLike | None,
    initial_state: str,
    restarts: int,
    jacobian: Jacobian,
    seed: int,
) -> Search:
    check_record(record)
    _check_options(order, models, restarts, initial_state, jacobian)
    names, phi = schedule(record, record.inputs if scheduling is None else scheduling)
    return Search(record, phi, names, initial_state, jacobian, restarts, seed)


def _check_options(
    order: int | None, models: int | None, restarts: int, initial_state: str, jacobian: str
) -> None:
    for name, value, least in (("order", order, 1), ("models", models, 1), ("restarts", restarts, 0)):
        if value is None:
            continue
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
            raise UsageError(f"{name} is {value!r}: give a whole number from {least}")
    if initial_state not in INITIAL_STATES:
        raise UsageError(f"initial state is {initial_state!r}: choose estimate or rest")
    if jacobian not in JACOBIANS:
        raise UsageError(f"jacobian is {jacobian!r}: choose one of {', '.join(JACOBIANS)}")


def _agree(problem: Problem, ends: Sequence[Minimum[At]]) -> bool:
    """Tell whether the two best ends have the same error."""
    size = sum(int(used.sum()) for used in problem.used) * problem.sizes.n_outputs
    return len(ends) == 1 or ends[1].cost <= ends[0].cost * (1.0 + AGREEMENT) ** 2 + 1e-18 * size


def _result(
    task: Search, problem: Problem, scaled: Scaled, best: Minimum[At], agree: bool, note: str
) -> LocalLinearFit:
    counts = [int(used.sum()) for used in problem.used]
    rows = sum(counts)
    measured = np.concatenate([y[used] for y, used in zip(problem.y, problem.used, strict=True)])
    residual = _residual(best.point, rows) * scaled.y_size
    linear = _linear(problem)
    return LocalLinearFit(
        model=scaled.physical(LocalLinearModel.of(problem.sizes, best.x, best.point.gains())),
        scheduling=task.names,
        initial_state=task.initial_state,
        inputs=task.record.inputs,
        outputs=task.record.outputs,
        period=task.record.period,
        rms=np.sqrt(np.mean(residual**2, axis=0)),
        output_std=np.std(measured * scaled.y_size, axis=0),
        linear_rms=np.sqrt(np.mean((_residual(linear, rows) * scaled.y_size) ** 2, axis=0)),
        n_rows=rows,
        n_parameters=problem.n_unknowns,
        noise=tuple(autoregression(np.split(column, np.cumsum(counts)[:-1]))[0] for column in residual.T),
        costs=best.costs,
        converged=best.status.converged,
        restarts_agree=agree,
        status=f"{best.status.value}; {note}",
    )


def _linear(problem: Problem) -> At:
    """Return one linear model, the better of the subspace estimates, with B, O and initial states fitted."""
    alone = replace(problem, sizes=replace(problem.sizes, n_models=1))
    q = problem.sizes.n_scheduling
    found = [
        alone(alone.sizes.pack(A[np.newaxis], C, np.ones((1, q)), np.zeros((1, q))))
        for A, C in linear_starts(problem)
    ]
    return min(found, key=lambda point: point.cost)


def _residual(point: At, rows: int) -> Floats:
    outputs = point.problem.sizes.n_outputs
    return point.solution.residual[: rows * outputs].reshape(rows, outputs)
