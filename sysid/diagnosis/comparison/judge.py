"""Judge a fitted model on the rows it has not seen."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.comparison.judgement import Judgement
from sysid.diagnosis.comparison.noise import noise_floor
from sysid.diagnosis.comparison.nonlinear_tests import nonlinear_tests
from sysid.diagnosis.comparison.periods import Distortion, distortion, periodic_part
from sysid.diagnosis.comparison.series import Series, judged_series
from sysid.diagnosis.comparison.set_scores import judged_rows, set_scores
from sysid.diagnosis.comparison.where import Location, locate
from sysid.diagnosis.models.fitted_model import FittedModel
from sysid.diagnosis.residuals import CorrelationTest, input_independence, whiteness
from sysid.errors import SysidError, UsageError
from sysid.linear.forms import Floats
from sysid.progress import Callback, part_of

if TYPE_CHECKING:
    from sysid.diagnosis.models.fitted_model import PortView
    from sysid.linear.output_error import OutputErrorFit
    from sysid.physics import PhysicsFit

# Percentage of the work that is done when the model is fitted, and when its error is located.
FITTING_SHARE, LOCATING_SHARE = 60, 90


def judge(
    record: Record,
    fitted: FittedModel,
    *,
    ports: bool = True,
    progress: Callback | None = None,
) -> Judgement:
    """Judge a fitted model on the rows it has not seen.

    Parameters
    ----------
    record : Record
    fitted : FittedModel
        Fitted on the estimation rows, and on estimation and validation rows.
    ports : bool
        Whether to fit a free-form curve at each port of a linear or physical model.
    progress : callable, optional
        Called with the number of steps done and to do.

    Returns
    -------
    Judgement
    """
    check_output(record)
    prediction = fitted.predict(record)
    judged, rows = judged_rows(record)
    delay_found = int(fitted.details().get("delay", 1))
    series = judged_series(record, judged, rows, prediction.free_run, delay_found)
    learned = None
    if record.learning.any():
        learning = (record.estimation_label, record.learning)
        learned = judged_series(record, *learning, prediction.free_run, delay_found)
    location = locate(series, learned, part_of(progress, FITTING_SHARE, LOCATING_SHARE))
    location = _with_reversals(location, series, prediction.free_run, fitted)
    curves, notes = _explored(record, fitted, part_of(progress, LOCATING_SHARE, 100)) if ports else ((), ())
    return Judgement(
        record=record,
        model=fitted,
        prediction=prediction,
        scores=set_scores(record, fitted, prediction),
        judged=judged,
        noise_floor=noise_floor(record, prediction.free_run, rows),
        series=series,
        tests=_tests(series),
        distortion=_distortion(record, rows),
        location=location,
        warnings=(*_warnings(record, fitted), *notes),
        ports=curves,
    )


def _explored(
    record: Record, fitted: FittedModel, progress: Callback | None
) -> "tuple[tuple[PortView, ...], tuple[str, ...]]":
    """Return the free-form curves at the ports, or a note why there are none."""
    from sysid.diagnosis.ports import explore_ports

    plant = _with_linear_part(fitted)
    if plant is None:
        return (), ()
    try:
        return explore_ports(record, plant, progress=progress), ()
    except SysidError as problem:
        return (), (f"Free-form curves at the ports of the model were not fitted: {problem}.",)


def _with_linear_part(fitted: FittedModel) -> "OutputErrorFit | PhysicsFit | None":
    """Return the fit whose linear part further effects can stand around, if the model has one."""
    from sysid.diagnosis.models.adapters import LinearModel, PhysicalModel

    if isinstance(fitted, LinearModel):
        return fitted.choice.fit
    return fitted.plant if isinstance(fitted, PhysicalModel) else None


def _with_reversals(location: Location, series: Series, free_run: Floats, fitted: FittedModel) -> Location:
    """Add what the residual tells of a force with the sign of the velocity, if no region told it."""
    from sysid.diagnosis.comparison.reversal_force import reversal_finding
    from sysid.diagnosis.ports.opening import plant_of

    model = _with_linear_part(fitted)
    if model is None or any(finding.kind == "velocity-sign" for finding in location.findings):
        return location
    try:
        found = reversal_finding(series, free_run, plant_of(model))
    except SysidError:  # a model that is not linear in state and input
        return location
    return location if found is None else replace(location, findings=(*location.findings, found))


def _tests(series: Series) -> dict[str, CorrelationTest]:
    names = series.record.inputs
    tests = {"whiteness": whiteness(series.residual)}
    for index, name in enumerate(names):
        key = "input_residual" if len(names) == 1 else f"input_residual_{name}"
        tests[key] = input_independence(series.record.u[series.places, index], series.residual)
    return tests | nonlinear_tests(series)


def _distortion(record: Record, rows: Mask) -> Distortion:
    """Return the distortion in the first judged experiment that is periodic, or in any other."""
    everywhere = np.ones(record.n_samples, dtype=bool)
    for used in (rows, everywhere):
        for part in record.slices:
            if (periodic := periodic_part(record, part, used)) is not None:
                return distortion(periodic, record.period)
    return distortion(None, record.period)


def check_output(record: Record) -> None:
    """Raise UsageError if a record has several outputs: one is compared at a time."""
    if len(record.outputs) > 1:
        raise UsageError(
            f"the record has {len(record.outputs)} outputs ({', '.join(record.outputs)}) and one is compared "
            "at a time: choose it when the record is made or read, by --output on the command line"
        )


def _warnings(record: Record, model: FittedModel) -> tuple[str, ...]:
    found = [*record.warnings, *model.warnings]
    if not record.test_sets:
        found.append(
            "The record has no test rows: the validation rows, on which the structure was chosen, are judged."
        )
    for name in record.test_sets:
        if (rows := int(record.scored_rows(name).sum())) <= 1:
            measured = "no measured output" if rows == 0 else "one row with a measured output after the skip"
            found.append(f"The test set {name!r} has {measured}: it is predicted and not scored.")
    return tuple(found)
