"""The scores of a prediction on each set of rows: estimation, validation, tests."""

from typing import TYPE_CHECKING

import numpy as np

from sysid.data import Record
from sysid.data.record import ESTIMATION_LABELS, Mask
from sysid.diagnosis.comparison.scores import SetScore, nrmse_interval, score
from sysid.diagnosis.models.fitted_model import FittedModel, Known

if TYPE_CHECKING:
    from sysid.linear.simulation import Prediction


def judged_rows(record: Record) -> tuple[str, Mask]:
    """Return name and rows of the set that is spoken of: the first test set, or the validation rows."""
    for name in record.test_sets:
        rows = record.scored_rows(name)
        if rows.sum() > 1:
            return name, rows
    return "validation", record.validation


def set_scores(record: Record, model: FittedModel, prediction: "Prediction") -> tuple[SetScore, ...]:
    """Return the scores on the rows of the fit, on validation rows, and on each test set."""
    label = record.estimation_label
    learned = np.isin(record.split, ESTIMATION_LABELS)
    both, first = "estimation and validation rows", "estimation rows"
    if isinstance(model, Known):
        both = first = model.fitted_on
    scores = [_set_score(record, label, learned, prediction, 0, both)] if learned.any() else []
    if record.validation.any():
        honest = model.predict_held_out(record)
        scores.append(_set_score(record, "validation", record.validation, honest, 0, first))
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
