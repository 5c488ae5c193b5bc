"""What to do next, in a sentence or two."""

from collections.abc import Sequence

from sysid.diagnosis.decide import NOISE_EFFECT
from sysid.diagnosis.decision import Decision
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
        sentence += f" The record cannot tell {' from '.join(decision.tie)}."
    return sentence
