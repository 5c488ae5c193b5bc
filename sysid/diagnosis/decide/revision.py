"""Effects that were found earlier, seen again beside those found later: exchanged or left out."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sysid.diagnosis.decide.allowance import THIRD
from sysid.diagnosis.decide.decision import Trial
from sysid.diagnosis.decide.evidence import told_apart
from sysid.diagnosis.decide.noise_colour import Noise
from sysid.diagnosis.decide.paths import begun_elsewhere
from sysid.diagnosis.decide.residual_evidence import SAME_CRITERION, Evidence
from sysid.diagnosis.decide.trials import Trials
from sysid.diagnosis.effects.base import Effect
from sysid.diagnosis.effects.input_maps import SWITCHES
from sysid.diagnosis.structures.sides import freer_forms, sibling_forms
from sysid.diagnosis.structures.structure import Choice, Effort, StructureFit, filtered
from sysid.diagnosis.structures.thresholds import is_switched_by_input

# How many are tried in the place of one that was accepted before.
EXCHANGED = 6
# How many of these are also tried before the effects that were found later.
LEADING = 3
# Ports at which one effect is given what the one before it makes.
MAPS = ("input", "output")


def exchanged(trials: Trials, fit: StructureFit, n_given: int) -> StructureFit:
    """Try to replace each earlier effect by another: the first was chosen before the others."""
    evidence = trials.evidence
    position = n_given
    for _ in range(n_given, len(fit.choices)):
        if position >= len(fit.choices) - 1:
            break
        others = tuple(choice for i, choice in enumerate(fit.choices) if i != position)
        noise = evidence.colour(fit)
        without = evidence.structure.fit(others, evidence.rows, noise.polynomial, fit, effort=Effort.REFIT)
        found: list[Trial] = []
        if without.usable:
            options = [effect for effect in trials.candidates if effect.name not in without.names]
            statistics = trials.screen(without, options, noise).statistics
            options.sort(key=lambda effect: -statistics[effect.name])
            found = trials.ranked(without, options[:EXCHANGED], noise)
        best = evidence.better_of(fit, _in_place(evidence, found, position), noise)
        # What comes to stand in its place was chosen beside the one that is gone: it is next.
        if best is fit or not trials.allowance.permits(THIRD):
            position += 1
        fit = best
    return fit


def among_its_kind(trials: Trials, fit: StructureFit, n_given: int, *, simpler: bool = False) -> StructureFit:
    """Try others of its kind in the place of each force and each switch, all else as it stands.

    The first was chosen without the others, and may be more than is missing.  Without any of its kind the
    plant is lost, so that no search from there comes back, nor does a screen there tell what to search.
    Where little work is left, only the ``simpler`` ones are tried, those with fewer parameters.
    """
    evidence = trials.evidence
    for position in range(n_given, len(fit.choices)):
        choice = fit.choices[position]
        for effect in trials.candidates:
            if effect.name in fit.names or not _of_one_kind(effect, choice.effect):
                continue
            for form in effect.found_by:
                if simpler and len(form.parameters) >= len(choice.form.parameters):
                    continue
                choices = list(fit.choices)
                choices[position] = Choice(effect, form)
                fit = _better_from(evidence, fit, choices, (Effort.REFIT, Effort.COARSE))
    return fit


def _of_one_kind(effect: Effect, other: Effect) -> bool:
    if "force" in (effect.port, other.port):
        return effect.port == other.port and effect.dry == other.dry
    return effect.name in SWITCHES and other.name in SWITCHES


def _in_place(evidence: Evidence, found: Sequence[Trial], position: int) -> list[StructureFit]:
    """Return the leading ones of some trials, also before the effects that were found later.

    What takes the place of an effect at one port with these may have to stand where that one stood.
    """
    leading = [trial.fit for trial in found[:LEADING] if trial.fit is not None]
    moved = [reordered(evidence, fit, position) for fit in leading]
    return [*moved, *leading]


def freed(evidence: Evidence, fit: StructureFit, n_given: int) -> StructureFit:
    """Give each earlier effect the freedom that was too much for it alone, such as sides of their own.

    Its form was chosen before the others were there: what they moved hid how its sides differ, or where it
    stood before the first row, and a further effect would mend it.
    """
    fit = _with_thresholds_again(evidence, fit, n_given)
    for position in range(n_given, len(fit.choices)):
        choice = fit.choices[position]
        beside_others = len(fit.choices) > n_given + 1
        for form in (*(sibling_forms(choice) if beside_others else ()), *freer_forms(choice)):
            choices = list(fit.choices)
            choices[position] = replace(choices[position], form=form)
            fit = _better_from(evidence, fit, choices, (Effort.REFIT,))
    return fit


def _with_thresholds_again(evidence: Evidence, fit: StructureFit, n_given: int) -> StructureFit:
    """Search the thresholds of earlier effects again beside later ones: no descent moves what jumps."""
    for choice in fit.choices[n_given:-1]:
        if is_switched_by_input(fit.choices, fit.choices.index(choice)) and not _feeds_another(fit, choice):
            others = [other for other in fit.choices if other is not choice]
            fit = _better_from(evidence, fit, (*others, choice), (Effort.FINE,))
    return fit


def without_idle(evidence: Evidence, fit: StructureFit, n_given: int) -> StructureFit:
    """Leave out each effect without which the others, from where they stand, explain as much.

    A law that was searched beside it may have found what it had missed alone, not by help of the other.
    """
    for choice in fit.choices[n_given:-1]:
        noise, others = evidence.colour(fit), tuple(other for other in fit.choices if other is not choice)
        lean = evidence.structure.fit(others, evidence.rows, noise.polynomial, fit, effort=Effort.REFIT)
        limit = evidence.criterion(fit, noise) + SAME_CRITERION
        fit = lean if lean.usable and evidence.criterion(lean, noise) <= limit else fit
    return fit


def reordered(evidence: Evidence, fit: StructureFit, n_given: int) -> StructureFit:
    """Let an effect act after others at its port where that explains more.

    Which of two maps comes first, a limit or a gain that drifts, has nothing to do with which of them was
    found first.
    """
    for choice in fit.choices[n_given:-1]:
        if _feeds_another(fit, choice):
            others = [other for other in fit.choices if other is not choice]
            # A limit stands elsewhere after what it was put before: it is also searched anew.
            fit = _better_from(evidence, fit, (*others, choice), (Effort.REFIT, Effort.COARSE))
    for choice in fit.choices[n_given:-1]:
        if _feeds_another(fit, choice) and choice.form.shapes:
            fit = _searched_beside(evidence, fit, choice)
    return begun_elsewhere(evidence, fit, evidence.colour(fit), n_given)


def _feeds_another(fit: StructureFit, choice: Choice) -> bool:
    """Tell whether an effect is a map before another one at its port."""
    behind = fit.choices[fit.choices.index(choice) + 1 :]
    return choice.effect.port in MAPS and any(other.effect.port == choice.effect.port for other in behind)


def _searched_beside(evidence: Evidence, fit: StructureFit, choice: Choice) -> StructureFit:
    """Search a map anew that stands before another, where it lies in the range of that one.

    A dead zone before a jump is at first as wide as both of them together make it, and from there the jump
    shows nothing.
    """
    structure, noise, rows = evidence.structure, evidence.colour(fit), evidence.rows
    others = [other for other in fit.choices if other is not choice]
    without = structure.fit(others, rows, noise.polynomial, fit, effort=Effort.REFIT)
    if not without.usable:
        return fit
    found = structure.fit(fit.choices, rows, noise.polynomial, without, effort=Effort.COARSE)
    return evidence.better_of(fit, [found], noise)


def _better_from(
    evidence: Evidence, fit: StructureFit, choices: Sequence[Choice], efforts: Sequence[Effort]
) -> StructureFit:
    """Return the best fit of other choices from where a fit stands, or that fit where none is better."""
    noise, rows = evidence.colour(fit), evidence.rows
    found = [
        evidence.structure.fit(choices, rows, noise.polynomial, fit, effort=effort) for effort in efforts
    ]
    return evidence.better_of(fit, found, noise)


def simplified(evidence: Evidence, fit: StructureFit, n_given: int) -> StructureFit:
    """Leave out an effect where another one, given sides of its own, explains as much without it.

    A two-sided form of an effect is tried alone only where its simple form leads: one that is very uneven
    may look in its simple form like nothing, and beside the offset that it brings with it like itself.
    """
    shorter = True
    while shorter:
        shorter = False
        noise = evidence.colour(fit)
        for choices in _with_one_less(fit, n_given):
            other = _with_effects(evidence, fit, choices, noise)
            if other.usable and evidence.criterion(other, noise) <= evidence.criterion(fit, noise):
                fit, shorter = other, True
                break
    return fit


def _with_effects(
    evidence: Evidence, fit: StructureFit, choices: tuple[Choice, ...], noise: Noise
) -> StructureFit:
    """Return the better of two fits of some effects: from where they stand, and with the changed one anew."""
    structure, rows = evidence.structure, evidence.rows
    names = [choice.name for choice in choices]
    stay = tuple(choice for choice in fit.choices if choice.name in names)
    before = structure.fit(stay, rows, noise.polynomial, fit, effort=Effort.REFIT)
    found = [
        structure.fit(choices, rows, noise.polynomial, start, effort=effort)
        for start, effort in ((fit, Effort.REFIT), (before, Effort.COARSE))
    ]
    return min(found, key=lambda other: evidence.criterion(other, noise) if other.usable else np.inf)


def _with_one_less(fit: StructureFit, n_given: int) -> Iterator[tuple[Choice, ...]]:
    """Yield the effects of a fit without one of them, and with more freedom for another."""
    for left_out in fit.choices[n_given:]:
        others = [choice for choice in fit.choices if choice is not left_out]
        for place, choice in enumerate(others[n_given:], n_given):
            for form in freer_forms(choice):
                yield (*others[:place], replace(choice, form=form), *others[place + 1 :])


def still_tied(trials: Trials, fit: StructureFit, tie: tuple[Trial, ...]) -> tuple[Trial, ...]:
    """Return who of a tie still stands beside the effects that were found after it.

    Candidates look alike that differ where an effect that was not yet found has left its own error.

    Parameters
    ----------
    trials : Trials
    fit : StructureFit
        With all effects.
    tie : tuple of Trial
        The accepted effect and those that could not be told from it when it was found.

    Returns
    -------
    tuple of Trial
        The same beside all others; empty where it is told from each, or gone.
    """
    evidence, first = trials.evidence, tie[0].name
    if first not in fit.names:
        return ()
    if len(fit.choices) < 2:
        return tie
    others = tuple(choice for choice in fit.choices if choice.name != first)
    noise, rows = evidence.colour(fit), evidence.structure.record.learning
    without = evidence.structure.fit(others, evidence.rows, noise.polynomial, fit, effort=Effort.REFIT)
    own = filtered(evidence.residual(fit), rows, noise.polynomial)
    stand, names = [], [trial.name for trial in tie[1:]]
    for effect in trials.candidates:
        if effect.name not in names or effect.name in fit.names or not without.usable:
            continue
        trial = trials.best_form(without, effect, effect.found_by, noise, Effort.COARSE)
        if trial.fit is None:
            continue
        left = filtered(evidence.residual(trial.fit), rows, noise.polynomial)
        if not told_apart(own, left):
            stand.append(trial)
    best = replace(tie[0], fit=fit, noise=noise)
    return (best, *sorted(stand, key=lambda trial: trial.criterion)) if stand else ()


def pruned(evidence: Evidence, fit: StructureFit, n_given: int) -> StructureFit:
    """Leave out effects that the information criterion does not want any more."""
    while len(fit.choices) > max(n_given, 1):
        noise = evidence.colour(fit)
        smaller = [
            evidence.structure.fit(
                tuple(choice for choice in fit.choices if choice is not left),
                evidence.rows,
                noise.polynomial,
                fit,
                effort=Effort.REFIT,
            )
            for left in fit.choices[n_given:]
        ]
        criteria = [evidence.criterion(other, noise) if other.usable else np.inf for other in smaller]
        best = smaller[int(np.argmin(criteria))]
        if min(criteria) > evidence.criterion(fit, noise):
            break
        fit = best
    return fit
