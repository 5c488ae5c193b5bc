"""Whether all evidence agrees that an effect is there, and which candidates cannot be told apart."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.diagnosis.decide.alignment import chance_at_other_times
from sysid.diagnosis.decide.decision import Trial
from sysid.diagnosis.decide.evidence import TIED, block_separation, chance_of, told_apart
from sysid.diagnosis.decide.modes import settles, swings
from sysid.diagnosis.decide.noise_colour import WHITE_NOISE
from sysid.diagnosis.decide.residual_evidence import LEFT_P_VALUE, SEEN_P_VALUE, Evidence
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.structures.structure import WHITE, StructureFit, filtered

# A further effect must explain this share of what all effects explain, or it is a detail of the first.  Less
# is enough where only white noise is left after it, or where it explains so many times what is left, or so
# much of the free-run error on held-out rows: a run that is lost without the first effect dwarfs all else.
# Where everything is significant the latter is asked for, too.
LEAST_SHARE, LARGE_STEP, LEAST_FALL = 0.01, 2.0, 0.1
# The median of the absolute value of a normal variable of variance 1.
NORMAL_MEDIAN = 0.6745
# Behind a quantiser errors count up to so many times what most of them are.
LARGEST_ERROR = 3.0
# An effect may explain as much at one of a hundred other times.
MOST_AT_OTHER_TIMES = 0.02


def is_accepted(
    evidence: Evidence, trial: Trial, current: StructureFit, baseline: StructureFit, further: bool
) -> bool:
    """Tell whether all evidence agrees that an effect is there.

    Parameters
    ----------
    evidence : Evidence
    trial : Trial
        Candidate that was fitted.
    current : StructureFit
        The model without it.
    baseline : StructureFit
        The model without any effect.
    further : bool
        Whether another effect was found before: then this one must not be a mere detail of it.
    """
    assert trial.fit is not None
    agreed = (
        is_significant(evidence, trial)
        and evidence.own_criterion(trial.fit) < evidence.own_criterion(current)
        and chance_under_own_noise(evidence, trial, current) < evidence.alpha
    )
    longest = evidence.structure.record.longest
    if not agreed or not (swings(trial.fit, longest) and settles(trial.fit, longest)):
        return False
    if rests_on_few_rows(evidence, trial, current):
        return False
    if not _holds(evidence, trial, current):
        # What shows in the first rows alone, as the start of a play does, held-out rows cannot tell.
        untold = further and not evidence.smooth and _is_not_refuted(evidence, trial, current)
        return untold and _explains_the_rest(evidence, trial, current, baseline)
    matters = trial.validation < (1.0 - LEAST_FALL) * evidence.held_out_error(current, WHITE)
    if further and evidence.smooth:
        if not matters:
            return False
    elif further and _explains_the_rest(evidence, trial, current, baseline):
        return True
    if chance_off_the_motion(evidence, trial, current) > MOST_AT_OTHER_TIMES:
        return False
    left = evidence.cost(trial.fit, WHITE_NOISE)
    whole = evidence.cost(baseline, WHITE_NOISE) - left
    step = evidence.cost(current, WHITE_NOISE) - left
    return not further or step > min(LEAST_SHARE * whole, LARGE_STEP * left) or matters


def is_accepted_at(
    evidence: Evidence,
    trial: Trial,
    fit: StructureFit,
    current: StructureFit,
    baseline: StructureFit,
    further: bool,
) -> bool:
    """Tell whether all evidence agrees that an effect is there, by another fit than that of its trial.

    Parameters
    ----------
    evidence : Evidence
    trial : Trial
        Of any candidate of the same round.
    fit : StructureFit
        With the effect.
    current, baseline : StructureFit
        Without it, and without any.
    further : bool
        Whether another effect was found before.
    """
    gain = evidence.own_criterion(current) - evidence.own_criterion(fit)
    noise, validation = evidence.noise(fit), evidence.held_out_error(fit, WHITE)
    found = replace(trial, fit=fit, noise=noise, gain=gain, validation=validation)
    found = replace(found, p_value=_chance_over_white(evidence, found, current))
    return is_accepted(evidence, found, current, baseline, further)


def _explains_the_rest(
    evidence: Evidence, trial: Trial, current: StructureFit, baseline: StructureFit
) -> bool:
    """Tell whether something was clearly left before, and nothing but white noise is now.

    A form with more freedom can do most of what a second effect does, and the motion need not tell: an
    offset is the same at any time.  A detail of an effect that is not there leaves something itself, unless
    two more effects mend it together.
    """
    assert trial.fit is not None
    if trial.noise.order > 0 or len(trial.fit.choices) > len(current.choices) + 1:
        return False
    chance = _chance_over_white(evidence, trial, current)
    if chance >= LEFT_P_VALUE:  # where this candidate shows little, probes of all kinds may show more
        chance = evidence.left(baseline, current, evidence.rows)[0]
    return chance < LEFT_P_VALUE and evidence.left(baseline, trial.fit, evidence.rows)[0] >= SEEN_P_VALUE


def is_significant(evidence: Evidence, trial: Trial) -> bool:
    """Tell whether a candidate explains more than chance does, and more than its parameters cost."""
    return trial.p_value < evidence.alpha and trial.gain > 0.0


def chance_under_own_noise(evidence: Evidence, trial: Trial, current: StructureFit) -> float:
    """Return the chance that a candidate explains as much, by the colour of what it leaves itself.

    What the probes leave has less slow noise than there is, for they follow it as they would follow an
    effect.  With the true effect its own residual has the colour of the noise; without any, of all.
    """
    assert trial.fit is not None
    if trial.noise.order == 0:
        return trial.p_value
    before = evidence.refitted(current, trial.noise)
    after = evidence.refitted(trial.fit, trial.noise)
    left = min(evidence.cost(fit, trial.noise) for fit in (trial.fit, after) if fit.usable)
    return _chance(evidence, trial, current, evidence.cost(before, trial.noise), left)


def rests_on_few_rows(evidence: Evidence, trial: Trial, current: StructureFit) -> bool:
    """Tell whether an effect behind a quantiser, or beside one, does no more than move single rows.

    Where the output is at the edge of a cell next to nothing moves a row to the other side of it, and one
    such row may weigh as much as a hundred others: any freedom explains it.
    """
    assert trial.fit is not None
    if not any(choice.effect.port == "output" and choice.form.jumps for choice in trial.fit.choices):
        return False
    before, after = (
        filtered(evidence.residual(fit), evidence.rows, trial.noise.polynomial)
        for fit in (current, trial.fit)
    )
    size = float(np.median(np.abs(after))) / NORMAL_MEDIAN
    if size == 0.0:
        return False
    limit = LARGEST_ERROR * size
    costs = (float(np.sum(np.clip(error, -limit, limit) ** 2)) for error in (before, after))
    return _chance(evidence, trial, current, *costs) >= evidence.alpha


def _chance_over_white(evidence: Evidence, trial: Trial, current: StructureFit) -> float:
    """Return the chance that a candidate explains as much of white noise."""
    assert trial.fit is not None
    costs = (evidence.cost(fit, WHITE_NOISE) for fit in (current, trial.fit))
    return _chance(evidence, trial, current, *costs)


def _chance(evidence: Evidence, trial: Trial, current: StructureFit, before: float, after: float) -> float:
    """Return the chance that the cost falls so far at one of all looks."""
    assert trial.fit is not None
    ratio = (before - after) / max(after, 1e-300) * int(evidence.rows.sum())
    return chance_of(ratio, trial.fit.n_parameters - current.n_parameters, trial.looks)


def chance_off_the_motion(evidence: Evidence, trial: Trial, current: StructureFit) -> float:
    """Return the chance that an effect explains as much of what does not follow the record's motion."""
    assert trial.fit is not None
    structure, rows, noise = evidence.structure, evidence.rows, trial.noise
    before, after = (evidence.refitted(fit, noise) for fit in (current, trial.fit))
    if not before.usable or not after.usable:
        before, after = current, trial.fit
    parts = (
        evidence.residual(before),
        structure.tangent(before),
        after.output - before.output,
        structure.tangent(after),
    )
    return chance_at_other_times(*(filtered(part, rows, noise.polynomial) for part in parts))


