"""Fit of a composite local linear model to a measured record by its free run."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.errors import DataError, IdentifiabilityError, ModelError, UsageError
from sysid.linear.subspace import INSTRUMENTS, Run, factorise
from sysid.linear.uncertainty import autoregression
from sysid.local_linear.model import LocalLinearModel
from sysid.local_linear.passes import regressors
from sysid.local_linear.problem import JACOBIANS, START_RIDGE, At, Jacobian, Problem
from sysid.local_linear.structure import Experiment, Sizes, course
from sysid.separable.descent import Minimum, descend

if TYPE_CHECKING:
    from sysid.linear.simulation import Prediction

Floats = NDArray[np.float64]
INITIAL_STATES = ("estimate", "rest")
EVALUATIONS, TRIAL_EVALUATIONS = 300, 40
DEEPEST = 20
AGREEMENT = 1e-3
STILL = 1e-9


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

    def schedule(self, record: Record, scheduling: ArrayLike | None = None) -> Floats:
        """Return the scheduling signal of a record, shape (n_samples, n_scheduling)."""
        return _schedule(record, self.scheduling if scheduling is None else scheduling)[1]

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

            order = self.model.sizes.n_states
            found.append(predict_experiments(record, rows, order, noise, free_start, run, output=o))
        if len(found) == 1:
            return found[0]
        return Prediction(
            np.column_stack([one.free_run for one in found]),
            np.column_stack([one.one_step for one in found]),
            found[0].starts,
        )

    def _run(self, u: Floats, phi: Floats, y: Floats, used: Mask) -> Floats:
        known = used & np.isfinite(y).all(axis=1)
        if self.initial_state != "estimate" or not known.any():
            return self.model.simulate(u, phi)
        forced = self.model.simulate(u, phi)
        sizes = self.model.sizes
        one = course(sizes, self.model.eta, Experiment.of(u, phi))
        free = regressors(one, starts=True)[:, :, sizes.n_linear :]
        weights = 1.0 / np.maximum(self.rms, 1e-12 * self.output_std)
        matrix = (free[known] * weights[:, np.newaxis]).reshape(-1, sizes.n_states)
        ridge = START_RIDGE * np.linalg.norm(matrix) * np.eye(sizes.n_states)
        target = np.concatenate([((y - forced)[known] * weights).ravel(), np.zeros(sizes.n_states)])
        return np.asarray(forced + free @ np.linalg.lstsq(np.vstack([matrix, ridge]), target, rcond=None)[0])

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
    order: int,
    models: int,
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
    together.

    Parameters
    ----------
    record : Record
        With any number of inputs and outputs.
    order : int
        Number of states.
    models : int
        Number of local models.
    scheduling : str, sequence of str or array_like, shape (n_samples, n_scheduling), optional
        Names of inputs, or a signal of its own; all inputs by default.
    initial_state : {"estimate", "rest"}
    rows : ndarray of bool, shape (n_samples,), optional
        Rows of the fit; estimation and validation rows by default.
    start : LocalLinearModel, optional
        Where to begin instead.
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
    from threadpoolctl import threadpool_limits

    check_record(record)
    _check_options(order, models, restarts, initial_state, jacobian)
    names, phi = _schedule(record, record.inputs if scheduling is None else scheduling)
    scaled = _scale(record, phi, record.learning if rows is None else rows)
    sizes = Sizes(order, models, record.u.shape[1], record.y.shape[1], phi.shape[1])
    free_start = initial_state == "estimate"
    problem = Problem(sizes, scaled.experiments, scaled.y, scaled.used, free_start, jacobian)
    _check_enough(problem, scaled, names)
    with threadpool_limits(1):
        if start is not None:
            starts = [_given(problem, start, scaled)]
        else:
            starts = _starts(problem, scaled, restarts, np.random.default_rng(seed))
        ends = _search(problem, starts)
    return _result(record, problem, scaled, ends, names, initial_state)


def _check_options(order: int, models: int, restarts: int, initial_state: str, jacobian: str) -> None:
    for name, value, least in (("order", order, 1), ("models", models, 1), ("restarts", restarts, 0)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
            raise UsageError(f"{name} is {value!r}: give a whole number from {least}")
    if initial_state not in INITIAL_STATES:
        raise UsageError(f"initial state is {initial_state!r}: choose estimate or rest")
    if jacobian not in JACOBIANS:
        raise UsageError(f"jacobian is {jacobian!r}: choose one of {', '.join(JACOBIANS)}")


def _schedule(record: Record, chosen: str | Sequence[str] | ArrayLike) -> tuple[tuple[str, ...], Floats]:
    """Return names and values of the scheduling signals."""
    texts = [chosen] if isinstance(chosen, str) else chosen
    if isinstance(texts, list | tuple) and texts and all(isinstance(name, str) for name in texts):
        unknown = [name for name in texts if name not in record.inputs]
        if unknown:
            raise UsageError(
                f"scheduling signal {unknown[0]!r} is no input ({', '.join(record.inputs)}): choose inputs, "
                "or give "
                "a signal as an array"
            )
        columns = [record.inputs.index(str(name)) for name in texts]
        return tuple(str(name) for name in texts), record.u[:, columns]
    if isinstance(texts, list | tuple) and not texts:
        raise UsageError(
            "the model was fitted with a scheduling signal of its own: give it for this record too"
        )
    values = np.asarray(texts, dtype=float)
    values = values[:, np.newaxis] if values.ndim == 1 else values
    if values.ndim != 2 or values.shape[0] != record.n_samples:
        raise DataError(
            f"the scheduling signal has shape {values.shape}: give one row for each of {record.n_samples} "
            "samples"
        )
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if bad.size:
        raise DataError(f"the scheduling signal is not finite at row {bad[0] + 1}: fill it before the fit")
    return (), values


@dataclass(frozen=True)
class _Scaled:
    """Experiments in units of their own: inputs and scheduling centred, all of size one."""

    experiments: tuple[Experiment, ...]
    y: tuple[Floats, ...]
    used: tuple[Mask, ...]
    u_mean: Floats
    u_size: Floats
    y_size: Floats
    phi_mean: Floats
    phi_size: Floats

    def visited(self) -> Floats:
        return np.concatenate([e.scheduling[m] for e, m in zip(self.experiments, self.used, strict=True)])

    def physical(self, model: LocalLinearModel) -> LocalLinearModel:
        """Return a model of the scaled signals in the units of the record."""
        B = model.B / self.u_size
        return replace(
            model,
            B=B,
            O=model.O - B @ self.u_mean,
            C=model.C * self.y_size[:, np.newaxis],
            centres=self.phi_mean + self.phi_size * model.centres,
            widths=model.widths / self.phi_size,
        )


def _scale(record: Record, phi: Floats, rows: Mask) -> _Scaled:
    cuts, masks = [], []
    for part in record.slices:
        chosen = np.flatnonzero(rows[part])
        if chosen.size:
            begin = part.start or 0
            cuts.append(slice(begin, begin + int(chosen[-1]) + 1))
            masks.append(np.asarray(rows[cuts[-1]], dtype=bool))
    if not cuts:
        raise DataError("no row is chosen for the fit: mark rows as train, est or val")
    for cut, mask in zip(cuts, masks, strict=True):
        missing = np.flatnonzero(mask & ~np.isfinite(record.y[cut]).all(axis=1))
        if missing.size:
            raise DataError(
                f"row {cut.start + int(missing[0]) + 1}: an output is missing and cannot be fitted: leave "
                "the row "
                "out of the fit"
            )
    u = np.concatenate([record.u[cut] for cut in cuts])
    y = np.concatenate([record.y[cut][mask] for cut, mask in zip(cuts, masks, strict=True)])
    visited = np.concatenate([phi[cut] for cut in cuts])
    u_size, y_size = np.std(u, axis=0), np.sqrt(np.mean(y**2, axis=0))
    u_size[u_size == 0.0], y_size[y_size == 0.0] = 1.0, 1.0
    phi_mean, phi_size = visited.mean(axis=0), visited.std(axis=0)
    still = np.flatnonzero(phi_size <= STILL * np.maximum(np.abs(phi_mean), 1e-300))
    if still.size:
        raise DataError(
            f"scheduling signal {int(still[0]) + 1} is constant ({phi_mean[still[0]]:g}) on the rows of the "
            "fit: "
            "choose a signal that varies, or fit a linear model with sysid.fit_state_space"
        )
    # The mean of the input goes into the constants O, and comes out of them again in `physical`.
    u_mean = u.mean(axis=0)
    experiments = tuple(
        Experiment.of((record.u[cut] - u_mean) / u_size, (phi[cut] - phi_mean) / phi_size) for cut in cuts
    )
    outputs = tuple(
        np.where(mask[:, np.newaxis], record.y[cut] / y_size, 0.0)
        for cut, mask in zip(cuts, masks, strict=True)
    )
    return _Scaled(experiments, outputs, tuple(masks), u_mean, u_size, y_size, phi_mean, phi_size)


def _check_enough(problem: Problem, scaled: _Scaled, names: tuple[str, ...]) -> None:
    sizes = problem.sizes
    values = sizes.n_outputs * sum(int(used.sum()) for used in problem.used)
    if values < 2 * problem.n_unknowns:
        raise IdentifiabilityError(
            f"{values} measured values cannot determine {problem.n_unknowns} unknowns ({sizes.n_models} "
            "local models "
            f"of order {sizes.n_states}): at least {2 * problem.n_unknowns} are needed; take fewer local "
            "models or a "
            "lower order"
        )
    different = np.unique(scaled.visited(), axis=0).shape[0]
    if different < sizes.n_models:
        raise IdentifiabilityError(
            f"the scheduling signal {' '.join(names)} takes {different} different values and there are "
            f"{sizes.n_models} local models: take at most {different}"
        )


def _given(problem: Problem, start: LocalLinearModel, scaled: _Scaled) -> Floats:
    if start.sizes != problem.sizes:
        raise ModelError(
            f"the start has {start.sizes}, and {problem.sizes} is to be fitted: give a matching one"
        )
    eta = problem.sizes.pack(
        start.A,
        start.C / scaled.y_size[:, np.newaxis],
        start.widths * scaled.phi_size,
        (start.centres - scaled.phi_mean) / scaled.phi_size,
    )
    if not np.isfinite(problem(eta).cost):
        radius = np.abs(np.linalg.eigvals(start.A)).max(axis=1)
        worst = int(np.argmax(radius))
        raise ModelError(
            f"the simulation of the start is not finite or a local model is never in charge; the largest "
            "eigenvalue "
            f"of A_{worst + 1} has the size {radius[worst]:.3g}: start from a stable model, or without one"
        )
    return eta


def linear_starts(problem: Problem) -> list[tuple[Floats, Floats]]:
    """Return A and C of one linear model by PO-MOESP and by PI-MOESP.

    Raises
    ------
    IdentifiabilityError
        If too few rows follow one another.
    """
    order = problem.sizes.n_states
    runs = [
        Run(experiment.inputs[:, :-1], y, used)
        for experiment, y, used in zip(problem.experiments, problem.y, problem.used, strict=True)
    ]
    channels = problem.sizes.n_inputs + problem.sizes.n_outputs
    longest = max(int(run.used.sum()) for run in runs)
    depth = int(np.clip(longest // (4 * channels), order + 1, min(max(2 * order, 10), DEEPEST)))
    factor = factorise(runs, depth)
    if factor is None:
        raise IdentifiabilityError(
            f"too few rows follow one another for a subspace estimate of order {order}: lower the order, or "
            "take a "
            "longer record"
        )
    return [factor.dynamics(kind, order) for kind in INSTRUMENTS]


def _starts(problem: Problem, scaled: _Scaled, restarts: int, rng: np.random.Generator) -> list[Floats]:
    sizes = problem.sizes
    s, q = sizes.n_models, sizes.n_scheduling
    visited = scaled.visited()
    levels = (np.arange(s) + 0.5) / s
    spread = np.quantile(visited, levels, axis=0)
    if q > 1:  # along the first direction the quantiles; the others drawn, so that centres are not on a line
        spread[:, 1:] = rng.permuted(spread[:, 1:], axis=0)
    placements = [(np.full((s, q), max(s - 1, 1) / 2.0), spread)]
    for _ in range(restarts):
        placements.append((rng.uniform(0.3, 2.0, (s, q)), visited[rng.choice(visited.shape[0], s)]))
    found = []
    for A, C in linear_starts(problem):
        found += [sizes.pack(np.repeat(A[np.newaxis], s, axis=0), C, w, c) for w, c in placements]
    return found


def _search(problem: Problem, starts: list[Floats]) -> list[Minimum[At]]:
    """Search shortly from every start, and on from the best two."""
    feasible = [eta for eta in starts if np.isfinite(problem(eta).cost)]
    if not feasible:
        raise IdentifiabilityError(
            "no start gives a finite simulation with every local model in charge somewhere: take fewer "
            "local models, "
            "or another scheduling signal"
        )
    with np.errstate(all="ignore"):
        trials = [
            descend(problem, eta, tolerance=1e-6, max_evaluations=TRIAL_EVALUATIONS) for eta in feasible
        ]
        trials.sort(key=lambda minimum: minimum.cost)
        ends = [
            descend(problem, trial.x, tolerance=1e-8, max_evaluations=EVALUATIONS) for trial in trials[:2]
        ]
    return sorted(ends, key=lambda minimum: minimum.cost)


def _result(
    record: Record,
    problem: Problem,
    scaled: _Scaled,
    ends: list[Minimum[At]],
    names: tuple[str, ...],
    initial_state: str,
) -> LocalLinearFit:
    best = ends[0]
    rows = sum(int(used.sum()) for used in problem.used)
    measured = (
        np.concatenate([y[used] for y, used in zip(problem.y, problem.used, strict=True)]) * scaled.y_size
    )
    residual = _residual(best.point, rows) * scaled.y_size
    cuts = np.cumsum([int(used.sum()) for used in problem.used])[:-1]
    agree = len(ends) == 1 or ends[1].cost <= best.cost * (1.0 + AGREEMENT) ** 2 + 1e-18 * measured.size
    same = (
        "the two best starts lead to the same error"
        if agree
        else "the two best starts lead to different errors"
    )
    linear = _linear(problem)
    return LocalLinearFit(
        model=scaled.physical(LocalLinearModel.of(problem.sizes, best.x, best.point.gains())),
        scheduling=names,
        initial_state=initial_state,
        inputs=record.inputs,
        outputs=record.outputs,
        period=record.period,
        rms=np.sqrt(np.mean(residual**2, axis=0)),
        output_std=np.std(measured, axis=0),
        linear_rms=np.sqrt(np.mean((_residual(linear, rows) * scaled.y_size) ** 2, axis=0)),
        n_rows=rows,
        n_parameters=problem.n_unknowns,
        noise=tuple(autoregression(np.split(column, cuts))[0] for column in residual.T),
        costs=best.costs,
        converged=best.status.converged,
        restarts_agree=agree,
        status=f"{best.status.value}; {same}",
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
