"""Compare a model with a measured record on held-out rows."""

import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.data import Record
from sysid.data.record import ESTIMATION_LABELS, Mask
from sysid.diagnosis.models import LINEAR, FittedModel, fit_model, resolve_model
from sysid.diagnosis.noise import NoiseFloor, noise_floor
from sysid.diagnosis.nonlinear_tests import nonlinear_tests
from sysid.diagnosis.periods import Distortion, distortion, periodic_part
from sysid.diagnosis.residuals import CorrelationTest, input_independence, whiteness
from sysid.diagnosis.scores import SetScore, nrmse_interval, score
from sysid.diagnosis.series import Series, judged_series
from sysid.diagnosis.summary import data_json, model_json, sentences
from sysid.diagnosis.where import Finding, Location, locate
from sysid.errors import SysidError, UsageError
from sysid.linear.forms import Floats

if TYPE_CHECKING:
    from sysid.diagnosis.content import Content
    from sysid.diagnosis.models import PortView
    from sysid.linear.output_error import OutputErrorFit
    from sysid.linear.simulation import Prediction
    from sysid.physics import Model, PhysicsFit, Starts
# Percentage of the work that is done when the model is fitted, and when its error is located.
FITTING_SHARE, LOCATING_SHARE = 60, 90


@dataclass(frozen=True)
class Comparison:
    """A model beside the measurements it was not fitted to.

    Attributes
    ----------
    record : Record
    model : FittedModel
    prediction : Prediction
        Of the final model, over all rows.
    scores : tuple of SetScore
        Estimation, validation, and each test set.
    judged : str
        The set of rows that the sentences, tests and findings speak of: the first test set or,
        without any, the validation rows.
    noise_floor : NoiseFloor
    series : Series
        Residual and signals on the judged rows.
    tests : mapping of str to CorrelationTest
    distortion : Distortion
        Even and odd nonlinear distortion, where the input is periodic and leaves lines out.
    location : Location
        Where the error lies: findings, and the shares that are drawn.
    warnings : tuple of str
    ports : tuple of PortView
        Free-form curves at the ports of the model, if they were explored.
    """

    record: Record
    model: FittedModel
    prediction: "Prediction"
    scores: tuple[SetScore, ...]
    judged: str
    noise_floor: NoiseFloor
    series: Series
    tests: dict[str, CorrelationTest]
    distortion: Distortion
    location: Location
    warnings: tuple[str, ...]
    ports: "tuple[PortView, ...]" = ()

    @property
    def where(self) -> tuple[Finding, ...]:
        """Findings: where the error is concentrated, beyond chance and by enough to matter."""
        return self.location.findings

    def score_of(self, name: str) -> SetScore:
        """Return the scores of one set of rows."""
        return next(s for s in self.scores if s.name == name)

    def sentences(self) -> list[str]:
        """Say what was found, the main thing first."""
        return sentences(self)

    def to_json(self) -> dict[str, Any]:
        """Return what the JSON file holds: plain values, no NaN."""
        return {
            "schema": 1,
            "model": model_json(self),
            "scores": {s.name: s.to_json() for s in self.scores},
            "noise_floor": self.noise_floor.to_json(),
            "where": [finding.to_json() for finding in self.where],
            "shares": self.location.to_json(),
            "tests": {name: test.to_json() for name, test in self.tests.items()}
            | {"distortion": self.distortion.to_json()},
            "ports": [port.to_json() for port in self.ports],
            "warnings": list(self.warnings),
            "data": data_json(self.record),
            "sentences": self.sentences(),
        }

    @cached_property
    def content(self) -> "Content":
        """What page and PDF show, its figures drawn once."""
        from sysid.diagnosis.content import content_of

        return content_of(self)

    def to_html(self) -> str:
        """Return the page as one self-contained HTML text."""
        from sysid.diagnosis.page import render

        return render(self.content)

    def to_pdf(self) -> bytes:
        """Return the same content as a PDF."""
        from sysid.diagnosis.document import render_pdf

        return render_pdf(self.content)

    def __repr__(self) -> str:
        return "\n".join(
            [
                f"Comparison of {self.record.name!r} with model {self.model.name!r}",
                *("  " + s for s in self.sentences()),
            ]
        )


