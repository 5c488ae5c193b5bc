"""What to do next, in a sentence or two."""

from collections.abc import Sequence

from sysid.diagnosis.decide.decision import NOISE_EFFECT, Decision, Trial
from sysid.diagnosis.decide.residual_evidence import LEFT_P_VALUE
from sysid.diagnosis.decide.verdict import TRACE_SHARE
from sysid.diagnosis.experiment import Responding, separating_experiment
from sysid.diagnosis.structures.structure import Structure
from sysid.diagnosis.wording import all_of, percent

# An experiment tells two candidates apart if their outputs differ by so many deviations of the noise.
LEAST_SEPARATION = 4.0
STANDS_IN = ", but at the values found that is something else than its name says"
CUT_SHORT = (
    " The search ended before all combinations of effects were tried, for its simulations had taken as many "
    "steps as a search is given: go on to its end with --thorough (thorough=True)."
)
SIZE_FORETOLD = (
    "What is left follows neither input nor output, as noise does, but its size goes with the input or with "
    "how fast the output moves, as that of no sensor's noise: look for samples that are taken too early or "
    "too late, for a delay or a gain that changes from row to row, or for an input that did not act at times."
)
KEPT = (
    "The model is kept with --save FILE, and judged on another record with sysid compare RECORD --model FILE."
)
# Of a wide tie so many are named.
MOST_NAMED = 4


def advise(structure: Structure, decision: Decision, accepted: Sequence[str]) -> str:
    """Return advice that fits the verdict."""
    return _by_verdict(structure, decision, accepted) + (
        CUT_SHORT if decision.cut_short and not decision.fed_back else ""
    )


def _by_verdict(structure: Structure, decision: Decision, accepted: Sequence[str]) -> str:
    if decision.verdict == "not-identifiable":
        return (
            f"Searches of the model {structure.name!r} from different starts end at different answers: "
            "fix known parameters with --fix, give better starts with --param, or measure with a richer "
            "input."
        )
    if decision.size_foretold:
        return SIZE_FORETOLD
    if decision.verdict == "unexplained":
        left = f"{percent(decision.left_share)} of the explainable error"
        tried = all_of(decision.rejected)
        closest = f"with {tried} {left} is left" if tried else f"{left} is left"
        closest += STANDS_IN if decision.stands_in else ""
        if decision.resembled_at:
            place = f"one free-form curve at the {decision.resembled_at}"
            closest = f"{tried} stood in for something else: {place} explains as much"
        return (
            f"The model lacks something that no candidate explains ({closest}). Where a free-form curve at a "
            "port removes much of the error, --draft FILE writes it as an effect to edit and to give with "
            "--effects-file; where none does, look for a memory (play, hysteresis, a further state) or for "
            "an input that was not measured."
        )
    if decision.verdict == "nothing-missing":
        return "No effect needs to be added. " + KEPT + _loop(decision)
    if decision.verdict == "coloured-noise":
        return (
            "The disturbance has a memory but follows neither input nor output: model it as noise."
            + _loop(decision)
        )
    physical = [name for name in accepted if name != NOISE_EFFECT]
    found = [name for name in physical if name not in decision.given]
    refused = [name for name in decision.accepted if name not in (*accepted, *decision.given, NOISE_EFFECT)]
    sentence = _added(found) if found else _not_added(refused)
    if decision.given and not found:
        sentence = "Keep what was given."
    if physical and decision.left_p_value < LEFT_P_VALUE and decision.left_share > TRACE_SHARE:
        sentence += (
            f" {percent(decision.left_share)} of the explainable error is left, which nothing in the list "
            "explains: a detail of the plant beside them, or their laws are not quite these."
        )
    for tie in decision.ties:
        sentence += f" {_tie([trial.name for trial in tie])}{_experiment(structure, tie, decision.floor)}"
    return sentence + _loop(decision)


def _added(names: Sequence[str]) -> str:
    """Say that effects are in the model, and what can be done with it."""
    return f"{all_of(names)} {'were' if len(names) > 1 else 'was'} added. {KEPT}"


def _not_added(names: Sequence[str]) -> str:
    """Say that effects were found and are not in the model."""
    was, options = ("were", "--add for each") if len(names) > 1 else ("was", "--add")
    return (
        f"{all_of(names)} {was} found and not added: {options}, or --accept auto, puts that into the model."
    )


def _loop(decision: Decision) -> str:
    """Say what the input's part in the noise means."""
    if not decision.fed_back:
        return ""
    return (
        " The input goes with the noise of the same sample, as under a controller: it biases the parameters "
        "of a free-run fit. Excite the reference more, or measure with the loop open."
    )


def _experiment(structure: Structure, tie: Sequence[Trial], noise: float) -> str:
    """Say which experiment would separate the first two candidates of a tie."""
    first, second = (trial.fit for trial in tie[:2])
    if first is None or second is None or not isinstance(structure, Responding):
        return " Repeat the measurement with larger and with faster inputs."
    record = structure.record
    found = separating_experiment(structure, first, second, record.u[:, 0], noise)
    if found is None:
        return " Repeat the measurement with larger and with faster inputs."
    told = f"{tie[0].name} from {tie[1].name}"
    design = f"{found.n_samples} samples of {found.design}"
    if found.separation < LEAST_SEPARATION:
        return (
            f" No input within the range of this one would tell {told} ({design}: {found.separation:.2g} "
            f"standard deviations of the noise): {_same(tie)}."
        )
    return (
        f" {design} would separate {told} best: by {found.separation:.3g} standard deviations of the noise."
    )


def _same(tie: Sequence[Trial]) -> str:
    """Say what it means that two candidates do the same, where the second may hold the first as a case."""
    first, second = (trial.fit for trial in tie[:2])
    if first is not None and second is not None and second.n_parameters > first.n_parameters:
        return f"{tie[1].name} does the same with more parameters, and the simpler one is named"
    return "here they do the same, unless over a wider range"


def _tie(tie: Sequence[str]) -> str:
    """Name those of a tie that explain most."""
    named, more = tie[1:MOST_NAMED], len(tie) - MOST_NAMED
    others = f", nor from {more} more that explain less" if more > 0 else ""
    return f"The record cannot tell {tie[0]} from {' or '.join(named)}{others}."
