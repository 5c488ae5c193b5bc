"""A comparison in words and in plain values."""

from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.data import Record
from sysid.diagnosis.residuals import CorrelationTest
from sysid.diagnosis.scores import Score, SetScore, finite
from sysid.diagnosis.wording import percent, quantity

if TYPE_CHECKING:
    from sysid.diagnosis.compare import Comparison

# Correlations of fewer rows lie within their bands whatever the residual is.
FEWEST_TESTED_ROWS = 20


def sentences(comparison: "Comparison") -> list[str]:
    """Return what was found, the main thing first."""
    judged = comparison.score_of(comparison.judged)
    output = comparison.record.outputs[0]
    window = f"{judged.n_rows} samples" + (f", skip {judged.skip}" if judged.skip else "")
    found = [
        f"{comparison.model.subject} {_explains(judged.free_run, output, comparison.judged)}; "
        f"its free-run error is {error_size(judged)} ({window}).",
        *comparison.model.notes,
    ]
    if judged.n_rows < FEWEST_TESTED_ROWS:
        found.append(
            f"The {judged.n_rows} samples of {comparison.judged} are too few to tell whether the residual is "
            "white or follows the input."
        )
    else:
        found += [_test_sentence(name, test, comparison.judged) for name, test in comparison.tests.items()]
    found += [finding.sentence for finding in comparison.where]
    return found


def _explains(free: Score, output: str, judged: str) -> str:
    if not np.isfinite(free.nrmse):
        return f"is judged on {judged}, where {output!r} is constant and has no variance to explain"
    return f"explains {percent(max(1.0 - free.nrmse**2, 0.0))} of the variance of {output!r} on {judged}"


def error_size(judged: SetScore) -> str:
    """Return the free-run error in the unit of the output and, unless that is constant, as a share of it."""
    free = judged.free_run
    share = f", {percent(free.nrmse)} of the signal" if np.isfinite(free.nrmse) else ""
    return f"{quantity(free.rmse, judged.unit)} RMSE{share}"


def _test_sentence(name: str, test: CorrelationTest, judged: str) -> str:
    if name == "whiteness":
        if test.passed:
            return f"The free-run residual on {judged} is white: its past does not tell its future."
        return (
            f"The free-run residual on {judged} is not white ({test.outside} of {test.lags.size} lags "
            "outside their 99 % band): it holds coloured noise or dynamics that the model lacks."
        )
    if test.passed:
        return f"No linear trace of the input is left in the residual on {judged}."
    worst = int(test.lags[np.argmax(np.abs(test.correlation) / test.band)])
    return (
        f"The residual on {judged} still follows the input linearly (largest at lag {worst}; "
        f"{test.outside} of {test.lags.size} lags outside their 99 % band)."
    )


def model_json(comparison: "Comparison") -> dict[str, Any]:
    """Return the model's part of the JSON file."""
    model = comparison.model
    return {
        "name": model.name,
        "order": model.order,
        "initial_state": model.initial_state,
        "parameters": {
            name: {
                "value": finite(p.value),
                "std_error": None if p.std_error is None else finite(p.std_error),
                "unit": p.unit,
            }
            for name, p in model.parameters.items()
        },
        "converged": model.converged,
        "restarts_agree": model.restarts_agree,
        "status": model.status,
        **model.details(),
    }


def data_json(record: Record) -> dict[str, Any]:
    """Return the record's part of the JSON file."""
    return {
        "name": record.name,
        "rows": record.n_samples,
        "period_s": record.period,
        "inputs": list(record.inputs),
        "outputs": list(record.outputs),
        "units": dict(record.units),
        "experiments": list(record.experiments),
        "sha256": record.sha256,
    }
