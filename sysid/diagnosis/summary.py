"""A comparison in words and in plain values."""

from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.data import Record
from sysid.diagnosis.residuals import CorrelationTest
from sysid.diagnosis.scores import Score, SetScore, finite
from sysid.diagnosis.wording import ordinal, percent, quantity

if TYPE_CHECKING:
    from sysid.diagnosis.compare import Comparison

# Correlations of fewer rows lie within their bands whatever the residual is.
FEWEST_TESTED_ROWS = 20


def sentences(comparison: "Comparison") -> list[str]:
    """Return what was found, the main thing first."""
    fit, judged = comparison.choice.fit, comparison.score_of(comparison.judged)
    output = comparison.record.outputs[0]
    free = judged.free_run
    window = f"{judged.n_rows} samples" + (f", skip {judged.skip}" if judged.skip else "")
    dead_time = fit.delay * fit.period
    acts = (
        "the input acts at once"
        if fit.delay == 0
        else f"the input acts after {fit.delay} sample{'s' * (fit.delay > 1)} ({quantity(dead_time, 's')})"
    )
    found = [
        f"A {ordinal(fit.order)}-order linear model {_explains(free, output, comparison.judged)}; "
        f"its free-run error is {error_size(judged)} ({window}).",
        f"In the model {acts}, {'with' if fit.structure.constant else 'without'} a constant.",
        comparison.choice.reason,
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
    choice, record = comparison.choice, comparison.record
    fit = choice.fit
    return {
        "name": "linear",
        "order": fit.order,
        "delay": fit.delay,
        "direct": fit.structure.direct,
        "constant": fit.structure.constant,
        "initial_state": "estimate" if fit.structure.free_start else "rest",
        "parameters": {
            name: {"value": finite(value), "std_error": finite(error), "unit": _parameter_unit(record, name)}
            for name, (value, error) in fit.parameters().items()
        },
        "poles": [[float(pole.real), float(pole.imag)] for pole in fit.poles],
        "converged": fit.converged,
        "restarts_agree": choice.restarts_agree,
        "status": fit.status,
        "reason": choice.reason,
        "candidates": [
            {
                "order": c.order,
                "delay": c.delay,
                "constant": c.constant,
                "validation_rmse": finite(c.validation_rms),
                "restarts_agree": c.restarts_agree,
            }
            for c in choice.candidates
        ],
    }


def _parameter_unit(record: Record, name: str) -> str:
    """Return the unit of a coefficient: none for a, output per input for b, output for the constant."""
    output = record.unit(record.outputs[0])
    if name == "constant":
        return output
    if not name.startswith("b"):
        return ""
    channel = int(name.split("_")[1]) - 1 if "_" in name else 0
    unit = record.unit(record.inputs[channel])
    if unit == output:
        return ""
    return f"{output or '1'}/{unit}" if unit else output


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
