"""Fit the parameters of a physical model by its free-run error."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.errors import IdentifiabilityError, ModelError, UsageError
from sysid.linear.forms import Floats
from sysid.physics.fitted import PhysicsFit, output_weights
from sysid.physics.hold import HOLDS
from sysid.physics.joint import (
    first_weights,
    output_sizes,
    rms_of_outputs,
    segments_of,
    weighed_by_noise,
)
from sysid.physics.model import Model, Starts
from sysid.physics.problem import Problem
from sysid.physics.reading import load_model
from sysid.physics.restarts import EVALUATIONS, agreement, descend, search_from_many
from sysid.physics.simulation import step_error
from sysid.physics.uncertainty import Uncertainty, parameter_uncertainty
from sysid.separable.descent import Minimum, Residual

if TYPE_CHECKING:
    from sysid.physics.classes import PhysicsModel

INITIAL_STATES = ("estimate", "rest")
STEP_TOLERANCE = 1e-4
HALVINGS = 5
# Priors are weighed by the noise that is left over, which depends on them.
PRIOR_ROUNDS = 20
PRIOR_TOLERANCE = 1e-6


def fit_physics(
    record: Record,
    model: "Model | str | Path | type[PhysicsModel]",
    *,
    start: Starts | None = None,
    fixed: Mapping[str, float] | None = None,
    initial_state: str = "estimate",
    rows: Mask | None = None,
    hold: str = "zero",
    progress: Callable[[int, int], None] | None = None,
) -> PhysicsFit:
    """Fit a physical model by its free-run error, from several starts.

    Several outputs are fitted together: they share parameters and initial states, and the error of each
    counts by one over the size of what is left of it, found in turn with the parameters (the most likely
    ones, if that is white noise independent of the others').

    Parameters
    ----------
    record : Record
        Of a model with several outputs it may have some; they are found by their names.
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
    hold : {"zero", "smooth"}
        Between samples the input is held, or follows a cubic spline, as one that was sampled does.
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
        If the record has too few rows or missing outputs.

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

    if initial_state not in INITIAL_STATES:
        raise UsageError(f"initial state is {initial_state!r}: choose estimate or rest")
    if hold not in HOLDS:
        raise UsageError(f"hold is {hold!r}: choose {' or '.join(HOLDS)}")
    described = (model if isinstance(model, Model) else load_model(model)).with_parameters(start, fixed)
    described = _read_by(described, check_record(record))
    segments = segments_of(record, rows)
    weights = first_weights(segments)
    problem = Problem(
        described, segments, record.period, initial_state == "estimate", hold=hold, weights=weights
    )
    _check_enough(problem)
    with threadpool_limits(1):  # blocks are small: further threads only wait for one another
        minimum, agreeing, tried = search_from_many(problem, progress)
        return _finished(problem, minimum, record, agreeing > 1, agreement(agreeing, tried))


def refit_physics(
    record: Record, fit: PhysicsFit, *, rows: Mask | None = None, hold: str | None = None
) -> PhysicsFit:
    """Fit the same model to other rows, from where a fit ended: the only start, so that it stays the same.

    Parameters
    ----------
    record : Record
    fit : PhysicsFit
    rows : ndarray of bool, shape (n_samples,), optional
        Rows of the fit; estimation and validation rows by default.
    hold : {"zero", "smooth"}, optional
        What the input does between samples, if not what it did before.

    Returns
    -------
    PhysicsFit

    Raises
    ------
    ModelError
        If the model diverges on these rows.
    """
    segments = segments_of(record, rows)
    free_start, hold = fit.initial_state == "estimate", fit.hold if hold is None else hold
    problem = Problem(fit.model, segments, record.period, free_start, hold=hold, weights=output_weights(fit))
    near = fit.states if free_start and fit.states.shape[0] == len(segments) else None
    return _from_one_start(problem, fit.values, near, record)


def fit_physics_near(
    record: Record, model: Model, values: Mapping[str, float], *, initial_state: str, hold: str
) -> PhysicsFit:
    """Fit a model of one output from values at which a search has ended, the only start.

    Parameters
    ----------
    record : Record
    model : Model
    values : mapping of str to float
        Of all its parameters.
    initial_state : {"estimate", "rest"}
    hold : {"zero", "smooth"}
        What the input does between samples.

    Returns
    -------
    PhysicsFit

    Raises
    ------
    ModelError
        If the model diverges.
    """
    problem = Problem(model, segments_of(record, None), record.period, initial_state == "estimate", hold=hold)
    return _from_one_start(problem, values, None, record)


def _from_one_start(
    problem: Problem, values: Mapping[str, float], near: Floats | None, record: Record
) -> PhysicsFit:
    from threadpoolctl import threadpool_limits

    _check_enough(problem)
    with threadpool_limits(1):
        point = problem.point(problem.coordinates(values), near)
        if point is None:
            raise ModelError(
                f"model {problem.model.name!r} diverges on the rows of the refit: try another start"
            )
        return _finished(
            problem, descend(problem, point, EVALUATIONS), record, True, "refitted from one start"
        )


def _finished(
    problem: Problem, minimum: Minimum[Residual], record: Record, agree: bool, restarts: str
) -> PhysicsFit:
    minimum = _with_fine_steps(problem, minimum)
    if len(record.outputs) > 1:
        problem, minimum = weighed_by_noise(problem, minimum)
    uncertainty = parameter_uncertainty(problem, minimum.x, minimum.point.residual)
    if any(parameter.prior is not None for parameter in problem.parameters):
        problem, minimum, uncertainty = _with_priors(problem, minimum, uncertainty)
    return _result(problem, minimum, uncertainty, record, agree, restarts)


def _result(
    problem: Problem,
    minimum: Minimum[Residual],
    uncertainty: Uncertainty,
    record: Record,
    agree: bool,
    restarts: str,
) -> PhysicsFit:
    values = problem.values(minimum.x[: len(problem.names)])
    sentences = [minimum.status.value, restarts]
    if uncertainty.undetermined:
        sentences.append(
            f"only combinations of {', '.join(uncertainty.undetermined)} are determined: fix one of them"
        )
    rms, sizes = rms_of_outputs(problem, minimum.point.residual), output_sizes(problem.segments)
    relative = rms if len(rms) == 1 else rms / sizes
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
        rms=float(np.sqrt(np.mean(relative**2))),
        rms_of=tuple(rms.tolist()),
        output_std=tuple(sizes.tolist()),
        n_rows=problem.n_rows,
        substeps=problem.simulator.substeps,
        converged=minimum.status.converged,
        restarts_agree=agree,
        status="; ".join(sentences),
        hold=problem.hold,
        nominal={parameter.name: parameter.start for parameter in problem.model.parameters},
    )


