"""Where a path beside the plant begins: before the maps of the input, or behind them as the plant does."""

from dataclasses import replace

from sysid.diagnosis.decide.noise_colour import Noise
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.structures.structure import Effort, StructureFit


def begun_elsewhere(evidence: Evidence, fit: StructureFit, noise: Noise, n_given: int = 0) -> StructureFit:
    """Let a path beside the plant begin behind the actuator, or before it, where that explains more.

    Parameters
    ----------
    evidence : Evidence
    fit : StructureFit
    noise : Noise
        By which fits are compared.
    n_given : int
        How many effects stay as they are.
    """
    if not any(choice.effect.port == "input" for choice in fit.choices):
        return fit
    for place, choice in enumerate(fit.choices[n_given:], n_given):
        for form in choice.effect.forms if choice.effect.port == "parallel" else ():
            if form.behind == fit.choices[place].form.behind or form.inside:
                continue
            choices = list(fit.choices)
            choices[place] = replace(choice, form=form)
            other = evidence.structure.fit(choices, evidence.rows, noise.polynomial, fit, effort=Effort.REFIT)
            fit = evidence.better_of(fit, [other], noise)
    return fit