def compare(
    record: Record,
    model: "str | Path | Model" = LINEAR,
    order: int | None = None,
    *,
    delay: int | None = None,
    constant: bool | None = None,
    start: "Starts | None" = None,
    fixed: Mapping[str, float] | None = None,
    initial_state: str = "estimate",
    ports: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Comparison:
    """Fit a model to a record and judge it on the rows it has not seen.

    The structure is chosen on validation rows, the accepted model refitted on estimation and
    validation rows, and only then run over the test rows.

    Parameters
    ----------
    record : Record
    model : str, Path or Model
        ``"linear"``, the name of a physical model (`sysid models` lists them), a TOML file, or a model.
    order, delay : int, optional
        Of the linear model; chosen from the data if not given.
    constant : bool, optional
        Whether the linear model has one; chosen from the data if not given.
    start, fixed : mapping of str to float, optional
        Parameters of a physical model known within some 20 %, and those known for good.
    initial_state : {"estimate", "rest"}
    ports : bool
        Whether to fit a free-form curve at each port of a linear or physical model.
    progress : callable, optional
        Called with the number of steps done and to do.

    Returns
    -------
    Comparison

    Raises
    ------
    UsageError, ModelError
        If the model or a parameter is not known or an argument is of the wrong kind.
    DataError, IdentifiabilityError
        If the record cannot be fitted.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(600)
    >>> y = np.zeros(600)
    >>> for k in range(1, 600):
    ...     y[k] = 0.8 * y[k - 1] + 0.5 * u[k - 1]
    >>> y += 0.05 * rng.standard_normal(600)
    >>> split = np.repeat(["train", "test"], [400, 200])
    >>> comparison = compare(make_record(u, y, period=0.1, split=split), order=1, delay=1)
    >>> comparison.score_of("test").free_run.nrmse < 0.1
    True
    """
    if not isinstance(record, Record):
        raise UsageError(
            f"record is of type {type(record).__name__}: make one with sysid.data.make_record(u, y, period)"
        )
    order, delay = _whole("order", order), _whole("delay", delay)
    if constant is not None and not isinstance(constant, bool | np.bool_):
        raise UsageError(f"constant is {constant!r}: give True, False or None (chosen from the data)")
    _check_output(record)
    fitted = fit_model(
        record,
        resolve_model(model, order, start, fixed),
        order,
        delay=delay,
        constant=constant,
        initial_state=initial_state,
        progress=part_of(progress, 0, FITTING_SHARE),
    )
    return judge(record, fitted, ports=ports, progress=progress)


def judge(
    record: Record,
    fitted: FittedModel,
    *,
    ports: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Comparison:
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
    Comparison
    """
    _check_output(record)
    prediction = fitted.predict(record)
    judged, rows = _judged_rows(record)
    delay_found = int(fitted.details().get("delay", 1))
    series, learned = (
        judged_series(record, name, chosen, prediction.free_run, delay_found)
        for name, chosen in ((judged, rows), (record.estimation_label, record.learning))
    )
    location = locate(series, learned, part_of(progress, FITTING_SHARE, LOCATING_SHARE))
    location = _with_reversals(location, series, prediction.free_run, fitted)
    curves, notes = _explored(record, fitted, part_of(progress, LOCATING_SHARE, 100)) if ports else ((), ())
    return Comparison(
        record=record,
        model=fitted,
        prediction=prediction,
        scores=_all_scores(record, fitted, prediction),
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
    record: Record, fitted: FittedModel, progress: Callable[[int, int], None] | None
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
    from sysid.diagnosis.adapters import LinearModel, PhysicalModel

    if isinstance(fitted, LinearModel):
        return fitted.choice.fit
    return fitted.fit if isinstance(fitted, PhysicalModel) else None


def _with_reversals(location: Location, series: Series, free_run: Floats, fitted: FittedModel) -> Location:
    """Add what the residual tells of a force with the sign of the velocity, if no region told it."""
    from sysid.diagnosis.ports.plants import plant_of
    from sysid.diagnosis.reversal_force import reversal_finding

    model = _with_linear_part(fitted)
    if model is None or any(finding.kind == "velocity-sign" for finding in location.findings):
        return location
    try:
        found = reversal_finding(series, free_run, plant_of(model))
    except SysidError:  # a model that is not linear in state and input
        return location
    return location if found is None else replace(location, findings=(*location.findings, found))


def part_of(
    progress: Callable[[int, int], None] | None, first: int, last: int
) -> Callable[[int, int], None] | None:
    """Return a callback that moves from one percentage to another."""
    if progress is None:
        return None
    return lambda done, total: progress(first + (last - first) * done // max(total, 1), 100)


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


def _check_output(record: Record) -> None:
    if len(record.outputs) > 1:
        raise UsageError(
            f"the record has {len(record.outputs)} outputs ({', '.join(record.outputs)}) and one is compared "
            "at a time: choose it when the record is made or read, by --output on the command line"
        )


def _whole(name: str, value: int | None) -> int | None:
    if value is None:
        return None
    try:
        return operator.index(value)
    except TypeError:
        raise UsageError(f"{name} is {value!r}: give a whole number, or None to have it chosen") from None


def _judged_rows(record: Record) -> tuple[str, Mask]:
    for name in record.test_sets:
        rows = record.scored_rows(name)
        if rows.sum() > 1:
            return name, rows
    return "validation", record.validation


def _all_scores(record: Record, model: FittedModel, prediction: "Prediction") -> tuple[SetScore, ...]:
    label = record.estimation_label
    learned = np.isin(record.split, ESTIMATION_LABELS)
    both = "estimation and validation rows"
    scores = [_set_score(record, label, learned, prediction, 0, both)]
    if record.validation.any():
        honest = model.predict_held_out(record)
        scores.append(_set_score(record, "validation", record.validation, honest, 0, "estimation rows"))
    for name in record.test_sets:
        rows = record.scored_rows(name)
        if rows.sum() > 1:
            scores.append(_set_score(record, name, rows, prediction, record.skip.get(name, 0), both))
    return tuple(scores)


def _set_score(
    record: Record, name: str, rows: Mask, prediction: "Prediction", skip: int, fitted_on: str
) -> SetScore:
    places = np.flatnonzero(rows)
    y, free_run = record.y[rows, 0], prediction.free_run[rows]
    starts = {prediction.starts[i] for i, part in enumerate(record.slices) if rows[part].any()}
    return SetScore(
        name=name,
        free_run=score(y, free_run),
        one_step=score(y, prediction.one_step[rows]),
        interval=nrmse_interval(y, free_run),
        unit=record.unit(record.outputs[0]),
        first_row=int(places[0]) + 1,
        last_row=int(places[-1]) + 1,
        n_rows=int(places.size),
        skip=skip,
        initial_state="; ".join(sorted(starts)),
        fitted_on=fitted_on,
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