def _read_by(model: Model, record: Record) -> Model:
    """Return the model with the outputs that the record has, found by their names if it has several."""
    n_outputs = len(record.outputs)
    if len(model.inputs) != record.u.shape[1] or n_outputs > len(model.outputs):
        raise UsageError(
            f"model {model.name!r} has {len(model.inputs)} inputs and {len(model.outputs)} outputs, "
            f"the record {record.u.shape[1]} and {n_outputs}: choose as many inputs and no more outputs"
        )
    if len(model.outputs) == 1:
        return model
    own = {output.name: output for output in model.outputs}
    if missing := [name for name in record.outputs if name not in own]:
        raise UsageError(
            f"model {model.name!r} has the outputs {', '.join(own)} and is fitted to them by their names; "
            f"the record's is {missing[0]!r}: rename one of them"
        )
    return replace(model, outputs=tuple(own[name] for name in record.outputs))


def _check_enough(problem: Problem) -> None:
    if not problem.names:
        raise UsageError(f"every parameter of model {problem.model.name!r} is fixed: leave at least one free")
    unknowns = len(problem.names) + problem.n_starts
    if problem.n_rows < 2 * unknowns:
        raise IdentifiabilityError(
            f"{problem.n_rows} rows cannot determine {unknowns} unknowns ({len(problem.names)} parameters, "
            f"{problem.n_starts} initial states): at least {2 * unknowns} rows are needed"
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
        minimum = descend(problem, minimum.x, EVALUATIONS)
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
        minimum = descend(problem, minimum.x, EVALUATIONS)
        uncertainty = parameter_uncertainty(problem, minimum.x, minimum.point.residual)
        if np.abs(uncertainty.effective_noise / noise - 1.0).max() < PRIOR_TOLERANCE:
            break
        noise = uncertainty.effective_noise
    return problem, minimum, uncertainty
