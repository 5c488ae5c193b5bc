"""What to do next, in a sentence or two."""

from collections.abc import Sequence

from sysid.diagnosis.decide import NOISE_EFFECT
from sysid.diagnosis.decision import Decision
from sysid.diagnosis.experiment import Responding, separating_experiment
from sysid.diagnosis.structures import Structure


def advise(structure: Structure, decision: Decision, accepted: Sequence[str]) -> str:
    """Return advice that fits the verdict."""
    if decision.verdict == "not-identifiable":
        return (
            f"Searches of the model {structure.name!r} from different starts end at different answers: "
            "fix known parameters with --fix, give better starts with --param, or measure with a richer "
            "input."
        )
    if decision.verdict == "unexplained":
        tried = ", ".join(decision.rejected) or "none of the candidates"
        return (
            f"The model lacks something that no candidate explains ({tried} came closest, but "
            f"{100 * decision.left_share:.2g} % of the explainable error is left): look at the free-form "
            "curves of `sysid compare`, write the effect in TOML and give it with --effects-file."
        )
    if decision.verdict == "nothing-missing":
        return "Nothing is missing: what is left of the error is noise."
    if decision.verdict == "coloured-noise":
        return "The disturbance has a memory but follows neither input nor output: model it as noise."
    physical = [name for name in accepted if name != NOISE_EFFECT]
    sentence = f"Add {' and '.join(physical)}." if physical else "The effect that was found was not added."
    if len(decision.tie) > 1:
        sentence += (
            f" The record cannot tell {' from '.join(decision.tie)}.{_experiment(structure, decision)}"
        )
    return sentence


def _experiment(structure: Structure, decision: Decision) -> str:
    """Say which experiment would separate the first two candidates of a tie."""
    fits = {trial.name: trial.fit for trial in decision.trials}
    first, second = fits.get(decision.tie[0]), fits.get(decision.tie[1])
    if first is None or second is None or not isinstance(structure, Responding):
        return " Repeat the measurement with larger and with faster inputs."
    record = structure.record
    found = separating_experiment(structure, first, second, record.u[:, 0], decision.floor)
    if found is None:
        return " Repeat the measurement with larger and with faster inputs."
    return (
        f" {found.n_samples} samples of {found.design} would separate {decision.tie[0]} from "
        f"{decision.tie[1]} best: by {found.separation:.3g} standard deviations of the noise."
    )
