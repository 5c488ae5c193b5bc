"""A model that grows by one effect after the other while all evidence agrees."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from sysid.diagnosis.decide.acceptance import is_accepted, is_accepted_at, is_significant, tied
from sysid.diagnosis.decide.allowance import REVISED
from sysid.diagnosis.decide.decision import Trial
from sysid.diagnosis.decide.noise_colour import WHITE_NOISE
from sysid.diagnosis.decide.revision import (
    among_its_kind,
    exchanged,
    freed,
    pruned,
    reordered,
    simplified,
    still_tied,
)
from sysid.diagnosis.decide.rungs import rungs_to
from sysid.diagnosis.decide.stand_ins import stand_in
from sysid.diagnosis.decide.trials import POLISHED, Trials
from sysid.diagnosis.effects.base import Effect
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort, StructureFit

# A minimum whose criterion is so much lower is another one, as by chance once in twenty times.
ANOTHER = 6.0


class Grown(NamedTuple):
    """What came of growing: fits with one, two, ... effects, the single candidates, and ties."""

    fits: list[StructureFit]
    trials: tuple[Trial, ...]
    ties: tuple[tuple[Trial, ...], ...]


@dataclass(frozen=True, eq=False)
class Growth:
    """Adds effects to a model.

    Attributes
    ----------
    trials : Trials
        By which candidates are fitted.
    given : tuple of Effect
        Effects that are in the model whatever the evidence.
    max_effects : int
        Most effects beside those.
    """

    trials: Trials
    given: tuple[Effect, ...]
    max_effects: int

    def given_fits(self, baseline: StructureFit) -> list[StructureFit]:
        """Return the fits with one, two, ... of the given effects."""
        fits: list[StructureFit] = []
        for effect in self.given:
            current = fits[-1] if fits else baseline
            trial = self.trials.best_form(current, effect, effect.found_by, WHITE_NOISE, Effort.FINE)
            if trial.fit is not None:
                fits.append(trial.fit)
        return fits

    def grown(
        self, baseline: StructureFit, fits: list[StructureFit], n_given: int, n_kept: int | None = None
    ) -> Grown:
        """Add effects while all evidence agrees.

        Parameters
        ----------
        baseline : StructureFit
            The model without effects.
        fits : list of StructureFit
            With one, two, ... effects that it starts from.
        n_given : int
            How many of these are there whatever the evidence.
        n_kept : int, optional
            How many of these are neither exchanged nor left out again; as many as are given by default.
        """
        evidence = self.trials.evidence
        n_kept = n_given if n_kept is None else n_kept
        trials: tuple[Trial, ...] = ()
        ties: dict[str, tuple[Trial, ...]] = {}
        while len(fits) < self.max_effects + n_given:
            current = fits[-1] if fits else baseline
            further = len(fits) > n_given
            found = self.trials.beside(current, further)
            if not further:
                trials = found
            best = found[0] if found else None
            if best is None or best.fit is None:
                break
            chosen = self._first_accepted(found, current, baseline, further)
            if chosen is not None and not further:
                chosen = self._in_its_own_right(chosen, found, current, baseline)
            if chosen is not None and chosen.fit is not None:
                grown = chosen.fit
                found = (chosen, *(trial for trial in found if trial is not chosen))
                trials = trials if further else found
            else:
                pair = self._with_another(best, current, baseline, len(fits))
                if pair is None:
                    break
                grown = pair
            ties[found[0].name] = tied(evidence, found)
            if len(grown.choices) > n_given + 1:
                revised = self.trials.allowance.permits(REVISED)
                if revised:
                    grown = exchanged(self.trials, grown, n_kept)
                grown = among_its_kind(self.trials, grown, n_kept, simpler=not revised)
                grown = simplified(evidence, pruned(evidence, grown, n_kept), n_kept)
            grown = freed(evidence, reordered(evidence, grown, n_kept), n_kept)
            grown = evidence.settled(grown)
            if evidence.own_criterion(grown) >= evidence.own_criterion(current):
                break  # what was accepted has been exchanged or left out again
            better = self._better_with_fewer(current, grown, found[0], baseline) if further else None
            if better is not None:
                fits[-1] = better  # what was accepted beside a poor fit is asked again
                del ties[found[0].name]
                if self.trials.allowance.permits(REVISED):
                    continue
                break
            fits = rungs_to(evidence.structure, evidence.rows, grown, baseline, n_given)
        stand = [still_tied(self.trials, fits[-1], tie) for tie in ties.values() if tie and fits]
        return Grown(fits, trials, tuple(tie for tie in stand if tie))

    def _better_with_fewer(
        self, current: StructureFit, grown: StructureFit, trial: Trial, baseline: StructureFit
    ) -> StructureFit | None:
        """Return a clearly better fit than the one before, to which a further effect has led the way.

        Then that effect was needed to leave a poor minimum, or for another to take the place of the first,
        and may be for nothing else: it is asked again while that may take work, and must hold beside it.
        """
        evidence = self.trials.evidence
        noise, limit = evidence.noise(current).polynomial, evidence.own_criterion(current) - ANOTHER
        grew = set(current.names) < set(grown.names)
        for choices in self._fewer(grown, current, grew):
            other = evidence.structure.fit(choices, evidence.rows, noise, grown, effort=Effort.REFIT)
            if not other.usable or evidence.own_criterion(other) > limit:
                continue
            again = grew and self.trials.allowance.permits(REVISED)
            if again or not is_accepted_at(evidence, trial, grown, other, baseline, True):
                return other
        return None

    def _fewer(self, grown: StructureFit, current: StructureFit, grew: bool) -> list[tuple[Choice, ...]]:
        """Return as many of a fit's effects as another has: the same ones if it ``grew`` from these."""
        if grew:
            return [tuple(choice for choice in grown.choices if choice.name in current.names)]
        if len(grown.choices) != len(current.choices) + 1:
            return []
        spare = grown.choices[len(self.given) :]
        return [tuple(choice for choice in grown.choices if choice is not left_out) for left_out in spare]

    def _first_accepted(
        self, trials: Sequence[Trial], current: StructureFit, baseline: StructureFit, further: bool
    ) -> Trial | None:
        """Return the best of the leading candidates on which all evidence agrees.

        Where the best by the criterion does not hold on held-out rows, one that predicts them better may.
        """
        evidence = self.trials.evidence
        for trial in trials[:POLISHED]:
            leads = trial is trials[0] or trial.validation < trials[0].validation
            if trial.fit is not None and leads and is_accepted(evidence, trial, current, baseline, further):
                return trial
        return None

    def _in_its_own_right(
        self, chosen: Trial, trials: Sequence[Trial], current: StructureFit, baseline: StructureFit
    ) -> Trial:
        """Return the candidate itself, or its equal if it but stands in for something else.

        A law at an end of its parameters, where it is another one, explains as much as that one does, and
        may lead by chance: of the two the other is the name.
        """
        evidence = self.trials.evidence
        if evidence.smooth or not self._stands_in(chosen):
            return chosen
        equals = tied(evidence, (chosen, *(trial for trial in trials if trial is not chosen)))[1:]
        for trial in equals:
            if is_accepted(evidence, trial, current, baseline, False) and not self._stands_in(trial):
                return trial
        return chosen

    def _stands_in(self, trial: Trial) -> bool:
        """Tell whether the fit of a first effect stands in for something else."""
        assert trial.fit is not None
        evidence = self.trials.evidence
        return stand_in(evidence, trial.fit, False, evidence.noise_accepted(trial.fit, trial.noise))

    def _with_another(
        self, best: Trial, current: StructureFit, baseline: StructureFit, n_before: int
    ) -> StructureFit | None:
        """Return a pair of effects that holds on held-out rows where the better one alone does not."""
        evidence = self.trials.evidence
        no_place = n_before + 2 > self.max_effects + len(self.given)
        # Where everything is significant a pair is no more than a detail in two parts.
        no_place = no_place or (evidence.smooth and n_before > len(self.given))
        if best.fit is None or no_place or not is_significant(evidence, best):
            return None
        if not self.trials.allowance.permits(REVISED):
            return None
        found = self.trials.beside(best.fit, True)
        if not found or found[0].fit is None:
            return None
        # The first was fitted without the second: search it again beside it.
        pair = exchanged(self.trials, found[0].fit, len(self.given))
        pair = reordered(evidence, pair, len(self.given))
        noise, validation = evidence.noise(pair), evidence.held_out_error(pair, WHITE)
        second = replace(found[0], fit=pair, noise=noise, validation=validation)
        return pair if is_accepted(evidence, second, current, baseline, n_before > 0) else None
