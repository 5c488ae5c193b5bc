"""Compare a model with a measured record on held-out rows."""

import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.data import Record
from sysid.data.record import ESTIMATION_LABELS, Mask
from sysid.diagnosis.models import LINEAR, FittedModel, fit_model, resolve_model
from sysid.diagnosis.residuals import CorrelationTest, Window, input_independence, whiteness, worst_windows
from sysid.diagnosis.scores import SetScore, finite, nrmse_interval, score
from sysid.diagnosis.summary import data_json, model_json, sentences
from sysid.diagnosis.wording import percent, significant
from sysid.errors import UsageError

if TYPE_CHECKING:
    from sysid.linear.forms import Floats
    from sysid.linear.simulation import Prediction
    from sysid.physics import Model, Starts

NO_NOISE_FLOOR = "not estimated: a noise floor needs repeated periods or a nonparametric model of the record"


@dataclass(frozen=True)
class Finding:
    """Where the error lies.

    Attributes
    ----------
    kind : str
        ``"time"`` in this form.
    region : dict
        Which part of the data.
    error_share, data_share, p_value : float
    sentence : str
    """

    kind: str
    region: dict[str, Any]
    error_share: float
    data_share: float
    p_value: float
    sentence: str

    def to_json(self) -> dict[str, Any]:
        """Return the form of the JSON file."""
        return {
            "kind": self.kind,
            "region": self.region,
            "error_share": finite(self.error_share),
            "data_share": finite(self.data_share),
            "p_value": finite(self.p_value),
            "sentence": self.sentence,
        }


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
    tests : mapping of str to CorrelationTest
    where : tuple of Finding
    warnings : tuple of str
    """

    record: Record
    model: FittedModel
    prediction: "Prediction"
    scores: tuple[SetScore, ...]
    judged: str
    tests: dict[str, CorrelationTest]
    where: tuple[Finding, ...]
    warnings: tuple[str, ...]

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
            "noise_floor": {"nrmse": None, "method": None, "reason": NO_NOISE_FLOOR},
            "where": [finding.to_json() for finding in self.where],
            "tests": {name: test.to_json() for name, test in self.tests.items()},
            "ports": [],
            "warnings": list(self.warnings),
            "data": data_json(self.record),
            "sentences": self.sentences(),
        }

    def to_html(self) -> str:
        """Return the page as one self-contained HTML text."""
        from sysid.diagnosis.page import render

        return render(self)

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
        progress=progress,
    )
    prediction = fitted.predict(record)
    scores = _all_scores(record, fitted, prediction)
    judged, rows = _judged_rows(record)
    residual = record.y[rows, 0] - prediction.free_run[rows]
    tests = {"whiteness": whiteness(residual)}
    for index, name in enumerate(record.inputs):
        key = "input_residual" if len(record.inputs) == 1 else f"input_residual_{name}"
        tests[key] = input_independence(record.u[rows, index], residual)
    where = _time_findings(record, judged, rows, residual)
    return Comparison(record, fitted, prediction, scores, judged, tests, where, _warnings(record, fitted))


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


def _time_findings(record: Record, judged: str, rows: Mask, residual: "Floats") -> tuple[Finding, ...]:
    places = np.flatnonzero(rows)
    findings = []
    for window in worst_windows(residual):
        start, end = _seconds(record, places, window)
        findings.append(
            Finding(
                kind="time",
                region={
                    "set": judged,
                    "from_s": start,
                    "to_s": end,
                    "first_row": int(places[window.first]) + 1,
                    "last_row": int(places[window.last - 1]) + 1,
                },
                error_share=window.error_share,
                data_share=window.data_share,
                p_value=window.p_value,
                sentence=(
                    f"{percent(window.error_share)} of the squared error on {judged} lies "
                    f"between {significant(start, 4)} and {significant(end, 4)} s, "
                    f"{percent(window.data_share)} of the time."
                ),
            )
        )
    return tuple(findings)


def _seconds(
    record: Record, places: np.ndarray[tuple[int], np.dtype[np.int64]], window: Window
) -> tuple[float, float]:
    """Return start and end of a window in seconds from the start of its experiment."""
    first, last = int(places[window.first]), int(places[window.last - 1])
    origin = max(start for start in record.starts if start <= first)
    return (first - origin) * record.period, (last - origin + 1) * record.period


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
