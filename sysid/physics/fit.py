"""Fit the parameters of a physical model by its free-run error."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.errors import IdentifiabilityError, ModelError, UsageError
from sysid.linear.forms import Floats
from sysid.linear.reduction import Segment
from sysid.physics.matching import matched_points
from sysid.physics.model import Model, Starts
from sysid.physics.problem import Problem
from sysid.physics.reading import load_model
from sysid.physics.simulation import step_error
from sysid.physics.starts import draw_widths, starting_points
from sysid.physics.uncertainty import Uncertainty, parameter_uncertainty
from sysid.separable.descent import Minimum, Residual, Status, levenberg_marquardt

if TYPE_CHECKING:
    from sysid.linear.simulation import Prediction
    from sysid.physics.classes import PhysicsModel

INITIAL_STATES = ("estimate", "rest")
RANKING_ROWS = 2_000
SCREENING_ROWS = 10_000
SEARCHED_STARTS = 8
# Starts are drawn again, so many times in all, until two searches agree.
BATCHES = 4
MATCHED_STARTS = 4
SCREENING_EVALUATIONS = 80
EVALUATIONS = 300
# Two searches agree when their errors differ by less than this share ...
AGREEMENT = 1e-3
# ... and their outputs by less than this share of the error.
OUTPUT_AGREEMENT = 0.05
EXACT = 1e-9
STEP_TOLERANCE = 1e-4
HALVINGS = 5
# Priors are weighed by the noise that is left over, which depends on them.
PRIOR_ROUNDS = 20
PRIOR_TOLERANCE = 1e-6


@dataclass(frozen=True)
class PhysicsFit:
    """A fitted physical model.

    Attributes
    ----------
    model : Model
        With the fitted values as its start values.
    names : tuple of str
        Parameters that were searched.
    values : mapping of str to float
        Value of every parameter, the fixed ones too.
    uncertainty : Uncertainty
        Standard errors, covariance, and the colour of the residual.
    states : ndarray, shape (n_experiments, n_states)
        Initial state of each experiment with rows in the fit.
    initial_state : {"estimate", "rest"}
    period : float
        Sampling period [s].
    inputs, outputs : tuple of str
    rms : float
        Root mean square of the free-run residual on the rows of the fit.
    output_std : float
        Standard deviation of the output on these rows.
    n_rows : int
    substeps : int or None
        Runge-Kutta steps in a sample; None if the simulation is exact.
    converged, restarts_agree : bool
        Restarts agree when at least two searches end at the same error with the same output; equal
        parameters are not asked for.
    status : str
        One sentence: how the search ended.
    """

    model: Model
    names: tuple[str, ...]
    values: Mapping[str, float]
    uncertainty: Uncertainty
    states: Floats
    initial_state: str
    period: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    rms: float
    output_std: float
    n_rows: int
    substeps: int | None
    converged: bool
    restarts_agree: bool
    status: str

    @property
    def order(self) -> int:
        """Number of states."""
        return self.model.order

    def parameters(self) -> dict[str, tuple[float, float]]:
        """Return value and standard error of each parameter; a fixed one has the error 0."""
        errors = dict(zip(self.names, self.uncertainty.standard_errors.tolist(), strict=True))
        return {name: (value, errors.get(name, 0.0)) for name, value in self.values.items()}

    def unit(self, name: str) -> str:
        """Return the unit of a parameter."""
        return self.model.parameter(name).unit

    def predict(self, record: Record, rows: Mask | None = None) -> "Prediction":
        """Predict every row of a record; see `sysid.physics.prediction.predict`."""
        from sysid.physics.prediction import predict

        return predict(self, record, rows)

    def __repr__(self) -> str:
        lines = [f"PhysicsFit of {self.model.name!r}: rms {self.rms:.4g} on {self.n_rows} rows"]
        for name, (value, error) in self.parameters().items():
            spread = "fixed" if name not in self.names else f"± {error:.2g}"
            if (prior := self.model.parameter(name).prior) is not None:
                spread += f" (prior {prior.mean:.4g} ± {prior.std:.2g})"
            lines.append(f"  {name:8s} {value: .6g} {self.unit(name)} {spread}")
        return "\n".join([*lines, f"  {self.status}"])


def fit_physics(
    record: Record,
    model: "Model | str | Path | type[PhysicsModel]",
    *,
    start: Starts | None = None,
    fixed: Mapping[str, float] | None = None,
    initial_state: str = "estimate",
    rows: Mask | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> PhysicsFit:
    """Fit a physical model by its free-run error, from several starts.

    Parameters
    ----------
    record : Record
        With one output.
    model : Model, str, Path or class
        A model, or what `load_model` takes: a name, a TOML file, a Python class.
    start : mapping of str to float or pair of float, optional
        Values known within some 20 %; or values with their standard deviations: Gaussian priors, which
        weigh in the fit by the noise of the record.
    fixed : mapping of str to float, optional
        Known values.
    initial_state : {"estimate", "rest"}
        Whether each experiment starts from a state of its own or from rest.
    rows : ndarray of bool, shape (n_samples,), optional
        Rows of the fit; estimation and validation rows by default.
    progress : callable, optional
        Called with the number of searches done and to do; these may become more, see `restarts_agree`.

    Returns
    -------
    PhysicsFit

    Raises
    ------
    UsageError, ModelError
        If the options make no sense or the model cannot be simulated.
    DataError, IdentifiabilityError
        If the record has too few rows, several outputs or missing outputs.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> from sysid.physics.simulation import Simulator
    >>> u = np.sign(np.sin(np.arange(300.0) ** 1.5))
    >>> y = Simulator(load_model("mass-spring-damper"), 0.1).run({"m": 2.0, "c": 0.5, "k": 8.0}, u)
    >>> fit = fit_physics(make_record(u, y, period=0.1), "mass-spring-damper", initial_state="rest")
    >>> {name: round(value, 6) for name, value in fit.values.items()}
    {'m': 2.0, 'c': 0.5, 'k': 8.0}
    """
    from threadpoolctl import threadpool_limits

    from sysid.linear.output_error import make_segments

    if initial_state not in INITIAL_STATES:
        raise UsageError(f"initial state is {initial_state!r}: choose estimate or rest")
    described = (model if isinstance(model, Model) else load_model(model)).with_parameters(start, fixed)
    _check_channels(described, check_record(record))
    segments = make_segments(record, rows)
    problem = Problem(described, segments, record.period, initial_state == "estimate")
    _check_enough(problem)
    with threadpool_limits(1):  # blocks are small: further threads only wait for one another
        minimum, agreeing, tried = _search_all(problem, progress)
        minimum = _with_fine_steps(problem, minimum)
        uncertainty = parameter_uncertainty(problem, minimum.x, minimum.point.residual)
        if any(parameter.prior is not None for parameter in problem.parameters):
            problem, minimum, uncertainty = _with_priors(problem, minimum, uncertainty)
    return _result(problem, minimum, uncertainty, record, (agreeing, tried))


def _result(
    problem: Problem,
    minimum: Minimum[Residual],
    uncertainty: Uncertainty,
    record: Record,
    restarts: tuple[int, int],
) -> PhysicsFit:
    agreeing, tried = restarts
    values = problem.values(minimum.x[: len(problem.names)])
    sentences = [minimum.status.value, _agreement(agreeing, tried)]
    if uncertainty.undetermined:
        sentences.append(
            f"only combinations of {', '.join(uncertainty.undetermined)} are determined: fix one of them"
        )
    measured = np.concatenate([segment.y[segment.used] for segment in problem.segments])
    return PhysicsFit(
        model=problem.model.with_values(values),
        names=problem.names,
        values=values,
        uncertainty=uncertainty,
        states=problem.states_of(minimum.x),
        initial_state="estimate" if problem.free_start else "rest",
        period=problem.period,
        inputs=record.inputs,
        outputs=record.outputs,
        rms=float(np.sqrt(np.mean(minimum.point.residual[: problem.n_rows] ** 2))),
        output_std=float(np.std(measured)),
        n_rows=problem.n_rows,
        substeps=problem.simulator.substeps,
        converged=minimum.status.converged,
        restarts_agree=agreeing > 1,
        status="; ".join(sentences),
    )


def _check_channels(model: Model, record: Record) -> None:
    if len(model.outputs) != 1 or len(model.inputs) != record.u.shape[1]:
        raise UsageError(
            f"model {model.name!r} has {len(model.inputs)} inputs and {len(model.outputs)} outputs, "
            f"the record {record.u.shape[1]} and {record.y.shape[1]}: choose as many inputs and one output"
        )


def _check_enough(problem: Problem) -> None:
    if not problem.names:
        raise UsageError(f"every parameter of model {problem.model.name!r} is fixed: leave at least one free")
    unknowns = len(problem.names) + problem.n_starts
    if problem.n_rows < 2 * unknowns:
        raise IdentifiabilityError(
            f"{problem.n_rows} rows cannot determine {unknowns} unknowns ({len(problem.names)} parameters, "
            f"{problem.n_starts} initial states): at least {2 * unknowns} rows are needed"
        )


def _search_all(
    problem: Problem, progress: Callable[[int, int], None] | None = None
) -> tuple[Minimum[Residual], int, int]:
    """Search from the best of all starts; return the best end, how many agree with it, how many ran.

    Where no second search ends as the best one does, further batches of starts are drawn.
    """
    screening = problem.with_segments(_shortened(problem.segments, SCREENING_ROWS))
    ranking = problem.with_segments(_shortened(problem.segments, RANKING_ROWS))
    count = len(problem.names)
    ends: list[Minimum[Residual]] = []
    for batch in range(BATCHES):
        starts = _starts(ranking, screening, batch)
        for number, (coordinates, states) in enumerate(starts):
            screening.use_steps(None)
            point = screening.point(coordinates, _all_states(screening, states))
            if point is not None:
                ends.append(_descend(screening, point, SCREENING_EVALUATIONS))
            if progress is not None and batch == 0:  # what comes after is the exception
                progress(number + 1, len(starts) + 1)
        if not ends:
            raise ModelError(
                f"model {problem.model.name!r} diverges from every start: give start values nearer to the "
                "plant's"
            )
        ends.sort(key=lambda end: end.cost)
        if ends[0].status is Status.MAX_EVALUATIONS:
            ends[0] = _descend(screening, ends[0].x, EVALUATIONS)
        best = ends[0]
        agreeing = 1 + sum(_same(best, end, screening) for end in ends[1:])
        if agreeing > 1:
            break
    if screening.n_rows < problem.n_rows:
        problem.use_steps(screening.simulator.substeps)
        point = problem.point(best.x[:count], _all_states(problem, screening.states_of(best.x)))
        if point is None:
            raise ModelError(
                f"model {problem.model.name!r} fits the first {screening.n_rows} rows and diverges later: "
                "give start values nearer to the plant's"
            )
        best = _descend(problem, point, EVALUATIONS)
    else:
        problem.use_steps(screening.simulator.substeps)
        best = _descend(problem, best.x, EVALUATIONS)
    return best, agreeing, len(ends)


def _starts(problem: Problem, screening: Problem, batch: int) -> list[tuple[Floats, Floats]]:
    """Return parameters and initial states from which to search.

    Where parameters are not known, the first come from a linear model that was identified before
    (`sysid.physics.matching`).  A free response from far away can hide what the input does, so where
    initial states are estimated too, half of the others come from runs at rest.
    """
    count = len(problem.names)
    found = [(p[:count], problem.states_of(p)) for p in starting_points(problem, SEARCHED_STARTS, batch)]
    if all(parameter.status == "uncertain" for parameter in problem.parameters):
        return found
    matched = _matched(screening) if batch == 0 else []
    if not problem.free_start:
        return matched + found[: SEARCHED_STARTS - len(matched)]
    at_rest = Problem(problem.model, problem.segments, problem.period, free_start=False)
    forced = [
        (p[:count], at_rest.states_of(p)) for p in starting_points(at_rest, SEARCHED_STARTS // 2, batch)
    ]
    return (matched + forced + found)[:SEARCHED_STARTS]


def _matched(problem: Problem) -> list[tuple[Floats, Floats]]:
    """Return starts with the transfer function of an identified model, each with its initial states."""
    problem.use_steps(None)
    centre = problem.coordinates(problem.simulator.values())
    points = matched_points(problem, centre, draw_widths(problem, centre), MATCHED_STARTS)
    placed = [problem.point(point) for point in points]
    return [(p[: centre.size], problem.states_of(p)) for p in placed if p is not None]


def _all_states(problem: Problem, known: Floats) -> Floats:
    missing = len(problem.segments) - known.shape[0]
    return np.vstack([known, np.tile(problem.simulator.rest(), (missing, 1))])


def _descend(problem: Problem, point: Floats, evaluations: int) -> Minimum[Residual]:
    lower, upper = problem.bounds()
    with np.errstate(all="ignore"):
        return levenberg_marquardt(
            problem.residual,
            problem.jacobian,
            np.clip(point, lower, upper),
            bounds=(lower, upper),
            max_evaluations=evaluations,
        )


def _with_fine_steps(problem: Problem, minimum: Minimum[Residual]) -> Minimum[Residual]:
    """Halve the Runge-Kutta step and search on until the output no longer depends on it."""
    if problem.simulator.linear:
        return minimum
    longest = max(range(len(problem.segments)), key=lambda i: problem.segments[i].used.size)
    for _ in range(HALVINGS):
        values = problem.values(minimum.x[: len(problem.names)])
        start = problem.states_of(minimum.x)[longest]
        if step_error(problem.simulator, values, problem.segments[longest].u, start) < STEP_TOLERANCE:
            break
        problem.use_steps(2 * (problem.simulator.substeps or 1))
        minimum = _descend(problem, minimum.x, EVALUATIONS)
    return minimum


def _with_priors(
    problem: Problem, minimum: Minimum[Residual], uncertainty: Uncertainty
) -> tuple[Problem, Minimum[Residual], Uncertainty]:
    """Weigh the priors by the noise of the record, and again by the noise that is then left over.

    The first search went on without them where they only guide it, so that they do not choose between
    minima that the record tells apart.
    """
    noise = uncertainty.effective_noise
    for _ in range(PRIOR_ROUNDS):
        problem = problem.with_noise(noise)
        minimum = _descend(problem, minimum.x, EVALUATIONS)
        uncertainty = parameter_uncertainty(problem, minimum.x, minimum.point.residual)
        if np.abs(uncertainty.effective_noise / noise - 1.0).max() < PRIOR_TOLERANCE:
            break
        noise = uncertainty.effective_noise
    return problem, minimum, uncertainty


def _same(best: Minimum[Residual], end: Minimum[Residual], problem: Problem) -> bool:
    """Tell whether two searches ended at the same error with the same output."""
    floor = EXACT * np.sqrt(sum(float(segment.y @ segment.y) for segment in problem.segments))
    error, other = np.sqrt(best.cost), np.sqrt(end.cost)
    apart = float(np.linalg.norm(end.point.residual - best.point.residual))
    return bool(
        other <= error * (1.0 + AGREEMENT) + floor and apart <= OUTPUT_AGREEMENT * error + 2.0 * floor
    )


def _agreement(agreeing: int, tried: int) -> str:
    if agreeing > 1:
        return f"{agreeing} of {tried} searches from different starts agree in error and output"
    return (
        f"{tried} searches from different starts disagree: the error has local minima, "
        "so give start values nearer to the plant's"
    )


def _shortened(segments: tuple[Segment, ...], rows: int) -> tuple[Segment, ...]:
    """Return the first experiments and rows, so many in all."""
    chosen: list[Segment] = []
    left = rows
    for segment in segments:
        if left <= 0:
            break
        count = int(segment.used.sum())
        chosen.append(segment if count <= left else segment.shortened(left))
        left -= count
    return tuple(chosen)
