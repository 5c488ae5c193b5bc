"""The leading candidates by the colour of their own residuals."""

from collections.abc import Sequence
from dataclasses import replace

from sysid.diagnosis.decide.acceptance import chance_under_own_noise
from sysid.diagnosis.decide.decision import Decision, Trial
from sysid.diagnosis.decide.evidence import ScoreScreen
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.decide.trials import POLISHED, Trials
from sysid.diagnosis.structures.structure import Effort, StructureFit

# How often a fit and the colour of its residual are brought to agree.
SETTLINGS = 2


def settled(trials: Trials, decision: Decision) -> Decision:
    """Return a decision whose leading candidates stand by the colour of their own residuals.

    They were weighted by the colour of what is left without them: no minima of their own likelihoods, so
    that their parameters would be off by more than their standard errors, and their p-values too small
    under slow noise.  What explains less than all of them is no less likely by chance.
    """
    n_given = len(decision.given)
    before = decision.fits[n_given - 1] if n_given else decision.baseline
    leading = [
        _settled(trials.evidence, trial)
        for trial in _by_own_noise(trials, decision.trials[:POLISHED], before)
    ]
    least = min((trial.p_value for trial in leading if trial.fit is not None), default=0.0)
    others = [replace(trial, p_value=max(trial.p_value, least)) for trial in decision.trials[POLISHED:]]
    return replace(decision, trials=(*leading, *others))


def _by_own_noise(trials: Trials, leading: Sequence[Trial], before: StructureFit) -> list[Trial]:
    """Return trials with the chance that they explain as much under noise as slow as it is.

    Where the bound on that chance says that nothing is missing, all of the residual is noise, so that
    its colour is known and the distribution of the largest score can be had without a bound.
    """
    evidence, found = trials.evidence, []
    screen: ScoreScreen | None = None
    for trial in leading:
        if trial.fit is None or trial.noise.order == 0:
            found.append(trial)
            continue
        chance = chance_under_own_noise(evidence, trial, before)
        if chance >= evidence.alpha:
            if screen is None:
                noise = evidence.noise(before)
                candidates = [e for e in trials.candidates if e.name not in before.names]
                screen = trials.screen(evidence.refitted(before, noise), candidates, noise)
            chance = min(chance, screen.p_value(screen.statistics[trial.name]))
        found.append(replace(trial, p_value=max(trial.p_value, chance)))
    return found


def _settled(evidence: Evidence, trial: Trial) -> Trial:
    structure, rows = evidence.structure, evidence.rows
    for _ in range(SETTLINGS):
        if trial.fit is None:
            break
        noise = evidence.noise(trial.fit)
        fit = structure.fit(trial.fit.choices, rows, noise.polynomial, trial.fit, effort=Effort.REFIT)
        if not fit.usable:
            break
        trial = replace(trial, fit=fit, noise=noise)
    return trial
