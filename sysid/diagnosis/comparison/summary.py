"""A comparison in words and in plain values."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.data import Record
from sysid.diagnosis.comparison.scores import Score, SetScore
from sysid.diagnosis.residuals import BAND_LEVEL, EXACT, CorrelationTest
from sysid.diagnosis.wording import all_of, percent, quantity
from sysid.result_files import finite

if TYPE_CHECKING:
    from sysid.diagnosis.comparison.judgement import Judgement

# Correlations of fewer rows lie within their bands whatever the residual is.
FEWEST_TESTED_ROWS = 20
NEGLIGIBLE = 0.05
# A static map is named in the summary if it removes at least this share of the error.
WORTH_TELLING = 0.1
SMALLEST_FLOOR = 1e-4
# Name of the test between residual and input; with several inputs, their names follow.
INPUT_RESIDUAL = "input_residual"
# Start of the names of tests on the size of the residual.
SIZE = "squared_residual"
NOWHERE = "the error is spread over time, levels, velocities and frequencies as chance would spread it"


def sentences(comparison: "Judgement") -> list[str]:
    """Return what was found, the main thing first."""
    judged = comparison.score_of(comparison.judged)
    output = comparison.record.outputs[0]
    window = f"{judged.n_rows} samples" + (f", skip {judged.skip}" if judged.skip else "")
    found = [
        f"{comparison.model.subject} {_explains(judged.free_run, output, comparison.judged)}; "
        f"its free-run error is {error_size(judged)} ({window}).",
    ]
    if judged.free_run.nrmse < EXACT:
        exact = (
            f"Nothing but rounding is left: {output!r} was computed, not measured, or is the input once more."
        )
        return [*found, exact, *comparison.model.notes]
    if floor := _floor_sentence(comparison, judged):
        found.append(floor)
    found += [finding.sentence for finding in comparison.where]
    if judged.n_rows < FEWEST_TESTED_ROWS:
        found.append(
            f"The {judged.n_rows} samples of {comparison.judged} are too few to tell whether the residual is "
            "white or follows the input."
        )
        return [*found, *comparison.model.notes]
    if not comparison.where:
        found.append(f"Nothing of note fails locally on {comparison.judged}: {NOWHERE}.")
    found += linear_test_sentences(comparison)
    found.append(_nonlinear_sentence(comparison))
    found += [port.sentence for port in comparison.ports[:1] if port.explains_at_most >= WORTH_TELLING]
    if comparison.distortion.available:
        found.append(f"{comparison.distortion.reason}.")
    return [*found, *comparison.model.notes, *_next_step(comparison)]


def _next_step(comparison: "Judgement") -> list[str]:
    """Say what to do where something is left that a linear or physical model may lack."""
    from sysid.diagnosis.models.adapters import LinearModel, PhysicalModel

    tests = nonlinear_tests_of(comparison)
    left = not comparison.tests["whiteness"].passed or any(not test.passed for test in tests.values())
    if not left or not isinstance(comparison.model, LinearModel | PhysicalModel):
        return []
    return ["What is missing in the model is looked for by sysid diagnose, with the same options."]


def linear_test_sentences(comparison: "Judgement") -> list[str]:
    """Return what whiteness and cross-correlation say."""
    judged, inputs = comparison.judged, comparison.record.inputs
    tests = {name: t for name, t in comparison.tests.items() if name.startswith(INPUT_RESIDUAL)}
    followed = [_follows_sentence(name, test, judged) for name, test in tests.items() if not test.passed]
    free = [place for place, test in enumerate(tests.values()) if test.passed]
    if free:
        named = "the input" if len(inputs) == 1 else _listed([repr(inputs[place]) for place in free])
        followed.append(f"No linear trace of {named} is left in the residual on {judged}.")
    return [_whiteness_sentence(comparison.tests["whiteness"], judged), *followed]


def _listed(names: Sequence[str]) -> str:
    """Join names as a sentence does.

    Examples
    --------
    >>> _listed(["a", "b", "c"])
    'a, b or c'
    """
    return " or ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]


def nonlinear_tests_of(comparison: "Judgement") -> dict[str, CorrelationTest]:
    """Return the tests for nonlinear traces."""
    return {
        name: test
        for name, test in comparison.tests.items()
        if not name.startswith(("whiteness", INPUT_RESIDUAL))
    }


def _nonlinear_sentence(comparison: "Judgement") -> str:
    tests = nonlinear_tests_of(comparison)
    # One sentence for several tests: each counts as one of so many looks.
    level = (1.0 - BAND_LEVEL) / max(len(tests), 1)
    traces = [name for name, test in tests.items() if test.p_value < level]
    if not traces:
        return f"No nonlinear trace of input or output is left in the residual on {comparison.judged}."
    sizes = [_followed(name) for name in traces if name.startswith(SIZE)]
    means = [_followed(name) for name in traces if not name.startswith(SIZE)]
    told = [f"it follows {all_of(means)}"] if means else []
    told += [f"its size follows {all_of(sizes)}"] if sizes else []
    return f"The residual on {comparison.judged} holds nonlinear traces: {'; '.join(told)}."


def spoken(name: str) -> str:
    """Say what a nonlinear test compares.

    Examples
    --------
    >>> spoken("residual_squared_input")
    'the residual follows the squared input'
    """
    return f"the {'size of the residual' if name.startswith(SIZE) else 'residual'} follows {_followed(name)}"


def _followed(name: str) -> str:
    power, _, signal = name.removeprefix("squared_").removeprefix("residual_").partition("_")
    return f"the {power} {signal.replace('_', ' ')}"


def _floor_sentence(comparison: "Judgement", judged: SetScore) -> str:
    floor, error = comparison.noise_floor, judged.free_run.nrmse
    if not (np.isfinite(floor.nrmse) and np.isfinite(error)):
        return ""
    left = max(_as_shown(error) - _as_shown(floor.nrmse), 0.0)
    if left < NEGLIGIBLE * error:
        return f"The error is {percent(error)} of the signal, and noise explains all of it ({floor.method})."
    if floor.repeated:
        return (
            f"The error is {percent(error)} of the signal; noise explains {percent(min(floor.nrmse, error))} "
            f"({floor.method}), so {percent(left)} is the model's."
        )
    if floor.wide and (most := min(floor.upper_nrmse, error)) > SMALLEST_FLOOR:
        least_left = max(_as_shown(error) - _as_shown(most), 0.0)
        least = "up to " if least_left < NEGLIGIBLE * error else f"{percent(least_left)} to "
        if percent(least_left) == percent(left):
            least = ""
        return (
            f"The error is {percent(error)} of the signal; noise explains {percent(floor.nrmse)} to "
            f"{percent(most)} ({floor.method}), so {least}{percent(left)} is the model's or a slow "
            "disturbance, which only repetitions could tell apart."
        )
    noise = percent(floor.nrmse) if floor.nrmse > SMALLEST_FLOOR else f"less than {percent(SMALLEST_FLOOR)}"
    return (
        f"The error is {percent(error)} of the signal; noise explains {noise} "
        f"({floor.method}), so {percent(left)} is the model's or a slow disturbance, which only repetitions "
        "could tell apart."
    )


def _as_shown(share: float) -> float:
    """Return a share as the reader sees it, so that what is shown adds up."""
    return float(percent(share).removesuffix(" %")) / 100.0


def _explains(free: Score, output: str, judged: str) -> str:
    if not np.isfinite(free.nrmse):
        return f"is judged on {judged}, where {output!r} is constant and has no variance to explain"
    return f"explains {percent(max(1.0 - free.nrmse**2, 0.0))} of the variance of {output!r} on {judged}"


def error_size(judged: SetScore) -> str:
    """Return the free-run error in the unit of the output and, unless that is constant, as a share of it."""
    free = judged.free_run
    share = f", {percent(free.nrmse)} of the signal" if np.isfinite(free.nrmse) else ""
    return f"{quantity(free.rmse, judged.unit)} RMSE{share}"


def _whiteness_sentence(test: CorrelationTest, judged: str) -> str:
    if test.passed:
        return f"The free-run residual on {judged} is white: its past does not tell its future."
    return (
        f"The free-run residual on {judged} is not white ({test.outside} of {test.lags.size} lags "
        "outside their 99 % band): it holds coloured noise or dynamics that the model lacks."
    )


def _follows_sentence(name: str, test: CorrelationTest, judged: str) -> str:
    named = name.removeprefix(INPUT_RESIDUAL).removeprefix("_")
    worst = int(test.lags[np.argmax(np.abs(test.correlation) / test.band)])
    samples = f"{abs(worst)} sample{'s' * (abs(worst) != 1)}"
    when = "of the same sample" if not worst else f"{samples} {'before' if worst > 0 else 'after'} it"
    hint = (
        ", as a slow input, feedback or columns that are not aligned in time bring about" if worst < 0 else ""
    )
    return (
        f"The residual on {judged} still follows {repr(named) if named else 'the input'} linearly "
        f"(most the input {when}{hint}; {test.outside} of {test.lags.size} lags outside their 99 % band)."
    )


def model_json(comparison: "Judgement") -> dict[str, Any]:
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
