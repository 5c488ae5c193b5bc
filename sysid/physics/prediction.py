"""Free run and one-step prediction of a fitted physical model."""

from typing import TYPE_CHECKING

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.linear.forms import Floats
from sysid.linear.reduction import Segment
from sysid.linear.simulation import Prediction, check_fits, predict_experiments
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
    """
    check_fits(check_record(record), fit.inputs, fit.outputs, fit.period)
    estimated = iter(fit.states)

    def run(part: slice, used: Mask, fitted: bool) -> Floats:
        near = next(estimated, None) if fitted else None
        return _run(fit, record.u[part], record.y[part, 0], used, near)

    free_start = fit.initial_state == "estimate"
    return predict_experiments(record, rows, fit.order, fit.uncertainty.noise, free_start, run)


def _run(fit: "PhysicsFit", u: Floats, y: Floats, used: Mask, near: Floats | None) -> Floats:
    """Simulate one experiment, its initial state estimated on the rows ``used`` if the fit had one."""
    last = int(np.flatnonzero(used)[-1]) + 1 if used.any() else 0
    segment = Segment(u[:last], np.where(used, y, 0.0)[:last], used[:last])
    known = fit.model.with_parameters(fixed=fit.values)
    problem = Problem(known, (segment,), fit.period, fit.initial_state == "estimate", hold=fit.hold)
    problem.use_steps(fit.substeps)
    point = problem.point(np.empty(0), None if near is None else near[np.newaxis]) if last else None
    start = problem.simulator.rest() if point is None else problem.states_of(point)[0]
    return problem.simulator.run(fit.values, u, start, before=problem.before)[:, 0]
