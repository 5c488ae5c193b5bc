"""Free run and one-step prediction of a fitted physical model."""

from typing import TYPE_CHECKING

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.linear.forms import Floats
from sysid.linear.reduction import Segment
from sysid.linear.simulation import Prediction, first_rows, foreseen
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
    chosen = record.learning if rows is None else rows
    free_run, one_step = np.empty(record.n_samples), np.empty(record.n_samples)
    notes, known = [], iter(fit.states)
    for part in record.slices:
        y = record.y[part, 0]
        used = chosen[part] & np.isfinite(y)
        near, note = None, "estimated on the rows of the fit"
        if used.any():
            near = next(known, None)
        else:
            used, count = first_rows(y, record.skip.get(str(record.split[part][0]), 0), fit.order)
            note = f"estimated on the first {count} rows" if count else "at rest: no output is measured there"
        free_run[part] = _run(fit, record.u[part], y, used, near)
        one_step[part] = free_run[part] + foreseen(y - free_run[part], fit.uncertainty.noise)
        notes.append(note if fit.initial_state == "estimate" else "at rest")
    return Prediction(free_run, one_step, tuple(notes))


def _run(fit: "PhysicsFit", u: Floats, y: Floats, used: Mask, near: Floats | None) -> Floats:
    """Simulate one experiment, its initial state estimated on the rows ``used`` if the fit had one."""
    last = int(np.flatnonzero(used)[-1]) + 1 if used.any() else 0
    segment = Segment(u[:last], np.where(used, y, 0.0)[:last], used[:last])
    known = fit.model.with_parameters(fixed=fit.values)
    problem = Problem(known, (segment,), fit.period, fit.initial_state == "estimate")
    problem.use_steps(fit.substeps)
    point = problem.point(np.empty(0), None if near is None else near[np.newaxis]) if last else None
    start = problem.simulator.rest() if point is None else problem.states_of(point)[0]
    return problem.simulator.run(fit.values, u, start, before=problem.before)[:, 0]
