"""Free run and one-step prediction of a fitted physical model."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.linear.forms import Floats
from sysid.linear.reduction import Segment
from sysid.linear.simulation import Prediction, check_fits, predict_experiments
from sysid.physics.joint import EXACT_SHARE
from sysid.physics.problem import Problem

if TYPE_CHECKING:
    from sysid.physics.fit import PhysicsFit


def predict(fit: "PhysicsFit", record: Record, rows: Mask | None = None) -> Prediction:
    """Predict every row of a record.

    The initial state of an experiment is estimated on its rows of the fit; in an experiment
    without any, on its first rows: the skipped ones or, where these are too few, ten for each state.

    Parameters
    ----------
    fit : PhysicsFit
    record : Record
    rows : ndarray of bool, shape (n_samples,), optional
        Rows that may be used for initial states; estimation and validation rows by default.

    Returns
    -------
    Prediction
        With arrays of shape (n_samples, n_outputs) if there are several outputs.
    """
    check_fits(check_record(record), fit.inputs, fit.outputs, fit.period)
    estimated = iter(fit.states)

    free_start = fit.initial_state == "estimate"
    runs: dict[int | None, Floats] = {}

    def run(part: slice, used: Mask, fitted: bool) -> Floats:
        if part.start not in runs:
            runs[part.start] = _run(fit, record, part, used, next(estimated, None) if fitted else None)
        return runs[part.start]

    found = []
    for place, noise in enumerate(fit.uncertainty.noises):
        take = partial(_column, run, place)
        found.append(predict_experiments(record, rows, fit.order, noise, free_start, take, output=place))
    if len(found) == 1:
        return found[0]
    free_run, one_step = (np.column_stack([getattr(p, n) for p in found]) for n in ("free_run", "one_step"))
    return Prediction(free_run, one_step, found[0].starts)


def _column(
    run: Callable[[slice, Mask, bool], Floats], place: int, part: slice, used: Mask, fitted: bool
) -> Floats:
    return np.ascontiguousarray(run(part, used, fitted)[:, place])


def _run(fit: "PhysicsFit", record: Record, part: slice, used: Mask, near: Floats | None) -> Floats:
    """Simulate one experiment, its initial state estimated on the rows ``used`` if the fit had one."""
    u, y = record.u[part], record.y[part]
    used = used & np.isfinite(y).all(axis=1)
    last = int(np.flatnonzero(used)[-1]) + 1 if used.any() else 0
    measured = np.where(used[:, np.newaxis], y, 0.0)[:last]
    segment = Segment(u[:last], measured[:, 0] if len(fit.outputs) == 1 else measured, used[:last])
    known = fit.model.with_parameters(fixed=fit.values)
    free_start = fit.initial_state == "estimate"
    problem = Problem(known, (segment,), fit.period, free_start, hold=fit.hold, weights=output_weights(fit))
    problem.use_steps(fit.substeps)
    point = problem.point(np.empty(0), None if near is None else near[np.newaxis]) if last else None
    start = problem.simulator.rest() if point is None else problem.states_of(point)[0]
    return problem.simulator.run(fit.values, u, start, before=problem.before)


def output_weights(fit: "PhysicsFit") -> Floats:
    """Return by how much the error of each output counts."""
    if len(fit.outputs) == 1:
        return np.ones(1)
    return 1.0 / np.maximum(fit.rms_of, EXACT_SHARE * np.maximum(fit.output_std, 1e-300))