def _holds(evidence: Evidence, trial: Trial, current: StructureFit) -> bool:
    """Tell whether an effect holds on held-out rows.

    The free-run error must fall and the innovations not rise by more than chance.  Under coloured
    noise the free-run error of a small effect is a matter of luck: then the innovations must fall
    and the free-run error not rise by more than chance.
    """
    assert trial.fit is not None
    after = evidence.residual(trial.fit)

    def errors(noise: Floats, before: StructureFit) -> tuple[float, float]:
        first = filtered(evidence.residual(before), evidence.held_out, noise)
        second = filtered(after, evidence.held_out, noise)
        return float(second @ second - first @ first), block_separation(first, second)

    innovations = errors(trial.noise.polynomial, evidence.refitted(current, trial.noise))
    free_run = errors(WHITE, current)
    if free_run[0] < 0.0:
        return innovations[1] < TIED
    return trial.noise.order > 0 and innovations[0] < 0.0 and free_run[1] < TIED


def _is_not_refuted(evidence: Evidence, trial: Trial, current: StructureFit) -> bool:
    """Tell whether the free-run error on held-out rows does not rise by more than chance."""
    assert trial.fit is not None
    before, after = (evidence.residual(fit)[evidence.held_out] for fit in (current, trial.fit))
    return block_separation(before, after) < TIED


def is_better_held_out(evidence: Evidence, fit: StructureFit, other: StructureFit) -> bool:
    """Tell whether a fit is better by its criterion and by its free run on held-out rows."""
    return evidence.own_criterion(fit) < evidence.own_criterion(other) and evidence.held_out_error(
        fit, WHITE
    ) < evidence.held_out_error(other, WHITE)


def tied(evidence: Evidence, trials: Sequence[Trial]) -> tuple[Trial, ...]:
    """Return the first candidate with those that a paired block test cannot tell from it."""
    best = trials[0]
    assert best.fit is not None
    noise, rows = best.noise.polynomial, evidence.structure.record.learning
    own = filtered(evidence.residual(best.fit), rows, noise)
    equals = [
        trial
        for trial in trials[1:]
        if trial.fit is not None
        and is_significant(evidence, trial)
        and not told_apart(own, filtered(evidence.residual(trial.fit), rows, noise))
        and not (evidence.smooth and (1.0 - LEAST_FALL) * trial.validation > best.validation)
    ]
    return (best, *equals) if equals else ()
